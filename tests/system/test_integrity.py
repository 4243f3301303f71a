"""Damage to a run file or its disk never changes a result silently; `scripts/robustness/integrity.py` counts cases.

By default `tests/hpe_rig/store/test_verification.py` flips bits and cuts files, and `test_run.py` removes one.
"""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "robustness" / "integrity.py"
Counts = dict[str, dict[str, int]]
KINDS = ("plain", "compressed")
"""Kinds of run files that the script damages, in its order."""
DETECTED = "detected by verify"
LINUX = pytest.mark.skipif(sys.platform != "linux" or shutil.which("cc") is None, reason="needs cc and Linux's /proc")


@pytest.fixture
def counts_of(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Counts]:
    """Return a function that runs the script in this process, which saves a second of start-up."""

    def run(*arguments: str) -> Counts:
        monkeypatch.syspath_prepend(SCRIPT.parent)
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *arguments])
        code = importlib.import_module("integrity").main()
        output = capfd.readouterr()
        assert code == 0, output.out + output.err
        return parse_counts(output.out, KINDS[:1] if "plain" in arguments else KINDS)

    return run


def parse_counts(text: str, kinds: Sequence[str]) -> Counts:
    """Return the counts that the script printed, by kind of file and outcome."""
    lines = re.findall(r"^\w+, (\w+): (.*)$", text, flags=re.MULTILINE)
    assert [kind for kind, _ in lines] == list(kinds)
    return {
        kind: {outcome: int(count) for count, outcome in re.findall(r"(\d+) ([^;]+)(?:; |$)", line)}
        for kind, line in lines
    }


@pytest.mark.slow
def test_no_flipped_bit_changes_a_result_without_a_message(counts_of: Callable[..., Counts]) -> None:
    cases = 1000
    for counts in counts_of("flips", "--cases", str(cases)).values():
        assert sum(count for outcome, count in counts.items() if outcome != DETECTED) == cases
        # Most of a file are records. If no flipped bit in them were reported, the test would test nothing.
        assert counts["result without the damaged records, with a message"] > cases / 4


@pytest.mark.slow
def test_no_truncation_changes_a_result_without_a_message(counts_of: Callable[..., Counts]) -> None:
    cases = 400
    for counts in counts_of("truncations", "--cases", str(cases)).values():
        assert sum(count for outcome, count in counts.items() if outcome != DETECTED) == cases
        assert counts[DETECTED] == cases


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize(
    "arguments",
    [("--every", "1")],
)
def test_a_disk_that_fails_at_any_operation_ends_in_a_message_and_an_intact_file(
    arguments: tuple[str, ...], counts_of: Callable[..., Counts]
) -> None:
    for counts in counts_of("faults", *arguments).values():
        assert sum(counts.values()) >= 4
        assert set(counts) <= {"exit 2, message, file readable", "exit 2, message, no file", "no step failed"}
        assert counts.get("no step failed", 0) <= 4


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows neither moves nor removes an open file")
def test_a_file_lost_under_its_run_ends_the_run_with_a_message(counts_of: Callable[..., Counts]) -> None:
    for counts in counts_of("lost").values():
        assert sum(counts.values()) == 2 * 7
        assert all("noticed" in outcome for outcome in counts)
