"""Setup -> run file: the measurement as planned, acquired and recorded."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hpe_rig.bench import BenchFile, interruptible, open_bench, twin_tables, uninterrupted
from hpe_rig.measurement.mover import Mover, mover_of, require_mover
from hpe_rig.measurement.recording import Recording
from hpe_rig.measurement.sequencer import Observer, Progress, ShotDone, Step, acquire, unobserved
from hpe_rig.measurement.setup import Setup
from hpe_rig.plan import Plan, refuse_conflicts
from hpe_rig.result import Stages
from hpe_rig.scene import Scene
from hpe_rig.store import RunWriter, StoredRun, WriteOptions, free_path, refuse_to_replace


def record_run(
    setup: Setup,
    path: Path | None = None,
    observer: Observer = unobserved,
    stages: Stages | None = None,
    options: WriteOptions | None = None,
    earlier: StoredRun | None = None,
    move: Mover | None = None,
) -> Path:
    """Acquire every shot into a new run file and return its path; every output is off when it returns or raises.

    ``move`` moves the tracking transducer between places on a bench that has no stage of its own. ``earlier`` is a run
    of the same plan: the shots ``options.predecessor`` counts are taken over from it. Where ``stages`` are given their
    times stand in the file, which is otherwise the same bit for bit at every simulated run.
    """
    taken, options = stages or Stages(), options or WriteOptions()
    refuse_conflicts(setup.findings)
    require_mover(setup.plan, setup.bench.bench.simulated, move)
    path = path or free_path(setup.scene.name, Path())
    first = options.predecessor.shots
    late = options.overwrite and path.exists()
    if late:
        refuse_to_replace(path)
    # Interrupts end what is in the innermost block, and are held back while file and bench are left in order.
    with uninterrupted(), ExitStack() as stack:
        create = partial(RunWriter, path, setup.scene, setup.bench, setup.plan, options)
        recording = stack.enter_context(Recording(path, create, late))
        stack.enter_context(interruptible())
        if earlier is not None:
            with taken("take over"):
                recording.take_over(earlier, first)
        watching = _timed(_looking(observer, recording), taken)
        for part in _parts(setup, first):
            with ExitStack() as opened:
                with taken("open bench"):
                    here = open_bench(part.scenes[0], part.bench, setup.plan.roles, part.plan.shots[0].index)
                    bench = opened.enter_context(here)
                mover = mover_of(setup.plan, bench, move)
                with taken("configure"), closing(acquire(part.plan, bench, watching, mover)) as events:
                    for event in events:
                        with taken("store"):
                            recording.take(event, part.scenes[event.shot.point - part.first_point], bench, taken)
                        if stages is not None and isinstance(event, ShotDone):
                            recording.run_time(stages)
    return path


@dataclass(frozen=True, slots=True)
class _Part:
    """Shots that one opened bench takes: ``scenes`` are those of its points, from ``first_point`` on."""

    scenes: tuple[Scene, ...]
    bench: BenchFile
    plan: Plan
    first_point: int


def _parts(setup: Setup, first_shot: int) -> Iterator[_Part]:
    """Yield the shots from ``first_shot`` on, apart where a sweep changes the bench file or what the twin is made of.

    A run without such a sweep has one part: its bench is opened once.
    """
    base, points = setup.bench.bench, setup.scene.scene.points
    benches = [base.with_(point.bench) for point in points]
    twins = [twin_tables(point.scene) if base.simulated else None for point in points]
    start = setup.plan.shots[first_shot].point
    while start < len(points):
        alike = zip(benches[start:], twins[start:], strict=True)
        same = itertools.takewhile(lambda each, like=(benches[start], twins[start]): each == like, alike)  # type: ignore[misc]
        end = start + len(list(same))
        shots = tuple(shot for shot in setup.plan.shots[first_shot:] if start <= shot.point < end)
        scenes = tuple(point.scene for point in points[start:end])
        yield _Part(scenes, benches[start], replace(setup.plan, shots=shots), start)
        start = end


def _timed(observer: Observer, stages: Stages) -> Observer:
    """Return ``observer`` such that the time of every step of the sequencer is charged to a stage of its name."""

    def observe(progress: Progress) -> None:
        observer(progress)
        if progress.step is not Step.SAFE:
            # This step is announced once the outputs are off: its time is part of the step before.
            stages.rename(progress.step.value)

    return observe


def _looking(observer: Observer, recording: Recording) -> Observer:
    """Return ``observer`` such that it also looks whether the run's file is still there, where nothing is written."""

    def observe(progress: Progress) -> None:
        observer(progress)
        recording.look()

    return observe
