"""Physics that a scene states: its medium, push, beams and tracking gate, and the motion they give."""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.bench import scanned_push, twin_of
from hpe_rig.medium import (
    BeamWidths,
    HarmonicMedium,
    PushForce,
    TrackingGate,
    aperture_force,
    burst_spectrum,
    scanned_force,
    tracked_motion,
)
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene

TYPICAL_VOIGT = (9e3, 2.0)
"""Shear modulus (Pa) and viscosity (Pa s) of muscle, used if no medium is known."""


def force_spectrum(
    harmonic: Int64Array | int, burst_rate_hz: float, burst_length_s: float, amplitude: float = 1.0
) -> ComplexArray:
    """Return the complex Fourier coefficients F_n of a train of tonebursts' force, with time from a burst's onset.

    ``harmonic`` is n and may be negative; the result has the unit of ``amplitude``. The sinusoid at n times the burst
    rate has the peak 2 |F_n|. Source: eq. (18) of the paper.
    """
    duty = burst_rate_hz * burst_length_s
    return np.asarray(amplitude * duty * burst_spectrum(np.asarray(harmonic, np.float64), duty))


def medium_of(scene: Scene, frequency_hz: FloatArray, simulated: bool = True) -> HarmonicMedium | None:
    """Return the complex shear modulus of the declared medium at ``frequency_hz``, else the twin's if ``simulated``.

    None if neither is known.
    """
    if scene.medium is not None:
        loss_pa = 2 * np.pi * frequency_hz * scene.medium.shear_viscosity_pa_s
        modulus_pa = np.asarray(scene.medium.shear_modulus_pa + 1j * loss_pa)
        return HarmonicMedium(frequency_hz, modulus_pa, scene.medium.density_kg_per_m3)
    twin = twin_of(scene) if simulated else None
    declared = None if twin is None else twin.medium(frequency_hz)
    return None if declared is None else HarmonicMedium(frequency_hz, *declared)


def push_force(scene: Scene) -> PushForce:
    """Return the shape of the force that pushes: as scanned, else of the declared aperture, else a Gaussian.

    The scene has [beams]. Raises ``SettingsError`` if the scan cannot be read.
    """
    beams, excitation = scene.beams, scene.excitation
    assert beams is not None  # noqa: S101 (callers check)
    if excitation is None:
        return PushForce.gaussian(beams.excitation_width_m)
    carrier_hz, sound_speed = excitation.carrier_hz, scene.acquisition.sound_speed_m_per_s
    if beams.excitation_scan is not None:
        intensity = scanned_push(beams.excitation_scan, carrier_hz, sound_speed)
        return scanned_force(intensity, carrier_hz, beams.attenuation_db_per_cm_mhz)
    # With two transducers the declared aperture is the one that tracks.
    if beams.transducer_diameter_m is None or beams.push_focus_depth_m is not None:
        return PushForce.gaussian(beams.excitation_width_m)
    focus_m = beams.focus_depth_m or scene.acquisition.gate_depth_m
    return aperture_force(
        beams.transducer_diameter_m, focus_m, carrier_hz, sound_speed, beams.attenuation_db_per_cm_mhz
    )


def pulse_length_m(scene: Scene) -> float:
    """Return the axial length of the received tracking pulse: as declared, else that of its cycles."""
    declared_m = None if scene.beams is None else scene.beams.pulse_length_m
    return declared_m or scene.tracking.cycles / scene.tracking.carrier_hz * scene.acquisition.sound_speed_m_per_s / 2


def tracking_gate(scene: Scene, estimator: str | None = None) -> TrackingGate:
    """Return tracking beam, gate and pulse of a scene with [beams], with the gate window of ``estimator``.

    Without an estimator: no window.
    """
    assert scene.beams is not None  # noqa: S101 (callers check)
    windowed = estimator is not None and spec_of(estimator).gate_window == "hann"
    return TrackingGate(
        tracking_width_m=scene.beams.tracking_width_m,
        gate_length_m=scene.acquisition.gate_length_m,
        pulse_length_m=pulse_length_m(scene),
        hann_window=windowed,
    )


def beam_widths(scene: Scene, estimator: str, offsets_of_joint_fit_m: tuple[float, ...] = ()) -> BeamWidths | None:
    """Return the widths of force and tracking beam that beam averaging depends on; None without beams.

    ``offsets_of_joint_fit_m``: all lateral offsets of a run; their ensembles of media are computed at once.
    """
    if scene.beams is None:
        return None
    # A force that is not Gaussian is modelled on its axis only.
    lateral_offset_m, force = abs(scene.tracking.lateral_offset_m), push_force(scene)
    return BeamWidths(
        force_width_m=scene.beams.excitation_width_m,
        tracking_width_m=scene.beams.tracking_width_m,
        depth_sd_m=tracking_gate(scene, estimator).depth_sd_m(),
        lateral_offset_m=lateral_offset_m,
        offsets_of_joint_fit_m=offsets_of_joint_fit_m,
        force=None if lateral_offset_m or force.is_gaussian else force,
    )


def focal_motion(
    scene: Scene, frequency_hz: FloatArray, simulated: bool = True
) -> tuple[ComplexArray, ComplexArray] | None:
    """Return tracked and peak displacement (frequency,) at the focus, up to a common factor, in the scene's medium.

    None if the medium is unknown. The force is Gaussian, the gate on its axis and without window.
    """
    medium = medium_of(scene, frequency_hz, simulated)
    if scene.beams is None or medium is None:
        return None
    # Without a gate window: one motion for all estimators.
    depth_sd_m = tracking_gate(scene).depth_sd_m()
    beams = BeamWidths(scene.beams.excitation_width_m, scene.beams.tracking_width_m, depth_sd_m)
    return tracked_motion(medium, beams)[:2]


def gaussian_motion_width_m(scene: Scene, frequency_hz: float) -> tuple[float, float, float]:
    """Return the sigmas (x, y, z), m, of a Gaussian motion with the same beam averaging as the scene's motion.

    Both have the same ratio of tracked to peak displacement at ``frequency_hz``. The error model needs the Gaussian,
    because it knows speckle for Gaussian motions only. In an unknown medium: the widths of the force.
    """
    assert scene.beams is not None  # noqa: S101 (callers check)
    force_width_m = scene.beams.excitation_width_m
    motion = focal_motion(scene, np.array([frequency_hz]))
    if motion is None:
        return force_width_m
    tracked, peak = motion
    beams = BeamWidths(force_width_m, scene.beams.tracking_width_m, tracking_gate(scene).depth_sd_m())
    scale = beams.width_scale(float(abs(tracked[0] / peak[0])))
    x_m, y_m, z_m = force_width_m
    return x_m * scale, y_m * scale, z_m * scale
