"""Fig. 15 on the twin: displacement at 200 Hz against force for T_b = 50, 100, 200 us, regression and threshold."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hpe_rig.result import ShotResult
from hpe_rig.run import measure, prepare, process

FREQUENCY_HZ = 200.0
SAMPLES = {50e-6: 9, 100e-6: 11, 200e-6: 13}
"""How many of the highest samples the paper's regression takes."""


def main(estimator: str = "coherent") -> None:
    """Measure both scenes and print the regression beside the paper's slopes of 409, 812 and 1654 nm."""
    for scene in ("muscle-force", "muscle-force-200us"):
        with TemporaryDirectory() as folder:
            result = process(measure(prepare(scene), Path(folder) / "run.h5"), estimator)
        for length_s, highest in SAMPLES.items():
            shots = [shot for shot in result.shots if shot.burst_length_s == length_s]
            if shots:
                report(length_s, highest, shots)


def report(length_s: float, highest: int, shots: list[ShotResult]) -> None:
    """Print one burst length: points, line through the highest, R^2, floor."""
    force = np.array([shot.force_fraction or 0.0 for shot in shots])
    found = [next(item for item in shot.estimates if item.frequency_hz == FREQUENCY_HZ) for shot in shots]
    nm = np.array([item.amplitude_m for item in found]) * 1e9
    noise_nm = np.median([item.amplitude_uncertainty_m for item in found]) * 1e9
    top = np.argsort(force)[-highest:]
    slope, offset = np.polyfit(force[top], nm[top], 1)
    r2 = np.corrcoef(force[top], nm[top])[0, 1] ** 2
    print(f"\nT_b = {length_s * 1e6:.0f} us: y = {slope:.0f} x {offset:+.0f} nm, R^2 = {r2:.4f}")
    # In both quadratures: what noise alone exceeds in one of twenty measurements.
    print(f"  noise {noise_nm:.0f} nm in each quadrature, detected above {noise_nm * np.sqrt(2 * np.log(20)):.0f} nm")
    print("  F/F_0  " + " ".join(f"{f:6.2f}" for f in force))
    print("  nm     " + " ".join(f"{y:6.0f}" for y in nm))


if __name__ == "__main__":
    main(*sys.argv[1:])
