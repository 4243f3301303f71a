"""Warnings of a result: plan, damage, clipped or untrusted shots, missing estimates; conditions of its shots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.bench import BenchFile, Condition
from hpe_rig.plan import CheckResult, Plan
from hpe_rig.result import ConditionSummary, condition_summary
from hpe_rig.scene import Scene, omitted_keys, unreadable
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
    if keys := omitted_keys(scene.simulation or {}) if stored.simulated else ():
        yield (
            f"these records are of an earlier twin with {' and '.join(keys)}, which was removed: predictions leave it "
            "out"
        )
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


def conditions_of_shot(stored: StoredRun, shot: int) -> dict[str, tuple[float, float]]:
    """Return the conditions before and after ``shot`` by name, NaN if not read."""
    return {name: (float(values[shot, 0]), float(values[shot, 1])) for name, values in stored.conditions.items()}


def condition_summaries(bench: BenchFile, stored: StoredRun) -> tuple[ConditionSummary, ...]:
    """Return the range of each condition over the complete shots of a run."""
    return tuple(
        condition_summary(item.name, item.unit, item.limits_text, stored.conditions[item.name][stored.shot_complete])
        for item in _stored_conditions(bench, stored)
    )


def condition_warnings(bench: BenchFile, stored: StoredRun) -> Iterator[str]:
    """Yield the conditions that were not read, and those that had left their limits after a shot."""
    for condition in _stored_conditions(bench, stored):
        values = stored.conditions[condition.name]
        unread = int(np.isnan(values[stored.shot_complete]).sum())
        if unread:
            yield f"{condition.name} was not read {unread} times; hpe-rig bench with the bench file shows the reason"
        outside = [
            shot for shot, after in enumerate(values[:, 1]) if np.isfinite(after) and not condition.accepts(after)
        ]
        if outside:
            value, more = condition.value_text(float(values[outside[0], 1])), len(outside) - 1
            where = f"shot {outside[0] + 1}" + (f" and outside its limits after {more} more" if more else "")
            yield f"{condition.name} was {value} after {where}, limits {condition.limits_text}"


def _stored_conditions(bench: BenchFile, stored: StoredRun) -> list[Condition]:
    return [condition for condition in bench.conditions if condition.name in stored.conditions]
