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
from hpe_rig.processing import BeamWidths, Window, displacement, harmonic_range_hz, medium_ensemble, spec_of
from hpe_rig.result import Averaging
from hpe_rig.scene import Scene

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Triple = tuple[float, float, float]

DIRECTIONS = 96
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
    motion = motion_of_medium(scene, frequency_hz, window, simulated=False)
    ratio, deviation = _ensemble_ratio(scene, beams, frequency_hz)
    if motion is not None:
        ratio, deviation = motion[0] / motion[1], 0 * deviation
    # To first order in how far the motion changes over the beam, all that speckle does is in proportion to the loss.
    lost = (1 - np.abs(ratio)) / (1 - gaussian_averaging(*widths, beams.axial_spread_m))
    turned = speckle_phase(ratio, gaussian, spread)
    uncertain = np.abs(ratio) * deviation.real, deviation.imag
    columns = np.stack([lost, np.angle(ratio), *uncertain, turned], axis=-1).tolist()
    return tuple(
        _off_focus(scene, Averaging(1 - share * (1 - gaussian), lag, share * spread, factor_u, phase_u, turn))
        for share, lag, factor_u, phase_u, turn in columns
    )


def _ensemble_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return tracked over peak motion (frequency,), and the standard deviations of its logarithm, over all media."""
    assert scene.excitation is not None  # noqa: S101 (as its caller knows)
    lowest_hz, highest_hz = harmonic_range_hz(scene.excitation.burst_rate_hz)
    # that of the prior, unless a frequency lies outside
    lowest_hz, highest_hz = min(lowest_hz, float(frequency_hz.min())), max(highest_hz, float(frequency_hz.max()))
    ensemble = medium_ensemble(beams, lowest_hz, highest_hz)
    to_wanted = ensemble.interpolation(frequency_hz)
    ratio = np.log((ensemble.tracked @ to_wanted.T) / (ensemble.peak @ to_wanted.T))
    return np.exp(ratio.mean(axis=0)), ratio.real.std(axis=0) + 1j * ratio.imag.std(axis=0)


def beam_widths(scene: Scene, estimator: str) -> BeamWidths | None:
    """Return the widths of the force and of what is tracked, for the ensemble of media; None without beams."""
    if scene.beams is None:
        return None
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    return BeamWidths(*widths, depth_spread(widths[1], *gate, spec_of(estimator).gate_window))


def speckle_phase(ratio: ComplexArray, gaussian: float, spread: float) -> FloatArray:
    """Return the standard deviation over speckle of the tracked phase, rad (frequency,).

    ``ratio`` (frequency,) is tracked over peak displacement. The tracked displacement is a mean over the scatterers
    with real weights that speckle draws, and to first order a draw scales the whole complex loss 1 - ratio by one
    number, whose standard deviation is known from the Gaussian motion: its averaging is ``gaussian``, its relative
    spread ``spread``. What of that loss lies across the mean phasor turns the phase.
    """
    scaled = spread * gaussian / (1 - gaussian)
    return np.asarray(scaled * np.abs(((1 - ratio) / ratio).imag))


def _off_focus(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` for a gate off the declared focus; as it is where no focus is declared.

    A gate that was put on the focus by its echoes stays there whatever the sound speed; one that was put there by its
    distance is off by what the sound speed is off.
    """
    if scene.beams is None or scene.beams.focus_depth_m is None:
        return averaging
    gate_m, relative = scene.acquisition.gate_depth_m, scene.acquisition.sound_speed_uncertainty
    width_m = scene.beams.excitation_width_m[2]
    factor, spread = off_focus(gate_m - scene.beams.focus_depth_m, gate_m * relative, width_m)
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
