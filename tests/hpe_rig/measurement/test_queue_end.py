"""Predicted end of a queue: from the plans where only short runs are done."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hpe_rig.measurement import QueueRun, time_left_s


def queue(first_planned_s: float, first_took_s: float) -> list[QueueRun]:
    waiting = QueueRun("long", "", None, "long.h5", planned_s=600.0)
    done = replace(waiting, state="done", planned_s=first_planned_s, took_s=first_took_s)
    return [done, waiting, waiting]


def test_a_short_first_run_adds_its_overhead_to_each_run_and_does_not_scale_them() -> None:
    # 1 s by the plan, and 11 s for opening, programming and computing: a scale would give 12 times 20 minutes.
    assert time_left_s(queue(1.0, 12.0), 1) == pytest.approx(2 * (600 + 11))


def test_a_long_first_run_sets_the_pace() -> None:
    assert time_left_s(queue(600.0, 720.0), 1) == pytest.approx(2 * 720)
