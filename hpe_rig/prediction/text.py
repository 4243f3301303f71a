"""Text of a forecast: the lines that ``hpe-rig check`` and the report print."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.medium import beam_averaging_factor
from hpe_rig.plan import Shot
from hpe_rig.prediction.beam_averaging import predicted_averaging
from hpe_rig.prediction.detection import FALSE_ALARMS, detection_floor
from hpe_rig.prediction.forecast import Prediction, forecast_of, remedies
from hpe_rig.prediction.linear_fit import fitted_over_true
from hpe_rig.prediction.output_text import dose_text
from hpe_rig.prediction.scene_physics import tracking_gate
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene


def detection_text(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Iterator[str]:
    """Yield the smallest amplitude that can be detected and, on the twin, the output and motion of its push."""
    floor = detection_floor(scene, simulated, shot)
    if floor.quadrature_m == 0:
        yield "detection floor: none, neither noise nor trigger jitter is known"
    else:
        # Jumps of a peak are rarer and larger than normal noise of their variance: fewer amplitudes exceed the floor.
        at_most = "at most " if spec_of(scene.processing.estimator).reads_peak else ""
        yield (
            f"detection floor: {floor.detected_m * 1e9:.3g} nm ({at_most}{100 * FALSE_ALARMS:g} % false alarms), from "
            f"noise ({floor.noise_m * 1e9:.3g} nm in each quadrature of the worst wanted frequency) and trigger jitter "
            f"({floor.trigger_jitter_m * 1e9:.3g} nm)"
        )
    if simulated:
        yield from dose_text(scene)


def aliasing_text(scene: Scene, shot: Shot, simulated: bool = True) -> Iterator[str]:
    """Yield the largest change of the wanted harmonics by unresolved ones, which alias onto them.

    Yields nothing if no medium is known.
    """
    ratio = fitted_over_true(scene, shot, simulated)
    if ratio is not None:
        amplitude, phase = np.abs(np.abs(ratio) - 1).max(), np.degrees(np.abs(np.angle(ratio)).max())
        yield (
            f"aliasing in this medium: unresolved harmonics change the wanted ones by at most "
            f"{100 * amplitude:.2g} % and {phase:.2g} deg ({scene.processing.estimator}, no noise)"
        )


def averaging_text(scene: Scene) -> Iterator[str]:
    """Yield the tracked fraction of the peak displacement, in the known medium or ensemble."""
    estimator = scene.processing.estimator
    averagings = [averaging for averaging in predicted_averaging(scene, estimator) if averaging is not None]
    if not averagings or scene.beams is None:
        return
    gaussian = beam_averaging_factor(scene.beams.excitation_width_m, tracking_gate(scene, estimator))
    if all(averaging.factor == gaussian for averaging in averagings):
        yield f"beam averaging: {gaussian:.3f} of the peak is tracked, for the Gaussian motion of eq. (12)"
        return
    # The lowest and the highest wanted frequency.
    lowest, highest = (
        f"{averagings[end].factor:.3f} ({math.degrees(averagings[end].phase_rad):.1f} deg)" for end in (0, -1)
    )
    medium = "in the declared medium"
    if scene.medium is None:
        uncertainty = max(averaging.factor_uncertainty for averaging in averagings)
        medium = f"on average over soft media (+-{uncertainty:.2g} between media)"
    yield (
        f"beam averaging: {lowest} of the peak is tracked at the lowest frequency, {highest} at the highest, {medium}; "
        f"{gaussian:.3f} for the Gaussian motion of eq. (12)"
    )


def prediction_text(scene: Scene, shot: Shot, target_m: float | None = None, simulated: bool = True) -> Iterator[str]:
    """Yield the lines that ``hpe-rig check`` prints: table, best estimator, settings that reach ``target_m``.

    ``target_m``: wanted error of the displacement, m. ``simulated``: the prediction is for a run with the twin, whose
    medium the table [simulation] gives.
    """
    prediction = forecast_of(scene, shot, simulated=simulated)
    if prediction is None:
        if scene.sphere is not None:
            yield "prediction: omitted, it predicts speckle in the beams, and a [sphere] moves as a whole"
        else:
            yield "prediction: omitted, it needs [beams], a frequency and processing.expected_snr_db"
        return
    conditions = prediction.conditions
    jitter = f"{conditions.trigger_jitter_s * 1e9:g} ns trigger jitter, " if conditions.trigger_jitter_s else ""
    yield (
        f"prediction at {conditions.frequency_hz:g} Hz for {conditions.amplitude_m * 1e9:.4g} nm, "
        f"{10 * math.log10(conditions.snr):.3g} dB SNR, {jitter}{conditions.pulses} pulses (standard deviations; "
        "noise of a quadrature):"
    )
    processing = scene.processing
    assumed = processing.expected_amplitude_m is None or processing.expected_snr_db is None
    if not simulated and scene.simulation is not None and assumed:
        yield (
            "  amplitude or SNR is that of [simulation]; for this bench, set processing.expected_amplitude_m and "
            "processing.expected_snr_db"
        )
    yield f"  {'estimator':18}{'bias':>12}{'noise':>12}{'aliasing':>12}{'speckle':>12}{'phase':>12}"
    yield from (_estimator_line(prediction, index) for index in range(len(prediction.expected)))
    if prediction.aliasing:
        best = min(range(len(prediction.expected)), key=prediction.error_m)
        yield (
            f"  smallest noise and aliasing together: {prediction.expected[best].estimator}, "
            f"{prediction.error_m(best) * 1e9:.3g} nm"
        )
    if scene.processing.drift == "linear":
        yield "  the noise excludes processing.drift, which adds a component of about 1.7 times this noise to u"
    if target_m is not None:
        yield _target_line(prediction, target_m, scene.acquisition.gate_depth_m, scene.processing.estimator)


def _estimator_line(prediction: Prediction, index: int) -> str:
    """Return the row of one estimator in the table of predicted errors: bias, noise, aliasing, speckle, phase."""
    errors, aliasing = prediction.expected[index], "-"
    if prediction.aliasing:
        aliasing = f"{abs(prediction.aliasing[index]) * prediction.conditions.amplitude_m * 1e9:.3g} nm"
    columns = f"{errors.bias_m * 1e9:>+8.3g} nm", f"{errors.quadrature_m * 1e9:>9.3g} nm", f"{aliasing:>12}"
    phase = f"{math.degrees(errors.phase_jitter_rad):>8.2g} deg"
    return f"  {errors.estimator:18}{''.join(columns)}{errors.speckle_jitter_m * 1e9:>9.3g} nm{phase}"


def _target_line(prediction: Prediction, target_m: float, depth_m: float, estimator: str) -> str:
    """Return the line that states whether the noise reaches ``target_m``, and cycles, pulse rate or SNR that would.

    ``depth_m``: of the gate, which limits the pulse rate.
    """
    cycles, pulse_rate_hz, snr_db = remedies(prediction, target_m, estimator)
    errors = prediction.errors_of(estimator)
    is_reached = errors.noise_jitter_m <= target_m
    state = "reached" if is_reached else "not reached"
    need = "sufficient" if is_reached else "needed"
    snr = {math.inf: "no SNR, because trigger jitter alone is larger", -math.inf: "any SNR"}.get(
        snr_db, f"SNR = {snr_db:.3g} dB"
    )
    beyond = " (beyond c/2z)" if pulse_rate_hz > prediction.conditions.sound_speed_m_per_s / (2 * depth_m) else ""
    return (
        f"target {target_m * 1e9:g} nm with {estimator}: {state}, noise is {errors.noise_jitter_m * 1e9:.3g} nm; "
        f"{need} is one of N_c = {cycles:.3g} cycles, f_prf = {pulse_rate_hz:.4g} Hz{beyond}, or {snr}; "
        f"speckle, {errors.speckle_jitter_m * 1e9:.3g} nm, is reduced by averaging over positions only"
    )
