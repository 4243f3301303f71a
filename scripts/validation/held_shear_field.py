"""Spectra of motion beside a push by brute force, held for a test: the moduli must come back from them to 1e-6.

Plain Gauss quadrature over both spherical wave numbers, real all along, which needs a loss and knows no closed form;
nothing of the program is used. Twice as many nodes show how far it is from converged.

    python scripts/validation/held_shear_field.py tests/fixtures/held_shear_field.json         # some minutes
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.special import j0

from hpe_rig.arrays import ComplexArray, FloatArray

WIDTH_M = (0.34e-3, 3.6e-3)
DENSITY = 1000.0
BURST_RATE_HZ, BURST_LENGTH_S = 100.0, 100e-6
LATERAL_M = (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3)
MEDIA = ((4e3, 1.0), (7.25e3, 1.0), (13.5e3, 1.0), (9e3, 2.0), (12e3, 5.7))
HARMONICS = 10
LARGEST_M = 800e-9
"""Of all amplitudes of a medium."""
CONVERGED = 1e-9
"""Largest change, over the largest amplitude, as the nodes are doubled."""


def main() -> None:
    """Write the spectra; fail where they are not converged."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    file, held = parser.parse_args().file, []
    for mu1, mu2 in MEDIA:
        phasor, finer = (spectra(mu1, mu2, nodes) for nodes in (12, 24))
        change = float(np.abs(phasor - finer).max() / np.abs(finer).max())
        print(f"{mu1 * 1e-3:g} kPa, {mu2:g} Pa s: {change:.0e} of the largest as the nodes are doubled", flush=True)
        if change > CONVERGED:
            raise SystemExit(1)
        parts = {"real_m": finer.real.tolist(), "imaginary_m": finer.imag.tolist()}
        held.append({"shear_modulus_pa": mu1, "viscosity_pa_s": mu2, **parts})
    force = {"width_m": WIDTH_M, "burst_rate_hz": BURST_RATE_HZ, "burst_length_s": BURST_LENGTH_S}
    file.write_text(json.dumps({**force, "lateral_m": LATERAL_M, "media": held}, indent=1), encoding="utf-8")


def spectra(mu1: float, mu2: float, nodes: int) -> ComplexArray:
    """Return A exp(j phase), m, of A sin(2 pi f t + phase) from a burst's onset, (place, harmonic)."""
    harmonic = np.arange(1, HARMONICS + 1)
    omega, duty = 2 * np.pi * BURST_RATE_HZ * harmonic, BURST_RATE_HZ * BURST_LENGTH_S * harmonic
    moved = np.stack([field(mu1 + 1j * each * mu2, each, nodes) for each in omega.tolist()], axis=1)
    bursts = 2j * np.sinc(duty) * np.exp(-1j * np.pi * duty)
    return np.asarray(moved * bursts * (LARGEST_M / np.abs(moved * bursts).max()))


def field(modulus: complex, omega: float, nodes: int) -> ComplexArray:
    """Return the displacement per body force in the focal plane, (place,), but for a real factor.

    int int k^2 (1 - m^2) / (k^2 - q^2) exp(-k^2 a(m)) J0(k r sqrt(1 - m^2)) dk dm / mu, m the cosine of the wave's
    direction with the force, a = (sx^2 (1 - m^2) + sz^2 m^2) / 2, q^2 = rho w^2 / mu.
    """
    q2, last = DENSITY * omega**2 / modulus, 9.0 / WIDTH_M[0]
    pole = abs(np.sqrt(q2))
    m, m_weight = panels(np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 16)]), nodes)
    near = pole * np.linspace(0, 2.0, 61)
    k, k_weight = panels(np.unique(np.concatenate([near, np.linspace(2 * pole, max(last, 3 * pole), 40)])), nodes)
    a = (WIDTH_M[0] ** 2 * (1 - m**2) + WIDTH_M[1] ** 2 * m**2) / 2
    radial = (k**2 / (k**2 - q2) * k_weight)[:, None] * np.exp(-np.outer(k**2, a)) * (m_weight * (1 - m**2))
    across = np.outer(k, np.sqrt(1 - m**2))
    return np.array([np.sum(radial * j0(across * place)) for place in LATERAL_M]) / modulus


def panels(edges: FloatArray, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss nodes and weights of all panels between ``edges``."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    parts = [((low + high) / 2 + (high - low) / 2 * node, (high - low) / 2 * weight) for low, high in pairwise(edges)]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


if __name__ == "__main__":
    main()
