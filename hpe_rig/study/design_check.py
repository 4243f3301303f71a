"""Monte Carlo of one scene: the twin's echoes and the scene's own estimator, against which the model is checked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpe_rig.estimation import driven_frequencies_hz, options_of, skipped_pulses
from hpe_rig.jitter_model import Setting
from hpe_rig.plan import Plan, slow_time_window
from hpe_rig.processing import EchoGate, estimate
from hpe_rig.scene import Scene
from hpe_rig.study.design_model import Baseline, echo_power, twin_settings

Floats = NDArray[np.float64]
TOLERANCE = 1e-7


@dataclass(frozen=True, slots=True)
class Measured:
    """A mean or a standard deviation over draws, and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, slots=True)
class Simulated:
    """Bias and jitter, eq. (14) and (15), of one scene; a draw is new scatterers and new noise."""

    draws: int
    bias_m: Measured
    jitter_m: Measured
    phase_jitter_rad: Measured


def simulate(scene: Scene, plan: Plan, setting: Setting, start: Baseline, draws: int, seed: int) -> Simulated:
    """Return what ``draws`` draws make of the first shot of ``scene``, moved at its first frequency alone.

    Beams, pulse length, amplitude and SNR are the model's, ``setting``; scatterers are the twin's. The noise of a draw
    is that of a receiver that sees the draw's own resting echo in the reference gate at the starting scene's SNR.
    """
    found = [part for chunk in _chunks(scene, plan, setting, start, draws, seed) for part in chunk]
    amplitude_m, phase_rad = np.array(found).T
    mean = np.angle(np.mean(np.exp(1j * phase_rad)))
    return Simulated(
        draws,
        Measured(float(amplitude_m.mean()) - setting.amplitude_m, float(amplitude_m.std(ddof=1)) / math.sqrt(draws)),
        deviation(amplitude_m),
        deviation(np.angle(np.exp(1j * (phase_rad - mean)))),
    )


def deviation(values: Floats) -> Measured:
    """Return the standard deviation of ``values`` and its standard error, from their fourth moment."""
    centred = values - values.mean()
    variance, fourth = float(np.mean(centred**2)), float(np.mean(centred**4))
    spread = math.sqrt(max(fourth - variance**2, 0.0) / values.size)
    return Measured(math.sqrt(variance), spread / (2 * math.sqrt(variance)) if variance > 0 else 0.0)


def _chunks(
    scene: Scene, plan: Plan, setting: Setting, start: Baseline, draws: int, seed: int
) -> Iterator[list[tuple[float, float]]]:
    from sim_backend.echo_batch import drawn_echoes
    from sim_backend.pulse import hann_pulse

    shot = plan.shots[0]
    inside = slow_time_window(scene, shot)
    time_s = shot.timeline.sensing_s[inside] - shot.timeline.reference_s
    valid = ~skipped_pulses(scene, shot)[inside]
    moved_m = setting.amplitude_m * np.sin(2 * np.pi * setting.frequency_hz * time_s)
    samples = shot.gate.stop - shot.gate.start
    reference = round(2 * start.gate_length_m / setting.sound_speed_m_per_s * setting.sample_rate_hz)
    most = max(samples, reference)
    sample_s = (np.arange(most) - (most - 1) / 2) / setting.sample_rate_hz
    gate, still = (slice((most - count) // 2, (most - count) // 2 + count) for count in (samples, reference))
    bandwidth = setting.sound_speed_m_per_s / 2 / (setting.pulse_length_m * setting.carrier_hz)
    settings = twin_settings(scene)
    beams = settings.beams.model_copy(
        update={
            "excitation_width_m": setting.excitation_width_m,
            "tracking_width_m": setting.tracking_width_m,
            "width_ratio": None,
        }
    )
    settings = settings.model_copy(update={"beams": beams})
    echo_rng, noise_rng = (np.random.default_rng([seed, stream]) for stream in (0, 1))
    # The first pulse at rest: it tells the noise.
    displacement_m = np.concatenate(([0.0], moved_m))
    pulse = hann_pulse(setting.carrier_hz, bandwidth)
    # SNR in the reference gate, of the pulse of this scene
    in_reference = setting.snr * echo_power(setting, start.gate_length_m) / echo_power(setting, setting.gate_length_m)
    frequencies_hz, also_hz = np.array(scene.wanted_frequencies_hz), driven_frequencies_hz(scene)
    for echoes in drawn_echoes(settings, displacement_m, pulse, sample_s, echo_rng, draws, TOLERANCE):
        power = np.mean(np.square(echoes[:, 0, still]), axis=-1)[:, None, None]
        volts = np.asarray(echoes[:, 1:, gate], dtype=np.float64)
        volts = volts + np.sqrt(power / in_reference) * noise_rng.standard_normal(volts.shape)
        gated = EchoGate(volts, setting.sample_rate_hz, time_s, setting.carrier_hz, setting.sound_speed_m_per_s, valid)
        fit = estimate(gated, frequencies_hz, scene.processing.estimator, also_hz, options_of(scene.processing))
        yield list(zip(fit.amplitude_m[:, 0].tolist(), fit.phase_rad[:, 0].tolist(), strict=True))
