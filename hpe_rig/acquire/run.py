"""Scene -> run file: the measurement as planned, acquired and recorded."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hpe_rig.acquire.places import Mover, mover_of, require_mover
from hpe_rig.acquire.recording import Recording
from hpe_rig.acquire.sequencer import Observer, Progress, ShotDone, Step, acquire, unobserved
from hpe_rig.bench import (
    BenchFile,
    BenchText,
    check_declared,
    check_simulation,
    interruptible,
    open_bench,
    read_bench,
    twin_tables,
    uninterrupted,
    with_transducers,
)
from hpe_rig.plan import CheckResult, Plan, check_plan, make_plan, refuse_conflicts
from hpe_rig.result import Stages
from hpe_rig.scene import (
    Mistake,
    Scene,
    SceneSource,
    SceneText,
    SettingsError,
    parse_scene,
    scene_text,
    with_default_specimen,
)
from hpe_rig.store import RunWriter, StoredRun, WriteOptions, free_path, read_run, refuse_to_replace

RUN_FILE = ".h5"
"""Ending by which a run file is told from a scene where either is taken."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A measurement ready to run: scene and bench file with their texts, the plan and what its checks found."""

    scene: SceneText
    bench: BenchText
    plan: Plan
    findings: tuple[CheckResult, ...]


def prepare(
    scene: SceneSource, bench_path: Path | None = None, stages: Stages | None = None, refuse: bool = True
) -> Setup:
    """Return the planned measurement of ``scene`` on the bench file ``bench_path``, None: the simulated bench.

    ``scene``: also the path of a run file, whose scene is measured again, by the rules that hold for scenes now.
    Raises ``SettingsError`` with every mistake, ``PlanError`` with every conflict unless ``refuse`` is off, and
    ``TypeError`` for what is no scene.
    """
    return prepare_text(*source_text(scene), bench_path, stages, refuse)


def source_text(scene: SceneSource) -> tuple[str, str]:
    """Return name and text of a scene, or of that which the run file ``scene`` was measured with."""
    if isinstance(scene, str | os.PathLike) and Path(scene).suffix == RUN_FILE:
        stored = read_run(Path(scene))
        return stored.scene_name, stored.scene_toml
    return scene_text(scene)


def prepare_text(
    name: str,
    text: str,
    bench_path: Path | None = None,
    stages: Stages | None = None,
    refuse: bool = True,
    stored: bool = False,
) -> Setup:
    """Return the planned measurement of a scene's text, ``stored`` where a run file holds it; raises as ``prepare``."""
    with (stages or Stages())("plan"):
        bench = read_bench(bench_path)
        if bench.bench.recording is not None:
            what = "this bench stands for an imported recording, no instrument of it is known"
            raise SettingsError(f"bench {bench.name}", [Mistake("recording", what, "a bench file of your own")])
        check = check_simulation if bench.bench.simulated else None
        scene = parse_scene(name, text, check, stored)
        scene = replace(scene, scene=with_transducers(scene.scene, bench.bench))
        if bench.bench.simulated:
            # Filled in here and in open_run alone: everything behind a plan meets a described specimen.
            scene = replace(scene, scene=with_default_specimen(scene.scene))
        if check and (mistakes := _twin_mistakes(scene.scene)):
            raise SettingsError(f"scene {name}", mistakes)
        plan, found = planned(scene.scene, bench.bench)
        if refuse:
            refuse_conflicts(found)
    return Setup(scene, bench, plan, found)


def _twin_mistakes(scene: Scene) -> list[Mistake]:
    """Return what the twin finds wrong at any point of a sweep, each mistake once.

    What the scene declares of beams and sound speed may contradict its [simulation].
    """
    found: list[Mistake] = []
    for point in scene.points:
        if scene.sweep.axes:
            found += check_simulation({"simulation": point.scene.simulation or {}})
        found += check_declared(point.scene) if not found else []
    return list(dict.fromkeys(found))


def planned(scene: Scene, bench: BenchFile) -> tuple[Plan, tuple[CheckResult, ...]]:
    """Return the plan and what its checks found; raise ``SettingsError`` where numbers go out of all bounds."""
    try:
        plan = make_plan(scene, bench)
        return plan, tuple(check_plan(scene, bench, plan))
    except (ArithmeticError, ValueError, MemoryError) as error:
        why = "more memory than is available" if isinstance(error, MemoryError) else error
        what = f"its numbers lead to no plan ({why})"
        raise SettingsError("the scene", [Mistake("", what, "values as they occur on a bench")]) from error


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
