"""Linear pressure field of a focused bowl around its focus: O'Neil's Rayleigh integral as a sum of plane waves.

    P(r, z) = int_-1^1 A(m) exp(-j k z m) J0(k r sqrt(1 - m^2)) dm,                 P = p / (rho c u0)
    A(m)    = (k F)^2 / 2 sum_n (2n + 1) (-j)^n h_n(k F) W_n P_n(m),   W_n = int_cos(theta0)^1 w(theta) P_n(x) dx

    p, rho, c, u0    pressure, Pa; density; sound speed; velocity of the surface, m/s
    r, z             distance from the axis and from the focus, m
    k, F             wave number, 1/m, complex in an attenuating medium; focal length, m
    m                cosine of a plane wave to the axis
    h_n              spherical Hankel function of the second kind (time factor exp(+jwt))
    w                apodisation over the angle at the focus, theta0 at the rim; x its cosine; P_n Legendre polynomial

The waves exp(-j k d) / d of the surface are expanded about the focus in spherical waves, and these in plane waves. Then
z and r separate, so a table is one matrix product. See docs/explanation/transducer.md, section 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.settings import Transducer

NEPER_PER_DB = math.log(10) / 20

_MARGIN_ORDERS = 30
_APODISATION_NODES = 400


def wave_number(frequency_hz: float, sound_speed_m_per_s: float, attenuation_db_per_cm_mhz: float = 0.0) -> complex:
    """Return k - j alpha, 1/m, with a loss in proportion to frequency."""
    loss_np_per_m = attenuation_db_per_cm_mhz * 100 * NEPER_PER_DB * frequency_hz * 1e-6
    return complex(2 * math.pi * frequency_hz / sound_speed_m_per_s, -loss_np_per_m)


def bowl_pressure(
    transducer: Transducer, wave_number_per_m: complex, lateral_m: FloatArray, axial_m: FloatArray
) -> ComplexArray:
    """Return the pressure of a focused bowl over rho c u0 on a grid around the focus, complex (axial, lateral).

    Time factor exp(+jwt). ``lateral_m`` are distances from the axis, ``axial_m`` from the focus (the bowl's centre of
    curvature), positive away from the transducer; u0 is the velocity of the surface where the apodisation is 1. Exact
    for the Rayleigh integral, to 1e-12 of the pressure at the focus. Raises ``ValueError`` for points as far from the
    focus as the bowl.
    """
    k = wave_number_per_m
    reach_m = float(np.hypot(np.abs(lateral_m).max(initial=0.0), np.abs(axial_m).max(initial=0.0)))
    if reach_m >= 0.9 * transducer.focal_length_m:
        raise ValueError(
            f"a point {reach_m * 1e3:.3g} mm from the focus is not in front of a bowl of "
            f"{transducer.focal_length_m * 1e3:.3g} mm focal length. Try: points within nine tenths of it."
        )
    # A spherical wave of order n is negligible nearer to the focus than n / k.
    size = abs(k) * reach_m
    orders = math.ceil(size + 6 * size ** (1 / 3)) + _MARGIN_ORDERS
    cosine, weight = np.polynomial.legendre.leggauss(orders + _MARGIN_ORDERS)
    spectrum = weight * _plane_waves(transducer, k, orders, cosine)
    # (axial, direction) @ (direction, lateral).
    along = np.exp(-1j * k * np.outer(axial_m, cosine)) * spectrum
    return np.asarray(along @ _bessel(k, np.outer(np.sqrt(1 - cosine**2), lateral_m)))


def _bessel(k: complex, distance_m: FloatArray) -> FloatArray | ComplexArray:
    """Return J0(k distance), any shape; a real argument takes a tenth of the time."""
    from scipy.special import j0, jv

    return np.asarray(j0(k.real * distance_m) if k.imag == 0 else jv(0, k * distance_m))


def apodisation(transducer: Transducer, relative_radius: FloatArray) -> FloatArray:
    """Return the surface velocity relative to that in the middle of the aperture, at fractions of its radius."""
    match transducer.apodisation:
        case "parabolic":
            return np.asarray(1 - relative_radius**2)
        case "hann":
            return np.asarray(np.cos(np.pi / 2 * relative_radius) ** 2)
    return np.ones_like(relative_radius)


def _plane_waves(transducer: Transducer, k: complex, orders: int, cosine: FloatArray) -> ComplexArray:
    """Return the amplitudes (direction,) of the plane waves that make up a bowl's field, at these cosines to its axis.

    They follow from spherical waves about the focus, of the orders 0 to ``orders`` - 1. ``k``: complex wave number.
    """
    # Amplitude of the spherical wave of order n: Hankel function at the bowl, times moment of the apodisation, times
    # (2n + 1) (-j)^n.
    amplitude = _hankel(k * transducer.focal_length_m, orders) * _moments(transducer, orders)
    n = np.arange(orders)
    amplitude *= (2 * n + 1) * np.array([1, -1j, -1, 1j])[n % 4]
    # Each is a sum of plane waves, with a Legendre polynomial of the cosine as amplitude, (order, direction).
    legendre = np.stack(list(_legendre(cosine, orders)))
    return np.asarray((k * transducer.focal_length_m) ** 2 / 2 * (amplitude @ legendre))


def _moments(transducer: Transducer, orders: int) -> FloatArray:
    """Return the Legendre moments of the apodisation over the bowl, W_n (order,).

    They are integrals of apodisation times the Legendre polynomial of order n over the cosine of the angle at the
    focus.
    """
    edge = math.sqrt(1 - transducer.half_aperture**2)
    if transducer.apodisation == "uniform":
        # int_x^1 P_n = (P_{n-1}(x) - P_{n+1}(x)) / (2n + 1), with P_{-1} = 1.
        value = np.concatenate([np.ones(1), *_legendre(np.array([edge]), orders + 1)])
        return np.asarray((value[:-2] - value[2:]) / (2 * np.arange(orders) + 1))
    # Other apodisations by quadrature over the cosine, from the rim to the axis.
    node, weight = np.polynomial.legendre.leggauss(max(_APODISATION_NODES, orders))
    cosine = edge + (1 - edge) * (node + 1) / 2
    relative_radius = np.sqrt(1 - cosine**2) / transducer.half_aperture
    strength = apodisation(transducer, relative_radius) * weight * (1 - edge) / 2
    return np.array([float(strength @ row) for row in _legendre(cosine, orders)])


def _legendre(x: FloatArray, orders: int) -> Iterator[FloatArray]:
    """Yield the Legendre polynomials of order 0 to ``orders`` - 1 at ``x``."""
    previous, value = np.zeros_like(x), np.ones_like(x)
    for n in range(orders):
        yield value
        previous, value = value, ((2 * n + 1) * x * value - n * previous) / (n + 1)


def _hankel(argument: complex, orders: int) -> ComplexArray:
    """Return the spherical Hankel functions of the second kind, orders 0 to ``orders`` - 1, by upward recurrence.

    Upward is accurate because they grow with the order.
    """
    value = [1j * np.exp(-1j * argument) / argument]
    value.append(value[0] * (1 / argument + 1j))
    for n in range(1, orders - 1):
        value.append((2 * n + 1) / argument * value[n] - value[n - 1])
    return np.array(value[:orders])
