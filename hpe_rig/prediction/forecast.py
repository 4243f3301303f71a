"""What a scene's measurement will be worth, before it is made: beam averaging, bias and jitter of every estimator."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.bench import twin_medium
from hpe_rig.plan import pulse_count
from hpe_rig.prediction.beam_averaging import depth_spread, gaussian_averaging, medium_motion, width_scale
from hpe_rig.prediction.error_model import Expected, Setting, draw_speckle, expected
from hpe_rig.prediction.theory import GateWindow, beam_averaging_factor, scatterer_density, speckle_spread
from hpe_rig.processing import ESTIMATORS, Estimator
from hpe_rig.result import Averaging
from hpe_rig.scene import Mistake, Scene, SettingsError

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


def predicted_averaging(scene: Scene, estimator: Estimator, simulated: bool = True) -> tuple[Averaging | None, ...]:
    """Return the averaging over the tracking beam at every wanted frequency; None without beams.

    The motion's shape is the field of the medium, ``scene.medium``'s or the twin's own; without either, eq. (12).
    """
    frequency_hz = np.array(scene.wanted_frequencies_hz)
    if scene.beams is None:
        return (None,) * frequency_hz.size
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    window: GateWindow = "hann" if estimator == "cross_spectrum" else "none"
    # A fixed seed: a prediction is a function of the scene alone.
    spread = speckle_spread(*widths, *gate, np.random.default_rng(0), gate_window=window)
    gaussian = beam_averaging_factor(*widths, *gate, gate_window=window)
    motion = motion_of_medium(scene, frequency_hz, window, simulated)
    if motion is None:
        return (Averaging(gaussian, 0.0, spread),) * frequency_hz.size
    depth_m, ratio = depth_spread(widths[1], *gate, window), motion[0] / motion[1]
    # To first order in how far the motion changes over the beam, all that speckle does is in proportion to the loss.
    lost = (1 - np.abs(ratio)) / (1 - gaussian_averaging(*widths, depth_m))
    return tuple(
        Averaging(1 - share * (1 - gaussian), lag, share * spread)
        for share, lag in zip(lost.tolist(), np.angle(ratio).tolist(), strict=True)
    )


def motion_of_medium(
    scene: Scene, frequency_hz: NDArray[np.float64], window: GateWindow = "none", simulated: bool = True
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]] | None:
    """Return ``medium_motion`` of the scene's medium; None where none is known."""
    if scene.beams is None:
        return None
    known: tuple[NDArray[np.complex128], float] | None = None
    if scene.medium is not None:
        loss_pa = 2 * np.pi * frequency_hz * scene.medium.shear_viscosity_pa_s
        known = np.asarray(scene.medium.shear_modulus_pa + 1j * loss_pa), scene.medium.density_kg_per_m3
    elif simulated:
        known = twin_medium(scene, frequency_hz)
    if known is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), window)
    return medium_motion(*known, frequency_hz, *widths, depth_m)


def averaging_text(scene: Scene, simulated: bool = True) -> Iterator[str]:
    """Yield how much of the peak is tracked, by the medium's field and by the Gaussian of eq. (12)."""
    each = [item for item in predicted_averaging(scene, scene.processing.estimator, simulated) if item is not None]
    if not each or scene.beams is None:
        return
    gaussian = beam_averaging_factor(
        scene.beams.excitation_width_m,
        scene.beams.tracking_width_m,
        scene.acquisition.gate_length_m,
        pulse_length_m(scene),
        gate_window="hann" if scene.processing.estimator == "cross_spectrum" else "none",
    )
    if all(item.factor == gaussian for item in each):
        yield f"beam averaging: {gaussian:.3f} of the peak is tracked, the motion being the Gaussian of eq. (12)"
        return
    span = " to ".join(f"{each[at].factor:.3f} ({math.degrees(each[at].phase_rad):.1f} deg)" for at in (0, -1))
    yield (
        f"beam averaging: {span} of the peak is tracked from the lowest frequency to the highest in the medium's own "
        f"field; by the Gaussian of eq. (12) {gaussian:.3f}, {(gaussian / each[0].factor - 1) * 100:+.1f} %"
    )


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
        excitation_width_m=_motion_width_m(scene, frequency_hz),
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
        trigger_jitter_s=_number(scene, "instruments", "trigger_jitter_s") or 0.0,
    )


def _motion_width_m(scene: Scene, frequency_hz: float) -> tuple[float, float, float]:
    """Return the sigmas of the Gaussian motion that is tracked like the scene's."""
    assert scene.beams is not None  # noqa: S101
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    motion = motion_of_medium(scene, np.array([frequency_hz]))
    if motion is None:
        return widths[0]
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), "none")
    x, y, z = widths[0]
    scale = width_scale(float(abs(motion[0][0] / motion[1][0])), *widths, depth_m)
    return x * scale, y * scale, z * scale


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

    Noise variance goes with 1 / (N_c f_prf SNR) where a pulse's phase is well above noise; of trigger jitter SNR takes
    nothing, so ``snr_db`` is inf where that alone exceeds the target, -inf where there is nothing else.
    ``reachable_rate_hz`` is c / 2z: no faster pulse rate can be.
    """
    setting = prediction.setting
    found = next(each for each in prediction.expected if each.estimator == estimator)
    factor = (found.noise_jitter_m / target_m) ** 2
    cycles = setting.pulses / setting.pulse_rate_hz * setting.frequency_hz
    worse = 1.5 if estimator == "cross_spectrum" else setting.fit_gain**2
    jitter = 2 * worse * setting.jitter_variance / setting.pulses * setting.metres_per_radian**2
    left = target_m**2 - jitter
    snr_factor = (found.noise_jitter_m**2 - jitter) / left if left > 0 else math.inf
    return Remedy(
        max(cycles * factor, LEAST_CYCLES),
        max(setting.pulse_rate_hz * factor, LEAST_POINTS * setting.frequency_hz),
        10 * math.log10(setting.snr * snr_factor) if snr_factor > 0 else -math.inf,
        setting.sound_speed_m_per_s / (2 * depth_m),
    )


def prediction_text(scene: Scene, target_m: float | None = None, fit_gain: float = 1.0) -> Iterator[str]:
    """Yield the lines that ``hpe-rig check`` prints: the table, and what reaches ``target_m``.

    ``fit_gain``: what skipped pulses and harmonics fitted along cost (`hpe_rig.prediction.detection.fit_gain`).
    """
    setting = setting_of(scene)
    if setting is None:
        yield "prediction: left out, it needs [beams], a frequency and processing.expected_snr_db"
        return
    prediction = predict(replace(setting, fit_gain=fit_gain))
    jitter = f"{setting.trigger_jitter_s * 1e9:g} ns trigger jitter, " if setting.trigger_jitter_s else ""
    yield (
        f"prediction at {setting.frequency_hz:g} Hz for {setting.amplitude_m * 1e9:g} nm, "
        f"{10 * math.log10(setting.snr):g} dB SNR, {jitter}{setting.pulses} pulses (standard deviations):"
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
    snr = {math.inf: "no SNR, trigger jitter alone is more", -math.inf: "any SNR, trigger jitter alone is less"}.get(
        remedy.snr_db, f"SNR = {remedy.snr_db:.3g} dB"
    )
    beyond = " (beyond c/2z)" if remedy.pulse_rate_hz > remedy.reachable_rate_hz else ""
    return (
        f"{head}N_c = {remedy.cycles:.3g} cycles, or f_prf = {remedy.pulse_rate_hz:.4g} Hz{beyond}, "
        f"or {snr}; speckle, {found.speckle_jitter_m * 1e9:.3g} nm, stays: it takes other places"
    )


def _number(scene: Scene, section: str, key: str) -> float | None:
    table: Any = (scene.simulation or {}).get(section)
    value = table.get(key) if isinstance(table, Mapping) else None
    return None if value is None else float(value)


LARGEST_M = 1e-3
"""A larger uncertainty is a forgotten unit."""
_UNITS_M = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "m": 1.0}


def length_m(text: str, key: str) -> float:
    """Return a length up to 1 mm, such as "20nm" or "2e-8"; raise ``SettingsError`` naming ``key`` for others."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(nm|um|mm|m)?\s*", text)
    try:
        value = float(match[1]) * _UNITS_M[match[2] or "m"] if match else math.nan
    except ValueError:
        value = math.nan
    if not 0 < value <= LARGEST_M:
        raise SettingsError(
            "command line", [Mistake(key, f"{text!r} is no length up to 1 mm", "a number with unit, such as 20nm")]
        )
    return value
