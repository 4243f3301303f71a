"""Nothing is silently wrong: bits flipped, files cut or lost, disks that fail; `scripts/robustness/integrity.py` counts."""

from __future__ import annotations

import importlib
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "robustness" / "integrity.py"
Counts = dict[str, dict[str, int]]
LINUX = pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs cc and Linux's /proc")


def counts(*arguments: str) -> Counts:
    """Return what the script counted in a process of its own; fail where anything was silent, crashed or hung."""
    command = [sys.executable, str(SCRIPT), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SCRIPT.parents[1])
    assert done.returncode == 0, done.stdout + done.stderr
    return counted(done.stdout)


@pytest.fixture
def counts_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Counts]:
    """Return the same of what needs no process: a second less of processor time a start."""

    def run(*arguments: str) -> Counts:
        monkeypatch.syspath_prepend(SCRIPT.parent)
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
        code = importlib.import_module("integrity").main()
        said = capsys.readouterr()
        assert code == 0, said.out + said.err
        return counted(said.out)

    return run


def counted(text: str) -> Counts:
    """Return the counts that the script printed, by kind of file and outcome."""
    lines = re.findall(r"^\w+, (\w+): (.*)$", text, flags=re.MULTILINE)
    assert [kind for kind, _ in lines] == ["plain", "compressed"]
    return {
        kind: {what: int(count) for count, what in re.findall(r"(\d+) ([^;]+)(?:; |$)", line)} for kind, line in lines
    }


@pytest.mark.parametrize("cases", [10, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_flipped_bit_changes_a_result_without_a_message(cases: int, counts_here: Callable[..., Counts]) -> None:
    for found in counts_here("flips", "--cases", str(cases)).values():
        assert sum(count for what, count in found.items() if what != "found by verify") == cases
        # Most of a file are records: a bit flipped there must be noticed, or the test tests nothing.
        assert found["result without what is damaged, said so"] > cases / 4


@pytest.mark.parametrize("cases", [5, pytest.param(400, marks=pytest.mark.slow)])
def test_no_truncation_changes_a_result_without_a_message(cases: int, counts_here: Callable[..., Counts]) -> None:
    for found in counts_here("truncations", "--cases", str(cases)).values():
        assert sum(count for what, count in found.items() if what != "found by verify") == cases
        assert found["found by verify"] == cases


@LINUX
@pytest.mark.parametrize("every", [61, pytest.param(1, marks=pytest.mark.slow)])
def test_a_disk_that_fails_at_any_step_ends_in_a_message_and_a_file_that_holds_what_it_says(every: int) -> None:
    for found in counts("faults", "--every", str(every)).values():
        assert sum(found.values()) >= 4
        assert set(found) <= {"exit 2, message, file readable", "exit 2, message, no file", "no step failed"}
        assert found.get("no step failed", 0) <= 4


@pytest.mark.skipif(sys.platform == "win32", reason="an open file is neither moved nor removed there")
def test_a_file_lost_under_its_run_ends_the_run_with_a_message(counts_here: Callable[..., Counts]) -> None:
    for found in counts_here("lost").values():
        assert sum(found.values()) == 14
        assert all("noticed" in what for what in found)
