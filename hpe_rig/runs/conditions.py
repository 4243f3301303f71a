"""Conditions of the shots of a stored run: values, range over the run, and warnings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, Condition
from hpe_rig.result import ConditionSummary, condition_summary
from hpe_rig.store import StoredRun


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
