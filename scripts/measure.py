"""Measurement of a scene from Python, as ``hpe-rig run`` does it.

Usage: python scripts/measure.py [SCENE [BENCH.toml]]
"""

import argparse

import hpe_rig as hpe


def main() -> None:
    """Measure, estimate and print; an exception or Ctrl-C leaves every output off."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="table-1", help="a shipped scene's name or a TOML file")
    parser.add_argument("bench", nargs="?", help="the bench's TOML file; absent: the simulated bench")
    asked = parser.parse_args()
    run = hpe.measure(asked.scene, asked.bench)
    result = run.estimate()
    print(f"{result.title}: {run.path}")
    for item in result.shots[0].estimates:
        peak = item.headline
        amplitude_nm, u_nm = peak.amplitude_m * 1e9, peak.amplitude_uncertainty_m * 1e9
        print(f"{item.frequency_hz:g} Hz: {amplitude_nm:.4g} nm, u = {u_nm:.2g} nm, phase {peak.phase_rad:.4f} rad")


if __name__ == "__main__":
    main()
