"""Badges of a page's first screen: the verdict of every check in a few words, linked to its section."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from hpe_rig.plan import CheckResult
from hpe_rig.report.residual_tests import ResidualTest
from hpe_rig.result import RepeatMean, Result
from hpe_rig.scene import plural

Verdict = Literal["passed", "noticed", "open"]
MARKS: dict[Verdict, str] = {"passed": "✓", "noticed": "!", "open": "–"}
"""Signs that distinguish the verdicts without colour."""


@dataclass(frozen=True, slots=True)
class Badge:
    """One verdict, its text, and the id of the page's section with the details."""

    verdict: Verdict
    text: str
    section: str

    @property
    def mark(self) -> str:
        """Sign of the verdict."""
        return MARKS[self.verdict]


def badges(
    result: Result, warnings: Sequence[str], check_results: Sequence[CheckResult], tests: Sequence[ResidualTest]
) -> Iterator[Badge]:
    """Yield the badges of a run: status, warnings, repeats, plan and residual tests."""
    yield Badge("passed" if result.status == "complete" else "noticed", f"run {result.status}", "measurement")
    if count := len({shot.index for shot in result.shots if shot.untrusted}):
        yield Badge("noticed", f"{plural(count, 'shot')} not to be trusted", "estimates")
    if warnings:
        yield Badge("noticed", plural(len(warnings), "warning"), "warnings")
    else:
        yield Badge("passed", "no warnings", "provenance")
    if result.means:
        yield _repeats_badge(result.means)
    # A measured plan has no refused check: any other level than passed is a warning.
    failed = sum(check.level != "passed" for check in check_results)
    checks = f"{len(check_results)} checks of the plan"
    yield Badge("noticed" if failed else "passed", f"{failed} of {checks} warn" if failed else checks, "checks")
    for test in tests:
        verdict: Verdict = "open" if test.verdict == "not possible" else test.verdict
        yield Badge(verdict, test.name, "residual-section")


def _repeats_badge(means: Sequence[RepeatMean]) -> Badge:
    disagreements = sum(not mean.agrees for mean in means)
    if not disagreements:
        return Badge("passed", "repeats agree", "means")
    return Badge("noticed", f"repeats scatter in {disagreements} of {len(means)} means", "means")
