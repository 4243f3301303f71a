"""Cost of a measurement against its number of pulses: seconds by stage and peak memory, each in a fresh process.

Usage: python scripts/benchmarks/many_pulses.py [1e3 1e4 1e5 1e6]

The scene is ``table-1`` with a longer train. Processor time counts what waits for the disk or for other programs as
nothing; the peak is that of the whole process, from ``import`` to the written result.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

STAGES = ("plan", "collect", "store", "truth", "process")


def main() -> None:
    """Print one row for each number of pulses."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pulses", nargs="*", type=float, default=[1e3, 1e4, 1e5, 1e6])
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.alone:
        print(_row(int(asked.pulses[0])), flush=True)
        return
    print("| pulses | " + " | ".join(f"{name}, s" for name in STAGES) + " | all, s | processor, s | peak, MB |")
    print("|---" * (len(STAGES) + 4) + "|")
    for count in asked.pulses:
        subprocess.run([sys.executable, __file__, "--alone", str(count)], check=True)


def _row(pulses: int) -> str:
    # Guarded, as it is not there on Windows.
    import resource

    import hpe_rig as hpe
    from hpe_rig.measurement import prepare, record_run
    from hpe_rig.result import Stages
    from hpe_rig.runs import process

    start_s, stages = time.perf_counter(), Stages()
    with tempfile.TemporaryDirectory() as folder:
        setup = prepare(hpe.load_scene("table-1").with_({"tracking.pulse_count": pulses}), stages=stages)
        process(record_run(setup, Path(folder) / "run.h5", stages=stages), stages=stages)
    all_s, used = time.perf_counter() - start_s, resource.getrusage(resource.RUSAGE_SELF)
    # macOS counts bytes, everybody else kilobytes
    peak_mb = used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    seconds = [stages.run_time_s.get(name, 0.0) for name in STAGES] + [all_s, used.ru_utime + used.ru_stime]
    return f"| {pulses} | " + " | ".join(f"{each:.3g}" for each in seconds) + f" | {peak_mb:.0f} |"


if __name__ == "__main__":
    main()
