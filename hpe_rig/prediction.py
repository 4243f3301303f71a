"""What a scene's measurement will be worth, before it is made: beam averaging, bias and jitter of every estimator."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.jitter_model import Expected, Setting, draw_speckle, expected
from hpe_rig.mistakes import Mistake, SettingsError
from hpe_rig.plan import pulse_count
from hpe_rig.processing import ESTIMATORS, Estimator
from hpe_rig.scene import Scene
from hpe_rig.theory import GateWindow, beam_averaging_factor, scatterer_density, speckle_spread

SPECKLE_PER_CELL = 11.0
"""Scatterers per resolution cell where nothing says otherwise: fully developed speckle (paper, Table I)."""
LEAST_CYCLES = 1.0
LEAST_POINTS = 2.5
"""Cycles and pulses a cycle below which no estimate is made, however little noise there is."""
FLOOR_M = 100e-9
"""Amplitude predicted for where none is known: the lower end of what the paper's bench detects."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Bias and jitter of every estimator for one vibration frequency of a scene."""

    setting: Setting
    expected: tuple[Expected, ...]


def predicted_averaging(scene: Scene, estimator: Estimator) -> tuple[float | None, float | None]:
    """Return the predicted tracked over peak displacement and its relative speckle spread; None without beams."""
    if scene.beams is None:
        return None, None
    beams = scene.beams
    geometry = (
        beams.excitation_width_m,
        beams.tracking_width_m,
        scene.acquisition.gate_length_m,
        pulse_length_m(scene),
    )
    window: GateWindow = "hann" if estimator == "cross_spectrum" else "none"
    # A fixed seed: a prediction is a function of the scene alone.
    spread = speckle_spread(*geometry, np.random.default_rng(0), gate_window=window)
    return beam_averaging_factor(*geometry, gate_window=window), spread


def pulse_length_m(scene: Scene) -> float:
    """Return the axial length of the tracking pulse as received: as declared, or that of its cycles."""
    declared_m = None if scene.beams is None else scene.beams.pulse_length_m
    return declared_m or scene.tracking.cycles / scene.tracking.carrier_hz * scene.acquisition.sound_speed_m_per_s / 2


def setting_of(scene: Scene) -> Setting | None:
    """Return what bias and jitter of the scene's first wanted frequency depend on; None without beams or SNR."""
    snr_db = expected_snr_db(scene)
    if scene.beams is None or snr_db is None or not scene.wanted_frequencies_hz:
        return None
    frequency_hz = scene.wanted_frequencies_hz[0]
    acquisition, tracking, beams = scene.acquisition, scene.tracking, scene.beams
    return Setting(
        excitation_width_m=beams.excitation_width_m,
        tracking_width_m=beams.tracking_width_m,
        gate_length_m=acquisition.gate_length_m,
        pulse_length_m=pulse_length_m(scene),
        scatterers_per_m3=scatterer_density(
            beams.tracking_width_m, _number(scene, "scatterers", "per_cell") or SPECKLE_PER_CELL
        ),
        carrier_hz=tracking.carrier_hz,
        sound_speed_m_per_s=acquisition.sound_speed_m_per_s,
        sample_rate_hz=acquisition.sample_rate_hz,
        pulse_rate_hz=tracking.pulse_rate_hz,
        pulses=used_pulses(scene),
        frequency_hz=frequency_hz,
        amplitude_m=expected_amplitude_m(scene, frequency_hz),
        snr=10 ** (snr_db / 10),
    )


def used_pulses(scene: Scene) -> int:
    """Return how many pulses lie in the processing window."""
    rate_hz, processing = scene.tracking.pulse_rate_hz, scene.processing
    after = pulse_count(scene) - math.floor(processing.window_start_s * rate_hz + 1e-6)
    if processing.window_length_s is None:
        return max(after, 1)
    return max(min(after, round(processing.window_length_s * rate_hz)), 1)


def expected_snr_db(scene: Scene) -> float | None:
    """Return the SNR that the scene expects or that its twin simulates; None where neither says."""
    if scene.processing.expected_snr_db is not None:
        return scene.processing.expected_snr_db
    return _number(scene, "receiver", "snr_db")


def expected_amplitude_m(scene: Scene, frequency_hz: float) -> float:
    """Return the amplitude that the scene expects or that its twin prescribes at ``frequency_hz``."""
    if scene.processing.expected_amplitude_m is not None:
        return scene.processing.expected_amplitude_m
    for component in (scene.simulation or {}).get("motion") or ():
        if math.isclose(component["frequency_hz"], frequency_hz) and component["amplitude_m"] > 0:
            return float(component["amplitude_m"])
    return FLOOR_M


def predict(setting: Setting, estimators: tuple[Estimator, ...] = ESTIMATORS, draws: int = 1000) -> Prediction:
    """Return bias and jitter of every estimator; a function of the setting alone."""
    speckle = draw_speckle(setting, np.random.default_rng(0), draws)
    each = (expected(setting, name, speckle, np.random.default_rng(1)) for name in estimators)
    return Prediction(setting, tuple(each))


@dataclass(frozen=True, slots=True)
class Remedy:
    """What alone would reach a wanted uncertainty: a factor on the cycles, the pulse rate, or dB of SNR."""

    cycles: float
    pulse_rate_hz: float
    snr_db: float
    reachable_rate_hz: float


def remedies(prediction: Prediction, target_m: float, depth_m: float, estimator: str = "coherent") -> Remedy:
    """Return N_c, f_prf and SNR of which each alone brings the noise jitter of ``estimator`` to ``target_m``.

    Noise variance goes with 1 / (N_c f_prf SNR) where a pulse's phase is well above noise. ``reachable_rate_hz`` is
    c / 2z: no faster pulse rate can be.
    """
    setting = prediction.setting
    found = next(each for each in prediction.expected if each.estimator == estimator)
    factor = (found.noise_jitter_m / target_m) ** 2
    cycles = setting.pulses / setting.pulse_rate_hz * setting.frequency_hz
    return Remedy(
        max(cycles * factor, LEAST_CYCLES),
        max(setting.pulse_rate_hz * factor, LEAST_POINTS * setting.frequency_hz),
        10 * math.log10(setting.snr * factor),
        setting.sound_speed_m_per_s / (2 * depth_m),
    )


def prediction_text(scene: Scene, target_m: float | None = None) -> Iterator[str]:
    """Yield the lines that ``hpe-rig check`` prints: the table, and what reaches ``target_m``."""
    setting = setting_of(scene)
    if setting is None:
        yield "prediction: left out, it needs [beams], a frequency and processing.expected_snr_db"
        return
    prediction = predict(setting)
    yield (
        f"prediction at {setting.frequency_hz:g} Hz for {setting.amplitude_m * 1e9:g} nm, "
        f"{10 * math.log10(setting.snr):g} dB SNR, {setting.pulses} pulses (standard deviations):"
    )
    yield f"  {'estimator':18}{'bias':>10}{'noise':>10}{'speckle':>10}{'phase':>10}"
    for each in prediction.expected:
        figures = (each.bias_m * 1e9, each.noise_jitter_m * 1e9, each.speckle_jitter_m * 1e9)
        words = "".join(f"{value:>+7.3g} nm" if k == 0 else f"{value:>7.3g} nm" for k, value in enumerate(figures))
        yield f"  {each.estimator:18}{words}{math.degrees(each.phase_jitter_rad):>6.2g} deg"
    if target_m is not None:
        chosen = scene.processing.estimator
        yield _target_line(
            remedies(prediction, target_m, scene.acquisition.gate_depth_m, chosen), prediction, target_m, chosen
        )


def _target_line(remedy: Remedy, prediction: Prediction, target_m: float, estimator: str) -> str:
    found = next(each for each in prediction.expected if each.estimator == estimator)
    head = f"target {target_m * 1e9:g} nm with {estimator}: "
    if found.noise_jitter_m <= target_m:
        head += f"reached, noise is {found.noise_jitter_m * 1e9:.3g} nm; the least is "
    else:
        head += f"not reached, noise is {found.noise_jitter_m * 1e9:.3g} nm; it takes "
    beyond = " (beyond c/2z)" if remedy.pulse_rate_hz > remedy.reachable_rate_hz else ""
    return (
        f"{head}N_c = {remedy.cycles:.3g} cycles, or f_prf = {remedy.pulse_rate_hz:.4g} Hz{beyond}, "
        f"or SNR = {remedy.snr_db:.3g} dB; speckle, {found.speckle_jitter_m * 1e9:.3g} nm, stays: it takes other places"
    )


def _number(scene: Scene, section: str, key: str) -> float | None:
    table: Any = (scene.simulation or {}).get(section)
    value = table.get(key) if isinstance(table, Mapping) else None
    return None if value is None else float(value)


_UNITS_M = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "m": 1.0}


def length_m(text: str, key: str) -> float:
    """Return a positive length such as "20nm" or "2e-8"; raise ``SettingsError`` naming ``key`` for anything else."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(nm|um|mm|m)?\s*", text)
    try:
        value = float(match[1]) * _UNITS_M[match[2] or "m"] if match else math.nan
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise SettingsError(
            "command line", [Mistake(key, f"{text!r} is no length", "a number with unit, such as 20nm")]
        )
    return value
