"""Shear field of a body force in a viscoelastic medium, on the axis and off it, with its derivatives.

    u(r, z) = f0 sx^2 sz / (sqrt(2 pi) rho w^2) int_0^inf k^3 J0(k r) exp(-A k^2 / 2) [V(kappa) - V(k)] dk,
    V(kappa) = pi / (2 kappa) exp(-b^2) [erfcx(kappa sqrt(a) + b) + erfcx(kappa sqrt(a) - b)],
    kappa^2 = k^2 - q^2,   q^2 = rho w^2 / G,   a = B / 2,   b = z / 2 sqrt(a)

Symbols: Gaussian force f0 exp(-(x^2 + y^2) / 2 sx^2 - z^2 / 2 sz^2) along z; r and z the distances from its axis and
its focus; G complex modulus, rho density, w angular frequency, time factor exp(+jwt); k the wave number across the
axis. A = sx^2 and B = sz^2 are the squared widths of the force plus the variances over which the tracking beam
averages.

A sum of Gaussian forces gives the sum of their fields. The integral over wave numbers along the axis has the closed
form V. The integral over k runs along a path in the upper half plane, clear of the pole k = q even in an elastic
medium. Derivation: docs/explanation/moduli.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import jv, wofz

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium.focal_field import legendre_nodes
from hpe_rig.medium.material_laws import HarmonicMedium
from hpe_rig.medium.push_force import PushForce

FULL, QUICK = (12, 36.0), (6, 16.0)
"""Nodes in a panel of the path, and the exponent of exp(-A k^2 / 2) at its end, for the full and the quick field."""
QUICK_ERROR = 1e-5
"""Error of the quick field, relative to the largest displacement."""
MAX_BESSEL_EXPONENT = 3.0
"""Im k times the largest distance: Bessel functions grow along the path up to exp of this."""
CLEARANCE = 1.0
"""Im k times the force's width, if no distance limits it."""
PANEL_WIDTH = 1.3
"""Widest panel near a pole, relative to the distance from the pole."""
START_SLOPE = 0.5
"""Slope of the path at k = 0: a path along the real axis would start next to the pole of a long wave."""
PANEL_PHASE_RAD = 7.0
"""Largest phase k r over a panel at the largest distance."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedRegion:
    """Points where a displacement is tracked, and the variances of position over which the tracking beam averages.

    ``lateral_m`` (point,): distances from the axis; ``axial_m``: distance from the focal plane. ``across_m2``, a number
    or (point,), and ``along_m2``: variances across and along the beam.
    """

    lateral_m: FloatArray
    axial_m: float = 0.0
    across_m2: FloatArray | float = 0.0
    along_m2: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ShearMotion:
    """Displacement per body force and its derivatives, complex (frequency, point).

    ``value`` is in m per N/m^3. The derivatives are by: the complex modulus; the variance across over which the
    tracking beam averages; the lateral and the axial distance; the logarithms of the force's widths across and along,
    at constant peak force; and one standard uncertainty of each property in ``PushForce.weight_changes``.
    """

    value: ComplexArray
    by_modulus: ComplexArray
    by_across: ComplexArray
    by_lateral: ComplexArray
    by_axial: ComplexArray
    by_width: ComplexArray
    by_length: ComplexArray
    by_weight_change: dict[str, ComplexArray]


def shear_motion(medium: HarmonicMedium, force: PushForce, region: TrackedRegion, quick: bool = False) -> ShearMotion:
    """Return the displacement of ``medium`` under ``force`` as tracked in ``region``, with its derivatives.

    Error: 1e-10 of the largest displacement, 1e-8 if the waves are a tenth of the force's width. Tested for 0.5 to
    500 kPa, 0 to 50 Pa s, distances to 20 mm, and wavelengths from 0.1 to some 1000 force widths. ``quick``: error
    ``QUICK_ERROR`` in a third of the time.
    """
    # All Gaussians of the force share one integration path over wave numbers across: that of the narrowest.
    narrowest_m2, along_m2 = min(force.across_m) ** 2, force.along_m**2 + region.along_m2
    path = _Waves.of(medium, narrowest_m2 + region.across_m2, along_m2, region.lateral_m, QUICK if quick else FULL)
    axial = _sum_over_stations(path, force, narrowest_m2, along_m2, region.axial_m)
    k2 = path.k[:, None] ** 2
    # Each product of factors along the axis (frequency, k) with the waves (k, point) is the integral over k. Derivative
    # by the modulus: kappa^2 = k^2 - q^2 and q^2 = rho w^2 / G. By the squared width A: waves contain exp(-A k^2 / 2).
    return ShearMotion(
        value=axial.value @ path.waves,
        by_modulus=(path.q2 / medium.modulus_pa)[:, None] * axial.by_kappa2 @ path.waves,
        by_across=axial.value @ (-k2 / 2 * path.waves),
        by_lateral=axial.value @ path.lateral_slopes,
        by_axial=axial.by_axial @ path.waves,
        by_width=axial.by_width @ path.waves,
        by_length=axial.by_length @ path.waves,
        by_weight_change={name: factor @ path.waves for name, factor in axial.by_weight_change.items()},
    )


def focal_plane_motion(
    medium: HarmonicMedium,
    force_width_m: tuple[float, float],
    across_m2: float,
    along_m2: float,
    lateral_m: FloatArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return displacement, and its derivatives by squared width and by lateral distance, in the focal plane.

    All are complex (frequency, point), at ``lateral_m`` (point,). The force is one Gaussian of sigmas ``force_width_m``
    (across, along). ``across_m2`` and ``along_m2``: its squared widths plus the variances of the tracking beam. The
    error is ``QUICK_ERROR``, for ensembles of media.
    """
    path = _Waves.of(medium, across_m2, along_m2, lateral_m, QUICK)
    prefactor = force_width_m[0] ** 2 * force_width_m[1] / path.denominator
    # The integral V over wave numbers along the axis has two equal terms at z = 0: V(kappa) = pi / kappa
    # erfcx(kappa sqrt(a)) with erfcx(x) = w(jx). V(kappa) is the dynamic part, V(k) the static one.
    root_a = np.sqrt(along_m2 / 2)
    dynamic, static = (np.pi / decay * wofz(1j * root_a * decay) for decay in (path.kappa, path.k[None]))
    axial = prefactor[:, None] * (dynamic - static)
    # Products of the factors along the axis (frequency, k) with waves (k, point) are integrals over wave numbers k.
    by_across = axial @ (-(path.k**2)[:, None] / 2 * path.waves)
    return axial @ path.waves, by_across, axial @ path.lateral_slopes


@dataclass(frozen=True, slots=True, eq=False)
class _Waves:
    """Factors of the integrand of u that depend on the lateral distance r, on a path of complex wave numbers k (k,).

    ``waves`` (k, point): k^3 J0(k r) exp(-A k^2 / 2) times the weights of the quadrature over k; ``lateral_slopes``:
    their derivatives by r. ``q2`` (frequency,): squared shear wave number. ``denominator`` (frequency,): sqrt(2 pi) rho
    w^2.
    """

    k: ComplexArray
    waves: ComplexArray
    lateral_slopes: ComplexArray
    q2: ComplexArray
    denominator: FloatArray

    @classmethod
    def of(
        cls,
        medium: HarmonicMedium,
        across_m2: FloatArray | float,
        along_m2: float,
        lateral_m: FloatArray,
        quality: tuple[int, float],
    ) -> _Waves:
        """Return the waves of a Gaussian force on a path of wave numbers k across the axis, at ``lateral_m`` (point,).

        ``across_m2`` and ``along_m2``: squared widths of the force, averaged over the tracking beam. ``quality``: nodes
        in a panel of the path, and the exponent of the force's spectrum exp(-A k^2 / 2) at its end.
        """
        q2 = medium.shear_k2
        max_distance_m = float(np.max(np.abs(lateral_m), initial=0.0))
        k, weight = _path(np.sqrt(np.abs(q2)), float(np.min(across_m2)), along_m2, max_distance_m, quality)
        # J0(k r) and its derivative by r, -k J1(k r), times k^3, the Gaussian's spectrum and the quadrature's weights.
        kr = k[:, None] * np.abs(lateral_m)
        spectrum = (weight * k**3)[:, None] * np.exp(-(k**2)[:, None] * across_m2 / 2)
        slopes = -spectrum * k[:, None] * jv(1, kr) * np.sign(lateral_m)
        omega = 2 * np.pi * medium.frequency_hz
        denominator = np.sqrt(2 * np.pi) * medium.density_kg_per_m3 * omega**2
        return cls(k=k, waves=spectrum * jv(0, kr), lateral_slopes=slopes, q2=q2, denominator=denominator)

    @property
    def kappa(self) -> ComplexArray:
        """Decay rate along the axis, (frequency, k)."""
        return np.asarray(np.sqrt(self.k**2 - self.q2[:, None]))


class _AxialFactors(NamedTuple):
    """Factor of the integrand of u by the force along the axis, and its derivatives, each (frequency, k).

    By kappa^2, the distance from the focal plane, the logarithms of the force's length and width, and one standard
    uncertainty of each property in ``PushForce.weight_changes``.
    """

    value: ComplexArray
    by_kappa2: ComplexArray
    by_axial: ComplexArray
    by_length: ComplexArray
    by_width: ComplexArray
    by_weight_change: dict[str, ComplexArray]


def _sum_over_stations(
    path: _Waves, force: PushForce, narrowest_m2: float, averaged_along_m2: float, axial_m: float
) -> _AxialFactors:
    """Return the sum over the Gaussians of ``force`` of V(kappa) - V(k), times their weights and spectra across.

    V is the integral over wave numbers along the axis, in closed form; kappa^2 = k^2 - q^2, with k the wave number
    across and q the shear wave number. ``axial_m``: distance from the focal plane. ``narrowest_m2``: squared width of
    the narrowest Gaussian. ``averaged_along_m2``: squared length of a Gaussian plus the variance of beam averaging.
    """
    # Squared widths across (width, 1), and stations: the centres of the Gaussians along the axis (station,).
    k2, width_m2, centre_m = path.k**2, np.square(force.across_m)[:, None], np.array(force.centre_m)
    # Spectra across (width, k), relative to the narrowest Gaussian, which the waves of the path contain already.
    across = width_m2 * np.exp(-k2 * (width_m2 - narrowest_m2) / 2)
    # Spectrum of each station (station, k), and its derivative by the logarithm of the widths.
    weights = np.array(force.weights)
    spectra, spectra_by_width = weights @ across, weights @ ((2 - k2 * width_m2) * across)
    # Stations at the same distance before and behind the point share V; its slope has opposite signs.
    offset_m = axial_m - centre_m
    distance_m, index = np.unique(np.round(np.abs(offset_m), 12), return_inverse=True)
    # 1 where a station is at a distance, (distance, station).
    is_at = np.zeros((distance_m.size, offset_m.size))
    is_at[index, np.arange(offset_m.size)] = 1.0
    sign_at = is_at * np.sign(offset_m)
    # Spectra summed over the stations at each distance (distance, k), with their signs for the slope of V.
    summed, summed_by_width = is_at @ spectra, is_at @ spectra_by_width
    signed, signed_centres = sign_at @ spectra, sign_at @ (centre_m[:, None] * spectra)
    summed_changes = {name: is_at @ (np.array(change) @ across) for name, change in force.weight_changes}
    kappa, half_m2 = path.kappa, averaged_along_m2 / 2
    value, by_kappa2, by_axial, by_length, by_width = np.zeros((5, *kappa.shape), np.complex128)
    by_weight_change = {name: np.zeros(kappa.shape, np.complex128) for name in summed_changes}
    for i, distance in enumerate(distance_m):
        # V(kappa) is the dynamic part, V(k) the static one, which does not depend on kappa.
        dynamic, static = (_axial_integral(decay, half_m2, distance) for decay in (kappa, path.k[None]))
        difference, slope = dynamic.value - static.value, dynamic.by_axial - static.by_axial
        value += difference * summed[i]
        by_kappa2 += dynamic.by_kappa2 * summed[i]
        by_axial += slope * signed[i]
        # By the logarithm of the length, which is a factor of the field: this gives ``difference``. A longer force also
        # has longer Gaussians, and stations that are farther from the focus.
        by_gaussian_length = force.along_m**2 * (dynamic.by_half_m2 - static.by_half_m2)
        by_length += (difference + by_gaussian_length) * summed[i] - slope * signed_centres[i]
        by_width += difference * summed_by_width[i]
        for name, summed_change in summed_changes.items():
            by_weight_change[name] += difference * summed_change[i]
    prefactor = (force.along_m / path.denominator)[:, None]
    return _AxialFactors(
        value=prefactor * value,
        by_kappa2=prefactor * by_kappa2,
        by_axial=prefactor * by_axial,
        by_length=prefactor * by_length,
        by_width=prefactor * by_width,
        by_weight_change={name: prefactor * change for name, change in by_weight_change.items()},
    )


class _AxialIntegral(NamedTuple):
    """V and its derivatives by kappa^2, by half the squared width along the axis and by z, each (..., k)."""

    value: ComplexArray
    by_kappa2: ComplexArray
    by_half_m2: ComplexArray
    by_axial: ComplexArray


def _axial_integral(decay: ComplexArray, half_m2: float, axial_m: float) -> _AxialIntegral:
    """Return the integral over wave numbers k_z along the axis of a Gaussian force, with its derivatives.

    V = int exp(-a k_z^2 + j k_z z) / (k_z^2 + kappa^2) dk_z over all k_z has, with b = z / 2 sqrt(a), the closed form

        V = pi / (2 kappa) exp(-b^2) [erfcx(kappa sqrt(a) + b) + erfcx(kappa sqrt(a) - b)].

    ``decay`` (..., k) is kappa, the decay rate along the axis. ``half_m2`` is a, half the squared width along the axis.
    ``axial_m`` is z >= 0, the distance from the centre of the force.
    """
    root_a = np.sqrt(half_m2)
    b = axial_m / (2 * root_a)
    x_plus, x_minus = decay * root_a + b, decay * root_a - b
    gaussian = np.exp(-(b**2))
    # The two terms exp(-b^2) erfcx(x), equal at z = 0.
    plus = gaussian * wofz(1j * x_plus)
    minus = _damped_erfcx(x_minus, b) if b else plus
    prefactor = np.pi / (2 * decay)
    value = prefactor * (plus + minus)
    # Their derivatives by x: erfcx'(x) = 2 x erfcx(x) - 2 / sqrt(pi).
    constant = 2 * gaussian / np.sqrt(np.pi)
    plus_slope, minus_slope = 2 * x_plus * plus - constant, 2 * x_minus * minus - constant
    by_kappa = -value / decay + prefactor * root_a * (plus_slope + minus_slope)
    # By a: the integrand times -k_z^2, where k_z^2 / (k_z^2 + kappa^2) = 1 - kappa^2 / (k_z^2 + kappa^2).
    by_half_m2 = decay**2 * value - np.sqrt(np.pi / half_m2) * gaussian
    by_axial = (np.pi / 2) * (plus - minus)
    return _AxialIntegral(value=value, by_kappa2=by_kappa / (2 * decay), by_half_m2=by_half_m2, by_axial=by_axial)


def _damped_erfcx(x: ComplexArray, b: float) -> ComplexArray:
    """Return exp(-b^2) erfcx(x) without overflow: for Re x < 0 from erfcx(x) = 2 exp(x^2) - erfcx(-x)."""
    mirrored = x.real < 0
    right_half = np.exp(-(b**2)) * wofz(1j * np.where(mirrored, -x, x))
    return np.asarray(np.where(mirrored, 2 * np.exp(np.where(mirrored, x**2 - b**2, 0)) - right_half, right_half))


def _path(
    q: FloatArray, across_m2: float, along_m2: float, max_distance_m: float, quality: tuple[int, float]
) -> tuple[ComplexArray, ComplexArray]:
    """Return complex wave numbers (k,) and quadrature weights on a path from 0 to the end of the force's spectrum.

    The path runs above the poles of the integrand, the shear wave numbers ``q`` (frequency,). ``across_m2`` and
    ``along_m2``: squared sigmas of the force across and along. ``quality``: nodes in a panel, and the exponent of the
    force's spectrum at the end. The parameters are rounded to the safe side, so that all iterations of a fit share one
    cached path.
    """
    # A force of sigma sz along the axis has wave numbers up to about 1 / sz there; the first panel must resolve that.
    rounded_low = 2 ** np.floor(np.log2(min(q.min(), 1 / np.sqrt(along_m2))))
    rounded_high = 2 ** np.ceil(np.log2(q.max()))
    rounded_across_m2 = 1.2 ** np.floor(np.log(across_m2) / np.log(1.2))
    rounded_distance_m = 1.1 ** np.ceil(np.log(max(max_distance_m, 1e-6)) / np.log(1.1))
    return _cached_path(
        float(rounded_low), float(rounded_high), float(rounded_across_m2), float(rounded_distance_m), quality
    )


@lru_cache(maxsize=32)
def _cached_path(
    lowest: float, highest: float, across_m2: float, max_distance_m: float, quality: tuple[int, float]
) -> tuple[ComplexArray, ComplexArray]:
    """Return wave numbers (k,) and quadrature weights on a path above the poles from ``lowest`` to ``highest``.

    It consists of Gauss-Legendre panels. ``across_m2``: squared width of the force, which limits its spectrum.
    ``quality``: nodes per panel, and exponent of the spectrum at the end of the path.
    """
    panel_nodes, end_exponent = quality
    end = np.sqrt(2 * end_exponent / across_m2)
    # Height of the path above the real axis.
    height = min(MAX_BESSEL_EXPONENT / max_distance_m, CLEARANCE / np.sqrt(across_m2))
    edges = [0.0, min(lowest / 2, end)]
    while edges[-1] < end:
        # A panel is at most as wide as its distance from 0, as ``PANEL_WIDTH`` distances from the poles if these are
        # near, and as ``PANEL_PHASE_RAD`` of the waves' phase.
        pole_limit = PANEL_WIDTH * height if edges[-1] < 1.5 * highest else end / 4
        width = min(edges[-1], pole_limit, PANEL_PHASE_RAD / max_distance_m)
        edges.append(min(edges[-1] + width, end))
    low, high = np.array(edges[:-1])[:, None], np.array(edges[1:])[:, None]
    node, weight = legendre_nodes(panel_nodes)
    real_k = ((high + low) / 2 + (high - low) / 2 * node).ravel()
    weights = ((high - low) / 2 * weight).ravel()
    # The path rises as a tanh; its derivative is part of the weights.
    relative_k = START_SLOPE * real_k / height
    k = real_k + 1j * height * np.tanh(relative_k)
    return k, weights * (1 + 1j * START_SLOPE / np.cosh(np.minimum(relative_k, 300)) ** 2)
