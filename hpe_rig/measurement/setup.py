"""Scene and bench file -> the measurement as planned and checked. Nothing is opened, no run file but as a scene."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

from hpe_rig.bench import (
    BenchFile,
    BenchText,
    check_declared,
    check_simulation,
    read_bench,
    with_transducers,
)
from hpe_rig.plan import CheckResult, Plan, check_plan, likely_causes, make_plan, refuse_conflicts
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

RUN_FILE = ".h5"
"""Ending by which a run file is told from a scene where either is taken."""
BenchSource = str | os.PathLike[str] | None
"""What is taken as a bench: the path of its TOML file; None: the simulated bench."""


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
        # here: a scene of its own needs no HDF5
        from hpe_rig.store import read_run

        stored = read_run(Path(scene))
        return stored.scene_name, stored.scene_toml
    return scene_text(scene)


def prepare_text(
    name: str,
    text: str,
    bench_path: Path | None = None,
    stages: Stages | None = None,
    refuse: bool = True,
    stored: Path | None = None,
) -> Setup:
    """Return the planned measurement of a scene's text, which may be that of a run file; raises as ``prepare``.

    ``stored`` is the path of that file.
    """
    with (stages or Stages())("plan"):
        bench = read_bench(bench_path)
        if bench.bench.recording is not None:
            what = "this bench stands for an imported recording, no instrument of it is known"
            raise SettingsError(f"bench {bench.name}", [Mistake("recording", what, "a bench file of your own")])
        check = check_simulation if bench.bench.simulated else None
        scene = parse_scene(name, text, check, stored is not None)
        if stored is not None:
            scene = replace(scene, scene=with_scan_beside(scene.scene, stored.parent))
        scene = replace(scene, scene=with_transducers(scene.scene, bench.bench))
        if bench.bench.simulated:
            # Filled in here and in open_run alone: everything behind a plan meets a described specimen.
            scene = replace(scene, scene=with_default_specimen(scene.scene))
        if check and (mistakes := _twin_mistakes(scene.scene)):
            raise SettingsError(f"scene {name}", mistakes)
        plan, found = planned(scene.scene, bench.bench)
        found = (*likely_causes(scene.scene, found), *found)
        if refuse:
            refuse_conflicts(found)
    return Setup(scene, bench, plan, found)


def with_scan_beside(scene: Scene, folder: Path) -> Scene:
    """Return ``scene`` with the scan of its push taken from ``folder`` where its own path leads to none."""
    beams = scene.beams
    if beams is None or beams.excitation_scan is None or Path(beams.excitation_scan).is_file():
        return scene
    # a path of Windows may be read elsewhere, and takes either slash
    beside = folder / PureWindowsPath(beams.excitation_scan).name
    if not beside.is_file():
        return scene
    return scene.model_copy(update={"beams": beams.model_copy(update={"excitation_scan": str(beside)})})


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


def bench_path(bench: BenchSource) -> Path | None:
    """Return the path of a bench file; raise ``TypeError`` for what is no path."""
    return as_path(bench, "a bench is taken as the path of its TOML file")


def as_path(path: str | os.PathLike[str] | None, taken: str) -> Path | None:
    """Return ``path`` as one; raise ``TypeError`` with ``taken``, which says what is taken, for what is none."""
    if path is not None and not isinstance(path, str | os.PathLike):
        raise TypeError(f"{taken} or None, not as {type(path).__name__}")
    return None if path is None else Path(path)
