"""Tracked over peak displacement where the medium's own field moves the scatterers, and the Gaussian that is its like.

A wave of the medium is broader than the force that makes it, so less of its peak is lost over the tracking beam than of
the Gaussian of eq. (12), and what is tracked lags.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from hpe_rig.prediction.theory import GateWindow, gate_energy

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Triple = tuple[float, float, float]

DIRECTIONS = 96
SCALES = (0.05, 1e3)
"""Between which a Gaussian's widths are scaled; the upper end tracks the peak to 1e-7."""


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


def depth_spread(tracking_width_m: Triple, gate_length_m: float, pulse_length_m: float, window: GateWindow) -> float:
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
