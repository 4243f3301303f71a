"""Monte Carlo check of the model for one scene: the twin's echoes and the scene's estimator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.bench import twin_settings
from hpe_rig.design.model import Baseline, power_in_gate
from hpe_rig.plan import Plan, driven_frequencies_hz, select
from hpe_rig.prediction import Conditions, beam_widths
from hpe_rig.processing import EchoGate, estimate, margin_samples, options_of, shot_prior
from hpe_rig.scene import Scene
from hpe_rig.study import Errors, errors

if TYPE_CHECKING:
    from sim_backend.settings import SimulationSettings

TOLERANCE = 1e-7
"""Error of the echoes, rms relative to rms."""
DRAWS_AT_ONCE = 16
MAX_VALUES = 1 << 27
"""Samples in a chunk of draws, 1 GiB, above which a scene is not simulated."""


def simulate(
    scene: Scene, plan: Plan, setting: Conditions, start: Baseline, draws: int, seed: int
) -> tuple[Errors, Errors] | None:
    """Return bias and jitter of amplitude, m, and phase, rad, of the first shot of ``scene``, eq. (14) and (15).

    Each of ``draws`` draws has new scatterers and new noise. None if 16 draws exceed the memory. The motion has the
    first frequency only, with a random phase in each draw. Beams, pulse length, amplitude and SNR are those of the
    model, ``setting``; the scatterers are the twin's. The noise of a draw is set by the power of its echo at rest in
    the reference gate and the starting scene's SNR.
    """
    train = _train(scene, plan, setting, start)
    if DRAWS_AT_ONCE * train.time_s.size * train.sample_s.size > MAX_VALUES:
        return None
    amplitude_m, phase_rad = np.concatenate(list(_deviations(scene, plan, setting, train, draws, seed))).T
    return errors(amplitude_m[:, None]), errors(phase_rad[:, None])


@dataclass(frozen=True, slots=True)
class _Train:
    """Sampling times of the motion by the pulses of a shot (pulse,), their validity, and the fast-time samples.

    ``gate`` selects the gate and ``margin`` samples at each end; ``reference`` the gate with the SNR ``reference_snr``.
    """

    time_s: FloatArray
    valid: BoolArray
    sample_s: FloatArray
    gate: slice
    margin: int
    reference: slice
    reference_snr: float


def _train(scene: Scene, plan: Plan, setting: Conditions, start: Baseline) -> _Train:
    shot = plan.shots[0]
    selection = select(scene, shot)
    gate_m = start.gate_length_m
    reference = round(2 * gate_m / setting.sound_speed_m_per_s * setting.sample_rate_hz)
    # A record continues beyond both ends of the gate.
    margin = margin_samples(setting.sample_rate_hz, setting.carrier_hz)
    counts = shot.gate.stop - shot.gate.start + 2 * margin, max(reference, 1)
    # Both gates have the same centre.
    samples = max(counts)
    gate, reference_gate = (slice((samples - count) // 2, (samples - count) // 2 + count) for count in counts)
    return _Train(
        time_s=selection.time_s,
        valid=selection.used,
        sample_s=(np.arange(samples) - (samples - 1) / 2) / setting.sample_rate_hz,
        gate=gate,
        margin=margin,
        reference=reference_gate,
        reference_snr=setting.snr * power_in_gate(setting, gate_m) / power_in_gate(setting, setting.gate_length_m),
    )


def _deviations(
    scene: Scene, plan: Plan, setting: Conditions, train: _Train, draws: int, seed: int
) -> Iterator[FloatArray]:
    """Yield the errors of amplitude, m, and phase, rad, of 16 draws at a time, (draw, 2)."""
    from sim_backend.echoes import drawn_echoes, hann_pulse

    echo_rng, noise_rng, phase_rng = (np.random.default_rng([seed, stream]) for stream in range(3))
    phase_rad = phase_rng.uniform(-np.pi, np.pi, draws)
    angle = 2 * np.pi * setting.frequency_hz * train.time_s + phase_rad[:, None]
    # The first echo is that of the specimen at rest, which sets the noise.
    displacement_m = np.concatenate([np.zeros((draws, 1)), setting.amplitude_m * np.sin(angle)], axis=1)
    bandwidth = setting.sound_speed_m_per_s / 2 / (setting.pulse_length_m * setting.carrier_hz)
    pulse, settings = hann_pulse(setting.carrier_hz, bandwidth), _twin(scene, setting)
    frequencies_hz, other_driven_hz = np.array(scene.wanted_frequencies_hz), driven_frequencies_hz(scene)
    estimator = scene.processing.estimator
    if shot_prior(scene, plan.shots[0], estimator, beam_widths(scene, estimator)) is not None:
        # The prior does not apply to a single sinusoid. A fit of the wanted frequencies alone has about the same noise.
        other_driven_hz = np.zeros(0)
    first = 0
    for echoes in drawn_echoes(settings, displacement_m, pulse, train.sample_s, echo_rng, draws, TOLERANCE):
        power = np.mean(np.square(echoes[:, 0, train.reference]), axis=-1)[:, None, None]
        volts = noise_rng.standard_normal(echoes[:, 1:, train.gate].shape)
        volts *= np.sqrt(power / train.reference_snr)
        volts += echoes[:, 1:, train.gate]
        gated = EchoGate(
            volts,
            setting.sample_rate_hz,
            train.time_s,
            setting.carrier_hz,
            setting.sound_speed_m_per_s,
            train.valid,
            (train.margin, train.margin),
        )
        fit = estimate(gated, frequencies_hz, estimator, other_driven_hz, options_of(scene.processing))
        phase_error = fit.phase_rad[:, 0] - phase_rad[first : first + len(echoes)]
        yield np.stack([fit.amplitude_m[:, 0] - setting.amplitude_m, np.angle(np.exp(1j * phase_error))], axis=-1)
        first += len(echoes)


def _twin(scene: Scene, setting: Conditions) -> SimulationSettings:
    """Return the twin's settings with the beams of the model."""
    settings = twin_settings(scene)
    widths = {"excitation_width_m": setting.excitation_width_m, "tracking_width_m": setting.tracking_width_m}
    beams = settings.beams.model_copy(update={**widths, "width_ratio": None})
    return settings.model_copy(update={"beams": beams})
