"""Accuracy of the shear field in extreme cases, compared with the same integral by mpmath with 25 digits.

The integrand is the closed form of docs/explanation/moduli.md with the Bessel and error functions of mpmath; the path
is a straight line at another height above the real axis. The first table is for a Gaussian force of 0.34 by 3.6 mm, the
second for a sum of Gaussians with the widths and depths of a bowl of 45 mm focused at 70 mm. Prints the tables of
docs/validation/moduli.md; exits with 1 above 1e-8 of the peak.

    python scripts/validation/shear_field_accuracy.py         # a quarter of an hour
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise

import mpmath as mp
import numpy as np

from hpe_rig.medium import HarmonicMedium, PushForce, TrackedRegion, shear_motion

GAUSSIAN = PushForce((0.34e-3,), 3.6e-3)
WEIGHTS = ((0.0, 0.0, 0.02), (0.1, 0.3, 0.0), (0.8, 0.2, -0.05), (0.0, 0.25, 0.1))
SUM = PushForce((0.18e-3, 0.9e-3, 4.7e-3), 1.87e-3, (-24e-3, -5e-3, 0.0, 8e-3), WEIGHTS)
DENSITY = 1000.0
ALLOWED = 1e-8
MEDIA = ((500.0, 0.0), (500.0, 50.0), (9e3, 2.0), (500e3, 0.0), (500e3, 50.0))
FREQUENCIES_HZ = (100.0, 1000.0)
SHORT_WAVES = ((500.0, 0.0, 20.8e3),)
"""Moduli and frequency of waves with a tenth of the force's width."""
LATERAL_M = (0.0, 1e-3, 20e-3)
SUM_MEDIA = ((500.0, 0.0, 1000.0), (9e3, 2.0, 100.0), (500e3, 50.0, 1000.0))
SUM_POINTS_M = ((0.0, 0.0), (1e-3, 0.0), (6e-3, 0.0), (1e-3, 3e-3))
"""Lateral offset from the axis and axial offset behind the focus."""
PANEL_RAD = 12.0
"""Phase of the Bessel function per panel of the path."""


def main() -> None:
    """Print the tables; exit with 1 for errors above ``ALLOWED`` relative to the peak."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    mp.mp.dps = 25
    media = [(mu1, mu2, hz) for mu1, mu2 in MEDIA for hz in FREQUENCIES_HZ]
    worst = table(sorted([*media, *SHORT_WAVES]), GAUSSIAN, [(lateral_m, 0.0) for lateral_m in LATERAL_M])
    worst = max(worst, table(SUM_MEDIA, SUM, SUM_POINTS_M))
    sys.exit(1 if worst > ALLOWED else 0)


def table(
    media: Sequence[tuple[float, float, float]], force: PushForce, points_m: Sequence[tuple[float, float]]
) -> float:
    """Print the errors of the field of ``force`` in every medium, and return the largest."""
    heads = (f"{1e3 * lateral:g} mm" + f", {1e3 * axial:g} mm deep" * (axial != 0) for lateral, axial in points_m)
    print("| medium | frequency | wavelength / width | " + " | ".join(heads) + " |")
    print("|---|---:|---:|" + "---:|" * len(points_m))
    worst = 0.0
    for mu1, mu2, hz in media:
        modulus = mu1 + 2j * np.pi * hz * mu2
        errors = deviations(modulus, hz, force, points_m)
        # Shear wavelength from the real part of the wave number.
        wave_m = 2 * np.pi / abs((2 * np.pi * hz * np.sqrt(DENSITY / modulus)).real)
        cells = " | ".join(f"{error:.0e}" for error in errors)
        medium = f"{mu1 * 1e-3:g} kPa, {mu2:g} Pa s"
        print(f"| {medium} | {hz:g} Hz | {wave_m / GAUSSIAN.across_m[0]:.3g} | {cells} |", flush=True)
        worst = max(worst, *errors)
    print()
    return worst


def deviations(
    modulus: complex, frequency_hz: float, force: PushForce, points_m: Sequence[tuple[float, float]]
) -> list[float]:
    """Return the error of the field at every point, relative to the largest displacement."""
    medium = HarmonicMedium(np.array([frequency_hz]), np.array([modulus]), DENSITY)
    field = [shear_motion(medium, force, TrackedRegion(np.array([x]), z)).value[0, 0] for x, z in points_m]
    exact = [exact_field(modulus, frequency_hz, force, *point) for point in points_m]
    peak = max(abs(value) for value in exact)
    return [abs(value - reference) / peak for value, reference in zip(field, exact, strict=True)]


def exact_field(modulus: complex, frequency_hz: float, force: PushForce, lateral_m: float, axial_m: float) -> complex:
    """Return the displacement per body force, m per N/m^3."""
    omega, along = 2 * mp.pi * frequency_hz, mp.mpf(force.along_m)
    q2, root = DENSITY * omega**2 / mp.mpc(modulus), along / mp.sqrt(2)
    squares, weights = [mp.mpf(width) ** 2 for width in force.across_m], force.weights
    offset = [(mp.mpf(axial_m) - centre) / (2 * root) for centre in force.centre_m]

    def station_term(kappa: mp.mpc, b: mp.mpf) -> mp.mpc:
        ahead, behind = (mp.exp(s * 2 * kappa * root * b) * mp.erfc(kappa * root + s * b) for s in (1, -1))
        return mp.pi / (2 * kappa) * mp.exp((kappa * root) ** 2) * (ahead + behind)

    def integrand(k: mp.mpc) -> mp.mpc:
        # Each Gaussian station has a term with the wave's and one with the static decay.
        across, kappa = [square * mp.exp(-square * k**2 / 2) for square in squares], mp.sqrt(k**2 - q2)
        terms = (
            mp.fdot(weight, across) * (station_term(kappa, b) - station_term(k, b))
            for weight, b in zip(weights, offset, strict=True)
        )
        return k**3 * mp.besselj(0, k * lateral_m) * mp.fsum(terms)

    width_m = force.across_m[0]
    max_k, height = 8.5 / width_m, min(1.7 / max(lateral_m, 1e-6), 0.6 / width_m)
    panels = 24 + int(max_k * lateral_m / PANEL_RAD)
    line = [mp.mpc(x, height) for x in np.linspace(2 * height, max_k, panels)]
    # The pole of a stiff medium is near 0: panel widths are proportional to the distance from 0. The first part of the
    # path is closer to the real axis than to the imaginary one, so that wide Gaussians decay along it.
    path = [mp.mpc(0), *(mp.mpc(2 * height, height) * 2.0**n for n in range(-12, 0)), *line]
    total = mp.fsum(mp.quad(integrand, ends, method="gauss-legendre", maxdegree=4) for ends in pairwise(path))
    return complex(along / (mp.sqrt(2 * mp.pi) * DENSITY * omega**2) * total)


if __name__ == "__main__":
    main()
