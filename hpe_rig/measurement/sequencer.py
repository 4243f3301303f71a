"""Sequence of a shot: configure, verify, arm, enable, fire, collect, recheck, off. It yields records, stores none."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

from drivers.interfaces import DeadlineError, InstrumentError, RecordBlock, Setting
from hpe_rig.bench import Bench, Condition, read_conditions
from hpe_rig.measurement.between_shots import Mover, choose_mover, wait_for_conditions
from hpe_rig.plan import SAFETY_MARGIN_S, Plan, Shot

_LOG = logging.getLogger("hpe_rig")
MAX_SLEEP_S = 0.2
RECHECK_INTERVAL_S = 1.0
"""Interval between checks of outputs and settings during a long shot."""


class Step(StrEnum):
    """Step that the sequencer begins."""

    MOVE = "move tracking transducer"
    CONDITIONS = "read conditions"
    CONFIGURE = "configure"
    VERIFY = "verify"
    ARM = "arm"
    ENABLE = "enable outputs"
    WAIT = "wait"
    FIRE = "fire"
    COLLECT = "collect"
    SAFE = "outputs off"


DRIVING_STEPS = frozenset({Step.WAIT, Step.FIRE, Step.COLLECT})
"""Steps with outputs on: nothing may wait in them, neither for a disk nor for a terminal."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Step of the sequencer; ``records`` of the shot's planned records have arrived."""

    step: Step
    shot: Shot
    records: int = 0


@dataclass(frozen=True, slots=True)
class ShotReady:
    """A shot is programmed and verified; ``settings``: read back from every instrument, by role."""

    shot: Shot
    settings: Mapping[str, Mapping[str, Setting]]


@dataclass(frozen=True, slots=True)
class ShotBlock:
    """Records of one shot that have just arrived."""

    shot: Shot
    block: RecordBlock


@dataclass(frozen=True, slots=True)
class ShotRows:
    """Values of a shot for its run file, by name: conditions, and settings that changed."""

    shot: Shot
    rows: Mapping[str, str | tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class ShotDone:
    """A shot has ended with all outputs off; ``clipped``: whether the digitizer's input left its range."""

    shot: Shot
    clipped: bool


Event = ShotReady | ShotBlock | ShotRows | ShotDone
Observer = Callable[[Progress], None]


def ignore_progress(progress: Progress) -> None:
    """Do nothing."""


def acquire(
    plan: Plan,
    bench: Bench,
    observer: Observer = ignore_progress,
    move: Mover | None = None,
    conditions: Sequence[Condition] = (),
) -> Generator[Event, None, None]:
    """Yield the events of every shot of ``plan``; every output is off after each shot and after any exception.

    If records stop before the deadline, those that arrived are yielded; ``DeadlineError`` is raised if none did.
    Outputs and settings are read back before the first and after the last record. If one has changed, the shot yields
    ``ShotRows`` and, unless the plan accepts changes, ends with ``InstrumentError``.
    In ``DRIVING_STEPS`` neither ``observer`` nor the reader of the events may wait: outputs are on.
    The tracking transducer is moved to the lateral offset of a shot before anything is programmed. Then ``conditions``
    are read, and a shot waits until they are within their limits. They are read again after the shot, as are all
    settings.
    """
    observer = _with_step_logging(observer)
    next_start_s = bench.clock.now_s()
    mover, lateral_offset_m = move or choose_mover(plan, bench, None), None
    for shot in plan.shots:
        if shot.lateral_offset_m != lateral_offset_m:
            observer(Progress(Step.MOVE, shot))
            mover(shot.lateral_offset_m)
            lateral_offset_m = shot.lateral_offset_m
        watch = partial(observer, Progress(Step.CONDITIONS, shot))
        before = wait_for_conditions(conditions, shot.index + 1, watch)
        try:
            settings = _configure(shot, bench, observer)
            yield ShotReady(shot, settings)
            _enable(shot, bench, observer)
            _wait_until(next_start_s, shot, bench, observer)
            observer(Progress(Step.FIRE, shot))
            next_start_s = bench.clock.now_s() + plan.shot_period_s
            bench.master.fire()
            changes = yield from _collect(shot, bench, observer)
        finally:
            bench.make_safe()
        observer(Progress(Step.SAFE, shot, shot.capture.record_count))
        if differences := bench.changed_since(settings):
            yield ShotRows(shot, {"changed_settings": "; ".join(differences)})
        if changes:
            yield ShotRows(shot, {"untrusted": changes})
            if plan.stops_on_changed_settings:
                what = f"shot {shot.index + 1} is not to be trusted: {changes}"
                cause = "its records are stored and marked as untrusted"
                remedy = (
                    'hpe-rig resume, which measures it again; acquisition.changed_settings = "continue" accepts changes'
                )
                raise InstrumentError("bench", what, cause, remedy)
        yield ShotDone(shot, bench.digitizer.clipped())
        # Last, so that an interrupt while a command is awaited leaves the shot complete.
        if conditions:
            after = tuple(reading.value for reading in read_conditions(conditions))
            yield ShotRows(shot, {"conditions/before": before, "conditions/after": after})


def _with_step_logging(observer: Observer) -> Observer:
    """Wrap ``observer`` so that each step is logged; arrivals of records are not."""

    def observe(progress: Progress) -> None:
        if not progress.records:
            _LOG.info("shot %d: %s", progress.shot.index + 1, progress.step.value)
        observer(progress)

    return observe


def program_shot(shot: Shot, bench: Bench) -> Mapping[str, Mapping[str, Setting]]:
    """Program ``shot`` without enabling an output; return the settings read back, by role."""
    return _configure(shot, bench, ignore_progress)


def _configure(shot: Shot, bench: Bench, observer: Observer) -> Mapping[str, Mapping[str, Setting]]:
    observer(Progress(Step.CONFIGURE, shot))
    bench.master.configure(shot.master)
    if bench.burst_train is not None and shot.burst_train is not None:
        bench.burst_train.configure(shot.burst_train)
    if bench.toneburst is not None and shot.toneburst is not None:
        bench.toneburst.configure(shot.toneburst)
    bench.tracking_train.configure(shot.tracking_train)
    bench.tracking_pulser.configure(shot.tracking_pulser)
    bench.digitizer.configure(shot.capture)
    observer(Progress(Step.VERIFY, shot))
    return bench.verify()


def _enable(shot: Shot, bench: Bench, observer: Observer) -> None:
    observer(Progress(Step.ARM, shot))
    bench.digitizer.arm()
    observer(Progress(Step.ENABLE, shot))
    # Downstream first: no generator may trigger an output that is not ready.
    for generator in reversed(bench.generators):
        if not (shot.is_control and generator is bench.toneburst):
            generator.enable_output()


def _wait_until(start_s: float, shot: Shot, bench: Bench, observer: Observer) -> None:
    """Sleep until ``start_s``; the observer is called every ``MAX_SLEEP_S``, so that it can end the run."""
    wait_s = start_s - bench.clock.now_s()
    for _ in range(math.floor(wait_s / MAX_SLEEP_S)):
        observer(Progress(Step.WAIT, shot))
        bench.clock.sleep(MAX_SLEEP_S)
    bench.clock.sleep(max(0.0, start_s - bench.clock.now_s()))


def _collect(shot: Shot, bench: Bench, observer: Observer) -> Generator[ShotBlock, None, str]:
    """Yield the records that arrive; return a description of changed outputs and settings, "" without changes.

    Raises ``DeadlineError`` if no record arrived and no change explains that.
    """
    checked_s = bench.clock.now_s()
    # The margin covers the transfer of the last records.
    deadline_s = checked_s + shot.train_end_s + SAFETY_MARGIN_S
    record_count = 0
    observer(Progress(Step.COLLECT, shot))
    try:
        for block in bench.digitizer.records(deadline_s):
            record_count += block.codes.shape[0]
            yield ShotBlock(shot, block)
            observer(Progress(Step.COLLECT, shot, record_count))
            if bench.clock.now_s() - checked_s >= RECHECK_INTERVAL_S:
                if changes := bench.recheck():
                    return " ".join(changes)
                checked_s = bench.clock.now_s()
    except DeadlineError:
        changes = bench.recheck()
        if not record_count and not changes:
            raise
        return " ".join(changes)
    return " ".join(bench.recheck())
