"""Acoustic output as text: dose, nonlinear push, and the bench file's calibration, for ``hpe-rig check`` and report."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, DriveCalibration, TwinDeclaration, twin_of
from hpe_rig.plan import drive_output
from hpe_rig.scene import Excitation, Scene

LISTED_FREQUENCIES = 4
MAX_LINEAR_DISTORTION = 0.25
"""Distortion at the focus above which nonlinear propagation changes the force in muscle by 10 % or more.

From scripts/validation/nonlinear_push.py; IEC 61949 treats a field as nearly linear up to 0.5."""
SHOCKED = (
    (0.0, 0.02, 0.04, 0.07, 0.10, 0.14, 0.20, 0.28, 0.39),
    (1.0, 1.00, 1.00, 1.01, 1.03, 1.06, 1.15, 1.38, 1.42),
    (1.0, 0.96, 0.93, 0.88, 0.84, 0.79, 0.73, 0.67, 0.65),
)
"""Distortion at the focus of a linear wave in water; I_sppa and p- over those of that wave.

For a bowl of 45 mm focused at 70 mm, at 3 MHz; weaker focusing changes less (scripts/validation/nonlinear_push.py)."""
DRIVE_TOLERANCE = 0.05
"""Relative difference of two drives that counts as equal."""
MIN_OUTPUT_CHANGE = 0.03
"""Relative change of an output that is reported."""
MAX_INTENSITY_RATIO = 2.0
"""Ratio of intensities above which they contradict each other: attenuation along the path is known no better."""
WATER_DENSITY_KG_PER_M3, WATER_NONLINEARITY = 1000.0, 3.5
"""The nonlinearity coefficient is beta = 1 + B/2A."""


def focal_distortion(
    intensity_w_per_m2: float,
    carrier_hz: float,
    focus_m: float,
    diameter_m: float,
    width_m: float,
    sound_speed_m_per_s: float,
) -> float:
    """Return the local distortion parameter of IEC 61949, z p 2 pi f beta / (rho c^3 sqrt(F_a)), in water.

    It measures how far a shock has formed at the focus: z is its distance, f the carrier, beta the nonlinearity of
    water, p the pressure of a linear wave of that intensity. F_a is 0.69 times the area of the source, of
    ``diameter_m``, over that of the -6 dB beam, with the sigma ``width_m`` of intensity.
    """
    pressure_pa = np.sqrt(2 * WATER_DENSITY_KG_PER_M3 * sound_speed_m_per_s * intensity_w_per_m2)
    beam_m = 2 * width_m * np.sqrt(2 * np.log(4))
    area_ratio = 0.69 * (diameter_m / beam_m) ** 2
    steepening = 2 * np.pi * carrier_hz * WATER_NONLINEARITY / (WATER_DENSITY_KG_PER_M3 * sound_speed_m_per_s**3)
    return float(focus_m * pressure_pa * steepening / np.sqrt(area_ratio))


def dose_text(scene: Scene) -> Iterator[str]:
    """Yield lines on the twin's push: output, motion at the FDA's track-3 limit for each burst length, linearity."""
    excitation, twin = scene.excitation, twin_of(scene)
    if excitation is None or twin is None:
        return
    yield from _push_text(twin, excitation)
    frequency_hz = np.array(scene.wanted_frequencies_hz[:LISTED_FREQUENCIES])
    intensity_w_per_m2 = None
    for length_s in excitation.burst_length_s:
        dose = twin.dose(excitation, length_s, frequency_hz)
        if dose is None:
            continue
        intensity_w_per_m2 = dose.intensity_w_per_m2
        motions = zip(frequency_hz.tolist(), dose.displacement_limit_m.tolist(), strict=True)
        yield (
            f"dose: at the limit of FDA track 3 ({dose.limit_w_per_m2 * 1e-4:.4g} W/cm2 while a toneburst of "
            f"{length_s * 1e6:g} us is on, {dose.force_limit_n_per_m3 * 1e-3:.3g} kN/m3) the focus moves "
            + ", ".join(f"{limit_m * 1e9:.3g} nm at {hz:g} Hz" for hz, limit_m in motions)
            + f"; the twin's force at {dose.reference_drive_vpp:g} Vpp is "
            f"{dose.intensity_w_per_m2 / dose.limit_w_per_m2:.3g} times that limit"
        )
    if intensity_w_per_m2 is not None:
        yield from _linearity_text(twin, excitation, intensity_w_per_m2)


def _push_text(twin: TwinDeclaration, excitation: Excitation) -> Iterator[str]:
    """Yield pressures, acoustic output and heating of the twin's tonebursts, if they propagate nonlinearly."""
    push, specimen = twin.push(excitation.carrier_hz), twin.settings.specimen
    if push is None or specimen is None:
        return
    force = specimen.force_density_n_per_m3
    surface_pa = push.surface_for(force)
    focus = push.at(np.array([surface_pa]))
    positive_mpa, negative_mpa = float(focus.positive_pa[0]) * 1e-6, float(focus.negative_pa[0]) * 1e-6
    sppa_w_per_cm2, heat_w_per_mm3 = float(focus.sppa_w_per_m2[0]) * 1e-4, float(focus.heat_w_per_m3[0]) * 1e-9
    yield (
        f"push: {surface_pa * 1e-3:.3g} kPa at the transducer give p+ {positive_mpa:.3g} MPa and p- "
        f"{negative_mpa:.2g} MPa in the specimen at {specimen.reference_drive_vpp:g} Vpp, "
        f"MI {negative_mpa / math.sqrt(excitation.carrier_hz * 1e-6):.2g}, I_sppa {sppa_w_per_cm2:.3g} W/cm2, heating "
        f"{heat_w_per_mm3:.2g} W/mm3; the force is proportional to the drive to the power "
        f"{2 * push.exponent(force):.2g}"
    )
    water = twin.water_output(surface_pa, excitation.carrier_hz)
    if water is None:
        return
    drive = DriveCalibration(
        amplitude_vpp=specimen.reference_drive_vpp,
        carrier_hz=excitation.carrier_hz,
        rarefaction_pa=water.negative_pa,
        sppa_w_per_m2=water.sppa_w_per_m2,
    )
    duty = excitation.burst_rate_hz * max(excitation.burst_length_s)
    derated = drive_output(drive, twin.push_focus_depth_m, specimen.reference_drive_vpp, duty)
    yield (
        f"output in water at that drive, shocks included: p+ {water.positive_pa * 1e-6:.3g} MPa, p- "
        f"{water.negative_pa * 1e-6:.2g} MPa; derated for the FDA's limits MI {derated.mechanical_index:.2g}, I_sppa "
        f"{derated.sppa_w_per_m2 * 1e-4:.3g} W/cm2, I_spta {derated.spta_w_per_m2 * 0.1:.3g} mW/cm2"
    )


def _linearity_text(twin: TwinDeclaration, excitation: Excitation, intensity_w_per_m2: float) -> Iterator[str]:
    """Yield a warning if the twin propagates a push linearly that is too strong for linear propagation."""
    if twin.settings.propagation is not None:
        return
    beams, sound_speed = twin.settings.beams, twin.sound_speed_m_per_s
    distortion = focal_distortion(
        intensity_w_per_m2,
        excitation.carrier_hz,
        focus_m=twin.push_focus_depth_m,
        diameter_m=beams.transducer.diameter_m,
        width_m=beams.excitation_width_m[0],
        sound_speed_m_per_s=sound_speed,
    )
    if distortion > MAX_LINEAR_DISTORTION:
        yield (
            f"propagation: simulated as linear propagation, but the distortion at the focus is {distortion:.2g} "
            f"(IEC 61949); above {MAX_LINEAR_DISTORTION:g} nonlinear propagation changes force and output by 10 % or "
            "more. Try: [simulation.propagation]"
        )


def calibration_text(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield a warning if the calibrated intensity in the bench file contradicts the force of the twin.

    An assumed calibration contradicts nothing. The force is 2 a I / c, as in the twin, with a the attenuation; the
    calibrated intensity is derated as for the limits.
    """
    drive = None if bench.calibration is None else bench.calibration.toneburst
    if not bench.simulated or bench.calibration is None or drive is None or scene.excitation is None:
        return
    if bench.calibration.source.startswith("assumed"):
        return
    twin = twin_of(scene)
    dose = None if twin is None else twin.dose(scene.excitation, scene.excitation.burst_length_s[0], np.zeros(1))
    if dose is None:
        return
    drive_vpp = dose.reference_drive_vpp
    calibrated_w_per_m2 = drive_output(drive, bench.calibration.focus_depth_m, drive_vpp, 1.0).sppa_w_per_m2
    ratio = dose.intensity_w_per_m2 / calibrated_w_per_m2
    if not 1 / MAX_INTENSITY_RATIO < ratio < MAX_INTENSITY_RATIO:
        yield (
            f"calibration: at {drive_vpp:g} Vpp [calibration] of the bench file gives "
            f"{calibrated_w_per_m2 * 1e-4:.3g} W/cm2, but the twin's force needs "
            f"{dose.intensity_w_per_m2 * 1e-4:.3g} W/cm2, {ratio:.3g} times as much. The acoustic output printed from "
            "the calibration does not apply to the simulated push"
        )


def extrapolation_text(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield a warning if the calibrated output is scaled to another drive, with the error of that scaling by shocks."""
    calibration, excitation = bench.calibration, scene.excitation
    drive = None if calibration is None else calibration.toneburst
    if calibration is None or drive is None or excitation is None:
        return
    drive_vpp = bench.limits.full_drive_vpp * math.sqrt(max(excitation.force_fraction))
    drive_ratio = drive_vpp / drive.amplitude_vpp
    if abs(drive_ratio - 1) <= DRIVE_TOLERANCE:
        return
    scaled = f"output by calibration: scaled linearly with drive, from {drive.amplitude_vpp:.3g} to {drive_vpp:.3g} Vpp"
    diameter_m = _push_diameter_m(scene, bench.simulated)
    if diameter_m is None:
        yield f"{scaled}. The effect of shocks is not known without beams.transducer_diameter_m"
        return
    sound_speed, focus_m = scene.acquisition.sound_speed_m_per_s, calibration.focus_depth_m
    # The full width at half maximum of a focused intensity is 1.03 lambda F / D.
    width_m = 1.03 / 2.3548 * sound_speed / drive.carrier_hz * focus_m / diameter_m
    measured = focal_distortion(drive.sppa_w_per_m2, drive.carrier_hz, focus_m, diameter_m, width_m, sound_speed)
    linear, intensity_ratio, rarefaction_ratio = (np.array(column) for column in SHOCKED)
    # The table is a function of the distortion of a linear wave. The measured intensity already includes shocks, so
    # its distortion is that of the linear wave times the root of the intensity ratio.
    distortion = float(np.interp(measured, linear * np.sqrt(intensity_ratio), linear))
    # Effect of shocks at the drive in use over that at the drive of the calibration.
    changes = [
        float(np.interp(distortion * drive_ratio, linear, ratio) / np.interp(distortion, linear, ratio)) - 1
        for ratio in (intensity_ratio, rarefaction_ratio)
    ]
    if max(abs(change) for change in changes) > MIN_OUTPUT_CHANGE:
        yield (
            f"{scaled}; at distortions of {distortion:.2g} and {distortion * drive_ratio:.2g} at the focus (IEC 61949) "
            f"shocks change I_sppa by up to {100 * changes[0]:+.0f} % and p- by up to {100 * changes[1]:+.0f} %. "
            "Try: a calibration at the drive in use"
        )


def _push_diameter_m(scene: Scene, simulated: bool) -> float | None:
    """Return the diameter of the transducer that pushes, m: the declared one, else the twin's; None if unknown."""
    # ``push_focus_depth_m`` declares a second transducer, which pushes; the declared diameter is then that of the first
    # one, which only tracks. The transducer of the twin does both.
    beams = scene.beams
    if beams is not None and beams.push_focus_depth_m is None and beams.transducer_diameter_m is not None:
        return beams.transducer_diameter_m
    twin = twin_of(scene) if simulated else None
    return None if twin is None else twin.settings.beams.transducer.diameter_m
