"""What a check of a plan finds, and the error that refuses the plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["passed", "warning", "refused"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found; ``remedy`` is empty where it passed."""

    check: str
    level: Level
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.check}: {self.text}" + (f". Try: {self.remedy}." if self.remedy else "")


class PlanError(Exception):
    """A plan that must not run; ``findings`` holds every conflict."""

    def __init__(self, findings: Sequence[Finding]) -> None:
        lines = "\n".join(f"  {finding}" for finding in findings)
        super().__init__(f"the plan has {len(findings)} conflict{'s' if len(findings) != 1 else ''}\n{lines}")
        self.findings = tuple(findings)


def refuse_conflicts(found: Sequence[Finding]) -> None:
    """Raise ``PlanError`` with all conflicts, if there are any."""
    refused = [finding for finding in found if finding.level == "refused"]
    if refused:
        raise PlanError(refused)


def judged(check: str, good: bool, text: str, remedy: str) -> Finding:
    """Return that ``check`` passed where ``good``, else that it refuses the plan."""
    return Finding(check, "passed", text) if good else Finding(check, "refused", text, remedy)
