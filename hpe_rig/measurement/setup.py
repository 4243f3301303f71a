"""Setup of a measurement: scene and bench file -> plan and the results of its checks. No instrument is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date, datetime
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any

from hpe_rig.bench import (
    BenchFile,
    BenchText,
    check_declared,
    check_simulation,
    parse_bench,
    read_bench,
    with_transducers,
)
from hpe_rig.plan import (
    CheckResult,
    Plan,
    calibration_expiry,
    check_plan,
    likely_causes,
    make_plan,
    refuse_conflicts,
)
from hpe_rig.result import Stages
from hpe_rig.scene import (
    Mistake,
    Scene,
    SceneSource,
    SceneText,
    SettingsError,
    parse_scene,
    path_of,
    scene_text,
    with_default_specimen,
)

if TYPE_CHECKING:
    from hpe_rig.store import StoredRun

RUN_FILE_SUFFIX = ".h5"
"""Where a scene or a run file is accepted, a path with this suffix is a run file."""
BenchSource = str | os.PathLike[str] | None
"""Path of a bench file; None: the simulated bench."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A measurement ready to run: scene and bench file with their texts, the plan and the findings of its checks."""

    scene: SceneText
    bench: BenchText
    plan: Plan
    findings: tuple[CheckResult, ...]


def prepare(
    scene: SceneSource,
    bench: BenchSource = None,
    stages: Stages | None = None,
    refuse: bool = True,
    changes: Mapping[str, Any] | None = None,
) -> Setup:
    """Return the planned measurement of ``scene`` on ``bench``.

    If ``scene`` is the path of a run file, its scene is planned again by the current rules for scenes. ``changes``:
    values that replace those of the scene, by their path, such as "tracking.pulse_rate_hz".
    Raises ``SettingsError`` with every mistake, ``PlanError`` with every conflict unless ``refuse`` is False, and
    ``TypeError`` if ``scene`` or ``bench`` has another type.
    """
    bench_path = as_path(bench, "the path of a bench file")
    name, text = source_text(scene)
    if changes:
        # Mistakes are reported of the text as written.
        parse_scene(name, text)
        # Loads the editor of TOML files, which no other run needs.
        from hpe_rig.scene import edited_text

        text = edited_text(text, {path_of(key): value for key, value in changes.items()})
    return prepare_text(name, text, bench_path, stages, refuse)


def source_text(scene: SceneSource) -> tuple[str, str]:
    """Return name and text of a scene, or of the scene stored in the run file ``scene``."""
    if isinstance(scene, str | os.PathLike) and Path(scene).suffix == RUN_FILE_SUFFIX:
        # Imported here: a scene file needs no HDF5.
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
    """Return the planned measurement of the scene ``text``; raises as ``prepare``.

    ``stored`` is the path of the run file that holds the text, if any.
    """
    with (stages or Stages())("plan"):
        bench = read_bench(bench_path)
        check = check_simulation if bench.bench.simulated else None
        scene = parse_scene(name, text, check, stored is not None)
        scene = replace(scene, scene=_completed(scene.scene, bench.bench, None if stored is None else stored.parent))
        if check:
            # At any point of a sweep the scene's beams and sound speed may contradict its [simulation].
            mistakes = [mistake for point in scene.scene.points for mistake in check_declared(point.scene)]
            if mistakes:
                raise SettingsError(f"scene {name}", list(dict.fromkeys(mistakes)))
        plan, findings = plan_and_check(scene.scene, bench.bench, date.today())
        findings = (*likely_causes(scene.scene, findings), *findings)
        if refuse:
            refuse_conflicts(findings)
    return Setup(scene, bench, plan, findings)


def setup_of_run(stored: StoredRun) -> Setup:
    """Return the setup of the run ``stored``, planned again from its scene and bench file.

    Raises ``StoreError`` if the records do not fit the plan, and ``SettingsError`` if there is no plan.
    """
    bench = parse_bench(stored.bench_name, stored.bench_toml)
    scene = parse_scene(stored.scene_name, stored.scene_toml, stored=True)
    scene = replace(scene, scene=_completed(scene.scene, bench.bench, stored.path.parent))
    plan, findings = plan_and_check(scene.scene, bench.bench, _day_of(stored), measured=True)
    stored.refuse_other_plan(plan)
    return Setup(scene, bench, plan, findings)


def _completed(scene: Scene, bench: BenchFile, folder: Path | None) -> Scene:
    """Return ``scene`` with the scan in ``folder``, the bench's transducers and, if simulated, a specimen."""
    if folder is not None:
        scene = with_scan_in_folder(scene, folder)
    scene = with_transducers(scene, bench)
    # Later steps rely on this: the scene of a simulated measurement always describes a specimen.
    return with_default_specimen(scene) if bench.simulated else scene


def with_scan_in_folder(scene: Scene, folder: Path) -> Scene:
    """Return ``scene`` with the scan of its push replaced by the file in ``folder`` if its path does not exist."""
    beams = scene.beams
    if beams is None or beams.excitation_scan is None or Path(beams.excitation_scan).is_file():
        return scene
    # A path written on Windows may be read elsewhere. `PureWindowsPath` accepts both slashes.
    scan = folder / PureWindowsPath(beams.excitation_scan).name
    if not scan.is_file():
        return scene
    return scene.model_copy(update={"beams": beams.model_copy(update={"excitation_scan": str(scan)})})


def _day_of(stored: StoredRun) -> date | None:
    """Return the day on which a stored run began, None if the file does not state it."""
    try:
        return datetime.fromisoformat(stored.provenance.started).date()
    except ValueError:
        return None


def plan_and_check(
    scene: Scene, bench: BenchFile, day: date | None = None, *, measured: bool = False
) -> tuple[Plan, tuple[CheckResult, ...]]:
    """Return the plan and the findings of its checks; raise ``SettingsError`` if the numbers allow no plan.

    The calibration must be valid on ``day``, the day of the measurement; None: that is not checked. ``measured``: the
    plan is that of a stored run, which needs fewer checks.
    """
    try:
        plan = make_plan(scene, bench)
        expiry = [] if day is None else calibration_expiry(bench, day)
        return plan, (*check_plan(scene, bench, plan, measured), *expiry)
    except (ArithmeticError, ValueError, MemoryError) as error:
        why = "more memory than is available" if isinstance(error, MemoryError) else error
        what = f"its numbers lead to no plan ({why})"
        raise SettingsError("the scene", [Mistake("", what, "values as they occur on a bench")]) from error


def as_path(path: str | os.PathLike[str] | None, meaning: str) -> Path | None:
    """Return ``path`` as a ``Path``; raise ``TypeError``, which names its ``meaning``, for other types."""
    if path is not None and not isinstance(path, str | os.PathLike):
        raise TypeError(f"expected {meaning} or None, not {type(path).__name__}")
    return None if path is None else Path(path)
