"""Warnings of a result: findings of the plan, damage, clipped or untrusted shots, missing estimates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from hpe_rig.plan import CheckResult, Plan
from hpe_rig.scene import Scene, unreadable
from hpe_rig.store import StoredRun, sha256_of_scan

if TYPE_CHECKING:
    from hpe_rig.processing import Estimates


def run_warnings(
    scene: Scene, plan: Plan, findings: Iterable[CheckResult], stored: StoredRun, estimates: Estimates
) -> Iterator[str]:
    """Yield the warnings that concern the whole run."""
    yield from (str(finding) for finding in findings if finding.level != "passed")
    yield from map(str, stored.damage)
    yield from _scan_warnings(scene, stored)
    # The board reports that a record was clipped, not which one. If disturbed records are skipped, the codes in the
    # gate decide.
    for shot in stored.clipped if scene.tracking.disturbed != "skip" else ():
        yield (
            f"shot {shot + 1}: the digitizer's input left its range of {plan.shots[shot].capture.input_range_v:g} V, "
            "in the gate or outside it: raise acquisition.input_range_v"
        )
    for shot, why in stored.untrusted.items():
        yield f"shot {shot + 1} is not to be trusted: {why}"
    for shot, changes in stored.changed_settings.items():
        # The reason of an untrusted shot names its changed settings.
        if shot not in stored.untrusted:
            yield f"shot {shot + 1}: settings read back after it differ: {changes}"
    if stored.status != "complete":
        complete = stored.shot_complete
        ended = {"failed": "failed", "killed": "was killed"}.get(stored.status, f"is {stored.status}")
        text = f"the run {ended}: {int(complete.sum())} of {complete.size} shots are complete"
        if stored.status == "killed" and not stored.simulated:
            text += "; its program did not switch the outputs off: hpe-rig bench BENCH --off does"
        yield text
    yield from incomplete_warnings(estimates)


def _scan_warnings(scene: Scene, stored: StoredRun) -> Iterator[str]:
    """Yield a warning if the file `beams.excitation_scan` has changed since the run was measured."""
    if not stored.scan_sha256:
        return
    try:
        unchanged = stored.scan_sha256 == sha256_of_scan(scene)
    except OSError as error:
        # Without tonebursts the file has not been read before.
        yield (
            f"beams.excitation_scan: the file cannot be read ({unreadable(error)}), so it is unknown whether it has "
            "changed since the run was measured; restore its path, or put it beside the run file"
        )
        return
    if not unchanged:
        yield (
            "beams.excitation_scan: the file has changed since the run was measured; corrections and fits use its "
            "present content"
        )


def incomplete_warnings(estimates: Estimates) -> Iterator[str]:
    """Yield the shots without a result, with the reason, and the shots estimated from part of their records."""
    for why in dict.fromkeys(estimates.failures.values()):
        yield f"{_shots([shot for shot, reason in estimates.failures.items() if reason == why])} left out: {why}"
    if partial := dict.fromkeys(shot.index for shot in estimates.shots if not shot.complete):
        is_or_are = "is" if len(partial) == 1 else "are"
        yield f"{_shots(partial)} {is_or_are} incomplete, estimated from the records that had arrived"


def _shots(shots: Iterable[int]) -> str:
    """Return the numbers of ``shots``, counted from 1: "shot 1", "shots 2 to 5" or "shots 1, 3"."""
    numbers = [shot + 1 for shot in shots]
    is_range = len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1
    text = f"{numbers[0]} to {numbers[-1]}" if is_range else ", ".join(map(str, numbers))
    return f"shot{'s' * (len(numbers) > 1)} {text}"
