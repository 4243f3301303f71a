"""Time the commands from `git clone` to the first report page, in a fresh folder and virtual environment."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    """Print the time of every command and their sum, alternating between versions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("repository", help="address or folder for `git clone`")
    parser.add_argument("commits", nargs="*", default=["HEAD"], help="versions to time")
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    for _ in range(options.rounds):
        for commit in options.commits:
            print_times(options.repository, commit)


def print_times(repository: str, commit: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "hpe_rig"
        # Activating the environment puts its programs first.
        programs = clone / ".venv" / ("Scripts" if os.name == "nt" else "bin")
        environment = {**os.environ, "PATH": os.pathsep.join((str(programs), os.environ["PATH"]))}
        environment.pop("PYTHONPATH", None)
        clone.mkdir()
        commands = (
            f"git clone -q {repository} .",
            f"git checkout -q {commit}",
            f"{sys.executable} -m venv .venv",
            "python -m pip install -q .",
            "hpe-rig run bovine-muscle --report",
        )
        times_s = {}
        for command in commands:
            start_s = time.monotonic()
            subprocess.run(command, shell=True, cwd=clone, env=environment, check=True, stdout=subprocess.DEVNULL)
            times_s[" ".join(command.split()[:2])] = time.monotonic() - start_s
        if not (clone / "bovine-muscle.html").exists():
            raise FileNotFoundError("the commands wrote no page")
    steps = ", ".join(f"{name} {time_s:.1f} s" for name, time_s in times_s.items())
    print(f"{commit}: {sum(times_s.values()):.1f} s ({steps})", flush=True)


if __name__ == "__main__":
    main()
