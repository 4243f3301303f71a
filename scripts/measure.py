"""Measure a scene from Python, as ``hpe-rig run`` does: SCENE [BENCH.toml]."""

import sys
from pathlib import Path

from hpe_rig.acquire import measure, prepare, process
from hpe_rig.cli import print_result


def main(scene: str = "table-1", bench: str | None = None) -> None:
    """Plan, acquire, estimate and print; an exception or Ctrl-C leaves every output off."""
    setup = prepare(scene, Path(bench) if bench else None)
    run_file = measure(setup)
    result = process(run_file)
    print_result(result)
    strongest = max(result.shots[0].estimates, key=lambda estimate: estimate.amplitude_m)
    print(f"strongest: {strongest.amplitude_m * 1e9:.0f} nm at {strongest.frequency_hz:g} Hz, in {run_file}")


if __name__ == "__main__":
    main(*sys.argv[1:])
