"""Try the lowest versions that pyproject.toml states: main job, report, bench, and the tests of drivers and store.

    python scripts/robustness/lowest_versions.py [--python python3.11] [--tests tests/drivers tests/hpe_rig/store]

Installs every dependency, and those of the extras below, at its lowest stated version into a fresh environment, then
runs each step there and prints a table. Ends with 1 if a step fails. Run it before each release and after each change
of the dependencies.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
EXTRAS = ("test", "live", "frames", "compression")
TOOLS = frozenset({"import-linter", "mypy", "ruff", "scipy-stubs"})
"""Packages of the extra ``test`` that check the source and do not run it: their newest version is installed."""


def lowest_versions(project: dict[str, object], extras: tuple[str, ...] = EXTRAS) -> list[str]:
    """Return a constraint ``name==version`` for each requirement of ``project``, the table of pyproject.toml."""
    optional = project["optional-dependencies"]
    lines = [*project["dependencies"], *(line for extra in extras for line in optional[extra])]  # type: ignore[index,misc]
    requirements = [Requirement(line) for line in lines]
    return sorted(
        {
            f"{requirement.name}=={specifier.version}"
            for requirement in requirements
            for specifier in requirement.specifier
            if specifier.operator == ">=" and requirement.name not in TOOLS
        }
    )


def main() -> int:
    """Install the lowest versions, run every step, print the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--python", default=sys.executable, help="Interpreter of the environment.")
    parser.add_argument("--tests", nargs="*", default=["tests/drivers", "tests/hpe_rig/store"])
    options = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        constraints = folder / "constraints.txt"
        constraints.write_text("\n".join(lowest_versions(project)) + "\n", encoding="utf-8")
        subprocess.run([options.python, "-m", "venv", folder / "venv"], check=True)
        python = str(folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python")
        target = f"{ROOT}[{','.join(EXTRAS)}]"
        install = [python, "-m", "pip", "install", "-q", "-e", target, "-c", str(constraints)]
        program = [python, "-m", "hpe_rig"]
        steps = {
            "install": install,
            "measure": [*program, "run", "bovine-muscle", "--output", "run.h5"],
            "process": [*program, "process", "run.h5"],
            "report": [*program, "report", "run.h5"],
            "bench": [*program, "bench"],
            "help": [*program, "run", "--help"],
            # An old library may warn of a new one below it: that is no failure here.
            "tests": [python, "-m", "pytest", "-q", "-W", "default", "-p", "no:cacheprovider", *options.tests],
        }
        return _run_steps(steps, folder)


def _run_steps(steps: dict[str, list[str]], folder: Path) -> int:
    """Run each of ``steps`` in ``folder``, print its outcome, and return 1 after the first failure."""
    for step, command in steps.items():
        cwd = ROOT if step == "tests" else folder
        process = subprocess.run(command, cwd=cwd, text=True, capture_output=True, check=False)
        print(f"{step:10}{'ok' if process.returncode == 0 else f'exit code {process.returncode}'}", flush=True)
        if process.returncode:
            print((process.stdout + process.stderr)[-4000:])
            return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
