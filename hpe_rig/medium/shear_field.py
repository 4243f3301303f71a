"""Shear field of a body force in a viscoelastic medium, on the axis and off it, with its derivatives.

    u(r, z) = f0 sx^2 sz / (sqrt(2 pi) rho w^2) int_0^inf k^3 J0(k r) exp(-A k^2 / 2) [V(kappa) - V(k)] dk,
    V(kappa) = pi / (2 kappa) exp(-b^2) [erfcx(kappa sqrt(a) + b) + erfcx(kappa sqrt(a) - b)],
    kappa^2 = k^2 - q^2,   q^2 = rho w^2 / mu,   a = B / 2,   b = z / 2 sqrt(a),

of a Gaussian force f0 exp(-(x^2 + y^2) / 2 sx^2 - z^2 / 2 sz^2) along z, time factor exp(+jwt), A = sx^2 and B = sz^2
the squared widths of the force, larger by the variances of what a tracking beam averages over. A force that is a sum of
Gaussians moves by the sum of theirs. The integral over wave numbers along the axis is done in closed form, that over
those across it along a path in the upper half plane, clear of the shear pole q even in an elastic medium.
docs/theory/moduli.md has the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.special import jv, wofz

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium.push_force import PushForce

Quality = tuple[int, float]
"""Nodes in a panel of the path, and the exponent in exp(-A k^2 / 2) at which the path ends."""
FULL: Quality = (12, 36.0)
"""2e-16 at the largest wave number."""
QUICK: Quality = (6, 16.0)
QUICK_ERROR = 1e-5
"""Of the largest displacement, that of the quick one."""
LARGEST_GROWTH = 3.0
"""Im k times the largest distance, to which the Bessel functions grow along the path."""
CLEARANCE = 1.0
"""Im k times the width of the force, where no distance limits it."""
PANEL_WIDTH = 1.3
"""Widest panel of nodes near a pole, over the distance from it."""
STEEPNESS = 0.5
"""Slope of the path at its start: what lies near 0 sees the pole from an angle."""
PANEL_PHASE_RAD = 7.0
"""Largest advance of a wave over the largest distance within a panel of nodes."""


@dataclass(frozen=True, slots=True)
class ShearMotion:
    """Displacement per body force and its derivatives at every frequency and place, complex (frequency, place).

    ``value`` in m per N/m^3; ``by_modulus`` its derivative with respect to the complex modulus, ``by_across`` and
    ``by_across_twice`` (the second) with respect to the variance that the tracking averages over across the beam,
    ``by_lateral`` and ``by_axial`` to the place, ``by_width`` and ``by_length`` to the logarithms of the force's widths
    across and along, its strength at the focus the same, ``by_unsure`` to what else is ``unsure`` of it, by name.
    """

    value: ComplexArray
    by_modulus: ComplexArray
    by_across: ComplexArray
    by_across_twice: ComplexArray
    by_lateral: ComplexArray
    by_axial: ComplexArray
    by_width: ComplexArray
    by_length: ComplexArray
    by_unsure: dict[str, ComplexArray]


def shear_motion(
    modulus_pa: ComplexArray,
    frequency_hz: FloatArray,
    density_kg_per_m3: float,
    force: PushForce,
    seen_across_m2: FloatArray | float,
    seen_along_m2: float,
    lateral_m: FloatArray,
    axial_m: float = 0.0,
    quick: bool = False,
) -> ShearMotion:
    """Return the field of a round ``force`` where it is tracked.

    ``modulus_pa`` and ``frequency_hz`` (frequency,); ``seen_across_m2``, one or (place,), and ``seen_along_m2``: the
    variances that the tracking averages over; ``lateral_m`` (place,) distances from the axis, ``axial_m`` that from the
    focal plane. Good to 1e-10 of the largest displacement, 1e-8 for waves of a tenth of the force's width: 0.5 to
    500 kPa, viscosities from none to 50 Pa s, places to 20 mm, waves from a tenth of the force's width to some thousand
    of it. ``quick``: to ``QUICK_ERROR`` of it, in a third of the time.
    """
    # every Gaussian of the force along the same path: that of the narrowest
    narrow_m2, along_m2 = min(force.across_m) ** 2, force.along_m**2 + seen_along_m2
    narrowest = narrow_m2 + seen_across_m2
    k, waves, slope, q2, front = _waves(
        modulus_pa,
        frequency_hz,
        density_kg_per_m3,
        (1.0, force.along_m),
        narrowest,
        along_m2,
        lateral_m,
        QUICK if quick else FULL,
    )
    half, k2 = along_m2 / 2, k**2
    kappa, area_m2 = np.sqrt(k2 - q2[:, None]), np.square(force.across_m)[:, None]
    # the path's waves hold the narrowest Gaussian across already
    across = area_m2 * np.exp(-k2 * (area_m2 - narrow_m2) / 2)
    spectra, wider = (np.array(force.share) @ each for each in (across, (2 - k2 * area_m2) * across))
    unsure = [np.array(share) @ across for _, share in force.unsure]
    # Gaussians at the same distance before and behind have all but the sign of the slope along the axis in common.
    off_m, centre_m = axial_m - np.array(force.centre_m), np.array(force.centre_m)[:, None]
    distance_m, which = np.unique(np.round(np.abs(off_m), 12), return_inverse=True)
    fold = np.zeros((distance_m.size, off_m.size))
    fold[which, np.arange(off_m.size)] = 1.0
    signed = fold * np.sign(off_m)
    shapes = fold @ spectra, signed @ spectra, signed @ (centre_m * spectra), fold @ wider
    rest = [fold @ each for each in unsure]
    sums = np.zeros((5 + len(rest), *kappa.shape), np.complex128)
    for away_m, spectrum, odd, shifted, widened, *others in zip(distance_m, *shapes, *rest, strict=True):
        dynamic, static = _along(kappa, half, away_m), _along(k[None], half, away_m)
        value, _, by_half, by_axial = (own - at_rest for own, at_rest in zip(dynamic, static, strict=True))
        # the static part does not hang on the modulus: dq2/dmu = -q2/mu, dkappa2/dq2 = -1
        sums[0] += value * spectrum
        sums[1] += dynamic[1] * spectrum
        sums[2] += by_axial * odd
        sums[3] += (value + force.along_m**2 * by_half) * spectrum - by_axial * shifted
        sums[4] += value * widened
        sums[5:] += value * np.array(others)[:, None] if others else 0.0
    kernel, by_kappa, by_axial, longer, widened, *extra = (front[:, None] * each for each in sums)
    return ShearMotion(
        value=kernel @ waves,
        by_modulus=(q2 / modulus_pa)[:, None] * by_kappa @ waves,
        by_across=kernel @ (-k2[:, None] / 2 * waves),
        by_across_twice=kernel @ (k2[:, None] ** 2 / 4 * waves),
        by_lateral=kernel @ slope,
        by_axial=by_axial @ waves,
        by_width=widened @ waves,
        by_length=longer @ waves,
        by_unsure={name: each @ waves for (name, _), each in zip(force.unsure, extra, strict=True)},
    )


def focal_motion(
    modulus_pa: ComplexArray,
    frequency_hz: FloatArray,
    density_kg_per_m3: float,
    force_width_m: tuple[float, float],
    across_m2: float,
    along_m2: float,
    lateral_m: FloatArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return value, ``by_across`` and ``by_lateral`` of ``shear_motion`` in the focal plane, (frequency, place) each.

    Good to 1e-5 of the largest displacement, in a fraction of the time: for ensembles of media.
    """
    k, waves, slope, q2, front = _waves(
        modulus_pa, frequency_hz, density_kg_per_m3, force_width_m, across_m2, along_m2, lateral_m, QUICK
    )
    root = np.sqrt(along_m2 / 2)
    dynamic, static = (np.pi / kappa * wofz(1j * root * kappa) for kappa in (np.sqrt(k**2 - q2[:, None]), k[None]))
    kernel = front[:, None] * (dynamic - static)
    return kernel @ waves, kernel @ (-(k**2)[:, None] / 2 * waves), kernel @ slope


def _waves(
    modulus_pa: ComplexArray,
    frequency_hz: FloatArray,
    density_kg_per_m3: float,
    force_width_m: tuple[float, float],
    across_m2: FloatArray | float,
    along_m2: float,
    lateral_m: FloatArray,
    quality: Quality = FULL,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, FloatArray]:
    """Return wave numbers (k,), weighted waves and their slopes (k, place), q^2 and the front factor (frequency,)."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    q2 = density_kg_per_m3 * omega**2 / modulus_pa
    reach_m = float(np.max(np.abs(lateral_m), initial=0.0))
    k, weight = _path(np.sqrt(np.abs(q2)), float(np.min(across_m2)), along_m2, reach_m, quality)
    kr = k[:, None] * np.abs(lateral_m)
    spectrum = (weight * k**3)[:, None] * np.exp(-(k**2)[:, None] * across_m2 / 2)
    waves = spectrum * jv(0, kr)
    slope = -spectrum * k[:, None] * jv(1, kr) * np.sign(lateral_m)
    front = force_width_m[0] ** 2 * force_width_m[1] / (np.sqrt(2 * np.pi) * density_kg_per_m3 * omega**2)
    return k, waves, slope, q2, front


def _along(kappa: ComplexArray, half: float, axial_m: float) -> tuple[ComplexArray, ...]:
    """Return V and its derivatives by kappa^2, by ``half`` = B / 2 and by z, each (..., k), at z >= 0."""
    root = np.sqrt(half)
    shift = axial_m / (2 * root)
    plus, minus = kappa * root + shift, kappa * root - shift
    falling = np.exp(-(shift**2))
    ahead = falling * wofz(1j * plus)
    behind = _scaled(minus, shift) if shift else ahead
    both, turn = ahead + behind, np.pi / (2 * kappa)
    value = turn * both
    edge = 2 * falling / np.sqrt(np.pi)
    # erfcx'(x) = 2 x erfcx(x) - 2 / sqrt(pi)
    by_plus, by_minus = 2 * plus * ahead - edge, 2 * minus * behind - edge
    by_kappa = -value / kappa + turn * root * (by_plus + by_minus)
    # kz^2 / (kz^2 + kappa^2) = 1 - kappa^2 / (kz^2 + kappa^2)
    by_half = kappa**2 * value - np.sqrt(np.pi / half) * falling
    by_axial = (np.pi / 2) * (ahead - behind)
    return value, by_kappa / (2 * kappa), by_half, by_axial


def _scaled(minus: ComplexArray, shift: float) -> ComplexArray:
    """Return exp(-shift^2) erfcx(minus); where the real part is negative by erfcx(-x) = 2 exp(x^2) - erfcx(x)."""
    mirrored = minus.real < 0
    inner = np.exp(-(shift**2)) * wofz(1j * np.where(mirrored, -minus, minus))
    return np.asarray(np.where(mirrored, 2 * np.exp(np.where(mirrored, minus**2 - shift**2, 0)) - inner, inner))


def _path(
    q: FloatArray, across_m2: float, along_m2: float, reach_m: float, quality: Quality
) -> tuple[ComplexArray, ComplexArray]:
    """Return wave numbers (k,) and their weights on a path from 0 to where the force's spectrum has died out.

    It runs above the poles ``q`` (frequency,), which lie on the real axis or below. What it hangs on is rounded to the
    safe side, so that the iterations of a fit share their paths.
    """
    # what lies along the axis falls off over wave numbers of 1 / sz, which the first panel must hold
    low = 2 ** np.floor(np.log2(min(q.min(), 1 / np.sqrt(along_m2))))
    high = 2 ** np.ceil(np.log2(q.max()))
    narrow = 1.2 ** np.floor(np.log(across_m2) / np.log(1.2))
    far = 1.1 ** np.ceil(np.log(max(reach_m, 1e-6)) / np.log(1.1))
    return _kept_path(float(low), float(high), float(narrow), float(far), quality)


_legendre = cache(np.polynomial.legendre.leggauss)
"""Nodes and weights of Gauss's quadrature, by their number."""


@lru_cache(maxsize=32)
def _kept_path(
    lowest: float, highest: float, across_m2: float, reach_m: float, quality: Quality
) -> tuple[ComplexArray, ComplexArray]:
    nodes, exponent = quality
    last = np.sqrt(2 * exponent / across_m2)
    clearance = min(LARGEST_GROWTH / reach_m, CLEARANCE / np.sqrt(across_m2))
    edges = [0.0, min(lowest / 2, last)]
    while edges[-1] < last:
        # as wide as it is far from 0; near the poles as wide as it is far from them
        near = PANEL_WIDTH * clearance if edges[-1] < 1.5 * highest else last / 4
        step = min(edges[-1], near, PANEL_PHASE_RAD / reach_m)
        edges.append(min(edges[-1] + step, last))
    low, high = np.array(edges[:-1])[:, None], np.array(edges[1:])[:, None]
    node, weight = _legendre(nodes)
    real = ((high + low) / 2 + (high - low) / 2 * node).ravel()
    share = ((high - low) / 2 * weight).ravel()
    rise = STEEPNESS * real / clearance
    k = real + 1j * clearance * np.tanh(rise)
    return k, share * (1 + 1j * STEEPNESS / np.cosh(np.minimum(rise, 300)) ** 2)
