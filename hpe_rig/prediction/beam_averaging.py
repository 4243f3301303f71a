"""Beam averaging: tracked over peak displacement, in the medium's own field and for the Gaussian motion of eq. (12).

A wave of the medium is broader than the force that makes it, so less of its peak is lost over the tracking beam than of
the Gaussian of eq. (12), and what is tracked lags.
"""

from __future__ import annotations

import cmath
import functools
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, SingleArray
from hpe_rig.bench import scanned_push, twin_of
from hpe_rig.medium import (
    BeamWidths,
    Ensemble,
    PushForce,
    aperture_force,
    displacement_and_slope,
    medium_ensemble,
    scanned_force,
    seen_beside,
)
from hpe_rig.prediction.error_model import Conditions, Moved, seeded_speckle, tracked_over_peak
from hpe_rig.prediction.theory import beam_averaging_factor, carrier_spread, gate_energy, scatterer_density
from hpe_rig.processing import (
    Window,
    bounded_steepness,
    driven_spectrum,
    harmonic_range_hz,
    spec_of,
    with_second_order_speckle,
)
from hpe_rig.result import Averaging
from hpe_rig.scene import Scene

Triple = tuple[float, float, float]

DIRECTIONS = 96
OFF_AXIS_SHARE = 0.913
"""Of what obliquity takes on the axis, its mean over the focal plane, by energy of echoes, at any aperture."""
SHAPE_RELATIVE = 0.004
"""Between what beams of an aperture and Gaussians of the same echo energy track, besides (scripts/validation/aperture.py)."""
SPECKLE_PER_CELL = 11.0
"""Scatterers per resolution cell where nothing says otherwise: fully developed speckle (paper, Table I)."""
SPECKLE_DRAWS = 2000
BY_ECHO = "coherent"
"""An estimator of the whole gate that divides the phase by the echo's own mean frequency."""
TYPICAL = (9e3, 2.0)
"""Shear modulus, Pa, and viscosity, Pa s, where no medium is known: those of muscle."""
SCALES = (0.05, 1e3)
"""Between which a Gaussian's widths are scaled; the upper end tracks the peak to 1e-7."""


def predicted_averaging(
    scene: Scene, estimator: str, together_m: tuple[float, ...] = ()
) -> tuple[Averaging | None, ...]:
    """Return the averaging over the tracking beam at every wanted frequency; None without beams and sphere.

    The motion's shape is the field of the declared medium. Where none is, it is that of the ensemble of media, with the
    spread of the ensemble as uncertainty; without tonebursts that of eq. (12). ``check``, report, design and the budget
    of a result all have it from here. ``together_m``: as of ``BeamWidths``.
    """
    frequency_hz, beams = np.array(scene.wanted_frequencies_hz), beam_widths(scene, estimator, together_m)
    resting = resting_conditions(scene)
    if scene.sphere is not None:
        # it moves as a whole: all of its motion is tracked
        return (Averaging(1.0, 0.0, 0.0),) * frequency_hz.size
    if scene.beams is None or beams is None or resting is None:
        return (None,) * frequency_hz.size
    widths, window = (beams.force_width_m, beams.tracking_width_m), spec_of(estimator).gate_window
    lengths = resting.gate_length_m, resting.pulse_length_m
    gaussian = beam_averaging_factor(*widths, *lengths, gate_window=window, scatterers_per_m3=resting.scatterers_per_m3)
    spread, carrier = speckle_spread(resting, estimator)
    if scene.excitation is None:
        alike = Averaging(gaussian, 0.0, spread, carrier_relative=carrier)
        return tuple(_as_sensed(scene, alike) for _ in frequency_hz)
    many = gaussian_averaging(*widths, beams.axial_spread_m)
    # To first order in how far the motion changes over the beam, its loss is in proportion to the Gaussian's.
    loss_scale, area_spread = (1 - gaussian) / (1 - many), spread / -_gaussian_steepness(beams)
    ratio, deviation, steepness = _seen_through(scene, beams, frequency_hz)
    factor = 1 - loss_scale * (1 - np.abs(ratio))
    speckle, uncertain = area_spread * steepness, (factor * deviation.real, deviation.imag)
    columns = np.stack([factor, np.angle(ratio), speckle.real, *uncertain, speckle.imag], axis=-1).tolist()
    rest = {"carrier_relative": carrier, "area_spread": area_spread, "loss_scale": loss_scale}
    found = [replace(Averaging(*each), **rest) for each in columns]
    return tuple(
        _scaled(_as_sensed(scene, with_second_order_speckle(each)), share)
        for each, share in zip(found, _by_its_force(scene, beams, frequency_hz), strict=True)
    )


def tracked_spread(scene: Scene, estimator: str) -> tuple[float, float, float]:
    """Return standard deviations over speckle: of the area across that is tracked, relative, its middle and depth, m.

    What tracks, weights the scatterers' motion: the mean of their (x^2 + y^2) / 2, x and z under those weights. Zeros
    without beams.
    """
    resting = resting_conditions(scene)
    return (0.0, 0.0, 0.0) if resting is None else region_spread(resting, estimator)


def depth_in_gate(scene: Scene, estimator: str, off_focus_m: float) -> tuple[float, float]:
    """Return how far from a gate's middle its echoes come on the mean, and their standard deviation in depth, m.

    Of a gate whose middle lies ``off_focus_m`` behind the focus, where the tracking beam is stronger on the near side:
    the energy of a gate at the focus times exp(-2 z_c z / T_z^2).
    """
    assert scene.beams is not None  # noqa: S101 (as its callers know)
    widths, lengths = scene.beams.tracking_width_m, (scene.acquisition.gate_length_m, pulse_length_m(scene))
    depth_m, energy = gate_energy(widths, *lengths, spec_of(estimator).gate_window)
    exponent = -2 * off_focus_m * depth_m / widths[2] ** 2
    energy = energy * np.exp(exponent - exponent.max())
    mean_m = float(energy @ depth_m / energy.sum())
    return mean_m, float(np.sqrt(energy @ (depth_m - mean_m) ** 2 / energy.sum()))


@functools.lru_cache(maxsize=16)
def region_spread(resting: Conditions, estimator: str) -> tuple[float, float, float]:
    """Return ``tracked_spread`` of ``resting`` echoes."""

    def spread(moved: Moved) -> tuple[float, float]:
        found = tracked_over_peak(resting, estimator, seeded_speckle(resting, SPECKLE_DRAWS, moved))
        return float(found.mean()), float(found.std())

    unit_m = resting.tracking_width_m[0]
    mean, area = spread(lambda place: np.square(place[:2] / unit_m).sum(axis=0) / 2)
    across, along = (unit_m * spread(functools.partial(_along_axis, axis, unit_m))[1] for axis in (0, 2))
    return area / mean, across, along


def _along_axis(axis: int, unit_m: float, place: SingleArray) -> SingleArray:
    return np.asarray(place[axis] / np.float32(unit_m))


def resting_conditions(scene: Scene) -> Conditions | None:
    """Return the conditions of echoes that are at rest and without noise; None without beams.

    Where no twin says how many scatterers there are, speckle is fully developed.
    """
    if scene.beams is None or not scene.wanted_frequencies_hz:
        return None
    acquisition, tracking, beams, twin = scene.acquisition, scene.tracking, scene.beams, twin_of(scene)
    per_cell = 0.0 if twin is None else twin.scatterers_per_cell
    return Conditions(
        excitation_width_m=beams.excitation_width_m,
        tracking_width_m=beams.tracking_width_m,
        gate_length_m=acquisition.gate_length_m,
        pulse_length_m=pulse_length_m(scene),
        scatterers_per_m3=scatterer_density(beams.tracking_width_m, per_cell or SPECKLE_PER_CELL),
        carrier_hz=tracking.carrier_hz,
        sound_speed_m_per_s=acquisition.sound_speed_m_per_s,
        sample_rate_hz=acquisition.sample_rate_hz,
        pulse_rate_hz=tracking.pulse_rate_hz,
        pulses=1,
        frequency_hz=scene.wanted_frequencies_hz[0],
        amplitude_m=0.0,
        snr=np.inf,
    )


@functools.lru_cache(maxsize=16)
def speckle_spread(resting: Conditions, estimator: str) -> tuple[float, float]:
    """Return relative standard deviations over speckle of the tracked displacement, and of the carrier it is taken for.

    Of a Gaussian motion as wide as ``resting`` says, over scatterers drawn at random:
    speckle's dark spots give a heavy tail, and it repeats to about 2 / sqrt(``SPECKLE_DRAWS``). The second, in closed
    form, is 0 for an estimator that does not divide by the carrier.
    """
    spec = spec_of(estimator)
    # An estimator that divides by the carrier sees the same echo and motion as one by the echo's own mean frequency.
    name, speckle = BY_ECHO if spec.by_carrier else estimator, seeded_speckle(resting, SPECKLE_DRAWS)
    ratio = tracked_over_peak(resting, name, speckle)
    lengths = resting.tracking_width_m[2], resting.gate_length_m, resting.pulse_length_m
    carrier = carrier_spread(*lengths, 1 / resting.metres_per_radian, spec.gate_window) if spec.by_carrier else 0.0
    return float(ratio.std() / ratio.mean()), carrier


def _seen_through(
    scene: Scene, beams: BeamWidths, frequency_hz: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return tracked over peak motion (frequency,), its uncertainty, and how steeply it falls with the beam's area.

    Complex: relative amplitude and phase. Of the
    declared medium, else of the whole ensemble: the mean of the ratio's logarithm, its standard deviation, and the
    root mean square of the steepness.
    """
    known = medium_of(scene, frequency_hz, simulated=False)
    if known is not None and beams.lateral_m:
        place_m = np.array([beams.lateral_m])
        tracked, peak, change = (each[:, 0] for each in seen_beside(*known, frequency_hz, beams, place_m))
        return tracked / peak, np.zeros_like(tracked), change / tracked
    if known is not None:
        widths = beams.force_width_m, beams.tracking_width_m
        tracked, peak, by_area = medium_motion(*known, frequency_hz, *widths, beams.axial_spread_m)
        steep = by_area / tracked
        return tracked / peak, np.zeros_like(tracked), np.abs(steep.real) + 1j * np.abs(steep.imag)
    ensemble = _ensemble(scene, beams, frequency_hz)
    to_wanted = ensemble.interpolation(frequency_hz).T
    tracked, peak, change = (each @ to_wanted for each in (ensemble.tracked, ensemble.peak, ensemble.steepness))
    assert scene.excitation is not None  # noqa: S101 (as its caller knows)
    # every medium is driven until it moves as far in all
    bursts = scene.excitation.burst_rate_hz, scene.excitation.burst_length_s[0]
    whole = ensemble.tracked @ driven_spectrum(ensemble, *bursts).T
    power = np.abs(tracked) ** 2 / np.sum(np.abs(whole) ** 2, axis=1, keepdims=True)
    ratio, steep = np.log(tracked / peak), bounded_steepness(change / tracked, power / power.mean(axis=0))

    def rms(values: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.mean(values**2, axis=0)))

    deviation = ratio.real.std(axis=0) + 1j * ratio.imag.std(axis=0)
    return np.exp(ratio.mean(axis=0)), deviation, rms(steep.real) + 1j * rms(steep.imag)


def _ensemble(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> Ensemble:
    """Return the ensemble of the prior, unless a frequency lies outside its range."""
    assert scene.excitation is not None  # noqa: S101 (as its caller knows)
    lowest_hz, highest_hz = harmonic_range_hz(scene.excitation.burst_rate_hz)
    if beams.lateral_m:
        return medium_ensemble(beams, lowest_hz, highest_hz)
    return medium_ensemble(beams, min(lowest_hz, float(frequency_hz.min())), max(highest_hz, float(frequency_hz.max())))


def beam_widths(scene: Scene, estimator: str, together_m: tuple[float, ...] = ()) -> BeamWidths | None:
    """Return the widths of the force and of what is tracked, for the ensemble of media; None without beams.

    ``together_m``: as of ``BeamWidths``.
    """
    if scene.beams is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    depth_m = depth_spread(widths[1], *gate, spec_of(estimator).gate_window)
    lateral_m, force = abs(scene.tracking.lateral_offset_m), force_of(scene)
    shape = None if lateral_m or len(force.centre_m) == 1 else force
    return BeamWidths(*widths, depth_m, lateral_m=lateral_m, together_m=together_m, force=shape)


def _by_its_force(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> list[complex]:
    """Return tracked over peak motion under the force of the declared aperture over that under the Gaussian.

    In the declared medium, else in a typical one: at the paper's aperture it is 1.005 at 100 Hz and less above, 0.1
    degrees later at all of them, and hangs little on the medium.
    """
    force = force_of(scene)
    if len(force.centre_m) == 1:
        return [1.0 + 0j] * frequency_hz.size
    typical_pa = np.asarray(TYPICAL[0] + 2j * np.pi * frequency_hz * TYPICAL[1])
    modulus_pa, density = medium_of(scene, frequency_hz, simulated=False) or (typical_pa, 1000.0)
    medium = tuple(modulus_pa.tolist()), tuple(frequency_hz.tolist()), density
    gaussian = PushForce(beams.force_width_m[:1], beams.force_width_m[2])
    own, its = (_tracked_share(*medium, each, beams) for each in (force, gaussian))
    return [one / other for one, other in zip(own, its, strict=True)]


@functools.lru_cache(maxsize=16)
def _tracked_share(
    modulus_pa: tuple[complex, ...],
    frequency_hz: tuple[float, ...],
    density: float,
    force: PushForce,
    beams: BeamWidths,
) -> tuple[complex, ...]:
    """Return tracked over peak motion under a force, complex (frequency,)."""
    # here: it needs SciPy, and most scenes declare no aperture
    from hpe_rig.medium import shear_motion

    medium = np.array(modulus_pa), np.array(frequency_hz), density, force
    seen, place = (beams.tracking_width_m[0] ** 2 / 2, beams.axial_spread_m**2), np.array([beams.lateral_m])
    tracked, peak = (shear_motion(*medium, *area, place).value[:, 0] for area in (seen, (0.0, 0.0)))
    return tuple((tracked / peak).tolist())


def _scaled(averaging: Averaging, share: complex) -> Averaging:
    size, turn = abs(share), cmath.phase(share)
    return replace(
        averaging,
        factor=averaging.factor * size,
        phase_rad=averaging.phase_rad + turn,
        offset_factor=averaging.offset_factor * size,
        offset_phase_rad=averaging.offset_phase_rad + turn,
    )


def force_of(scene: Scene) -> PushForce:
    """Return the shape of the push's force: as scanned, that of the declared aperture, else a Gaussian.

    The scene has [beams]. Raises ``SettingsError`` where the scan cannot be read.
    """
    beams, carrier = scene.beams, scene.excitation
    assert beams is not None  # noqa: S101 (as its callers know)
    if beams.excitation_scan is not None and carrier is not None:
        seen = scanned_push(beams.excitation_scan, carrier.carrier_hz, scene.acquisition.sound_speed_m_per_s)
        return scanned_force(seen, carrier.carrier_hz, beams.attenuation_db_per_cm_mhz)
    # with two transducers the aperture is the one that tracks
    if beams.transducer_diameter_m is None or carrier is None or beams.push_focus_depth_m is not None:
        return PushForce(beams.excitation_width_m[:1], beams.excitation_width_m[2])
    focus_m, loss = beams.focus_depth_m or scene.acquisition.gate_depth_m, beams.attenuation_db_per_cm_mhz
    known = beams.transducer_diameter_m, focus_m, carrier.carrier_hz, scene.acquisition.sound_speed_m_per_s
    return aperture_force(*known, loss)


def _gaussian_steepness(beams: BeamWidths) -> float:
    """Return the relative change of the Gaussian motion's averaging with the logarithm of the tracking beam's area."""
    pairs = zip(beams.tracking_width_m[:2], beams.force_width_m[:2], strict=True)
    squares = [width**2 / 2 / motion**2 for width, motion in pairs]
    return -sum(square / (1 + square) for square in squares) / 2


def _as_sensed(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` for the oblique waves of the declared aperture, and for a gate off the focus."""
    return _off_focus(scene, _oblique(scene, averaging))


def _oblique(scene: Scene, averaging: Averaging) -> Averaging:
    if scene.beams is None or scene.beams.transducer_diameter_m is None:
        return averaging
    focus_m = scene.beams.focus_depth_m or scene.acquisition.gate_depth_m
    sensed = oblique_share(scene.beams.transducer_diameter_m, focus_m)
    return replace(averaging, factor=averaging.factor * sensed, offset_factor=sensed, shape_relative=SHAPE_RELATIVE)


def oblique_share(diameter_m: float, focal_length_m: float) -> float:
    """Return the delay that a displacement makes in a focused beam, over 2 u / c, weighted by the echoes' energy.

    The waves of a bowl reach the focus under all angles up to its half angle: their mean cosine is less than 1.
    docs/explanation/transducer.md, section 2.
    """
    sine = min(diameter_m / 2 / focal_length_m, 1.0)
    return float(1 - OFF_AXIS_SHARE * (1 - np.sqrt(1 - sine**2)) / 2)


def _off_focus(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` for a gate off the declared focus; as it is where no focus is declared.

    A gate that was put on the focus by its echoes stays there whatever the sound speed; one that was put there by its
    distance is off by what the sound speed is off.
    """
    if scene.beams is None or (scene.beams.focus_depth_m is None and not scene.tracking.axial_offset_m):
        return averaging
    gate_m, relative = scene.gate_depth_m, scene.acquisition.sound_speed_uncertainty
    width_m, focus_m = scene.beams.excitation_width_m[2], scene.beams.focus_depth_m
    if focus_m is None:
        # put there by its echoes, from where the gate is moved by a known distance
        focus_m, relative = scene.acquisition.gate_depth_m, 0.0
    factor, spread = off_focus(gate_m - focus_m, gate_m * relative, width_m)
    both = averaging.offset_factor * factor
    return replace(averaging, factor=averaging.factor * factor, offset_relative=spread, offset_factor=both)


def off_focus(offset_m: float, uncertainty_m: float, width_m: float) -> tuple[float, float]:
    """Return displacement at ``offset_m`` along the beam over that at the focus, and its relative uncertainty.

    The force, of sigma ``width_m`` along the beam, is much longer than wide, so that the displacement follows it:
    d(z) = exp(-z^2 / 2 E_z^2). The uncertainty is the root mean square of d(z) / d(offset) - 1 over z normal about
    ``offset_m`` with the standard deviation ``uncertainty_m``, which holds also at the focus, where the slope is none.
    """
    there = np.exp(-(offset_m**2) / (2 * width_m**2))

    def moment(order: int) -> float:
        broader = width_m**2 + order * uncertainty_m**2
        return float(width_m / np.sqrt(broader) * np.exp(-order * offset_m**2 / (2 * broader)))

    mean_square = moment(2) - 2 * there * moment(1) + there**2
    return float(there), float(np.sqrt(max(mean_square, 0.0)) / there)


def motion_of_medium(
    scene: Scene, frequency_hz: FloatArray, window: Window = "none", simulated: bool = True
) -> tuple[ComplexArray, ComplexArray] | None:
    """Return tracked and peak displacement of ``medium_motion`` in the scene's medium; None where none is known."""
    known = medium_of(scene, frequency_hz, simulated)
    if scene.beams is None or known is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), window)
    return medium_motion(*known, frequency_hz, *widths, depth_m)[:2]


def medium_of(scene: Scene, frequency_hz: FloatArray, simulated: bool = True) -> tuple[ComplexArray, float] | None:
    """Return complex shear modulus (frequency,), Pa, and density, kg/m^3, as declared, else of the twin if wanted."""
    if scene.medium is not None:
        loss_pa = 2 * np.pi * frequency_hz * scene.medium.shear_viscosity_pa_s
        return np.asarray(scene.medium.shear_modulus_pa + 1j * loss_pa), scene.medium.density_kg_per_m3
    twin = twin_of(scene) if simulated else None
    return None if twin is None else twin.medium(frequency_hz)


def motion_width_m(scene: Scene, frequency_hz: float) -> Triple:
    """Return the sigmas of the Gaussian motion that is tracked like the scene's."""
    assert scene.beams is not None  # noqa: S101 (as its caller knows)
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    motion = motion_of_medium(scene, np.array([frequency_hz]))
    if motion is None:
        return widths[0]
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), "none")
    x, y, z = widths[0]
    scale = width_scale(float(abs(motion[0][0] / motion[1][0])), *widths, depth_m)
    return x * scale, y * scale, z * scale


def pulse_length_m(scene: Scene) -> float:
    """Return the axial length of the tracking pulse as received: as declared, or that of its cycles."""
    declared_m = None if scene.beams is None else scene.beams.pulse_length_m
    return declared_m or scene.tracking.cycles / scene.tracking.carrier_hz * scene.acquisition.sound_speed_m_per_s / 2


def medium_motion(
    modulus_pa: ComplexArray,
    density_kg_per_m3: float,
    frequency_hz: FloatArray,
    force_width_m: Triple,
    tracking_width_m: Triple,
    axial_spread_m: float,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the tracked and the peak displacement over the force, complex (frequency,), time factor exp(+jwt).

    And the derivative of the tracked one by the logarithm of the tracking beam's area. All but for one real factor.
    ``modulus_pa`` (frequency,) complex shear modulus; ``force_width_m`` the sigmas of the Gaussian body force (round),
    ``tracking_width_m`` those of the tracking beam; ``axial_spread_m`` the standard deviation of depth in the gate,
    weighted by echo energy. Speckle weights by energy, a Gaussian of variance T^2/2 across: in the plane of wave
    numbers that is a force as much broader, of the same density at each.
    """
    shear_k2 = density_kg_per_m3 * (2 * np.pi * frequency_hz) ** 2 / modulus_pa
    lateral, axial, area = force_width_m[0] ** 2, force_width_m[2] ** 2, tracking_width_m[0] ** 2 / 2
    across, along = (lateral + area, lateral), (axial + axial_spread_m**2, axial)
    moved, by_area = _tracked_and_peak(np.asarray(shear_k2, np.complex128).tobytes(), across, along)
    tracked, peak, change = np.stack([*moved, area * by_area[0]]) / modulus_pa
    return tracked, peak, change


@functools.lru_cache(maxsize=4)
def _tracked_and_peak(
    shear_k2: bytes, across: tuple[float, float], along: tuple[float, float]
) -> tuple[ComplexArray, ComplexArray]:
    """Return tracked and peak motion times the modulus, and their changes with area across, each (2, frequency).

    Kept: what is foreseen of a scene asks several times for the motion of all harmonics.
    """
    wave = np.frombuffer(shear_k2, np.complex128)
    return displacement_and_slope(np.stack([wave, wave]), np.array(across), np.array(along), DIRECTIONS)


def depth_spread(tracking_width_m: Triple, gate_length_m: float, pulse_length_m: float, window: Window) -> float:
    """Return the standard deviation of depth in the (windowed) gate, m, weighted by the energy of the echoes."""
    depth_m, energy = gate_energy(tracking_width_m, gate_length_m, pulse_length_m, window)
    return float(np.sqrt(energy @ depth_m**2 / energy.sum()))


def gaussian_averaging(motion_width_m: Triple, tracking_width_m: Triple, axial_spread_m: float) -> float:
    """Return the same for a motion of Gaussian shape with the sigmas ``motion_width_m``, eq. (12)."""
    spreads = [width / np.sqrt(2) for width in tracking_width_m[:2]] + [axial_spread_m]
    return float(np.prod([1 / np.hypot(1, s / e) for s, e in zip(spreads, motion_width_m, strict=True)]))


def width_scale(averaging: float, motion_width_m: Triple, tracking_width_m: Triple, axial_spread_m: float) -> float:
    """Return the factor on ``motion_width_m`` with which a Gaussian motion is tracked at ``averaging`` of its peak."""

    low, high = SCALES
    # The averaging grows with the width: halve the ratio of the bounds until they meet.
    while high > low * (1 + 1e-12):
        scale = float(np.sqrt(low * high))
        wide = (motion_width_m[0] * scale, motion_width_m[1] * scale, motion_width_m[2] * scale)
        enough = gaussian_averaging(wide, tracking_width_m, axial_spread_m) >= averaging
        low, high = (low, scale) if enough else (scale, high)
    return high
