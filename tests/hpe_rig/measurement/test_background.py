"""Threads of storage and observers: order, failures, limits, and what the measuring thread never waits for."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import RecordBlock
from hpe_rig.measurement import Progress, Step, StopRequested, record_run, recording
from hpe_rig.measurement.background import BackgroundTasks, detached
from hpe_rig.measurement.recording import RunRecorder
from hpe_rig.measurement.sequencer import ShotBlock, ShotDone
from hpe_rig.measurement.setup import prepare
from hpe_rig.plan import Shot
from hpe_rig.result import Stages
from hpe_rig.store import StoreError


@pytest.fixture(scope="module")
def shot() -> Shot:
    return prepare("table-1").plan.shots[0]


def test_tasks_run_in_order_and_the_first_failure_is_raised_once_and_discards_the_others() -> None:
    tasks, done = BackgroundTasks("test"), list[int]()

    def task(number: int) -> None:
        if number in (3, 5):
            raise ZeroDivisionError(number)
        done.append(number)

    for number in range(3):
        tasks.submit(lambda number=number: task(number), 10)
    tasks.drain()
    assert (done, tasks.unfinished, tasks.backlog_bytes) == ([0, 1, 2], 0, 0)
    gate = threading.Event()
    tasks.submit(lambda: gate.wait(20) and None)
    for number in range(3, 6):
        tasks.submit(lambda number=number: task(number), 10)
    assert tasks.backlog_bytes == 30
    assert not tasks.wait(0.0)
    gate.set()
    with pytest.raises(ZeroDivisionError, match="3"):
        tasks.drain()
    tasks.check()
    assert done == [0, 1, 2]


def test_an_observer_that_hangs_is_not_waited_for_while_outputs_are_on_and_gets_the_newest_progress(shot: Shot) -> None:
    answers, calls = threading.Event(), list[tuple[Step, int, bool]]()

    def observe(progress: Progress) -> None:
        calls.append((progress.step, progress.records, threading.current_thread() is threading.main_thread()))
        if progress.step is Step.FIRE:
            answers.wait(20)

    with detached(observe) as detached_observe:
        detached_observe(Progress(Step.ENABLE, shot))
        detached_observe(Progress(Step.FIRE, shot))
        for records in range(100):
            detached_observe(Progress(Step.COLLECT, shot, records))
        answers.set()
        detached_observe(Progress(Step.SAFE, shot, 100))
    # What comes while the observer hangs is left out, but no step is.
    expected = [(Step.ENABLE, 0, True), (Step.FIRE, 0, False), (Step.COLLECT, 0, False), (Step.SAFE, 100, True)]
    assert calls == expected


def test_a_stop_that_an_observer_raises_in_its_thread_ends_the_shot_at_the_next_step(shot: Shot) -> None:
    raised = threading.Event()

    def observe(progress: Progress) -> None:
        if progress.step is Step.FIRE:
            raised.set()
            raise StopRequested

    def shot_steps() -> None:
        with detached(observe) as detached_observe:
            detached_observe(Progress(Step.FIRE, shot))
            raised.wait(20)
            for _ in range(10_000):
                detached_observe(Progress(Step.COLLECT, shot))

    with pytest.raises(StopRequested):
        shot_steps()


class Disk:
    """A writer whose disk takes nothing before ``answers`` is set."""

    def __init__(self) -> None:
        self.answers, self.blocks, self.calls = threading.Event(), list[RecordBlock](), list[str]()

    def append(self, shot: Shot, block: RecordBlock) -> None:
        assert self.answers.wait(20)
        self.blocks.append(block)

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: self.calls.append(f"{name} after {len(self.blocks)} blocks")


class RealBench:
    simulated, world = False, None


def blocks_of(shot: Shot, count: int, has_monitor: bool = False) -> list[ShotBlock]:
    block = RecordBlock(0, np.zeros((2, 500), np.int16), np.zeros(2), 1.0, 0.0, (-128, 127))
    block = replace(block, monitor=block if has_monitor else None)
    return [ShotBlock(shot, replace(block, first_record=2 * number)) for number in range(count)]


def test_records_are_written_in_order_while_the_measurement_goes_on_and_before_the_shot_is_marked(
    shot: Shot, tmp_path: Path
) -> None:
    disk, bench = Disk(), RealBench()
    scene = prepare("table-1").scene.scene
    create: Any = lambda cancelled: disk  # noqa: E731
    with RunRecorder(tmp_path / "run.h5", create, defer=False) as recorder:
        for event in blocks_of(shot, 50):
            recorder.write(event, scene, bench, Stages())  # type: ignore[arg-type]
            recorder.check_file_present(wait=False)
        assert not disk.blocks
        disk.answers.set()
        recorder.write(ShotDone(shot, False), scene, bench, Stages())  # type: ignore[arg-type]
        recorder.check_file_present(wait=True)
    assert [block.first_record for block in disk.blocks] == list(range(0, 100, 2))
    assert "finish after 50 blocks" in disk.calls
    assert disk.calls.count("check_file after 50 blocks") == 1


@pytest.mark.parametrize(("has_monitor", "blocks"), [(False, 6), (True, 3)])
def test_a_disk_that_falls_behind_by_more_than_memory_may_hold_ends_the_shot_with_a_remedy(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_monitor: bool, blocks: int
) -> None:
    monkeypatch.setattr(recording, "MAX_BACKLOG_BYTES", 10_000)
    disk, bench, scene = Disk(), RealBench(), prepare("table-1").scene.scene
    create: Any = lambda cancelled: disk  # noqa: E731
    written = 0

    def record() -> None:
        nonlocal written
        with RunRecorder(tmp_path / "run.h5", create, defer=False) as recorder:
            try:
                for event in blocks_of(shot, 50, has_monitor):
                    recorder.write(event, scene, bench, Stages())  # type: ignore[arg-type]
                    written += 1
            finally:
                disk.answers.set()

    with pytest.raises(StoreError, match=r"fallen behind by 0\.012 MB .* 0\.01 MB that are kept in memory\. Try:"):
        record()
    # What had arrived is written all the same.
    assert written == blocks - 1
    assert len(disk.blocks) == blocks


def test_a_run_leaves_no_thread_behind(tmp_path: Path) -> None:
    before = set(threading.enumerate())
    record_run(prepare("table-1"), tmp_path / "run.h5")
    for thread in set(threading.enumerate()) - before:
        # A thread that nobody ends would be alive after any time.
        thread.join(5.0)
    assert set(threading.enumerate()) <= before
