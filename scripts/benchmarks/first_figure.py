"""Time the steps from `git clone` to the first report page for two versions, alternately.

Each round clones the repository, checks out the version, makes a virtual environment, installs and measures.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMANDS_BEFORE = ("hpe-rig run bovine-muscle", "hpe-rig report bovine-muscle.h5")
COMMANDS_AFTER = ("hpe-rig run bovine-muscle --report",)
"""Commands typed after the installation in versions without and with the option `--report`."""
INSTALLATION_COMMANDS = 5
"""Clone, enter the folder, make the environment, activate it, install."""


def main() -> None:
    """Time both versions alternately and print the ratio of the sums and the numbers of commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("repository", help="address or folder for `git clone`")
    parser.add_argument("before", help="commit without the option --report")
    parser.add_argument("after", help="commit with it")
    parser.add_argument("rounds", nargs="?", type=int, default=2)
    options = parser.parse_args()
    before_s = after_s = 0.0
    for _ in range(options.rounds):
        before_s += time_to_page_s(options.repository, options.before, COMMANDS_BEFORE)
        after_s += time_to_page_s(options.repository, options.after, COMMANDS_AFTER)
    counts = [INSTALLATION_COMMANDS + len(commands) for commands in (COMMANDS_BEFORE, COMMANDS_AFTER)]
    print(f"after over before: {after_s / before_s:.2f}; commands typed: {counts[0]} and {counts[1]}")


def time_to_page_s(repository: str, commit: str, measurement_commands: tuple[str, ...]) -> float:
    """Return the seconds from the clone to the page, and print the seconds of every command."""
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "hpe_rig"
        programs = clone / ".venv" / ("Scripts" if os.name == "nt" else "bin")
        environment = {**os.environ, "PATH": os.pathsep.join((str(programs), os.environ["PATH"]))}
        environment.pop("PYTHONPATH", None)
        commands = [
            (f"git clone -q {repository} hpe_rig", folder),
            (f"git checkout -q {commit}", clone),
            (f"{sys.executable} -m venv .venv", clone),
            ("python -m pip install -q .", clone),
            *((command, clone) for command in measurement_commands),
        ]
        steps, total_s = [], 0.0
        for command, working_folder in commands:
            start_s = time.monotonic()
            subprocess.run(
                command, shell=True, cwd=working_folder, env=environment, check=True, stdout=subprocess.DEVNULL
            )
            step_s = time.monotonic() - start_s
            total_s += step_s
            steps.append(f"{' '.join(command.split()[:2])} {step_s:.1f} s")
        if not (clone / "bovine-muscle.html").exists():
            raise FileNotFoundError("the commands wrote no page")
        print(f"{commit}: {total_s:.1f} s ({', '.join(steps)})", flush=True)
        return total_s


if __name__ == "__main__":
    main()
