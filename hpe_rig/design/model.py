"""Model of what a scene will achieve: bias, jitter, time and dose, relative to the scene that a design starts from."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hpe_rig.bench import twin_of, twin_settings
from hpe_rig.plan import Plan, Shot
from hpe_rig.prediction import (
    LATERAL,
    Conditions,
    Expected,
    Scattering,
    Speckle,
    conditions_of,
    draw_scattering,
    echo_power,
    expected,
    expected_snr_db,
    noise_gain,
    relative_drive,
)
from hpe_rig.processing import EchoGate, band_grid
from hpe_rig.scene import Mistake, Scene, SettingsError

CELLS = 256
"""Cells of depth in which scatterers are summed: 23 um for the paper's beam, a tenth of a three-cycle pulse."""
WIDTH_STEP = 0.05
"""Step of the grid of widths, in logarithms: interpolated on it, a displacement is off by 1e-4 of the peak."""
_BEAMS = ("excitation_width_m", "tracking_width_m", "scatterers_per_m3")
# What scatterers do not depend on, at one value, so that their draws are kept.
_UNSEEN: dict[str, Any] = {field.name: 1 for field in fields(Conditions) if field.name not in _BEAMS}


@dataclass(frozen=True, slots=True)
class Baseline:
    """What of the starting scene its SNR and its amplitude hold for."""

    gate_length_m: float
    cycles: int
    drive: float


def baseline(scene: Scene) -> Baseline:
    """Return what SNR and amplitude of ``scene`` hold for; raise ``SettingsError`` with all that no model can lack."""
    mistakes = []
    if scene.beams is None:
        mistakes.append(Mistake("beams", "the model needs the beams' widths", "a [beams] section"))
    if expected_snr_db(scene) is None:
        what = "the model needs the echo's SNR, and the scene does not say"
        mistakes.append(Mistake("processing.expected_snr_db", what, "the SNR in the gate, such as 40.0"))
    if not scene.wanted_frequencies_hz:
        what = "no vibration frequency is wanted"
        mistakes.append(Mistake("processing.frequencies_hz", what, "the frequency to design for, such as [200.0]"))
    if mistakes:
        raise SettingsError("the scene", mistakes)
    gate_m = scene.acquisition.gate_length_m
    if scene.processing.expected_snr_db is None:
        # What the twin simulates holds in a gate of its own.
        gate_m = twin_settings(scene).receiver.reference_gate_m
    return Baseline(gate_m, scene.tracking.cycles, relative_drive(scene, scene.wanted_frequencies_hz[0]))


def design_setting(scene: Scene, plan: Plan, start: Baseline) -> Conditions:
    """Return what bias and jitter of the scene's first shot and first frequency depend on.

    Beyond ``conditions_of``: noise is fixed, so the SNR follows the echo's strength, and a declared one its depth
    profile in the gate too; the amplitude follows the force. Raises ``ValueError`` where the pulses cannot tell the
    frequencies, or the gate is too short for the estimators' band.
    """
    _require_band(plan.shots[0], scene)
    noise_gain(scene, plan.shots[0])  # raises where conditions_of would leave the fit's cost out
    setting = conditions_of(scene, plan.shots[0])
    assert setting is not None  # noqa: S101 (baseline has refused such a scene)
    snr = setting.snr * echo_strength(scene, start)
    if scene.processing.expected_snr_db is not None:
        profile = [echo_power_of(setting, gate_m) for gate_m in (setting.gate_length_m, start.gate_length_m)]
        snr *= profile[0] / profile[1]
    amplitude_m = setting.amplitude_m
    driven = relative_drive(scene, setting.frequency_hz, plan.shots[0])
    if driven > 0 and start.drive > 0 and not _simulates_specimen(scene):
        amplitude_m *= driven / start.drive
    return replace(setting, snr=snr, amplitude_m=max(amplitude_m, 1e-15))


def effective_pulses(scene: Scene, plan: Plan) -> int:
    """Return how many pulses, evenly spread over whole cycles, would tell the first frequency as well as those used.

    Skipped pulses, and frequencies and background that are fitted along and hard to tell apart, cost as many. Raises
    ``ValueError`` where the pulses cannot tell the frequencies.
    """
    return max(1, round(2 / float(noise_gain(scene, plan.shots[0])[0]) ** 2))


def _require_band(shot: Shot, scene: Scene) -> None:
    gate, tracking = shot.gate, scene.tracking
    silent = np.zeros((1, gate.stop - gate.start))
    rate_hz, speed_m_per_s = shot.capture.sample_rate_hz, scene.acquisition.sound_speed_m_per_s
    echoes = EchoGate(silent, rate_hz, np.zeros(1), tracking.carrier_hz, speed_m_per_s, np.ones(1, dtype=bool))
    band_grid(echoes, silent.size)


def echo_strength(scene: Scene, start: Baseline) -> float:
    """Return the power of the echo relative to the starting scene's pulse.

    A longer pulse has as much more amplitude where the received length is declared, the transducer's; else it fills as
    much more of the gate.
    """
    declared = scene.beams is not None and scene.beams.pulse_length_m is not None
    return float((scene.tracking.cycles / start.cycles) ** (2 if declared else 1))


def echo_power_of(setting: Conditions, gate_length_m: float) -> float:
    """Return the mean echo power in a gate around the focus, relative to that at the focus."""
    return echo_power(gate_length_m, setting.pulse_length_m, setting.tracking_width_m[2])


def predicted(setting: Conditions, estimator: str, draws: int, seed: int = 0) -> Expected:
    """Return bias and jitter from ``draws`` draws of scatterers, the same for every gate and pulse."""
    # A medium's field widens with gate and frequency: between two widths of a grid the displacement is interpolated.
    grid = math.log(setting.excitation_width_m[0]) / WIDTH_STEP
    share = grid - math.floor(grid)
    low, high = (
        _speckle(
            _beams(setting, (end - share) * WIDTH_STEP), setting.gate_length_m, setting.pulse_length_m, draws, seed
        )
        for end in (0, 1)
    )
    speckle = Speckle(low.resting, (1 - share) * low.moved + share * high.moved)
    return expected(setting, estimator, speckle, np.random.default_rng([seed, 1]))


def _beams(setting: Conditions, logarithm: float) -> Conditions:
    """Return what draws of scatterers depend on, the displacement's widths scaled by exp(``logarithm``)."""
    x, y, z = (float(f"{width * math.exp(logarithm):.6g}") for width in setting.excitation_width_m)
    return replace(setting, **_UNSEEN, excitation_width_m=(x, y, z))


@functools.lru_cache(maxsize=16)
def _speckle(beams: Conditions, gate_length_m: float, pulse_length_m: float, draws: int, seed: int) -> Speckle:
    return _scattering(beams, draws, seed).speckle(gate_length_m, pulse_length_m)


@functools.lru_cache(maxsize=16)
def _scattering(beams: Conditions, draws: int, seed: int) -> Scattering:
    """Return draws as deep as the tracking beam sees: whatever gate, the scatterers are the same."""
    deep_m = 2 * LATERAL * beams.tracking_width_m[2]
    return draw_scattering(beams, np.random.default_rng([seed, 0]), draws, deep_m, CELLS)


def _simulates_specimen(scene: Scene) -> bool:
    """Return whether the expected amplitude is the simulated specimen's, which follows the force already."""
    twin = twin_of(scene)
    return scene.processing.expected_amplitude_m is None and twin is not None and twin.has_specimen
