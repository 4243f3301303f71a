"""Rigid sphere in the medium, pushed by the radiation force: it calibrates the moduli of a gelatin.

    F = U (6 pi a mu (1 + l + l² / 9) + m s²),      l = a s sqrt(rho / mu(s))

    F, U       force, N; displacement, m
    a, m       radius, m; mass of the sphere, kg
    mu, rho    shear modulus, Pa, and density, kg/m³, of the medium
    s          complex frequency, 1/s

Oestreicher's impedance of an oscillating rigid sphere (J. Acoust. Soc. Am. 23, 1951, p. 707) in an incompressible
medium: Stokes' drag, Basset's history term and the moved mass of medium. Chen and others (J. Acoust. Soc. Am. 112,
2002, p. 884) push such a sphere by ultrasound and fit its motion. See docs/explanation/medium.md, section 8.
"""

from __future__ import annotations

import math

import numpy as np

from sim_backend.arrays import ComplexArray
from sim_backend.motion.inverse_laplace import Contour
from sim_backend.settings import Specimen, Sphere

SPHERE_CONTOUR = Contour(96, 5.6, 0.8, 0.15)
"""Contour to the right of a sphere's poles, which for steel are 22 degrees off the imaginary axis; exact to 1e-6."""
SPHERE_DEGREES = 48
"""Chebyshev coefficients of a panel: a sphere's poles near the imaginary axis make its response oscillate."""


def sphere_mass_kg(sphere: Sphere) -> float:
    """Return the mass of the sphere."""
    return 4 / 3 * math.pi * sphere.radius_m**3 * sphere.density_kg_per_m3


def sphere_response(
    sphere: Sphere, modulus_pa: ComplexArray, density_kg_per_m3: float, s_per_s: ComplexArray
) -> ComplexArray:
    """Return the displacement of a rigid sphere over the force on it, m/N (frequency,).

    ``modulus_pa`` (frequency,): complex shear modulus of the medium at complex frequencies ``s_per_s`` (frequency,).
    The force over the displacement is that of the medium, by Oestreicher's impedance, plus the sphere's inertia.
    """
    a = sphere.radius_m
    # Wave number of shear waves times the radius, times j for s = jw.
    wavenumber_radius = a * s_per_s * np.sqrt(density_kg_per_m3 / modulus_pa)
    # Impedance is force over velocity: times s it is force over displacement.
    medium_n_per_m = 6 * math.pi * a * modulus_pa * (1 + wavenumber_radius + wavenumber_radius**2 / 9)
    return np.asarray(1 / (medium_n_per_m + sphere_mass_kg(sphere) * s_per_s**2))


def sphere_force_volume_m3(specimen: Specimen, sphere: Sphere) -> float:
    """Return the force on the sphere over the body force that represents the same drive, m³."""
    return sphere.force_n / specimen.force_density_n_per_m3
