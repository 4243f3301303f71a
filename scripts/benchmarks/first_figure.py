"""Time from `git clone` to the first figure, and the commands that are typed for it, of two versions in turns.

Each round clones REPOSITORY, checks out the commit, makes a virtual environment, and types what the README of that
version says. Printed: seconds of every command and round; then the ratio of the sums and the numbers of commands.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BEFORE = ("hpe-rig run bovine-muscle", "hpe-rig report bovine-muscle.h5")
AFTER = ("hpe-rig run bovine-muscle --report",)
"""What each version needs typed after the installation; the page is then opened in a browser."""


def main() -> None:
    """Time both versions in turns and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("repository", help="what git can clone")
    parser.add_argument("before", help="commit of the version before")
    parser.add_argument("after", help="commit of the version after")
    parser.add_argument("rounds", nargs="?", type=int, default=2)
    given = parser.parse_args()
    taken: dict[str, list[float]] = {given.before: [], given.after: []}
    for _ in range(given.rounds):
        for commit, words in ((given.before, BEFORE), (given.after, AFTER)):
            taken[commit].append(timed(given.repository, commit, words))
    ratio = sum(taken[given.after]) / sum(taken[given.before])
    print(f"after over before: {ratio:.2f}; commands typed: {5 + len(BEFORE)} and {5 + len(AFTER)}")


def timed(repository: str, commit: str, words: tuple[str, ...]) -> float:
    """Return the seconds from the clone to the page, each command's told on the way."""
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder) / "hpe_rig"
        programs = there / ".venv" / ("Scripts" if os.name == "nt" else "bin")
        path = {**os.environ, "PATH": os.pathsep.join((str(programs), os.environ["PATH"]))}
        path.pop("PYTHONPATH", None)
        commands = [
            (f"git clone -q {repository} hpe_rig", folder),
            (f"git checkout -q {commit}", there),
            (f"{sys.executable} -m venv .venv", there),
            ("python -m pip install -q .", there),
            *((command, there) for command in words),
        ]
        begun_s = time.monotonic()
        each = []
        for command, where in commands:
            start_s = time.monotonic()
            subprocess.run(command, shell=True, cwd=where, env=path, check=True, stdout=subprocess.DEVNULL)
            each.append(f"{command.split()[0]} {command.split()[1]} {time.monotonic() - start_s:.1f} s")
        if not (there / "bovine-muscle.html").exists():
            raise FileNotFoundError("no page came of it")
        took_s = time.monotonic() - begun_s
        print(f"{commit}: {took_s:.1f} s ({', '.join(each)})", flush=True)
        return took_s


if __name__ == "__main__":
    main()
