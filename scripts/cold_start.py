"""Cold start: processor time and modules of commands, each run in fresh processes.

Usage: python scripts/cold_start.py [--repeats 7] [--against TREE] [--only moduli]

Median and least of several runs, in turn, so that a busy machine slows all alike. ``--against`` runs the package of
another tree, such as that of an earlier version, beside it: the last column is the ratio of the medians.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

COMMANDS = (
    "--help",
    "check table-1",
    "run table-1 --output table.h5 --overwrite",
    "check bovine-muscle",
    "run bovine-muscle --output muscle.h5 --overwrite",
    "process muscle.h5",
    "report muscle.h5",
    "run gelatin-moduli --yes --output moduli.h5 --overwrite",
    "moduli moduli.h5",
    "list",
)
ROOT = Path(__file__).parents[1]
COUNTING = """
import atexit, runpy, sys
atexit.register(lambda: print(len(sys.modules), file=sys.stderr))
runpy.run_module("hpe_rig", run_name="__main__", alter_sys=True)
"""


def main() -> None:
    """Print one row for each command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--against", type=Path, help="another tree with the package")
    parser.add_argument("--only", default="", help="commands that hold this word")
    asked = parser.parse_args()
    trees = [ROOT, *([asked.against.resolve()] if asked.against else [])]
    with tempfile.TemporaryDirectory() as folder:
        runs = [_runner(tree, Path(folder)) for tree in trees]
        print("| command | median, s | least, s | modules |" + (" before, s | ratio |" if asked.against else ""))
        print("|---" * (6 if asked.against else 4) + "|")
        for command in (each for each in COMMANDS if asked.only in each):
            print(_row(command, runs, asked.repeats), flush=True)


def _runner(tree: Path, folder: Path) -> Callable[[str], tuple[float, int]]:
    """Return a function that runs a command with the package of ``tree``: processor time, s, and modules loaded."""
    # Guarded, as it is not there on Windows.
    import resource

    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
        "PYTHONDONTWRITEBYTECODE": "",
        "OMP_NUM_THREADS": "1",
    }

    def run(command: str) -> tuple[float, int]:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        words = [sys.executable, "-c", COUNTING, *command.split()]
        done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=folder, env=environment)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return used_s, int(done.stderr.split()[-1])

    return run


def _row(command: str, runs: list[Callable[[str], tuple[float, int]]], repeats: int) -> str:
    for run in runs:
        # once for the bytecode and the disk's cache
        run(command)
    found = [[run(command) for run in runs] for _ in range(repeats)]
    used = [[each[tree][0] for each in found] for tree in range(len(runs))]
    medians = [statistics.median(each) for each in used]
    row = f"| `{command}` | {medians[0]:.2f} | {min(used[0]):.2f} | {found[0][0][1]} |"
    return row + (f" {medians[1]:.2f} | {medians[0] / medians[1]:.2f} |" if len(runs) > 1 else "")


if __name__ == "__main__":
    main()
