"""Text of a forecast: the lines that ``hpe-rig check`` and the report print."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, DriveCalibration, twin_dose, twin_of, twin_push, twin_water_output
from hpe_rig.plan import Shot, drive_output
from hpe_rig.prediction.aliasing import fitted_over_true
from hpe_rig.prediction.beam_averaging import predicted_averaging, pulse_length_m
from hpe_rig.prediction.detection import FALSE_ALARMS, detection_floor
from hpe_rig.prediction.error_model import Expected
from hpe_rig.prediction.forecast import Prediction, Remedy, forecast_of, remedies
from hpe_rig.prediction.theory import beam_averaging_factor, focal_distortion
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene

LISTED = 4
STEEP = 0.25
"""Distortion at the focus from which nonlinear propagation changes the force in muscle by a tenth and more
(scripts/nonlinear_push.py); IEC 61949 takes a field for nearly linear up to 0.5."""
SHOCKED = (
    (0.0, 0.02, 0.04, 0.07, 0.10, 0.14, 0.20, 0.28, 0.39),
    (1.0, 1.00, 1.00, 1.01, 1.03, 1.06, 1.15, 1.38, 1.42),
    (1.0, 0.96, 0.93, 0.88, 0.84, 0.79, 0.73, 0.67, 0.65),
)
"""Distortion at the focus of a linear wave in water; I_sppa and p- over that wave's. Of a bowl of 45 mm focused at
70 mm, at 3 MHz; weaker focusing changes less (scripts/nonlinear_push.py)."""
EXTRAPOLATED = 0.05
"""Relative, from which a drive is another than the calibrated one."""
CHANGED = 0.03
"""Relative change of an output from which it is worth a line."""
AGREEING = 2.0
"""Intensities further apart than this factor are not of one transducer: attenuation over the way is known no better."""


def detection_text(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Iterator[str]:
    """Yield the detection floor and, where the medium is known, what moves at the FDA's track-3 limit.

    One line a burst length; for ``hpe-rig check`` and the report.
    """
    floor = detection_floor(scene, simulated, shot)
    if floor.quadrature_m == 0:
        yield "detection floor: none, neither noise nor trigger jitter is known"
    else:
        yield (
            f"detection floor: {floor.detected_m * 1e9:.3g} nm ({100 * FALSE_ALARMS:g} % false alarms), from noise "
            f"({floor.noise_m * 1e9:.3g} nm in each quadrature of the worst wanted frequency) and trigger jitter "
            f"({floor.trigger_jitter_m * 1e9:.3g} nm)"
        )
    if scene.excitation is None:
        return
    yield from _push_text(scene) if simulated else ()
    frequency_hz, found = np.array(scene.wanted_frequencies_hz[:LISTED]), None
    for length_s in scene.excitation.burst_length_s:
        found = twin_dose(scene, length_s, frequency_hz) if simulated else None
        if found is None:
            continue
        moved = zip(frequency_hz.tolist(), found.displacement_limit_m.tolist(), strict=True)
        yield (
            f"dose: at the limit of FDA track 3 ({found.limit_w_per_m2 * 1e-4:.4g} W/cm2 while a toneburst of "
            f"{length_s * 1e6:g} us is on, {found.force_limit_n_per_m3 * 1e-3:.3g} kN/m3) the focus moves "
            + ", ".join(f"{limit_m * 1e9:.3g} nm at {hz:g} Hz" for hz, limit_m in moved)
            + f"; the twin's force at {found.reference_drive_vpp:g} Vpp is "
            f"{found.intensity_w_per_m2 / found.limit_w_per_m2:.3g} times that"
        )
    if found is not None:
        yield from _linear_text(scene, found.intensity_w_per_m2)


def _linear_text(scene: Scene, intensity_w_per_m2: float) -> Iterator[str]:
    """Yield that the push is no longer linear where the scene takes it for that."""
    twin, excitation = twin_of(scene), scene.excitation
    if twin is None or excitation is None or twin.settings.propagation is not None:
        return
    beams, speed = twin.settings.beams, twin.sound_speed_m_per_s
    shape = beams.transducer.diameter_m, beams.excitation_width_m[0], speed
    distortion = focal_distortion(intensity_w_per_m2, excitation.carrier_hz, twin.push_focus_depth_m, *shape)
    if distortion > STEEP:
        yield (
            f"push: taken to propagate linearly, though its distortion at the focus is {distortion:.2g} (IEC 61949); "
            f"from {STEEP:g} on force and output go with drive otherwise by 10 % and more. Try: "
            "[simulation.propagation]"
        )


def _push_text(scene: Scene) -> Iterator[str]:
    """Yield what the tonebursts of full drive do on their way and at the focus, where they propagate nonlinearly."""
    push, twin = twin_push(scene), twin_of(scene)
    if push is None or twin is None or twin.settings.specimen is None or scene.excitation is None:
        return
    specimen = twin.settings.specimen
    force = specimen.force_density_n_per_m3
    surface_pa = push.surface_for(force)
    here = push.at(np.array([surface_pa]))
    known = here.positive_pa, here.negative_pa, here.sppa_w_per_m2, here.heat_w_per_m3
    high_pa, low_pa, sppa, heat = (float(each[0]) for each in known)
    index = low_pa * 1e-6 / math.sqrt(scene.excitation.carrier_hz * 1e-6)
    yield (
        f"push: {surface_pa * 1e-3:.3g} kPa at the transducer make p+ {high_pa * 1e-6:.3g} MPa and p- "
        f"{low_pa * 1e-6:.2g} MPa in the specimen at {specimen.reference_drive_vpp:g} Vpp, MI {index:.2g}, I_sppa "
        f"{sppa * 1e-4:.3g} W/cm2, heating {heat * 1e-9:.2g} W/mm3; the force there goes with drive to the power "
        f"{2 * push.exponent(force):.2g}"
    )
    water = twin_water_output(scene, surface_pa)
    if water is not None:
        focus_m, drive_vpp = twin.push_focus_depth_m, specimen.reference_drive_vpp
        own = drive_vpp, scene.excitation.carrier_hz, water.negative_pa, water.sppa_w_per_m2
        keys = "amplitude_vpp", "carrier_hz", "rarefaction_pa", "sppa_w_per_m2"
        drive = DriveCalibration(**dict(zip(keys, own, strict=True)))
        duty = scene.excitation.burst_rate_hz * max(scene.excitation.burst_length_s)
        output = drive_output(drive, focus_m, drive_vpp, duty)
        yield (
            f"output in water at that drive, shocks included: p+ {water.positive_pa * 1e-6:.3g} MPa, p- "
            f"{water.negative_pa * 1e-6:.2g} MPa; derated as the FDA asks MI {output.mechanical_index:.2g}, I_sppa "
            f"{output.sppa_w_per_m2 * 1e-4:.3g} W/cm2, I_spta {output.spta_w_per_m2 * 0.1:.3g} mW/cm2"
        )


def calibration_text(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield how the bench file's calibration contradicts the twin's force, where their intensities are far apart.

    Body force 2 a I / c, as in the twin; the calibration derated as for the limits.
    """
    drive = None if bench.calibration is None else bench.calibration.toneburst
    if not bench.simulated or bench.calibration is None or drive is None or scene.excitation is None:
        return
    found = twin_dose(scene, scene.excitation.burst_length_s[0], np.zeros(1))
    if found is None:
        return
    depth_m, drive_vpp = bench.calibration.focus_depth_m, found.reference_drive_vpp
    stated_w_per_m2 = drive_output(drive, depth_m, drive_vpp, 1.0).sppa_w_per_m2
    ratio = found.intensity_w_per_m2 / stated_w_per_m2
    if not 1 / AGREEING < ratio < AGREEING:
        yield (
            f"calibration: [calibration] of the bench file states {stated_w_per_m2 * 1e-4:.3g} W/cm2 at {drive_vpp:g} "
            f"Vpp, the twin's force stands for {found.intensity_w_per_m2 * 1e-4:.3g} W/cm2, {ratio:.3g} times that: "
            "the acoustic output by this calibration is not the output that moves the twin"
        )


def extrapolation_text(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield that the calibrated output is scaled to another drive, and by how much shocks make that wrong."""
    calibration, excitation = bench.calibration, scene.excitation
    drive = None if calibration is None else calibration.toneburst
    if calibration is None or drive is None or excitation is None:
        return
    drive_vpp = bench.limits.full_drive_vpp * math.sqrt(max(excitation.force_fraction))
    share = drive_vpp / drive.amplitude_vpp
    if abs(share - 1) <= EXTRAPOLATED:
        return
    scaled = f"output by calibration: linear in drive, from {drive.amplitude_vpp:.3g} to {drive_vpp:.3g} Vpp"
    diameter_m = _pushing_diameter_m(scene, bench.simulated)
    if diameter_m is None:
        yield f"{scaled}; how far shocks change that is not known without beams.transducer_diameter_m"
        return
    speed, focus_m = scene.acquisition.sound_speed_m_per_s, calibration.focus_depth_m
    # an intensity's full width at half maximum is 1.03 lambda F / D
    width_m = 1.03 / 2.3548 * speed / drive.carrier_hz * focus_m / diameter_m
    own = focal_distortion(drive.sppa_w_per_m2, drive.carrier_hz, focus_m, diameter_m, width_m, speed)
    linear, intensity, rarefaction = (np.array(each) for each in SHOCKED)
    # what was measured holds its own shocks already
    at = float(np.interp(own, linear * np.sqrt(intensity), linear))
    changes = [np.interp(at * share, linear, each) / np.interp(at, linear, each) for each in (intensity, rarefaction)]
    if max(abs(each - 1) for each in changes) > CHANGED:
        higher, lower = (100 * (float(each) - 1) for each in changes)
        yield (
            f"{scaled}; the distortion at the focus is {at:.2g} and {at * share:.2g} (IEC 61949), where shocks change "
            f"I_sppa by up to {higher:+.0f} % and p- by up to {lower:+.0f} %. Try: a calibration at the drive in use"
        )


def _pushing_diameter_m(scene: Scene, simulated: bool) -> float | None:
    """Return the diameter of the aperture that pushes; None where nobody says it."""
    beams, twin = scene.beams, twin_of(scene) if simulated else None
    if beams is not None and beams.transducer_diameter_m is not None and beams.push_focus_depth_m is None:
        return beams.transducer_diameter_m
    return None if twin is None else twin.settings.beams.transducer.diameter_m


def aliasing_text(scene: Scene, shot: Shot, simulated: bool = True) -> Iterator[str]:
    """Yield by how much aliased harmonics change the wanted ones at most."""
    ratio = fitted_over_true(scene, shot, simulated)
    if ratio is not None:
        amplitude, phase = np.abs(np.abs(ratio) - 1).max(), np.degrees(np.abs(np.angle(ratio)).max())
        yield (
            f"aliasing in this medium: unresolved harmonics change the wanted ones by at most "
            f"{100 * amplitude:.2g} % and {phase:.2g} deg ({scene.processing.estimator}, no noise)"
        )


def averaging_text(scene: Scene) -> Iterator[str]:
    """Yield how much of the peak is tracked, by what is known of the medium and by the Gaussian of eq. (12)."""
    each = [item for item in predicted_averaging(scene, scene.processing.estimator) if item is not None]
    if not each or scene.beams is None:
        return
    gaussian = beam_averaging_factor(
        scene.beams.excitation_width_m,
        scene.beams.tracking_width_m,
        scene.acquisition.gate_length_m,
        pulse_length_m(scene),
        gate_window=spec_of(scene.processing.estimator).gate_window,
    )
    if all(item.factor == gaussian for item in each):
        yield f"beam averaging: {gaussian:.3f} of the peak is tracked, the motion being the Gaussian of eq. (12)"
        return
    span = " to ".join(f"{each[at].factor:.3f} ({math.degrees(each[at].phase_rad):.1f} deg)" for at in (0, -1))
    known = "in the declared medium's own field"
    if scene.medium is None:
        doubt = max(item.factor_uncertainty for item in each)
        known = f"over all media of the ensemble, give or take {doubt:.2g}, before the motion itself tells more"
    yield (
        f"beam averaging: {span} of the peak is tracked from the lowest frequency to the highest {known}; "
        f"by the Gaussian of eq. (12) {gaussian:.3f}"
    )


def prediction_text(scene: Scene, shot: Shot, target_m: float | None = None, simulated: bool = True) -> Iterator[str]:
    """Yield the lines that ``hpe-rig check`` prints: the table, the best estimator, what reaches ``target_m``."""
    prediction = forecast_of(scene, shot, simulated=simulated)
    if prediction is None:
        whole = "of speckle in the beams, and a [sphere] moves as a whole"
        needs = "it needs [beams], a frequency and processing.expected_snr_db"
        yield f"prediction: left out, it is {whole}" if scene.sphere is not None else f"prediction: left out, {needs}"
        return
    conditions = prediction.conditions
    jitter = f"{conditions.trigger_jitter_s * 1e9:g} ns trigger jitter, " if conditions.trigger_jitter_s else ""
    yield (
        f"prediction at {conditions.frequency_hz:g} Hz for {conditions.amplitude_m * 1e9:.4g} nm, "
        f"{10 * math.log10(conditions.snr):.3g} dB SNR, {jitter}{conditions.pulses} pulses (standard deviations; "
        "noise of a quadrature):"
    )
    yield f"  {'estimator':18}{'bias':>10}{'noise':>10}{'aliasing':>10}{'speckle':>10}{'phase':>10}"
    for place, each in enumerate(prediction.expected):
        yield _estimator_line(prediction, place, each)
    if prediction.aliasing:
        best = min(range(len(prediction.expected)), key=prediction.error_m)
        yield (
            f"  least noise and aliasing together: {prediction.expected[best].estimator}, "
            f"{prediction.error_m(best) * 1e9:.3g} nm"
        )
    if target_m is not None:
        chosen = scene.processing.estimator
        yield _target_line(
            remedies(prediction, target_m, scene.acquisition.gate_depth_m, chosen), prediction, target_m, chosen
        )


def _estimator_line(prediction: Prediction, place: int, each: Expected) -> str:
    aliasing = "-"
    if prediction.aliasing:
        aliasing = f"{abs(prediction.aliasing[place]) * prediction.conditions.amplitude_m * 1e9:.3g} nm"
    figures = f"{each.bias_m * 1e9:>+7.3g} nm", f"{each.quadrature_m * 1e9:>7.3g} nm", f"{aliasing:>10}"
    phase = f"{math.degrees(each.phase_jitter_rad):>6.2g} deg"
    return f"  {each.estimator:18}{''.join(figures)}{each.speckle_jitter_m * 1e9:>7.3g} nm{phase}"


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
        f"or {snr}; speckle, {found.speckle_jitter_m * 1e9:.3g} nm, remains: only other places reduce it"
    )
