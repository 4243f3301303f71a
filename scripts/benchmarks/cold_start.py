"""Cold start: processor time and modules of commands, each run in fresh processes, and of the libraries they need.

Usage: python scripts/benchmarks/cold_start.py [--repeats 7] [--against TREE ...] [--clock] [--libraries]

Median and least of several runs, in turn, so that a busy machine slows all alike. The floor of a command is a process
that loads the libraries that it needs as the program does and does nothing: no command can take less. ``--against``
runs the package of other trees, such as those of earlier versions, beside it: the last columns are the medians of each
and the ratio to it. ``--clock`` takes the time by the clock, for an idle machine. ``--libraries``: each library alone.
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
COMPILED = """
import numba
@numba.njit(cache=True)
def total(values):
    found = 0.0
    for value in values:
        found += value
    return found
"""
LIBRARIES = {
    "Python": "",
    "numpy": "import numpy, numpy.random",
    "pydantic": "import pydantic; pydantic.create_model('Settings', value=(float, 0.0))(value=1)",
    "typer": TYPER,
    "typer, help": "import typer.main",
    "h5py": "import h5py",
    "rich": "import rich.console, rich.table",
    "scipy.special": "import scipy.special; scipy.special.wofz",
    "matplotlib": "from matplotlib.figure import Figure; from matplotlib.backends.backend_svg import FigureCanvasSVG",
    "jinja2": "import jinja2",
    "numba": "import numpy, compiled; compiled.total(numpy.ones(3))",
}
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
"""What each needs; numba none."""
ROOT = Path(__file__).parents[2]
COUNTING = "import atexit, sys\natexit.register(lambda: print(len(sys.modules), file=sys.stderr))\n"
PROGRAM = COUNTING + 'import runpy\nrunpy.run_module("hpe_rig", run_name="__main__", alter_sys=True)\n'
Run = Callable[[str, str], tuple[float, int]]


def main() -> None:
    """Print one row for each command, or for each library."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--against", type=Path, nargs="+", default=[], help="other trees with the package")
    parser.add_argument("--clock", action="store_true", help="time by the clock, for an idle machine")
    parser.add_argument("--libraries", action="store_true", help="what each library takes alone")
    asked = parser.parse_args()
    trees = [ROOT, *(tree.resolve() for tree in asked.against)]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "compiled.py").write_text(COMPILED, encoding="utf-8")
        runs = [_runner(tree, Path(folder), asked.clock) for tree in trees]
        if asked.libraries:
            _print_libraries(runs[0], asked.repeats)
            return
        more = "".join(f" {tree.name}, s | ratio |" for tree in trees[1:])
        print(f"| command | median, s | least, s | floor, s | modules |{more}")
        print("|---" * (5 + more.count("|")) + "|")
        for command in COMMANDS:
            print(_row(command, runs, asked.repeats), flush=True)


def _print_libraries(run: Run, repeats: int) -> None:
    print("| library | median, s | beyond Python, s | modules |")
    print("|---|---|---|---|")
    found = _in_turn([lambda text=text: run(COUNTING + text, "") for text in LIBRARIES.values()], repeats)
    bare = statistics.median(each[0] for each in found[0])
    for name, each in zip(LIBRARIES, found, strict=True):
        median = statistics.median(used for used, _ in each)
        print(f"| {name} | {median:.3f} | {median - bare:.3f} | {each[0][1]} |")


def _in_turn(calls: list[Callable[[], tuple[float, int]]], repeats: int) -> list[list[tuple[float, int]]]:
    """Return what each call gives, ``repeats`` times; called once before, for the bytecode and the disk's cache."""
    rounds = [[call() for call in calls] for _ in range(repeats + 1)][1:]
    return [list(each) for each in zip(*rounds, strict=True)]


def _runner(tree: Path, folder: Path, by_clock: bool) -> Run:
    """Return a function that runs code with the package of ``tree``: time, s, and modules loaded."""
    # Guarded, as it is not there on Windows.
    import resource

    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
        "PYTHONDONTWRITEBYTECODE": "",
        "OMP_NUM_THREADS": "1",
    }

    def now_s() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.perf_counter() if by_clock else used.ru_utime + used.ru_stime

    def run(code: str, arguments: str) -> tuple[float, int]:
        begun_s = now_s()
        words = [sys.executable, "-c", code, *arguments.split()]
        done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=folder, env=environment)
        return now_s() - begun_s, int(done.stderr.split()[-1])

    return run


def _row(command: str, runs: list[Run], repeats: int) -> str:
    floor = COUNTING + "\n".join(LIBRARIES[name] for name in COMMANDS[command])
    calls = [lambda run=run: run(PROGRAM, command) for run in runs]
    *found, bare = _in_turn([*calls, lambda: runs[0](floor, "")], repeats)
    used = [[each for each, _ in tree] for tree in found]
    medians = [statistics.median(each) for each in used]
    least_s, floor_s, modules = min(used[0]), statistics.median(each for each, _ in bare), found[0][0][1]
    row = f"| `{command}` | {medians[0]:.2f} | {least_s:.2f} | {floor_s:.2f} | {modules} |"
    return row + "".join(f" {other_s:.2f} | {medians[0] / other_s:.2f} |" for other_s in medians[1:])


if __name__ == "__main__":
    main()
