"""Shear wave speed from the phase at several lateral offsets, and the Voigt moduli of its dispersion.

    c_s(w) = w |dr / dphi|,    G = mu1 + j w mu2,    c_s = w / Re(w sqrt(rho / G))

r is the lateral offset, phi the phase, rho the density. Derivation: docs/explanation/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hpe_rig.arrays import FloatArray, numbers_text


@dataclass(frozen=True, slots=True)
class Voigt:
    """Moduli of a Voigt medium."""

    elasticity_pa: float
    viscosity_pa_s: float


def shear_speed(
    position_m: Sequence[float] | FloatArray,
    frequency_hz: Sequence[float] | FloatArray,
    phase_rad: FloatArray,
    uncertainty_rad: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the shear wave speed (frequency,) and its uncertainty by the phases, m/s, from phase over lateral offset.

    The speed follows from the slope of a line through the phases. ``position_m`` (offset,); ``phase_rad`` and
    ``uncertainty_rad`` (offset, frequency). Phases are unwrapped in order of offset, so neighbours must be less than
    half a wavelength apart. The wave runs away from the focus: the phase falls with distance. Within a wavelength or
    two of the push the wave is not plane: at 100 Hz in 9 kPa the speed is a sixth too low 1 to 4 mm off the axis.
    Raises ``ValueError`` for fewer than two different offsets and if a phase does not fall. Source: Chen, Fatemi,
    Greenleaf (2004), phase gradient.
    """
    offset, frequency = np.asarray(position_m, dtype=np.float64), np.asarray(frequency_hz, dtype=np.float64)
    if np.unique(offset).size < 2:
        raise ValueError(f"lateral offsets {numbers_text(offset)} m: a phase gradient needs two different ones")
    order = np.argsort(offset, kind="stable")
    phase = np.unwrap(phase_rad[order], axis=0)
    # Weighted least squares for the slope, about the weighted mean offset.
    weight = 1 / np.square(np.maximum(uncertainty_rad[order], np.finfo(np.float32).tiny))
    centre = (weight * offset[order, None]).sum(axis=0) / weight.sum(axis=0)
    distance = offset[order, None] - centre
    information = np.sum(weight * distance**2, axis=0)
    slope = np.sum(weight * distance * phase, axis=0) / information
    if not np.all(slope < 0):
        rising_hz = numbers_text(frequency[slope >= 0])
        raise ValueError(
            f"the phase does not fall with distance at {rising_hz} Hz: offsets more than half a wavelength apart, "
            "positions not counted from the focus, or noise. Try: smaller steps of the lateral offset"
        )
    # Speed = angular frequency over the slope of phase by distance; its uncertainty follows from that of the slope.
    speed = -2 * np.pi * frequency / slope
    return speed, speed**2 / (2 * np.pi * frequency) / np.sqrt(information)


def voigt_speed(
    frequency_hz: FloatArray | float, elasticity_pa: float, viscosity_pa_s: float, density_kg_per_m3: float = 1000.0
) -> FloatArray:
    """Return the shear wave speed in a Voigt medium, in the shape of ``frequency_hz``."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    magnitude_pa = np.hypot(elasticity_pa, omega * viscosity_pa_s)  # |G|
    return np.asarray(np.sqrt(2 * magnitude_pa**2 / (density_kg_per_m3 * (elasticity_pa + magnitude_pa))))


def fit_voigt(
    frequency_hz: FloatArray, speed_m_per_s: FloatArray, uncertainty_m_per_s: FloatArray, density_kg_per_m3: float = 1e3
) -> Voigt:
    """Return the Voigt moduli, at least zero, that fit shear wave speeds (frequency,) best.

    Speeds are weighted by their uncertainties. Raises ``ValueError`` for fewer than two frequencies.
    """
    if frequency_hz.size < 2:
        raise ValueError("one frequency does not separate elasticity from viscosity. Try: at least two")
    sigma = np.maximum(uncertainty_m_per_s, np.finfo(np.float32).tiny)
    # Units: the modulus of the median speed, and the viscosity with as large a loss at the highest frequency.
    median_pa = density_kg_per_m3 * float(np.median(speed_m_per_s)) ** 2
    unit = np.array([median_pa, median_pa / (2 * np.pi * frequency_hz.max())])

    def residual(relative: FloatArray) -> FloatArray:
        """Return modelled minus measured speed (frequency,), in standard uncertainties, for moduli in ``unit``."""
        elasticity_pa, viscosity_pa_s = (relative * unit).tolist()
        model = voigt_speed(frequency_hz, elasticity_pa, viscosity_pa_s, density_kg_per_m3)
        return np.asarray((model - speed_m_per_s) / sigma)

    # Two starts, a mostly elastic and a mostly viscous medium.
    starts = (np.array([1.0, 0.1]), np.array([0.5, 0.8]))
    solutions = [least_squares(residual, start, bounds=(0, np.inf), xtol=1e-14, ftol=1e-14) for start in starts]
    best = min(solutions, key=lambda solution: float(solution.cost))
    elasticity_pa, viscosity_pa_s = (best.x * unit).tolist()
    return Voigt(elasticity_pa, viscosity_pa_s)
