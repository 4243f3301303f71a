"""Record a run: the measurement as planned by a setup, acquired shot by shot and written to a run file."""

from __future__ import annotations

import itertools
import os
from collections.abc import Generator, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.interfaces import InstrumentError, RecordBlock
from hpe_rig.bench import BenchFile, interruptible, open_bench, twin_tables, uninterrupted
from hpe_rig.measurement.awake import kept_awake
from hpe_rig.measurement.background import detached
from hpe_rig.measurement.between_shots import Mover, choose_mover, require_mover
from hpe_rig.measurement.recording import RunRecorder
from hpe_rig.measurement.sequencer import (
    DRIVING_STEPS,
    Event,
    Observer,
    Progress,
    ShotBlock,
    ShotDone,
    Step,
    acquire,
    ignore_progress,
)
from hpe_rig.measurement.setup import Setup, as_path
from hpe_rig.plan import Plan, Shot, refuse_conflicts
from hpe_rig.result import Stages
from hpe_rig.store import RunWriter, StoredRun, WriteOptions, check_replaceable, free_path


def record_run(
    setup: Setup,
    path: str | os.PathLike[str] | None = None,
    observer: Observer = ignore_progress,
    stages: Stages | None = None,
    options: WriteOptions | None = None,
    *,
    earlier: StoredRun | None = None,
    move: Mover | None = None,
) -> Path:
    """Acquire every shot into a new run file and return its path; every output is off when it returns or raises.

    ``move`` moves the tracking transducer on a bench without a stage. ``earlier`` is a run of the same plan: its first
    ``options.predecessor.shots`` shots are copied. The times of ``stages`` are stored if they are given; without them
    a simulated run gives the same file bit for bit.
    """
    options = options or WriteOptions()
    refuse_conflicts(setup.findings)
    require_mover(setup.plan, setup.bench.bench.simulated, move)
    path = as_path(path, "the path of a run file") or free_path(setup.scene.name, Path())
    replaces = options.overwrite and path.exists()
    if replaces:
        check_replaceable(path)
    timer = stages or Stages()
    # Interrupts end the innermost block. They are held back while the file is closed and the bench is made safe.
    with uninterrupted(), kept_awake(not setup.bench.bench.simulated), ExitStack() as stack:
        create = partial(RunWriter, path, setup.scene, setup.bench, setup.plan, options)
        recorder = stack.enter_context(RunRecorder(path, create, defer=replaces))
        stack.enter_context(interruptible())
        if earlier is not None:
            with timer("take over"):
                recorder.copy_shots(earlier, options.predecessor.shots)
        if not setup.bench.bench.simulated:
            # A simulated bench drives nothing, and its clock does not wait for an observer either.
            observer = stack.enter_context(detached(observer))
        watched = _timed(_checking_file(observer, recorder), timer)
        record = partial(_record, setup, move=move, timer=timer, store_times=stages is not None)
        for bench_file, segment in _segments(setup, options.predecessor.shots):
            record(bench_file, segment, recorder, watched)
    return path


def _segments(setup: Setup, first_shot: int) -> Iterator[tuple[BenchFile, Plan]]:
    """Split the shots from ``first_shot`` on where a sweep changes the bench file or the settings of the twin.

    A run without such a sweep is one segment: its bench is opened once.
    """
    base = setup.bench.bench
    settings = [
        (base.with_(point.bench), twin_tables(point.scene) if base.simulated else None)
        for point in setup.scene.scene.points
    ]
    shots_by_settings = itertools.groupby(setup.plan.shots[first_shot:], key=lambda shot: settings[shot.point])
    for (bench_file, _), shots in shots_by_settings:
        yield bench_file, replace(setup.plan, shots=tuple(shots))


def _record(
    setup: Setup,
    bench_file: BenchFile,
    segment: Plan,
    recorder: RunRecorder,
    observer: Observer,
    *,
    move: Mover | None,
    timer: Stages,
    store_times: bool,
) -> None:
    """Acquire and write the shots of ``segment`` on the bench of ``bench_file``."""
    points, first = setup.scene.scene.points, segment.shots[0]
    with ExitStack() as stack:
        with timer("open bench"):
            opening = open_bench(points[first.point].scene, bench_file, setup.plan.roles, first.index)
            bench = stack.enter_context(opening)
        # Lateral offsets are those of the whole run: a segment may have a single one.
        mover = choose_mover(setup.plan, bench, move)
        events = end_at_full_scale(acquire(segment, bench, observer, mover, bench_file.conditions))
        with timer("configure"), closing(events):
            for event in events:
                with timer("store"):
                    recorder.write(event, points[event.shot.point].scene, bench, timer)
                # The stored times include those of the shots so far, also if the run is stopped.
                if store_times and isinstance(event, ShotDone):
                    recorder.write_run_time(timer)


def _timed(observer: Observer, stages: Stages) -> Observer:
    """Wrap ``observer`` so that each step of the sequencer is timed as a stage."""

    def observe(progress: Progress) -> None:
        observer(progress)
        if progress.step is not Step.SAFE:
            # SAFE is announced after the outputs are off: its time belongs to the step before.
            stages.rename(progress.step.value)

    return observe


def _checking_file(observer: Observer, recorder: RunRecorder) -> Observer:
    """Wrap ``observer`` so that each step checks that the run file still exists."""

    def observe(progress: Progress) -> None:
        observer(progress)
        recorder.check_file_present(wait=progress.step not in DRIVING_STEPS)

    return observe


def end_at_full_scale(events: Generator[Event, None, None]) -> Generator[Event, None, None]:
    """Yield ``events``; raise ``InstrumentError`` if every record of the first shot reaches full scale in its gate.

    It is raised instead of the first ``ShotDone``, when outputs are off: the records are kept, and the shot counts as
    not measured.
    """
    is_first, records, all_at_full_scale = True, 0, True
    with closing(events):
        for event in events:
            if is_first and isinstance(event, ShotBlock) and all_at_full_scale:
                records += event.block.codes.shape[0]
                all_at_full_scale = _every_record_at_full_scale(event.shot, event.block)
            elif is_first and isinstance(event, ShotDone):
                if records and all_at_full_scale:
                    raise _too_large(event.shot, records)
                is_first = False
            yield event


def _every_record_at_full_scale(shot: Shot, block: RecordBlock) -> bool:
    """Return whether each record of ``block`` has a sample at full scale in the gate."""
    lowest, highest = block.code_limits
    # The rest of a record may hold the tracking pulse itself, which may saturate the input.
    gate = block.codes[:, shot.gate]
    return bool(np.all((gate.min(axis=1) <= lowest) | (gate.max(axis=1) >= highest)))


def _too_large(shot: Shot, records: int) -> InstrumentError:
    range_v = shot.capture.input_range_v
    return InstrumentError(
        "digitizer",
        f"all {records} records of shot {shot.index + 1} reach full scale (+-{range_v:g} V) in the gate",
        "the echo is larger than the range, a toneburst reaches the receiver, or generators are exchanged",
        "hpe-rig align; less gain, then hpe-rig resume; or a new run with a larger acquisition.input_range_v",
    )
