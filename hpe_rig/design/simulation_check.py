"""Monte Carlo of one scene: the twin's echoes and the scene's own estimator, against which the model is checked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.bench import twin_settings
from hpe_rig.design.model import Baseline, echo_power_of
from hpe_rig.plan import Plan, driven_frequencies_hz, select
from hpe_rig.prediction import Conditions, beam_widths
from hpe_rig.processing import EchoGate, estimate, margin_samples, options_of, shot_prior
from hpe_rig.scene import Scene
from hpe_rig.study import Errors, errors

if TYPE_CHECKING:
    from sim_backend.settings import SimulationSettings

TOLERANCE = 1e-7
DRAWS_AT_ONCE = 16
MOST_VALUES = 1 << 27
"""Samples of a chunk of draws, 1 GiB, up to which a scene is simulated."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """Bias and jitter, eq. (14) and (15), of one scene; a draw is new scatterers and new noise."""

    amplitude_m: Errors
    phase_rad: Errors


def simulate(scene: Scene, plan: Plan, setting: Conditions, start: Baseline, draws: int, seed: int) -> Simulated | None:
    """Return what ``draws`` draws make of the first shot of ``scene``; None where 16 of them do not fit the memory.

    Moved at the first frequency alone, at a phase of its own in each draw. Beams, pulse length, amplitude and SNR are
    the model's, ``setting``; scatterers are the twin's. The noise of a draw is that of a receiver that sees the draw's
    own resting echo in the reference gate at the starting scene's SNR.
    """
    train = _train(scene, plan, setting, start)
    if train.values > MOST_VALUES:
        return None
    amplitude_m, phase_rad = np.concatenate(list(_deviations(scene, plan, setting, train, draws, seed))).T
    return Simulated(errors(amplitude_m[:, None]), errors(phase_rad[:, None]))


@dataclass(frozen=True, slots=True)
class _Train:
    """When the pulses of a shot sense the motion (pulse,), which count, and where in fast time they are seen.

    Of the samples (sample,) those in ``around`` are the gate's, ``margin`` of them at either end outside it.
    """

    time_s: FloatArray
    valid: BoolArray
    sample_s: FloatArray
    around: slice
    margin: int
    reference: slice
    reference_snr: float

    @property
    def values(self) -> int:
        return DRAWS_AT_ONCE * self.time_s.size * self.sample_s.size


def _train(scene: Scene, plan: Plan, setting: Conditions, start: Baseline) -> _Train:
    shot = plan.shots[0]
    chosen = select(scene, shot)
    gate_m = start.gate_length_m
    reference = round(2 * gate_m / setting.sound_speed_m_per_s * setting.sample_rate_hz)
    counts = shot.gate.stop - shot.gate.start, max(reference, 1)
    # a record goes on at both ends of the gate
    margin = margin_samples(setting.sample_rate_hz, setting.carrier_hz)
    counts = counts[0] + 2 * margin, counts[1]
    most = max(counts)
    around, still = (slice((most - count) // 2, (most - count) // 2 + count) for count in counts)
    return _Train(
        chosen.time_s,
        chosen.used,
        (np.arange(most) - (most - 1) / 2) / setting.sample_rate_hz,
        around,
        margin,
        still,
        setting.snr * echo_power_of(setting, gate_m) / echo_power_of(setting, setting.gate_length_m),
    )


def _deviations(
    scene: Scene, plan: Plan, setting: Conditions, train: _Train, draws: int, seed: int
) -> Iterator[FloatArray]:
    """Yield the deviations of amplitude, m, and phase, rad, of 16 draws at a time: (draw, 2)."""
    from sim_backend.echoes import drawn_echoes, hann_pulse

    echo_rng, noise_rng, phase_rng = (np.random.default_rng([seed, stream]) for stream in range(3))
    phase_rad = phase_rng.uniform(-np.pi, np.pi, draws)
    angle = 2 * np.pi * setting.frequency_hz * train.time_s + phase_rad[:, None]
    # The first pulse finds everything at rest: it tells the noise.
    moved_m = np.concatenate([np.zeros((draws, 1)), setting.amplitude_m * np.sin(angle)], axis=1)
    bandwidth = setting.sound_speed_m_per_s / 2 / (setting.pulse_length_m * setting.carrier_hz)
    pulse, settings = hann_pulse(setting.carrier_hz, bandwidth), _twin(scene, setting)
    frequencies_hz, also_hz = np.array(scene.wanted_frequencies_hz), driven_frequencies_hz(scene)
    estimator = scene.processing.estimator
    if shot_prior(scene, plan.shots[0], estimator, beam_widths(scene, estimator)) is not None:
        # One sinusoid is no medium's answer; it costs as little noise as the prior to fit the wanted ones alone.
        also_hz = np.zeros(0)
    first = 0
    for echoes in drawn_echoes(settings, moved_m, pulse, train.sample_s, echo_rng, draws, TOLERANCE):
        power = np.mean(np.square(echoes[:, 0, train.reference]), axis=-1)[:, None, None]
        volts = noise_rng.standard_normal(echoes[:, 1:, train.around].shape)
        volts *= np.sqrt(power / train.reference_snr)
        volts += echoes[:, 1:, train.around]
        gated = EchoGate(
            volts,
            setting.sample_rate_hz,
            train.time_s,
            setting.carrier_hz,
            setting.sound_speed_m_per_s,
            train.valid,
            (train.margin, train.margin),
        )
        fit = estimate(gated, frequencies_hz, estimator, also_hz, options_of(scene.processing))
        turned = fit.phase_rad[:, 0] - phase_rad[first : first + len(echoes)]
        yield np.stack([fit.amplitude_m[:, 0] - setting.amplitude_m, np.angle(np.exp(1j * turned))], axis=-1)
        first += len(echoes)


def _twin(scene: Scene, setting: Conditions) -> SimulationSettings:
    settings = twin_settings(scene)
    widths = {"excitation_width_m": setting.excitation_width_m, "tracking_width_m": setting.tracking_width_m}
    beams = settings.beams.model_copy(update={**widths, "width_ratio": None})
    return settings.model_copy(update={"beams": beams})
