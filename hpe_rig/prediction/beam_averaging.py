"""Beam averaging: tracked over peak displacement, in the medium's own field and for the Gaussian motion of eq. (12).

A wave of the medium is broader than the force that makes it, so less of its peak is lost over the tracking beam than of
the Gaussian of eq. (12), and what is tracked lags.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hpe_rig.bench import twin_of
from hpe_rig.prediction.theory import beam_averaging_factor, gate_energy, speckle_spread
from hpe_rig.processing import (
    MEMBERS,
    BeamWidths,
    Window,
    displacement,
    harmonic_range_hz,
    medium_ensemble,
    shear_motion,
    spec_of,
)
from hpe_rig.result import Averaging
from hpe_rig.scene import Medium, Scene

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Triple = tuple[float, float, float]

DIRECTIONS = 96
FEW_MEMBERS = 40
"""Media that tell how steeply the averaging falls with the beam's area, which hardly hangs on the medium."""
TYPICAL_MEDIUM = Medium(shear_modulus_pa=8e3, shear_viscosity_pa_s=1.7)
"""In the middle of the ensemble of media."""
AREA_STEP = 0.05
"""Relative step in the tracking beam's area over which a derivative is taken."""
SCALES = (0.05, 1e3)
"""Between which a Gaussian's widths are scaled; the upper end tracks the peak to 1e-7."""


def predicted_averaging(scene: Scene, estimator: str) -> tuple[Averaging | None, ...]:
    """Return the averaging over the tracking beam at every wanted frequency; None without beams.

    The motion's shape is the field of the declared medium. Where none is, it is that of the ensemble of media, with the
    spread of the ensemble as uncertainty; without tonebursts that of eq. (12).
    """
    frequency_hz, beams = np.array(scene.wanted_frequencies_hz), beam_widths(scene, estimator)
    if scene.beams is None or beams is None:
        return (None,) * frequency_hz.size
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    window = spec_of(estimator).gate_window
    # A fixed seed: a prediction is a function of the scene alone.
    spread = speckle_spread(*widths, *gate, np.random.default_rng(0), gate_window=window)
    gaussian = beam_averaging_factor(*widths, *gate, gate_window=window)
    if scene.excitation is None:
        return tuple(_off_focus(scene, Averaging(gaussian, 0.0, spread)) for _ in frequency_hz)
    if beams.lateral_m:
        return tuple(_off_focus(scene, each) for each in _beside(scene, beams, frequency_hz, spread))
    motion = motion_of_medium(scene, frequency_hz, window, simulated=False)
    ratio, deviation = _ensemble_ratio(scene, beams, frequency_hz)
    if motion is not None:
        ratio, deviation = motion[0] / motion[1], 0 * deviation
    # To first order in how far the motion changes over the beam, its loss is in proportion to the Gaussian's.
    lost = (1 - np.abs(ratio)) / (1 - gaussian_averaging(*widths, beams.axial_spread_m))
    uncertain = np.abs(ratio) * deviation.real, deviation.imag
    share = spread * speckle_share(scene, estimator)
    columns = np.stack([lost, np.angle(ratio), np.abs(share.real), *uncertain, np.abs(share.imag)], axis=-1).tolist()
    return tuple(_off_focus(scene, Averaging(1 - loss * (1 - gaussian), *each)) for loss, *each in columns)


def _beside(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray, gaussian_spread: float) -> list[Averaging]:
    """Return the averaging where the tracking beam lies beside the push.

    Speckle moves the middle of what is tracked, and changes its area; the motion changes by its slopes. Without a
    declared medium it is that of a typical one, and half of what the averaging does is uncertain.
    """
    medium = scene.medium or TYPICAL_MEDIUM
    loss_pa = 2 * np.pi * frequency_hz * medium.shear_viscosity_pa_s
    modulus: ComplexArray = np.asarray(medium.shear_modulus_pa + 1j * loss_pa, np.complex128)
    across, along, seen = beams.force_width_m[0] ** 2, beams.force_width_m[2] ** 2, beams.tracking_width_m[0] ** 2 / 2
    rest = modulus, frequency_hz, medium.density_kg_per_m3, (beams.force_width_m[0], beams.force_width_m[2])
    place = np.array([beams.lateral_m])
    tracked = shear_motion(*rest, across + seen, along + beams.axial_spread_m**2, place)
    ratio = (tracked.value / shear_motion(*rest, across, along, place).value)[:, 0]
    area = _area_spread(beams, gaussian_spread)
    shift = tracked.by_lateral / tracked.value * np.sqrt(seen) * area
    wider = tracked.by_across / tracked.value * seen * area
    amplitude, phase = np.hypot(shift.real, wider.real)[:, 0], np.hypot(shift.imag, wider.imag)[:, 0]
    unsure = 0.0 if scene.medium else 0.5
    columns = np.stack([np.abs(ratio), np.angle(ratio), amplitude, phase], axis=-1).tolist()
    return [
        Averaging(factor, lag, speckle, unsure * abs(1 - factor), unsure * abs(lag), turned)
        for factor, lag, speckle, turned in columns
    ]


def area_spread(scene: Scene, estimator: str) -> float:
    """Return the relative spread of the area that speckle lets the tracking average over; needs [beams].

    The middle of that area moves by the same share of its radius: both are means over as many independent speckles.
    """
    beams = beam_widths(scene, estimator)
    if scene.beams is None or beams is None:
        raise ValueError("without [beams] nothing is known of what the tracking averages over")
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate, window = (scene.acquisition.gate_length_m, pulse_length_m(scene)), spec_of(estimator).gate_window
    return _area_spread(beams, speckle_spread(*widths, *gate, np.random.default_rng(0), gate_window=window))


def _area_spread(beams: BeamWidths, gaussian_spread: float) -> float:
    """Return it from what speckle does to a Gaussian motion, whose mean over a variance s is E^2 / (E^2 + s)."""
    seen = beams.tracking_width_m[0] ** 2 / 2
    return gaussian_spread * (beams.force_width_m[0] ** 2 + seen) / seen


def _ensemble_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return tracked over peak motion (frequency,), and the standard deviations of its logarithm, over all media."""
    tracked, peak = _ensemble_motion(scene, beams, frequency_hz, MEMBERS)
    ratio = np.log(tracked / peak)
    return np.exp(ratio.mean(axis=0)), ratio.real.std(axis=0) + 1j * ratio.imag.std(axis=0)


def _ensemble_motion(
    scene: Scene, beams: BeamWidths, frequency_hz: FloatArray, members: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return tracked and peak motion (member, frequency) of the ensemble of media."""
    assert scene.excitation is not None  # noqa: S101 (as its caller knows)
    lowest_hz, highest_hz = harmonic_range_hz(scene.excitation.burst_rate_hz)
    # that of the prior, unless a frequency lies outside
    lowest_hz, highest_hz = min(lowest_hz, float(frequency_hz.min())), max(highest_hz, float(frequency_hz.max()))
    ensemble = medium_ensemble(beams, lowest_hz, highest_hz, members=members)
    to_wanted = ensemble.interpolation(frequency_hz)
    return ensemble.tracked @ to_wanted.T, ensemble.peak @ to_wanted.T


def beam_widths(scene: Scene, estimator: str) -> BeamWidths | None:
    """Return the widths of the force and of what is tracked, for the ensemble of media; None without beams."""
    if scene.beams is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    depth_m = depth_spread(widths[1], *gate, spec_of(estimator).gate_window)
    return BeamWidths(*widths, depth_m, lateral_m=abs(scene.tracking.lateral_offset_m))


def speckle_share(scene: Scene, estimator: str) -> ComplexArray:
    """Return what speckle does to the tracked displacement over what it does to a Gaussian motion's, (frequency,).

    Relative changes: the real part that of the amplitude, the imaginary part that of the phase. The tracked
    displacement is a mean over the scatterers with real weights that speckle draws about a Gaussian of variance s. Its
    variance is the sum of |a_n|^2 over the motion's Laguerre modes, a_n = (-s)^n / n! d^n M / ds^n for the mean M(s),
    and the first mode is nearly all of it: what counts is how steeply the averaging falls with the beam's area.
    """
    window = spec_of(estimator).gate_window
    steps = [_wider(scene, 1 + step) for step in (-AREA_STEP, AREA_STEP)]
    lower, upper = (_log_tracked(each, estimator) for each in steps)
    means = [_gaussian_of(each, window) for each in steps]
    return np.asarray((upper - lower).mean(axis=0) / np.log(means[1] / means[0]))


def _log_tracked(scene: Scene, estimator: str) -> ComplexArray:
    """Return the logarithm of the tracked motion (member, frequency): of the declared medium alone, or of all."""
    frequency_hz, beams = np.array(scene.wanted_frequencies_hz), beam_widths(scene, estimator)
    motion = motion_of_medium(scene, frequency_hz, spec_of(estimator).gate_window, simulated=False)
    if motion is not None:
        return np.asarray(np.log(motion[0])[None])
    assert beams is not None  # noqa: S101 (as its caller knows)
    return np.asarray(np.log(_ensemble_motion(scene, beams, frequency_hz, FEW_MEMBERS)[0]))


def _wider(scene: Scene, area: float) -> Scene:
    """Return ``scene`` with a tracking beam of ``area`` times its cross section."""
    assert scene.beams is not None  # noqa: S101 (as its caller knows)
    x, y, z = scene.beams.tracking_width_m
    beams = scene.beams.model_copy(update={"tracking_width_m": (x * area**0.5, y * area**0.5, z)})
    return scene.model_copy(update={"beams": beams})


def _gaussian_of(scene: Scene, window: Window) -> float:
    """Return the averaging of the Gaussian motion of eq. (12) over the scene's beams."""
    assert scene.beams is not None  # noqa: S101 (as its caller knows)
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), window)
    return gaussian_averaging(*widths, depth_m)


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
    return replace(averaging, factor=averaging.factor * factor, offset_relative=spread, offset_factor=factor)


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
    """Return ``medium_motion`` of the scene's medium; None where none is known."""
    if scene.beams is None:
        return None
    known: tuple[ComplexArray, float] | None = None
    if scene.medium is not None:
        loss_pa = 2 * np.pi * frequency_hz * scene.medium.shear_viscosity_pa_s
        known = np.asarray(scene.medium.shear_modulus_pa + 1j * loss_pa), scene.medium.density_kg_per_m3
    elif simulated and (twin := twin_of(scene)) is not None:
        known = twin.medium(frequency_hz)
    if known is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    depth_m = depth_spread(widths[1], scene.acquisition.gate_length_m, pulse_length_m(scene), window)
    return medium_motion(*known, frequency_hz, *widths, depth_m)


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
) -> tuple[ComplexArray, ComplexArray]:
    """Return the tracked and the peak displacement over the force, complex (frequency,), time factor exp(+jwt).

    Both but for one real factor. ``modulus_pa`` (frequency,) complex shear modulus; ``force_width_m`` the sigmas of the
    Gaussian body force (round), ``tracking_width_m`` those of the tracking beam; ``axial_spread_m`` the standard
    deviation of depth in the gate, weighted by echo energy. Speckle weights by energy, a Gaussian of variance T^2/2
    across: in the plane of wave numbers that is a force as much broader, of the same density at each.
    """
    shear_k2 = density_kg_per_m3 * (2 * np.pi * frequency_hz) ** 2 / modulus_pa
    lateral, axial = force_width_m[0] ** 2, force_width_m[2] ** 2
    across = np.array([lateral + tracking_width_m[0] ** 2 / 2, lateral])
    along = np.array([axial + axial_spread_m**2, axial])
    tracked, peak = displacement(np.stack([shear_k2, shear_k2]), across, along, DIRECTIONS) / modulus_pa
    return tracked, peak


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
