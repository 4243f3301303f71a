"""Accuracy of the shear field at its extremes, against the same integral by mpmath with 25 digits on a path of its own.

The integrand is the closed form of docs/theory/moduli.md, evaluated by mpmath's own Bessel and error functions; the
path is a straight line at another height above the axis. Prints the table of docs/moduli.md and fails above 1e-8 of the
peak.

    python scripts/shear_field_accuracy.py         # some minutes
"""

from __future__ import annotations

import sys
from itertools import pairwise

import mpmath as mp
import numpy as np

from hpe_rig.processing import PushForce, shear_motion

WIDTH_M = (0.34e-3, 3.6e-3)
DENSITY = 1000.0
ALLOWED = 1e-8
MEDIA = ((500.0, 0.0), (500.0, 50.0), (9e3, 2.0), (500e3, 0.0), (500e3, 50.0))
FREQUENCIES_HZ = (100.0, 1000.0)
LATERAL_M = (0.0, 1e-3, 20e-3)
PANEL_RAD = 12.0
"""Advance of the Bessel function in a panel of the path."""


def main() -> None:
    """Print the table; exit with 1 where the field is off by more than ``ALLOWED`` of its peak."""
    mp.mp.dps = 25
    print("| medium | frequency | wavelength / width | " + " | ".join(f"{1e3 * r:g} mm" for r in LATERAL_M) + " |")
    print("|---|---:|---:|" + "---:|" * len(LATERAL_M))
    worst = 0.0
    for mu1, mu2 in MEDIA:
        for hz in FREQUENCIES_HZ:
            modulus = mu1 + 2j * np.pi * hz * mu2
            errors = deviations(modulus, hz)
            wave_m = 2 * np.pi / abs((2 * np.pi * hz * np.sqrt(DENSITY / modulus)).real)
            cells = " | ".join(f"{each:.0e}" for each in errors)
            medium = f"{mu1 * 1e-3:g} kPa, {mu2:g} Pa s"
            print(f"| {medium} | {hz:g} Hz | {wave_m / WIDTH_M[0]:.3g} | {cells} |", flush=True)
            worst = max(worst, *errors)
    sys.exit(1 if worst > ALLOWED else 0)


def deviations(modulus: complex, frequency_hz: float) -> list[float]:
    """Return by how much the field differs from mpmath's at every place, over the largest displacement."""
    force = PushForce(WIDTH_M[:1], WIDTH_M[1])
    ours = [
        shear_motion(np.array([modulus]), np.array([frequency_hz]), DENSITY, force, 0.0, 0.0, np.array([place])).value[
            0, 0
        ]
        for place in LATERAL_M
    ]
    exact = [reference(modulus, frequency_hz, place) for place in LATERAL_M]
    peak = max(abs(each) for each in exact)
    return [abs(own - other) / peak for own, other in zip(ours, exact, strict=True)]


def reference(modulus: complex, frequency_hz: float, lateral_m: float) -> complex:
    """Return the displacement per body force in the focal plane, m per N/m^3."""
    omega, across, half = 2 * mp.pi * frequency_hz, mp.mpf(WIDTH_M[0]) ** 2, mp.mpf(WIDTH_M[1]) ** 2 / 2
    q2 = DENSITY * omega**2 / mp.mpc(modulus)
    root = mp.sqrt(half)

    def along(kappa: mp.mpc) -> mp.mpc:
        return mp.pi / kappa * mp.exp((kappa * root) ** 2) * mp.erfc(kappa * root)

    def integrand(k: mp.mpc) -> mp.mpc:
        spectrum = k**3 * mp.besselj(0, k * lateral_m) * mp.exp(-across * k**2 / 2)
        return spectrum * (along(mp.sqrt(k**2 - q2)) - along(k))

    last = 8.5 / WIDTH_M[0]
    height = min(1.7 / max(lateral_m, 1e-6), 0.6 / WIDTH_M[0])
    panels = 24 + int(last * lateral_m / PANEL_RAD)
    line = [mp.mpc(x, height) for x in np.linspace(height, last, panels)]
    # panels as wide as they are far from 0: the pole of a stiff medium lies next to it
    path = [mp.mpc(0), *(mp.mpc(height, height) * 2.0**n for n in range(-12, 0)), *line]
    total = mp.fsum(mp.quad(integrand, each, method="gauss-legendre", maxdegree=4) for each in pairwise(path))
    front = WIDTH_M[0] ** 2 * WIDTH_M[1] / (mp.sqrt(2 * mp.pi) * DENSITY * omega**2)
    return complex(front * total)


if __name__ == "__main__":
    main()
