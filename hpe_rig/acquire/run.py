"""Scene -> result: the only file that knows every stage."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hpe_rig.acquire.sequencer import (
    Event,
    Observer,
    Progress,
    ShotBlock,
    ShotDone,
    ShotReady,
    Step,
    acquire,
    unobserved,
)
from hpe_rig.bench import (
    Bench,
    BenchFile,
    BenchText,
    check_simulation,
    declared,
    interruptible,
    open_bench,
    parse_bench,
    read_bench,
    simulation_schema,
    uninterrupted,
)
from hpe_rig.plan import Finding, Plan, findings, make_plan, refuse_conflicts
from hpe_rig.processing import true_harmonics_m
from hpe_rig.result import Result, Stages
from hpe_rig.scene import (
    Estimator,
    Mistake,
    Processing,
    Scene,
    SceneText,
    SettingsError,
    mistakes_of,
    parse_scene,
    scene_text,
)
from hpe_rig.store import (
    RunWriter,
    StoredRun,
    StoreError,
    WriteOptions,
    free_path,
    read_run,
    result_path,
    versions,
    write_result,
)


@dataclass(frozen=True, slots=True)
class Setup:
    """A measurement ready to run."""

    scene: SceneText
    bench: BenchText
    plan: Plan
    findings: tuple[Finding, ...]


def prepare(
    scene_name: str, bench_path: Path | None = None, stages: Stages | None = None, refuse: bool = True
) -> Setup:
    """Return the planned measurement; raise ``SettingsError`` or, unless told otherwise, ``PlanError``."""
    return prepare_text(*scene_text(scene_name), bench_path, stages, refuse)


def prepare_text(
    name: str, text: str, bench_path: Path | None = None, stages: Stages | None = None, refuse: bool = True
) -> Setup:
    """Return the planned measurement of a scene's text; raises as ``prepare``."""
    with (stages or Stages())("plan"):
        bench = read_bench(bench_path)
        check = check_simulation if bench.bench.simulated else None
        scene = parse_scene(name, text, check)
        # What the scene declares of beams and sound speed may contradict its [simulation].
        if check and scene.scene.simulation and (mistakes := check(declared(scene.scene))):
            raise SettingsError(f"scene {name}", mistakes)
        plan, found = planned(scene.scene, bench.bench)
        if refuse:
            refuse_conflicts(found)
    return Setup(scene, bench, plan, found)


def planned(scene: Scene, bench: BenchFile) -> tuple[Plan, tuple[Finding, ...]]:
    """Return the plan and what its checks found; raise ``SettingsError`` where numbers go out of all bounds."""
    try:
        plan = make_plan(scene, bench)
        return plan, tuple(findings(scene, bench, plan))
    except (ArithmeticError, ValueError, MemoryError) as error:
        why = "more memory than is available" if isinstance(error, MemoryError) else error
        what = f"its numbers lead to no plan ({why})"
        raise SettingsError("the scene", [Mistake("", what, "values as they occur on a bench")]) from error


def measure(
    setup: Setup,
    path: Path | None = None,
    observer: Observer = unobserved,
    stages: Stages | None = None,
    options: WriteOptions | None = None,
    earlier: StoredRun | None = None,
) -> Path:
    """Acquire every shot into a new run file and return its path; every output is off when it returns or raises.

    ``earlier`` is a run of the same plan: the shots ``options.predecessor`` counts are taken over from it. Where
    ``stages`` are given their times stand in the file, which is otherwise the same bit for bit at every simulated run.
    """
    taken, options = stages or Stages(), options or WriteOptions()
    refuse_conflicts(setup.findings)
    path = path or free_path(setup.scene.name, Path())
    first = options.predecessor.shots
    rest = replace(setup.plan, shots=setup.plan.shots[first:])
    with interruptible(), ExitStack() as stack:
        with uninterrupted():
            # Between the file's appearance and its guard nothing may come.
            writer = stack.enter_context(RunWriter(path, setup.scene, setup.bench, setup.plan, options))
        if earlier is not None:
            with taken("take over"):
                writer.take_over(earlier, first)
        stack.enter_context(_noting(f"{path} holds the records that had arrived"))
        with taken("open bench"):
            bench = stack.enter_context(open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles, first))
        with taken("configure"), closing(acquire(rest, bench, _timed(observer, taken))) as events:
            for event in events:
                _record(event, setup.scene.scene, bench, writer, taken)
                if stages is not None and isinstance(event, ShotDone):
                    writer.run_time(stages.run_time_s)
    return path


def _timed(observer: Observer, stages: Stages) -> Observer:
    """Return ``observer`` such that the innermost stage changes its name with every step of the sequencer."""

    def observe(progress: Progress) -> None:
        observer(progress)
        if progress.step is not Step.SAFE:
            # Told when every output is off already.
            stages.rename(progress.step.value)

    return observe


@contextmanager
def _noting(note: str) -> Iterator[None]:
    """Add ``note`` to whatever ends the block."""
    try:
        yield
    except BaseException as error:
        error.add_note(note)
        raise


def _record(event: Event, scene: Scene, bench: Bench, writer: RunWriter, stages: Stages) -> None:
    with stages("store"):
        match event:
            case ShotReady(shot, settings):
                writer.settings(shot, settings)
            case ShotBlock(shot, block):
                writer.append(shot, block)
            case ShotDone(shot, clipped):
                writer.clipped(shot, clipped)
                if bench.world is not None:
                    with stages("truth"):
                        pulses_m = bench.world.true_displacement_m()
                        harmonics_m = true_harmonics_m(scene, shot, bench.world.true_motion_m)
                    writer.ground_truth(shot, pulses_m)
                    writer.true_harmonics(shot, harmonics_m)
                writer.finish(shot)


def process(path: Path, estimator: str | None = None, stages: Stages | None = None) -> Result:
    """Return the result of the run in ``path`` and write it beside the run file."""
    from hpe_rig.prediction import predicted_averaging
    from hpe_rig.processing import estimate_run

    stages = stages or Stages()
    with stages("read"):
        stored = read_run(path)
        stages.come_after(stored.run_time_s)
        scene = parse_scene(stored.scene_name, stored.scene_toml).scene
        bench = parse_bench(stored.bench_name, stored.bench_toml).bench
        plan, found = planned(scene, bench)
        stored.refuse_unlike(plan)
    chosen = chosen_estimator(estimator, scene)
    with stages("process"):
        try:
            averaging = predicted_averaging(scene, chosen, stored.simulated)
            shots = estimate_run(scene, plan, stored, chosen, averaging)
        except ValueError as error:
            raise StoreError(
                f"{path} cannot be estimated ({error}). Try: another estimator, or more records."
            ) from error
    if not shots:
        raise StoreError(
            f"{path} holds no records, the run is {stored.status}: it ended before the first came. "
            f"Try: hpe-rig resume {path}."
        )
    warnings = tuple(str(finding) for finding in found if finding.level != "passed")
    warnings += tuple(
        f"shot {shot + 1}: the digitizer's input left its range of {scene.acquisition.input_range_v:g} V, in the gate "
        "or outside it: raise acquisition.input_range_v"
        for shot in stored.clipped
        # The board cannot say which record it was; where some are skipped the gate's own codes decide.
        if scene.tracking.disturbed != "skip"
    )
    if stored.status != "complete":
        warnings += (f"the run is {stored.status}: not every record was acquired",)
    result = Result(
        title=scene.title,
        run_file=path.name,
        simulated=stored.simulated,
        status=stored.status,
        estimator=chosen,
        phase_reference=phase_reference(scene),
        shots=shots,
        warnings=warnings,
        left_out=tuple((item.what, item.why) for item in plan.left_out),
        versions=versions(),
        run_time_s=stages.run_time_s,
    )
    with stages("write result"):
        write_result(result_path(path, chosen), result)
    return result


def chosen_estimator(name: str | None, scene: Scene) -> Estimator:
    """Return the estimator of that name, or the scene's; raise ``SettingsError`` for a name that is none."""
    asked = {"estimator": name or scene.processing.estimator}
    mistakes = mistakes_of(Processing, asked, ("processing",))
    if mistakes:
        raise SettingsError("command line", mistakes)
    return Processing.model_validate(asked).estimator


def phase_reference(scene: Scene) -> str:
    """Return in words what phase zero means; the way from transducer to gate is accounted for."""
    start = "the first toneburst's arrival at the gate" if scene.excitation else "the master trigger's edge"
    return f"of sin(2 pi f t + phase), the motion at the gate, with t from {start}"


def json_schema(of: str) -> dict[str, Any]:
    """Return the JSON schema of a scene, a bench file or the twin's settings."""
    schemas = {"scene": Scene.model_json_schema, "bench": BenchFile.model_json_schema, "simulation": simulation_schema}
    if of not in schemas:
        raise SettingsError(f"schema {of}", [Mistake("", "there is no such schema", f"one of {', '.join(schemas)}")])
    return schemas[of]()
