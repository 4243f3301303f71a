"""A power loss at any moment costs nothing that was announced as stored; `scripts/robustness/power_loss.py`.

By default `tests/hpe_rig/store/test_log.py` cuts and damages the log of a run.
"""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "robustness" / "power_loss.py"


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs cc and Linux's /proc")
@pytest.mark.slow
def test_no_state_of_the_disk_after_a_power_loss_lacks_a_stored_shot_or_is_wrong_silently(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(SCRIPT.parent)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "--states", "3000"])
    code = importlib.import_module("power_loss").main()
    output = capfd.readouterr()
    assert code == 0, output.out + output.err
    # Without states, or with a trace of nothing, the test would test nothing.
    states = [int(line.split()[1]) for line in output.out.splitlines() if " states, 0 broken" in line]
    assert sum(states) >= 3000
