"""Shear wave speed from the phase at several lateral positions, and the Voigt moduli that explain its dispersion.

c_s(w) = w |dr / dphi|,    mu* = mu1 + j w mu2,    c_s = w / Re(w sqrt(rho / mu*)); docs/theory/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hpe_rig.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class ShearSpeed:
    """Speed by frequency: ``frequency_hz``, ``speed_m_per_s`` and ``uncertainty_m_per_s`` (frequency,).

    ``misfit`` (frequency,): mean square of the phases' departure from a line over their variance, NaN for two places.
    """

    frequency_hz: FloatArray
    speed_m_per_s: FloatArray
    uncertainty_m_per_s: FloatArray
    misfit: FloatArray


@dataclass(frozen=True, slots=True)
class Voigt:
    """Moduli of a Voigt medium with their covariance (2, 2) of (Pa, Pa s), and the reduced chi-square of the fit."""

    elasticity_pa: float
    viscosity_pa_s: float
    covariance: FloatArray
    misfit: float


def shear_speed(
    position_m: Sequence[float] | FloatArray,
    frequency_hz: Sequence[float] | FloatArray,
    phase_rad: FloatArray,
    uncertainty_rad: FloatArray,
) -> ShearSpeed:
    """Return the speed from a line through the phase over distance from the focus, at every frequency.

    ``position_m`` (place,); ``phase_rad`` and ``uncertainty_rad`` (place, frequency). Phases are unwrapped from place
    to place in order of distance, so neighbours must be less than half a wavelength apart. The wave runs away from the
    focus: the phase falls with distance. The uncertainty is the phases' alone: within a wavelength or two of the push
    the wave is not yet plane, and the speed off by more (100 Hz in 9 kPa, 1 to 4 mm off the axis: a sixth too slow in
    the medium's own field, without noise). Raises ``ValueError`` for fewer than two different places and for a phase
    that does not fall. Source: Chen, Fatemi, Greenleaf (2004), phase gradient.
    """
    place, frequency = np.asarray(position_m, dtype=np.float64), np.asarray(frequency_hz, dtype=np.float64)
    if np.unique(place).size < 2:
        raise ValueError(f"positions {place.tolist()} m: two different ones are needed for a phase gradient")
    order = np.argsort(place, kind="stable")
    phase = np.unwrap(phase_rad[order], axis=0)
    weight = 1 / np.square(np.maximum(uncertainty_rad[order], np.finfo(np.float32).tiny))
    centre = (weight * place[order, None]).sum(axis=0) / weight.sum(axis=0)
    distance = place[order, None] - centre
    information = np.sum(weight * distance**2, axis=0)
    slope = np.sum(weight * distance * phase, axis=0) / information
    if not np.all(slope < 0):
        wrong = frequency[slope >= 0].tolist()
        raise ValueError(
            f"the phase does not fall with distance at {wrong} Hz: places more than half a wavelength apart, "
            "positions not counted from the focus, or noise; try places closer together"
        )
    speed = -2 * np.pi * frequency / slope
    rest = phase - np.sum(weight * phase, axis=0) / weight.sum(axis=0) - slope * distance
    spare = place.size - 2
    misfit = np.sum(weight * rest**2, axis=0) / spare if spare else np.full(frequency.shape, np.nan)
    return ShearSpeed(frequency, speed, speed**2 / (2 * np.pi * frequency) / np.sqrt(information), misfit)


def voigt_speed(
    frequency_hz: FloatArray | float, elasticity_pa: float, viscosity_pa_s: float, density_kg_per_m3: float = 1000.0
) -> FloatArray:
    """Return the shear wave speed in a Voigt medium, shapes of ``frequency_hz``."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    size = np.hypot(elasticity_pa, omega * viscosity_pa_s)
    return np.asarray(np.sqrt(2 * size**2 / (density_kg_per_m3 * (elasticity_pa + size))))


def fit_voigt(speed: ShearSpeed, density_kg_per_m3: float = 1000.0) -> Voigt:
    """Return the moduli that fit the speeds best, weighted by their uncertainties; both at least zero.

    Raises ``ValueError`` for fewer than two frequencies.
    """
    if speed.frequency_hz.size < 2:
        raise ValueError("one frequency cannot tell elasticity from viscosity: try at least two")
    first = density_kg_per_m3 * float(np.median(speed.speed_m_per_s)) ** 2
    sigma = np.maximum(speed.uncertainty_m_per_s, np.finfo(np.float32).tiny)
    # in units of the median speed's modulus and of the viscosity that matches it at the highest frequency
    unit = np.array([first, first / (2 * np.pi * speed.frequency_hz.max())])

    def misfit(moduli: FloatArray) -> FloatArray:
        elasticity_pa, viscosity_pa_s = (moduli * unit).tolist()
        model = voigt_speed(speed.frequency_hz, elasticity_pa, viscosity_pa_s, density_kg_per_m3)
        return np.asarray((model - speed.speed_m_per_s) / sigma)

    starts = (np.array([1.0, 0.1]), np.array([0.5, 0.8]))
    tries = [least_squares(misfit, start, bounds=(0, np.inf), xtol=1e-14, ftol=1e-14) for start in starts]
    found = min(tries, key=lambda each: float(each.cost))
    jacobian = np.asarray(found.jac, dtype=np.float64)
    covariance = np.asarray(np.linalg.pinv(jacobian.T @ jacobian) * np.outer(unit, unit), dtype=np.float64)
    spare = speed.frequency_hz.size - 2
    misfit_left = 2 * float(found.cost) / spare if spare else float("nan")
    elasticity_pa, viscosity_pa_s = (found.x * unit).tolist()
    return Voigt(elasticity_pa, viscosity_pa_s, covariance, misfit_left)
