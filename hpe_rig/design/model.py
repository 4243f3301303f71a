"""Model of a candidate scene: its SNR, amplitude, bias and jitter, relative to those of the starting scene."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hpe_rig.bench import BenchFile, twin_of, twin_settings
from hpe_rig.medium import echo_power
from hpe_rig.plan import Plan, Shot
from hpe_rig.prediction import (
    BOX_HALF_WIDTH_SIGMAS,
    Conditions,
    EstimatorErrors,
    Scattering,
    Speckle,
    conditions_of,
    draw_scattering,
    estimator_errors,
    expected_snr_db,
    noise_gain,
    relative_drive,
    time_base_uncertainty,
)
from hpe_rig.processing import EchoGate, band_frequencies_hz
from hpe_rig.scene import Mistake, Scene, SettingsError

CELLS = 256
"""Depth cells for the sum over scatterers: 23 um for the paper's beam, a tenth of a three-cycle pulse."""
LOG_WIDTH_STEP = 0.05
"""Step of the grid of beam widths, in logarithms: interpolation on it has an error of 1e-4 of the peak."""
_SCATTERING_FIELDS = ("excitation_width_m", "tracking_width_m", "scatterers_per_m3")
# Fixed values for all fields that the scattering does not depend on, so that the cache finds equal draws.
_OTHER_FIELDS: dict[str, Any] = {field.name: 1 for field in fields(Conditions) if field.name not in _SCATTERING_FIELDS}


@dataclass(frozen=True, slots=True)
class Baseline:
    """Gate, pulse and drive of the starting scene, for which its SNR and amplitude hold."""

    gate_length_m: float
    cycles: int
    drive: float


def baseline(scene: Scene) -> Baseline:
    """Return the baseline of ``scene``; raise ``SettingsError`` with every input of the model that it lacks."""
    mistakes = []
    if scene.beams is None:
        mistakes.append(Mistake("beams", "the model needs the beams' widths", "a [beams] section"))
    if expected_snr_db(scene) is None:
        what = "the model needs the echo's SNR, and the scene does not state it"
        mistakes.append(Mistake("processing.expected_snr_db", what, "the SNR in the gate, such as 40.0"))
    if not scene.wanted_frequencies_hz:
        what = "the scene has no vibration frequency to estimate"
        mistakes.append(Mistake("processing.frequencies_hz", what, "the frequency to design for, such as [200.0]"))
    if mistakes:
        raise SettingsError("the scene", mistakes)
    gate_m = scene.acquisition.gate_length_m
    if scene.processing.expected_snr_db is None:
        # The twin's SNR holds in its reference gate.
        gate_m = twin_settings(scene).receiver.reference_gate_m
    return Baseline(gate_m, scene.tracking.cycles, relative_drive(scene, scene.wanted_frequencies_hz[0]))


def design_setting(scene: Scene, plan: Plan, start: Baseline) -> Conditions:
    """Return the conditions of bias and jitter for the scene's first shot and first frequency.

    In addition to ``conditions_of``, the noise is constant, so the SNR follows the echo's power; a declared SNR also
    follows the echo's depth profile in the gate. The amplitude follows the force. Raises ``ValueError`` if the pulses
    cannot resolve the frequencies, or the gate is too short for the estimators' band.
    """
    _require_band(plan.shots[0], scene)
    noise_gain(scene, plan.shots[0])  # raises ValueError for unresolved frequencies, which conditions_of ignores
    setting = conditions_of(scene, plan.shots[0])
    assert setting is not None  # noqa: S101 (baseline has refused such a scene)
    # The noise stays, so that the SNR follows the power of the echo.
    snr = setting.snr * relative_echo_power(scene, start)
    if scene.processing.expected_snr_db is not None:
        snr *= power_in_gate(setting, setting.gate_length_m) / power_in_gate(setting, start.gate_length_m)
    amplitude_m = setting.amplitude_m
    drive = relative_drive(scene, setting.frequency_hz, plan.shots[0])
    if drive > 0 and start.drive > 0 and not _simulates_specimen(scene):
        amplitude_m *= drive / start.drive
    return replace(setting, snr=snr, amplitude_m=max(amplitude_m, 1e-15))


def clock_phase_u(scene: Scene, plan: Plan, setting: Conditions, bench: BenchFile) -> float:
    """Return the u that the clocks add to the phase of the first frequency, rad, as ``check`` predicts it.

    SNR and a declared amplitude are those of ``setting``.
    """
    plain = conditions_of(scene, plan.shots[0])
    snr_db = expected_snr_db(scene)
    if plain is None or snr_db is None:
        return 0.0
    expected = {"expected_snr_db": snr_db + 10 * math.log10(setting.snr / plain.snr)}
    if scene.processing.expected_amplitude_m is not None:
        expected["expected_amplitude_m"] = setting.amplitude_m
    expected_scene = scene.model_copy(update={"processing": scene.processing.model_copy(update=expected)})
    return float(time_base_uncertainty(expected_scene, bench, plan.shots[0])[2][0])


def effective_pulses(scene: Scene, plan: Plan) -> int:
    """Return the number of pulses, evenly spread over whole cycles, with the same noise of the first frequency.

    Skipped pulses, and correlated frequencies and background in the fit, reduce it. Raises ``ValueError`` if the pulses
    cannot resolve the frequencies.
    """
    return max(1, round(2 / float(noise_gain(scene, plan.shots[0])[0]) ** 2))


def _require_band(shot: Shot, scene: Scene) -> None:
    """Raise ``ValueError`` if the gate is too short for the estimators' band."""
    gate, tracking = shot.gate, scene.tracking
    silent = np.zeros((1, gate.stop - gate.start))
    rate_hz, speed_m_per_s = shot.capture.sample_rate_hz, scene.acquisition.sound_speed_m_per_s
    echoes = EchoGate(silent, rate_hz, np.zeros(1), tracking.carrier_hz, speed_m_per_s, np.ones(1, dtype=bool))
    band_frequencies_hz(echoes, silent.size)


def relative_echo_power(scene: Scene, start: Baseline) -> float:
    """Return the power of the echo relative to the starting scene's pulse.

    With a declared received length, that of the transducer, a longer pulse raises the amplitude in proportion. Else it
    fills more of the gate and raises the power in proportion.
    """
    declared = scene.beams is not None and scene.beams.pulse_length_m is not None
    return float((scene.tracking.cycles / start.cycles) ** (2 if declared else 1))


def power_in_gate(setting: Conditions, gate_length_m: float) -> float:
    """Return the mean echo power in a gate around the focus, relative to that at the focus."""
    return echo_power(gate_length_m, setting.pulse_length_m, setting.tracking_width_m[2])


def predicted(setting: Conditions, estimator: str, draws: int, seed: int = 0) -> EstimatorErrors:
    """Return bias and jitter from ``draws`` draws of scatterers, the same draws for every gate and pulse."""
    # A medium's field widens with gate and frequency. On a grid of widths the cached draws serve all candidates, and
    # the displacement is interpolated between two widths.
    grid = math.log(setting.excitation_width_m[0]) / LOG_WIDTH_STEP
    fraction = grid - math.floor(grid)
    low, high = (
        _speckle(
            _beams(setting, (end - fraction) * LOG_WIDTH_STEP),
            setting.gate_length_m,
            setting.pulse_length_m,
            draws,
            seed,
        )
        for end in (0, 1)
    )
    speckle = Speckle(low.resting, (1 - fraction) * low.displaced + fraction * high.displaced)
    return estimator_errors(setting, estimator, speckle, np.random.default_rng([seed, 1]))


def _beams(setting: Conditions, log_scale: float) -> Conditions:
    """Return the fields that the scattering depends on, with the displacement's widths times exp(``log_scale``)."""
    x, y, z = (float(f"{width * math.exp(log_scale):.6g}") for width in setting.excitation_width_m)
    return replace(setting, **_OTHER_FIELDS, excitation_width_m=(x, y, z))


@functools.lru_cache(maxsize=16)
def _speckle(beams: Conditions, gate_length_m: float, pulse_length_m: float, draws: int, seed: int) -> Speckle:
    return _scattering(beams, draws, seed).speckle(gate_length_m, pulse_length_m)


@functools.lru_cache(maxsize=16)
def _scattering(beams: Conditions, draws: int, seed: int) -> Scattering:
    """Return draws over the depth of the tracking beam, so that all gates have the same scatterers."""
    depth_m = 2 * BOX_HALF_WIDTH_SIGMAS * beams.tracking_width_m[2]
    return draw_scattering(beams, np.random.default_rng([seed, 0]), draws, depth_m, CELLS)


def _simulates_specimen(scene: Scene) -> bool:
    """Return whether the expected amplitude is that of the simulated specimen, which already follows the force."""
    twin = twin_of(scene)
    return scene.processing.expected_amplitude_m is None and twin is not None and twin.settings.specimen is not None
