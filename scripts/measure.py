"""Measurement of a scene from Python, as ``hpe-rig run`` does it: SCENE [BENCH.toml]."""

import sys

import hpe_rig as hpe


def main(scene: str = "table-1", bench: str | None = None) -> None:
    """Measure, estimate and print; an exception or Ctrl-C leaves every output off."""
    run = hpe.measure(scene, bench)
    result = run.estimate()
    print(f"{result.title}: {run.path}")
    for item in result.shots[0].estimates:
        peak = item.headline
        amplitude_nm, u_nm = peak.amplitude_m * 1e9, peak.amplitude_uncertainty_m * 1e9
        print(f"{item.frequency_hz:g} Hz: {amplitude_nm:.4g} nm, u = {u_nm:.2g} nm, phase {peak.phase_rad:.4f} rad")


if __name__ == "__main__":
    main(*sys.argv[1:])
