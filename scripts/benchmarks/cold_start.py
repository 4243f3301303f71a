"""Measure the processor time and loaded modules of commands in fresh processes.

Runs alternate, so that a busy machine slows all of them alike; the table has the median and the minimum. The column
"floor" is a process that only loads the libraries that the command needs: no command can be faster.

    python scripts/benchmarks/cold_start.py [--repeats 7] [--clock]
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

TYPER = """
import typer
app = typer.Typer()
app.command()(lambda: None)
app([], standalone_mode=False)
"""
LIBRARIES = {
    "numpy": "import numpy, numpy.random",
    "pydantic": "import pydantic; pydantic.create_model('Settings', value=(float, 0.0))(value=1)",
    "typer": TYPER,
    "typer, help": "import typer.main",
    "h5py": "import h5py",
    "rich": "import rich.console, rich.table",
    "scipy.special": "import scipy.special; scipy.special.wofz",
    "matplotlib": "from matplotlib.figure import Figure; from matplotlib.backends.backend_svg import FigureCanvasSVG",
    "jinja2": "import jinja2",
}
"""Code that loads each library as the program does, first use included."""
CHECK = ("numpy", "pydantic", "typer")
RUN = (*CHECK, "h5py", "rich")
COMMANDS = {
    "--help": ("typer, help",),
    "check table-1": CHECK,
    "run table-1 --output table.h5 --overwrite": RUN,
    "check bovine-muscle": (*CHECK, "scipy.special"),
    "run bovine-muscle --output muscle.h5 --overwrite": (*RUN, "scipy.special"),
    "process muscle.h5": (*RUN, "scipy.special"),
    "report muscle.h5": (*CHECK, "h5py", "scipy.special", "matplotlib", "jinja2"),
    "list": (*CHECK, "h5py", "rich"),
}
"""Libraries that each command needs."""
ROOT = Path(__file__).parents[2]
# The program replaces its own standard error, so the number is written to the descriptor.
COUNT_MODULES = "import atexit, os, sys\natexit.register(lambda: os.write(2, b'%d\\n' % len(sys.modules)))\n"
PROGRAM = COUNT_MODULES + 'import runpy\nrunpy.run_module("hpe_rig", run_name="__main__", alter_sys=True)\n'
Cost = tuple[float, int]
"""Time, s, and number of modules loaded."""
RunCode = Callable[[str, str], Cost]


def main() -> None:
    """Print one row for each command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--clock", action="store_true", help="elapsed instead of processor time, for an idle machine")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        run = code_runner(Path(folder), options.clock)
        print("| command | median, s | least, s | floor, s | modules |\n|---|---|---|---|---|")
        for command in COMMANDS:
            print(command_row(command, run, options.repeats), flush=True)


def code_runner(folder: Path, by_clock: bool) -> RunCode:
    """Return a function that runs code in a fresh process; POSIX only."""
    import resource

    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
        "PYTHONDONTWRITEBYTECODE": "",
        "OMP_NUM_THREADS": "1",
    }

    def now_s() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.perf_counter() if by_clock else usage.ru_utime + usage.ru_stime

    def run(code: str, arguments: str) -> Cost:
        # Every program prints the number of its modules as the last word of the standard error.
        start_s = now_s()
        command = [sys.executable, "-c", code, *arguments.split()]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder, env=environment)
        return now_s() - start_s, int(done.stderr.split()[-1])

    return run


def alternating_costs(calls: list[Callable[[], Cost]], repeats: int) -> list[list[Cost]]:
    """Return the costs (call, repeat); a first round, which fills the bytecode and disk caches, is dropped."""
    rounds = [[call() for call in calls] for _ in range(repeats + 1)][1:]
    return [list(costs) for costs in zip(*rounds, strict=True)]


def median_s(costs: list[Cost]) -> float:
    return statistics.median(time_s for time_s, _ in costs)


def command_row(command: str, run: RunCode, repeats: int) -> str:
    libraries = COUNT_MODULES + "\n".join(LIBRARIES[name] for name in COMMANDS[command])
    costs, floor_costs = alternating_costs([lambda: run(PROGRAM, command), lambda: run(libraries, "")], repeats)
    least_s, modules = min(costs)
    return f"| `{command}` | {median_s(costs):.2f} | {least_s:.2f} | {median_s(floor_costs):.2f} | {modules} |"


if __name__ == "__main__":
    main()
