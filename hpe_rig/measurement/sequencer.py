"""Sequence of a shot: configure, verify, arm, enable, fire, collect, recheck, off; yields records, stores nothing."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from drivers.interfaces import DeadlineError, InstrumentError, RecordBlock, Setting
from hpe_rig.bench import Bench
from hpe_rig.measurement.mover import Mover, mover_of
from hpe_rig.plan import SAFETY_MARGIN_S, Plan, Shot

_LOG = logging.getLogger("hpe_rig")
LONGEST_SLEEP_S = 0.2
WATCH_S = 1.0
"""How often a long shot looks whether outputs and settings are still as verified."""


class Step(StrEnum):
    """What the sequencer is about to do."""

    MOVE = "move tracking transducer"
    CONFIGURE = "configure"
    VERIFY = "verify"
    ARM = "arm"
    ENABLE = "enable outputs"
    WAIT = "wait"
    FIRE = "fire"
    COLLECT = "collect"
    SAFE = "outputs off"


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the sequencer stands: ``records`` of the shot's planned records have arrived."""

    step: Step
    shot: Shot
    records: int = 0


@dataclass(frozen=True, slots=True)
class ShotReady:
    """A shot is programmed and verified; ``settings`` are those of every instrument, read back, by role."""

    shot: Shot
    settings: Mapping[str, Mapping[str, Setting]]


@dataclass(frozen=True, slots=True)
class ShotBlock:
    """Records of one shot, as they arrive."""

    shot: Shot
    block: RecordBlock


@dataclass(frozen=True, slots=True)
class ShotUntrusted:
    """A shot has ended, and ``why`` its records are not to be trusted; every output is off."""

    shot: Shot
    why: str


@dataclass(frozen=True, slots=True)
class ShotDone:
    """A shot has ended and every output is off; ``clipped`` says whether the digitizer's input left its range."""

    shot: Shot
    clipped: bool


class UntrustedShotError(InstrumentError):
    """A shot during which settings changed, and with which a run ends unless the scene says otherwise."""

    def __init__(self, shot: Shot, why: str) -> None:
        remedy = 'hpe-rig resume, which measures it again; acquisition.changed_settings = "continue" goes on regardless'
        cause = "its records are kept, marked as untrusted"
        super().__init__("bench", f"shot {shot.index + 1} is not to be trusted: {why}", cause, remedy)


Event = ShotReady | ShotBlock | ShotUntrusted | ShotDone
Observer = Callable[[Progress], None]


def unobserved(progress: Progress) -> None:
    """Ignore every step."""


def _heard(observer: Observer) -> Observer:
    """Return ``observer`` with every step but the arriving records written to the log as well."""

    def observe(progress: Progress) -> None:
        if not progress.records:
            _LOG.info("shot %d: %s", progress.shot.index + 1, progress.step.value)
        observer(progress)

    return observe


def acquire(
    plan: Plan, bench: Bench, observer: Observer = unobserved, move: Mover | None = None
) -> Generator[Event, None, None]:
    """Yield what happens in every shot of ``plan``; after each shot, and on any exception, every output is off.

    A shot whose records stop before the deadline yields those that came; ``DeadlineError`` is raised when none did.
    Outputs and settings are read back after the last record as before the first: a shot in which one has changed yields
    ``ShotUntrusted`` and ends with ``UntrustedShotError``, unless the plan goes on. Where the tracking transducer
    stands elsewhere in a shot than in the one before, it is moved before anything is programmed.
    """
    observer = _heard(observer)
    next_start_s = bench.clock.now_s()
    mover, place_m = move or mover_of(plan, bench, None), None
    for shot in plan.shots:
        if shot.lateral_offset_m != place_m:
            observer(Progress(Step.MOVE, shot))
            mover(shot.lateral_offset_m)
            place_m = shot.lateral_offset_m
        try:
            yield ShotReady(shot, _configure(shot, bench, observer))
            _enable(shot, bench, observer)
            _wait_until(next_start_s, shot, bench, observer)
            observer(Progress(Step.FIRE, shot))
            next_start_s = bench.clock.now_s() + plan.shot_period_s
            bench.master.fire()
            why = yield from _collect(shot, bench, observer)
        finally:
            bench.make_safe()
        observer(Progress(Step.SAFE, shot, shot.capture.record_count))
        if why:
            yield ShotUntrusted(shot, why)
            if plan.stops_when_changed:
                raise UntrustedShotError(shot, why)
        yield ShotDone(shot, bench.digitizer.clipped())


def programmed(shot: Shot, bench: Bench) -> Mapping[str, Mapping[str, Setting]]:
    """Return every instrument's settings as read back once ``shot`` is programmed, by role; no output is enabled."""
    return _configure(shot, bench, unobserved)


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
    # Downstream first: nothing may trigger an output that is not ready for it.
    for generator in reversed(bench.generators):
        generator.enable_output()


def _wait_until(start_s: float, shot: Shot, bench: Bench, observer: Observer) -> None:
    """Return at ``start_s``; meanwhile the observer is asked again and again, since it may want to end the run."""
    wait_s = start_s - bench.clock.now_s()
    for _ in range(math.floor(wait_s / LONGEST_SLEEP_S)):
        observer(Progress(Step.WAIT, shot))
        bench.clock.sleep(LONGEST_SLEEP_S)
    bench.clock.sleep(max(0.0, start_s - bench.clock.now_s()))


def _collect(shot: Shot, bench: Bench, observer: Observer) -> Generator[ShotBlock, None, str]:
    """Yield the records as they arrive, and return in words what of outputs and settings changed, "" for nothing.

    Raises ``DeadlineError`` where no record came and nothing changed that could explain it.
    """
    looked_s = bench.clock.now_s()
    deadline_s = looked_s + shot.train_end_s + SAFETY_MARGIN_S
    arrived = 0
    observer(Progress(Step.COLLECT, shot))
    try:
        for block in bench.digitizer.records(deadline_s):
            arrived += block.codes.shape[0]
            yield ShotBlock(shot, block)
            observer(Progress(Step.COLLECT, shot, arrived))
            if bench.clock.now_s() - looked_s >= WATCH_S:
                if changed := bench.recheck():
                    return " ".join(changed)
                looked_s = bench.clock.now_s()
    except DeadlineError:
        changed = bench.recheck()
        if not arrived and not changed:
            raise
        return " ".join(changed)
    return " ".join(bench.recheck())
