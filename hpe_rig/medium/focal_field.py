"""Closed form of the displacement at the focus of a Gaussian body force in a viscoelastic medium.

    U = F0 sx^2 sz / (sqrt(2 pi) G) int_0^1 2 (1 - m^2) [sqrt(pi/a)/2 + j pi q w(q sqrt(a)) / 2] dm,
    a = (sx^2 (1 - m^2) + sz^2 m^2) / 2,   q^2 = rho w^2 / G,   Im q >= 0

F0 is the peak force, sx and sz its sigmas across and along the beam, G the complex shear modulus, rho the density.
w() is the Faddeeva function and m the cosine of the angle between a wave and the beam; time factor exp(+jwt). The
displacement averaged over a Gaussian tracking beam is the displacement of a force that is wider by the beam's variance.
Derivation: docs/explanation/medium-prior.md.
"""

from __future__ import annotations

import functools

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray

DIRECTIONS, FINE_DIRECTIONS = 12, 96
"""Quadrature nodes over wave directions: relative error 3e-4 in the paper's beams for an ensemble; for one medium."""

legendre_nodes = functools.cache(np.polynomial.legendre.leggauss)
"""Nodes and weights of Gauss's quadrature, by their number."""


def focal_displacement(
    shear_k2: ComplexArray, across_m2: FloatArray, along_m2: FloatArray, directions: int = DIRECTIONS
) -> tuple[ComplexArray, ComplexArray]:
    """Return displacement times modulus at the focus of a Gaussian force, up to a real factor, and its derivative.

    Both are (member, frequency), a member being one medium and force; the derivative is by ``across_m2``. ``shear_k2``
    (member, frequency): squared wave number q^2 of shear waves. ``across_m2`` and ``along_m2`` (member,): squared
    sigmas of the force. The result is an integral over m, the cosine between a wave and the beam, by quadrature with
    ``directions`` nodes.
    """
    # A function-level import: a prescribed motion has no medium and must not load SciPy.
    from scipy.special import wofz

    node, weight = legendre_nodes(directions)
    # Substitute m = tan(angle) / slope, which makes the spectrum of a needle-shaped force smooth.
    slope = np.sqrt(np.maximum(along_m2 / across_m2 - 1, 1e-12))[:, None]
    angle = np.arctan(slope) * (node + 1) / 2
    m = np.tan(angle) / slope
    weight = weight * np.arctan(slope) / 2 / (slope * np.cos(angle) ** 2)
    # The part of the force across the direction of the wave, 1 - m^2, drives shear waves.
    weight = weight * 2 * (1 - m**2)
    # sqrt(a) with a half the squared width of the force along the direction of the wave.
    root_a = np.sqrt((across_m2[:, None] * (1 - m**2) + along_m2[:, None] * m**2) / 2)[:, None]
    # Im q >= 0 selects the wave that decays away from the force.
    q = np.sqrt(shear_k2)
    q = np.where(q.imag < 0, -q, q)[:, :, None]
    # Integrand sqrt(pi/a) / 2 + j pi q w(q sqrt(a)) / 2: a static and a dynamic part, (member, frequency, direction).
    static, dynamic = np.sqrt(np.pi) / 2 / root_a, 0.5j * np.pi * q * wofz(q * root_a)
    # Its derivative by a, with w'(z) = 2j / sqrt(pi) - 2 z w(z). By the chain rule da / d(across_m2) = (1 - m^2) / 2.
    by_a = -static * (0.5 / root_a**2 + q**2) - q**2 * dynamic
    value = _sum_over_directions(static + dynamic, weight)
    return value, _sum_over_directions(by_a, weight * (1 - m**2) / 2)


def _sum_over_directions(values: ComplexArray, weight: FloatArray) -> ComplexArray:
    return np.asarray((values @ weight[:, :, None])[..., 0])
