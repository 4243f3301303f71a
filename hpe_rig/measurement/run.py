"""Record a run: the measurement as planned by a setup, acquired shot by shot and written to a run file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hpe_rig.bench import BenchFile, interruptible, open_bench, twin_tables, uninterrupted
from hpe_rig.measurement.mover import Mover, choose_mover, require_mover
from hpe_rig.measurement.recording import RunRecorder
from hpe_rig.measurement.sequencer import Observer, Progress, ShotDone, Step, acquire, ignore_progress
from hpe_rig.measurement.setup import Setup, as_path
from hpe_rig.plan import Plan, refuse_conflicts
from hpe_rig.result import Stages
from hpe_rig.scene import Scene
from hpe_rig.store import RunWriter, StoredRun, WriteOptions, free_path, refuse_to_replace


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
        refuse_to_replace(path)
    timer = stages or Stages()
    # Interrupts end the innermost block. They are held back while the file is closed and the bench is made safe.
    with uninterrupted(), ExitStack() as stack:
        create = partial(RunWriter, path, setup.scene, setup.bench, setup.plan, options)
        recorder = stack.enter_context(RunRecorder(path, create, defer=replaces))
        stack.enter_context(interruptible())
        if earlier is not None:
            with timer("take over"):
                recorder.copy_shots(earlier, options.predecessor.shots)
        watched = _timed(_checking_file(observer, recorder), timer)
        for segment in _segments(setup, options.predecessor.shots):
            _record(segment, setup.plan, recorder, watched, move=move, timer=timer, store_times=stages is not None)
    return path


@dataclass(frozen=True, slots=True)
class _Segment:
    """Shots acquired on one opened bench; ``scenes``: those of the sweep's points from ``first_point`` on."""

    scenes: tuple[Scene, ...]
    bench: BenchFile
    plan: Plan
    first_point: int


def _segments(setup: Setup, first_shot: int) -> Iterator[_Segment]:
    """Split the shots from ``first_shot`` on where a sweep changes the bench file or the settings of the twin.

    A run without such a sweep is one segment: its bench is opened once.
    """
    base, points = setup.bench.bench, setup.scene.scene.points
    settings = [(base.with_(point.bench), twin_tables(point.scene) if base.simulated else None) for point in points]
    start = setup.plan.shots[first_shot].point
    while start < len(points):
        end = start
        while end < len(points) and settings[end] == settings[start]:
            end += 1
        shots = tuple(shot for shot in setup.plan.shots[first_shot:] if start <= shot.point < end)
        scenes = tuple(point.scene for point in points[start:end])
        yield _Segment(scenes, settings[start][0], replace(setup.plan, shots=shots), start)
        start = end


def _record(
    segment: _Segment,
    plan: Plan,
    recorder: RunRecorder,
    observer: Observer,
    *,
    move: Mover | None,
    timer: Stages,
    store_times: bool,
) -> None:
    """Acquire and write the shots of ``segment``; ``plan`` is that of the whole run."""
    with ExitStack() as stack:
        with timer("open bench"):
            opening = open_bench(segment.scenes[0], segment.bench, plan.roles, segment.plan.shots[0].index)
            bench = stack.enter_context(opening)
        # Roles and lateral offsets are those of the whole run: a segment may have a single offset.
        events = acquire(segment.plan, bench, observer, choose_mover(plan, bench, move))
        with timer("configure"), closing(events):
            for event in events:
                with timer("store"):
                    recorder.write(event, segment.scenes[event.shot.point - segment.first_point], bench, timer)
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
        recorder.check_file_present()

    return observe
