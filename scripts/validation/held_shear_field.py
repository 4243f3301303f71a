"""Write the spectra of displacement off the axis of a push, by direct quadrature, as reference of a test.

Gauss quadrature over both spherical wave numbers along real paths, independent of the program; it needs a lossy medium.
Convergence is checked with twice as many nodes. The moduli fitted to these spectra must be correct to 1e-6.

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
"""Largest amplitude of each medium."""
CONVERGED = 1e-9
"""Allowed change relative to the largest amplitude when the nodes are doubled."""


def main() -> None:
    """Write the spectra; exit with 1 if they are not converged."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    file, media = parser.parse_args().file, []
    for mu1, mu2 in MEDIA:
        phasor, finer = (spectra(mu1, mu2, nodes) for nodes in (12, 24))
        change = float(np.abs(phasor - finer).max() / np.abs(finer).max())
        print(
            f"{mu1 * 1e-3:g} kPa, {mu2:g} Pa s: {change:.0e} of the largest amplitude when the nodes are doubled",
            flush=True,
        )
        if change > CONVERGED:
            raise SystemExit(1)
        spectrum = {"real_m": finer.real.tolist(), "imaginary_m": finer.imag.tolist()}
        media.append({"shear_modulus_pa": mu1, "viscosity_pa_s": mu2, **spectrum})
    force = {"width_m": WIDTH_M, "burst_rate_hz": BURST_RATE_HZ, "burst_length_s": BURST_LENGTH_S}
    file.write_text(json.dumps({**force, "lateral_m": LATERAL_M, "media": media}, indent=1), encoding="utf-8")


def spectra(mu1: float, mu2: float, nodes: int) -> ComplexArray:
    """Return A exp(j phase), m (offset, harmonic), of A sin(2 pi f t + phase) with t from the onset of a burst."""
    harmonic = np.arange(1, HARMONICS + 1)
    omega, duty = 2 * np.pi * BURST_RATE_HZ * harmonic, BURST_RATE_HZ * BURST_LENGTH_S * harmonic
    response = np.stack([field(mu1 + 1j * value * mu2, value, nodes) for value in omega.tolist()], axis=1)
    # Spectrum of the burst train, one-sided, for a sine with the phase of the onset.
    bursts = 2j * np.sinc(duty) * np.exp(-1j * np.pi * duty)
    return np.asarray(response * bursts * (LARGEST_M / np.abs(response * bursts).max()))


def field(modulus: complex, omega: float, nodes: int) -> ComplexArray:
    """Return the displacement per body force in the focal plane (offset,), up to a real factor.

    int int k^2 (1 - m^2) / (k^2 - q^2) exp(-k^2 a(m)) J0(k r sqrt(1 - m^2)) dk dm / mu, with m the cosine between wave
    vector and force, a = (sx^2 (1 - m^2) + sz^2 m^2) / 2, q^2 = rho w^2 / mu.
    """
    # The integrand is negligible beyond k = 9 / s_x, and steep near the pole |q|: panels are narrow there.
    q2, max_k = DENSITY * omega**2 / modulus, 9.0 / WIDTH_M[0]
    pole = abs(np.sqrt(q2))
    m, m_weight = panels(np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 16)]), nodes)
    near = pole * np.linspace(0, 2.0, 61)
    k, k_weight = panels(np.unique(np.concatenate([near, np.linspace(2 * pole, max(max_k, 3 * pole), 40)])), nodes)
    a = (WIDTH_M[0] ** 2 * (1 - m**2) + WIDTH_M[1] ** 2 * m**2) / 2
    # The Gaussian force in wave-number space, and the projection of the force on shear waves.
    radial = (k**2 / (k**2 - q2) * k_weight)[:, None] * np.exp(-np.outer(k**2, a)) * (m_weight * (1 - m**2))
    across = np.outer(k, np.sqrt(1 - m**2))
    return np.array([np.sum(radial * j0(across * lateral_m)) for lateral_m in LATERAL_M]) / modulus


def panels(edges: FloatArray, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss nodes and weights of all panels between adjacent ``edges``."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    pairs = [((low + high) / 2 + (high - low) / 2 * node, (high - low) / 2 * weight) for low, high in pairwise(edges)]
    return np.concatenate([x for x, _ in pairs]), np.concatenate([w for _, w in pairs])


if __name__ == "__main__":
    main()
