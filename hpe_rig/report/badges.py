"""Badges of a report's first screen: the verdict of every check in a few words, with the place that says more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from hpe_rig.plan import CheckResult
from hpe_rig.report.residual_tests import ResidualTest
from hpe_rig.result import RepeatMean, Result

Verdict = Literal["passed", "noticed", "open"]
MARKS: dict[Verdict, str] = {"passed": "✓", "noticed": "!", "open": "–"}
"""Signs that tell the verdicts apart without colour."""


@dataclass(frozen=True, slots=True)
class Badge:
    """One verdict: what is said, and the part of the page that says why."""

    verdict: Verdict
    text: str
    part: str

    @property
    def mark(self) -> str:
        """Sign of the verdict."""
        return MARKS[self.verdict]


def badges(
    result: Result, warnings: Sequence[str], findings: Sequence[CheckResult], tests: Sequence[ResidualTest]
) -> list[Badge]:
    """Return the badges of a run: its state, warnings, repeats, plan and the tests of what the fit leaves."""
    return list(_badges(result, warnings, findings, tests))


def _badges(
    result: Result, warnings: Sequence[str], findings: Sequence[CheckResult], tests: Sequence[ResidualTest]
) -> Iterator[Badge]:
    yield Badge("passed" if result.status == "complete" else "noticed", f"run {result.status}", "what")
    if count := len({shot.shot for shot in result.shots if shot.untrusted}):
        yield Badge("noticed", f"{_number(count, 'shot')} not to be trusted", "harm")
    yield (
        Badge("noticed", _number(len(warnings), "warning"), "w") if warnings else Badge("passed", "no warnings", "prov")
    )
    if result.means:
        yield _repeats(result.means)
    wrong = sum(finding.level != "passed" for finding in findings)
    told = f"{wrong} of {len(findings)} checks of the plan warn" if wrong else f"{len(findings)} checks of the plan"
    yield Badge("noticed" if wrong else "passed", told, "plan")
    for test in tests:
        verdict: Verdict = "open" if test.verdict == "not possible" else test.verdict
        yield Badge(verdict, test.name, "left")


def _repeats(means: Sequence[RepeatMean]) -> Badge:
    scatter = sum(not mean.agrees for mean in means)
    if not scatter:
        return Badge("passed", "repeats agree", "means")
    return Badge("noticed", f"repeats scatter in {scatter} of {len(means)} means", "means")


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
