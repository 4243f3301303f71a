"""Result of one check of a plan, and the error that refuses the plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from hpe_rig.scene import engineering

Level = Literal["passed", "warning", "refused"]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of one check; ``remedy`` is empty if it passed."""

    check: str
    level: Level
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        end = "" if self.remedy.endswith("?") else "."
        return f"{self.check}: {self.text}" + (f". Try: {self.remedy}{end}" if self.remedy else "")


class PlanError(Exception):
    """A plan that must not run; ``conflicts`` holds the result of every check that refused it."""

    def __init__(self, conflicts: Sequence[CheckResult]) -> None:
        lines = "\n".join(f"  {conflict}" for conflict in conflicts)
        super().__init__(f"the plan has {len(conflicts)} conflict{'s' if len(conflicts) != 1 else ''}\n{lines}")
        self.conflicts = tuple(conflicts)

    def __reduce__(self) -> tuple[type[PlanError], tuple[tuple[CheckResult, ...]]]:
        """Return the arguments that rebuild a worker's error in the main process."""
        return PlanError, (self.conflicts,)


def refuse_conflicts(results: Sequence[CheckResult]) -> None:
    """Raise ``PlanError`` with all conflicts among ``results``, if there are any."""
    refused = [result for result in results if result.level == "refused"]
    if refused:
        raise PlanError(refused)


def pass_or_refuse(check: str, good: bool, text: str, remedy: str) -> CheckResult:
    """Return that ``check`` passed if ``good``, otherwise that it refuses the plan."""
    return CheckResult(check, "passed", text) if good else CheckResult(check, "refused", text, remedy)


def in_hz(rate_hz: float) -> str:
    """Return a rate as messages write it."""
    return engineering(rate_hz, "Hz")


def in_us(time_s: float) -> str:
    """Return a time as messages write it."""
    return f"{time_s * 1e6:.4g} us" if abs(time_s) < 0.1 else engineering(time_s, "s")


def is_whole(number: float) -> bool:
    """Return whether ``number`` is whole up to rounding."""
    return abs(number - round(number)) < 1e-6 * max(1.0, abs(number))
