"""A power loss at any moment costs nothing that was announced as stored; `scripts/robustness/power_loss.py`."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "robustness" / "power_loss.py"


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs cc and Linux's /proc")
@pytest.mark.parametrize(
    "arguments",
    [
        ("--states", "3", "--scenarios", "plain"),
        pytest.param(("--states", "3000"), marks=pytest.mark.slow),
    ],
    ids=["few", "all"],
)
def test_no_state_of_the_disk_after_a_power_loss_lacks_a_stored_shot_or_is_wrong_silently(
    arguments: tuple[str, ...],
) -> None:
    command = [sys.executable, str(SCRIPT), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SCRIPT.parents[1])
    assert done.returncode == 0, done.stdout + done.stderr
    # Without states, or with a trace of nothing, the test would test nothing.
    states = [int(line.split()[1]) for line in done.stdout.splitlines() if " states, 0 broken" in line]
    assert sum(states) >= int(arguments[1])
