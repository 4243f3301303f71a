"""Beam averaging: tracked over peak displacement, in the medium's own field and for the Gaussian motion of eq. (12).

A wave of the medium is broader than the force that makes it, so less of its peak is lost over the tracking beam than of
the Gaussian of eq. (12), and what is tracked lags.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from hpe_rig.bench import twin_of
from hpe_rig.prediction.theory import beam_averaging_factor, gate_energy, speckle_spread
from hpe_rig.processing import Window, spec_of
from hpe_rig.result import Averaging
from hpe_rig.scene import Scene

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Triple = tuple[float, float, float]

DIRECTIONS = 96
AREA_STEP = 0.05
"""Relative step in the tracking beam's area over which a derivative is taken."""
SCALES = (0.05, 1e3)
"""Between which a Gaussian's widths are scaled; the upper end tracks the peak to 1e-7."""


def predicted_averaging(scene: Scene, estimator: str, simulated: bool = True) -> tuple[Averaging | None, ...]:
    """Return the averaging over the tracking beam at every wanted frequency; None without beams.

    The motion's shape is the field of the medium, ``scene.medium``'s or the twin's own; without either, eq. (12).
    """
    frequency_hz = np.array(scene.wanted_frequencies_hz)
    if scene.beams is None:
        return (None,) * frequency_hz.size
    widths = scene.beams.excitation_width_m, scene.beams.tracking_width_m
    gate = scene.acquisition.gate_length_m, pulse_length_m(scene)
    window = spec_of(estimator).gate_window
    # A fixed seed: a prediction is a function of the scene alone.
    spread = speckle_spread(*widths, *gate, np.random.default_rng(0), gate_window=window)
    gaussian = beam_averaging_factor(*widths, *gate, gate_window=window)
    motion = motion_of_medium(scene, frequency_hz, window, simulated)
    if motion is None:
        return tuple(_off_focus(scene, Averaging(gaussian, 0.0, spread)) for _ in frequency_hz)
    depth_m, ratio = depth_spread(widths[1], *gate, window), motion[0] / motion[1]
    # To first order in how far the motion changes over the beam, its loss is in proportion to the Gaussian's.
    lost = (1 - np.abs(ratio)) / (1 - gaussian_averaging(*widths, depth_m))
    share = speckle_share(scene, frequency_hz, window, simulated)
    return tuple(
        _off_focus(scene, Averaging(1 - loss * (1 - gaussian), lag, amplitude, speckle_phase_rad=phase_rad))
        for loss, lag, amplitude, phase_rad in zip(
            lost.tolist(),
            np.angle(ratio).tolist(),
            (spread * np.abs(share.real)).tolist(),
            (spread * np.abs(share.imag)).tolist(),
            strict=True,
        )
    )


def speckle_share(
    scene: Scene, frequency_hz: FloatArray, window: Window = "none", simulated: bool = True
) -> ComplexArray:
    """Return what speckle does to the tracked displacement over what it does to a Gaussian motion's, (frequency,).

    Relative changes: the real part that of the amplitude, the imaginary part that of the phase. The tracked
    displacement is a mean over the scatterers with real weights that speckle draws about a Gaussian of variance s. Its
    variance is the sum of |a_n|^2 over the motion's Laguerre modes, a_n = (-s)^n / n! d^n M / ds^n for the mean M(s),
    and the first mode is nearly all of it: what counts is how steeply the averaging falls with the beam's area.
    """
    steps = [_wider(scene, 1 + step) for step in (-AREA_STEP, AREA_STEP)]
    motions = [motion_of_medium(each, frequency_hz, window, simulated) for each in steps]
    tracked = [motion[0] for motion in motions if motion is not None]
    means = [_gaussian_of(each, window) for each in steps]
    return np.asarray(
        (tracked[1] - tracked[0]) / (tracked[1] + tracked[0]) / ((means[1] - means[0]) / (means[1] + means[0]))
    )


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
    if scene.beams is None or scene.beams.focus_depth_m is None:
        return averaging
    gate_m, relative = scene.acquisition.gate_depth_m, scene.acquisition.sound_speed_uncertainty
    width_m = scene.beams.excitation_width_m[2]
    factor, spread = off_focus(gate_m - scene.beams.focus_depth_m, gate_m * relative, width_m)
    return replace(averaging, factor=averaging.factor * factor, offset_relative=spread)


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
    tracked = _displacement(shear_k2, lateral + tracking_width_m[0] ** 2 / 2, axial + axial_spread_m**2)
    return tracked / modulus_pa, _displacement(shear_k2, lateral, axial) / modulus_pa


@functools.lru_cache(maxsize=1)
def _nodes() -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(DIRECTIONS)


def _displacement(shear_k2: ComplexArray, lateral: float, axial: float) -> ComplexArray:
    """Return the displacement at the focus but for a factor: the sum over wave numbers done, that over directions here.

    Only the part 1 - m^2 of the force that has no divergence moves an incompressible medium, m the cosine to the beam.
    """
    node, weight = _nodes()
    # In the variable that makes a needle's spectrum smooth: m = tan(angle) / slope.
    slope = np.sqrt(max(axial / lateral - 1, 1e-12))
    angle = np.arctan(slope) * (node + 1) / 2
    m = np.tan(angle) / slope
    weight = weight * np.arctan(slope) / 2 / (slope * np.cos(angle) ** 2)
    a = (lateral * (1 - m**2) + axial * m**2) / 2
    q = np.sqrt(shear_k2)
    q = np.where(q.imag < 0, -q, q)[:, None]
    waves = np.sqrt(np.pi / a) / 2 + 0.5j * np.pi * q * wofz(q * np.sqrt(a))
    return np.asarray(waves @ (weight * 2 * (1 - m**2)))


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
