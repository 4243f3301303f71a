"""Linear field of a focused circular transducer around its focus: O'Neil's bowl as a sum of plane waves, exactly.

    P(r, z) = int_-1^1 A(m) exp(-j k z m) J0(k r sqrt(1 - m^2)) dm,                 P = p / (rho c u0)
    A(m)    = (k F)^2 / 2 sum_n (2n + 1) (-j)^n h_n(k F) W_n P_n(m),   W_n = int_cos(theta0)^1 w(theta) P_n(x) dx

The Rayleigh integral over the bowl, whose waves exp(-j k d) / d are expanded about the focus in spherical waves and
these in plane waves: z and r separate, so that a table is one matrix product. w is the apodisation over the angle seen
from the focus, h_n the spherical Hankel function of the second kind (time factor exp(+jwt)), k is complex where the
medium attenuates. docs/explanation/transducer.md, section 1.
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
    """Return k - j alpha, 1/m, of a medium whose loss grows in proportion to frequency."""
    loss_np_per_m = attenuation_db_per_cm_mhz * 100 * NEPER_PER_DB * frequency_hz * 1e-6
    return complex(2 * math.pi * frequency_hz / sound_speed_m_per_s, -loss_np_per_m)


def bowl_pressure(
    transducer: Transducer, wave_number_per_m: complex, lateral_m: FloatArray, axial_m: FloatArray
) -> ComplexArray:
    """Return the pressure over rho c u0 on a grid around the focus, complex (axial, lateral), time factor exp(+jwt).

    ``lateral_m`` distances from the axis, ``axial_m`` from the focus (the bowl's centre of curvature), positive away
    from the transducer; u0 is the surface's velocity where the apodisation is 1. Exact for the Rayleigh integral over
    the bowl, to 1e-12 of the focus' pressure. Raises ``ValueError`` for places as far from the focus as the bowl.
    """
    k = wave_number_per_m
    reach_m = float(np.hypot(np.abs(lateral_m).max(initial=0.0), np.abs(axial_m).max(initial=0.0)))
    if reach_m >= 0.9 * transducer.focal_length_m:
        raise ValueError(
            f"a place {reach_m * 1e3:.3g} mm from the focus is not in front of a bowl of "
            f"{transducer.focal_length_m * 1e3:.3g} mm focal length. Try: places within nine tenths of it."
        )
    # Spherical waves of order n do not reach closer to the focus than n / k; beyond, they fall faster than any power.
    size = abs(k) * reach_m
    orders = math.ceil(size + 6 * size ** (1 / 3)) + _MARGIN_ORDERS
    cosine, weight = np.polynomial.legendre.leggauss(orders + _MARGIN_ORDERS)
    spectrum = weight * _plane_waves(transducer, k, orders, cosine)
    along = np.exp(-1j * k * np.outer(axial_m, cosine)) * spectrum
    return np.asarray(along @ _bessel(k, np.outer(np.sqrt(1 - cosine**2), lateral_m)))


def _bessel(k: complex, distance_m: FloatArray) -> FloatArray | ComplexArray:
    """Return J0(k distance), any shape; of a real argument in a tenth of the time."""
    from scipy.special import j0, jv

    return np.asarray(j0(k.real * distance_m) if k.imag == 0 else jv(0, k * distance_m))


def apodisation(transducer: Transducer, share: FloatArray) -> FloatArray:
    """Return the velocity over the aperture, relative to that of its middle, at shares of its radius from 0 to 1."""
    match transducer.apodisation:
        case "parabolic":
            return np.asarray(1 - share**2)
        case "hann":
            return np.asarray(np.cos(np.pi / 2 * share) ** 2)
    return np.ones_like(share)


def _plane_waves(transducer: Transducer, k: complex, orders: int, cosine: FloatArray) -> ComplexArray:
    """Return A at ``cosine`` (direction,), from ``orders`` spherical waves."""
    weighted = _hankel(k * transducer.focal_length_m, orders) * _moments(transducer, orders)
    n = np.arange(orders)
    weighted *= (2 * n + 1) * np.array([1, -1j, -1, 1j])[n % 4]
    legendre = np.stack(list(_legendre(cosine, orders)))
    return np.asarray((k * transducer.focal_length_m) ** 2 / 2 * (weighted @ legendre))


def _moments(transducer: Transducer, orders: int) -> FloatArray:
    """Return W_n, (order,): Legendre moments of the apodisation over the bowl."""
    edge = math.sqrt(1 - transducer.half_aperture**2)
    if transducer.apodisation == "uniform":
        # int_x^1 P_n = (P_{n-1}(x) - P_{n+1}(x)) / (2n + 1), with P_{-1} = 1
        value = np.concatenate([np.ones(1), *_legendre(np.array([edge]), orders + 1)])
        return np.asarray((value[:-2] - value[2:]) / (2 * np.arange(orders) + 1))
    node, weight = np.polynomial.legendre.leggauss(max(_APODISATION_NODES, orders))
    cosine = edge + (1 - edge) * (node + 1) / 2
    share = np.sqrt(1 - cosine**2) / transducer.half_aperture
    strength = apodisation(transducer, share) * weight * (1 - edge) / 2
    return np.array([float(strength @ row) for row in _legendre(cosine, orders)])


def _legendre(x: FloatArray, orders: int) -> Iterator[FloatArray]:
    """Yield P_0 to P_(orders - 1) at ``x``."""
    before, value = np.zeros_like(x), np.ones_like(x)
    for n in range(orders):
        yield value
        before, value = value, ((2 * n + 1) * x * value - n * before) / (n + 1)


def _hankel(argument: complex, orders: int) -> ComplexArray:
    """Return the spherical Hankel functions of the second kind, (order,): upwards, where they grow."""
    value = [1j * np.exp(-1j * argument) / argument]
    value.append(value[0] * (1 / argument + 1j))
    for n in range(1, orders - 1):
        value.append((2 * n + 1) / argument * value[n] - value[n - 1])
    return np.array(value[:orders])
