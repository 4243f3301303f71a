"""Measure run time per stage and peak memory of a measurement against its number of pulses.

The scene is `table-1` with a longer train. Each row is a fresh process, from import to the stored result.
Waiting for the disk or for other programs does not count as processor time.

    python scripts/benchmarks/many_pulses.py [1e3 1e4 1e5 1e6]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from process_cost import resource_usage

STAGES = ("plan", "collect", "store", "truth", "process")


def main() -> None:
    """Print one row for each number of pulses."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pulses", nargs="*", type=float, default=[1e3, 1e4, 1e5, 1e6])
    parser.add_argument("--in-process", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.in_process:
        print(table_row(int(options.pulses[0])), flush=True)
        return
    print("| pulses | " + " | ".join(f"{name}, s" for name in STAGES) + " | all, s | processor, s | peak, MB |")
    print("|---" * (len(STAGES) + 4) + "|")
    for pulses in options.pulses:
        subprocess.run([sys.executable, __file__, "--in-process", str(pulses)], check=True)


def table_row(pulses: int) -> str:
    """Measure and process a scene of ``pulses`` pulses in this process; return its row of the table."""
    import hpe_rig as hpe
    from hpe_rig.measurement import prepare, record_run
    from hpe_rig.result import Stages
    from hpe_rig.runs import process

    start_s, stages = time.perf_counter(), Stages()
    with tempfile.TemporaryDirectory() as folder:
        setup = prepare(hpe.load_scene("table-1").with_({"tracking.pulse_count": pulses}), stages=stages)
        process(record_run(setup, Path(folder) / "run.h5", stages=stages), stages=stages)
    all_s = time.perf_counter() - start_s
    processor_s, peak_mb = resource_usage()
    times_s = [*(stages.run_time_s.get(name, 0.0) for name in STAGES), all_s, processor_s]
    return f"| {pulses} | " + " | ".join(f"{time_s:.3g}" for time_s in times_s) + f" | {peak_mb:.0f} |"


if __name__ == "__main__":
    main()
