"""Measure a scene from Python, as `hpe-rig run` does.

Usage: python scripts/measure.py [SCENE [BENCH.toml]]
"""

import argparse

import hpe_rig as hpe


def main() -> None:
    """Measure, estimate and print. Outputs are off at the end, also after an exception or Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="table-1", help="a shipped scene's name or a TOML file")
    parser.add_argument("bench", nargs="?", help="the bench's TOML file; default: the simulated bench")
    options = parser.parse_args()
    run = hpe.measure(options.scene, options.bench)
    result = run.estimate()
    print(f"{result.title}: {run.path}")
    for item in result.shots[0].estimates:
        # The headline is the peak displacement where the beams are known, else the tracked one.
        amplitude_nm, u_nm = item.amplitude_m * 1e9, item.amplitude_uncertainty_m * 1e9
        print(f"{item.frequency_hz:g} Hz: {amplitude_nm:.4g} nm, u = {u_nm:.2g} nm, phase {item.phase_rad:.4f} rad")


if __name__ == "__main__":
    main()
