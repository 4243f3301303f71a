"""Run file -> result: a stored run parsed, planned and validated once, and what is estimated from it."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import BenchFile, parse_bench, with_transducers
from hpe_rig.measurement import planned, with_scan_beside
from hpe_rig.plan import (
    CheckResult,
    Plan,
    depth_gates,
    gates_over_depth,
    offsets_beside_m,
    omissions,
    places_of,
    reference_gate,
    refuse_conflicts,
    scene_of,
    select,
    shots_with_gate,
    with_gate,
)
from hpe_rig.result import GateResult, Result, ShotResult, Stages
from hpe_rig.runs.checked_scene import plan_html
from hpe_rig.scene import (
    Estimator,
    Mistake,
    Processing,
    Scene,
    SettingsError,
    mistakes_of,
    parse_scene,
    unreadable,
    with_default_specimen,
)
from hpe_rig.store import (
    StoredRecords,
    StoredRun,
    StoreError,
    read_run,
    result_path,
    sha256_of_scan,
    versions,
    write_result,
)

if TYPE_CHECKING:
    from hpe_rig.processing import EchoGate, Estimates


@dataclass(frozen=True, slots=True)
class Run:
    """A stored run; its records are read when they are asked for, so that a long one takes no memory.

    ``findings``: what the checks of its plan found; ``stored``: what the file held when it was opened, scene and bench
    file verbatim among it.

    >>> run = open_run("bovine-muscle.h5")
    >>> run.scene.tracking.pulse_rate_hz, run.records[0].codes.shape
    >>> run.estimate("kasai").shots[0].estimates[0].amplitude_m
    """

    path: Path
    scene: Scene
    bench: BenchFile
    plan: Plan
    findings: tuple[CheckResult, ...]
    stored: StoredRun

    @property
    def records(self) -> StoredRecords:
        """The digitizer's codes of every shot, each int16 (pulse, sample), with what turns them into volts."""
        return self.stored.records

    def __repr__(self) -> str:
        """Return path, title and state; the file's texts and the plan would fill a screen."""
        return f"<Run {str(self.path)!r}: {self.scene.title!r}, {self._state}>"

    @property
    def _state(self) -> str:
        complete, simulated = self.stored.shot_complete, ", simulated" if self.stored.simulated else ""
        return f"{self.stored.status}, {int(complete.sum())} of {complete.size} shots{simulated}"

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: state, timing of the first shot, checks of the plan; nothing is estimated."""
        return plan_html(self.scene.title, f"{self.path}: {self._state}", self.plan.shots[0], self.findings)

    def displacement_m(self, shot: int = 0) -> FloatArray:
        """Return the displacement of every tracking pulse of ``shot``, counted from 0, up to a constant; (pulse,), m.

        By the scene's estimator; positive away from the transducer,
        sensed at ``plan.shots[shot].timeline.sensing_s``; of the whole train, whatever the processing window. NaN where
        the record is missing or the pulse is omitted. Raises ``IndexError`` for a shot that is none, ``ValueError``
        where the echoes carry no displacement.
        """
        from hpe_rig.processing import coherent, relative_to, shot_motion, spec_of

        count = len(self.plan.shots)
        if not -count <= shot < count:
            raise IndexError(f"shot {shot} does not exist: the run has {count}, counted from 0")
        scene = scene_of(self.scene, self.plan.shots[shot])
        estimator = spec_of(scene.processing.estimator)
        motion = shot_motion(scene, self.plan.shots[shot], self._echoes(shot), estimator.motion)
        reference = reference_gate(scene, self.plan.shots[shot])
        if reference is not None:
            motion = relative_to(motion, coherent(self._echoes(shot, reference)))
        return motion.displacement_m

    def estimate(self, estimator: str | None = None, stages: Stages | None = None) -> Result:
        """Return amplitude and phase of every shot, by the scene's estimator or the one named.

        ``stages`` takes the wall time. Raises ``SettingsError`` for an estimator that does not exist and ``StoreError``
        where the records carry no estimate.
        """
        stages = stages or Stages()
        stages.come_after(self.stored.run_time_s)
        chosen = chosen_estimator(estimator, self.scene)
        with stages("process"):
            estimates = _shots(self, chosen)
            profile, lost = _profile(self, chosen)
        return Result(
            title=self.scene.title,
            run_file=self.path.name,
            simulated=self.stored.simulated,
            status=self.stored.status,
            estimator=chosen,
            phase_reference=phase_reference(self.scene),
            shots=tuple(replace(shot, untrusted=self.stored.untrusted.get(shot.shot, "")) for shot in estimates.shots),
            warnings=(*_warnings(self, estimates), *lost),
            omitted=tuple((item.what, item.why) for item in omissions(_with_estimator(self.scene, chosen), self.bench)),
            versions=versions(),
            run_time_s=stages.run_time_s,
            simulated_specimen=self.scene.default_specimen,
            shots_without_result=tuple(estimates.without.items()),
            imported=None if self.bench.recording is None else self.bench.recording.words,
            notes=self.scene.notes,
            provenance=self.stored.provenance,
            profile=profile,
        )

    def sweep(
        self,
        axes: Mapping[str, Sequence[float]],
        *,
        together: bool = False,
        estimator: str | None = None,
    ) -> Result:
        """Return the estimates at every value of the ``axes``, all of the same records: nothing is acquired.

        ``axes``: values by the name of a number of [processing] or [beams], or of the gate; each value with each or,
        where ``together``, the first values of all axes, then the second ones. Raises ``SettingsError`` with every
        axis that is none of these, ``PlanError`` where a window or gate is not in the records, and as ``estimate``.

        >>> run.sweep({"gate_length_m": [0.5e-3, 1e-3]}).to_frame()[["acquisition.gate_length_m", "amplitude_m"]]
        """
        from hpe_rig.runs.reprocessing import estimate_over

        return estimate_over(self, axes, estimator, together)

    def with_profile(self, step_m: float | None) -> Run:
        """Return the run with gates every ``step_m`` over the depth of its records; with None as it is.

        Raises ``PlanError`` where the records have no room for them, and ``SettingsError`` for a step that is none.
        """
        if step_m is None:
            return self
        asked = {"gate_profile_step_m": step_m}
        if mistakes := mistakes_of(Processing, asked, ("processing",)):
            raise SettingsError("gate profile", mistakes)
        if self.scene.processing.follow_gate:
            what = "gates over depth stand still where processing.follow_gate moves"
            raise SettingsError("gate profile", [Mistake("processing.follow_gate", what, "a run without it")])
        if self.scene.sphere is not None:
            what = "gates over depth see the medium, which moves unlike the sphere"
            raise SettingsError("gate profile", [Mistake("sphere", what, "a run of the medium without a sphere")])
        processing = self.scene.processing.model_copy(update=asked | {"gates": ()})
        scene = self.scene.model_copy(update={"processing": processing})
        parts = places_of(scene, self.plan)
        found = dict.fromkeys(each for place, plan in parts for each in gates_over_depth(place, self.bench, plan))
        refuse_conflicts(list(found))
        return replace(self, scene=scene)

    def save(self, result: Result) -> Path:
        """Write ``result`` beside the run file, in place of an earlier one of that estimator, and return its path."""
        path = result_path(self.path, result.estimator)
        write_result(path, result)
        return path

    def _echoes(self, shot: int, gate: slice | None = None) -> EchoGate:
        """Return the echoes of every pulse of ``shot``, (pulse, sample), also outside the processing window."""
        from hpe_rig.processing import margin_needed, samples_needed, shot_echoes

        whole_train = {"window_start_s": 0.0, "window_length_s": None}
        planned_shot = self.plan.shots[shot]
        scene = scene_of(self.scene, planned_shot)
        whole = scene.model_copy(update={"processing": scene.processing.model_copy(update=whole_train)})
        needed = gate or samples_needed(scene, planned_shot)
        records = self.records.gated(shot, needed, margin=margin_needed(scene, planned_shot))
        return shot_echoes(whole, planned_shot, records, select(whole, planned_shot))

    def refreshed(self) -> Run:
        """Return the run as its file stands by now, for one that is still being written."""
        stored = read_run(self.path)
        return replace(self, stored=stored, plan=_as_set(self.plan, stored))


def open_run(path: str | os.PathLike[str]) -> Run:
    """Return the run in the run file ``path``, also one that is going on or was interrupted.

    Raises ``StoreError`` where it is none or its records are not those of its scene, ``SettingsError`` where its scene
    or bench file leads to no plan, and ``TypeError`` for what is no path.

    >>> open_run("bovine-muscle.h5").estimate().shots[0].estimates[0].amplitude_m
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"a run is taken as the path of a run file, not as {type(path).__name__}")
    stored = read_run(Path(path))
    bench = parse_bench(stored.bench_name, stored.bench_toml).bench
    scene = parse_scene(stored.scene_name, stored.scene_toml, stored=True).scene
    scene = with_transducers(with_scan_beside(scene, stored.path.parent), bench)
    if bench.simulated:
        scene = with_default_specimen(scene)
    plan, found = planned(scene, bench)
    stored.refuse_unlike(plan)
    plan = _as_set(plan, stored)
    if bench.recording is not None:
        plan = _at_imported_times(plan, stored)
    return Run(stored.path, scene, bench, plan, found, stored)


def _as_set(plan: Plan, stored: StoredRun) -> Plan:
    """Return ``plan`` with the forces that the generator really was set to, which rounds what it is sent."""
    pairs = zip(plan.shots, stored.force_set.tolist(), strict=True)
    shots = (replace(shot, force_fraction=force) if math.isfinite(force) else shot for shot, force in pairs)
    return replace(plan, shots=tuple(shots))


def _at_imported_times(plan: Plan, stored: StoredRun) -> Plan:
    """Return ``plan`` with its pulses when the file says that they were fired, in place of a regular train's times."""
    onset_s = stored.rows(0).tables["records/pulse_onset_s"]
    if not np.isfinite(onset_s).all():
        return plan
    shots = (replace(shot, timeline=replace(shot.timeline, pulse_onset_s=onset_s)) for shot in plan.shots)
    return replace(plan, shots=tuple(shots))


def process(
    path: Path, estimator: str | None = None, stages: Stages | None = None, profile_step_m: float | None = None
) -> Result:
    """Return the result of the run in ``path`` and write it beside the run file.

    ``profile_step_m``: also in gates so far apart over depth, whatever the scene says of such.
    """
    stages = stages or Stages()
    with stages("read"):
        run = open_run(path).with_profile(profile_step_m)
    result = run.estimate(estimator, stages)
    with stages("write result"):
        run.save(result)
    return result


def chosen_estimator(name: str | None, scene: Scene | None = None) -> Estimator:
    """Return the estimator of that name, or the scene's; raise ``SettingsError`` for a name that is none."""
    if name is None and scene is not None:
        return scene.processing.estimator
    asked = {"estimator": name}
    mistakes = mistakes_of(Processing, asked, ("processing",))
    if mistakes:
        raise SettingsError("estimator", mistakes)
    return Processing.model_validate(asked).estimator


def _with_estimator(scene: Scene, estimator: Estimator) -> Scene:
    """Return ``scene`` as if it had asked for ``estimator``."""
    return scene.model_copy(update={"processing": scene.processing.model_copy(update={"estimator": estimator})})


def phase_reference(scene: Scene) -> str:
    """Return in words what phase zero means; the way from transducer to gate is accounted for."""
    start = "the first toneburst's arrival at the gate" if scene.excitation else "the master trigger's edge"
    return f"of sin(2 pi f t + phase), the motion at the gate, with t from {start}"


def _shots(run: Run, estimator: Estimator) -> Estimates:
    from hpe_rig.prediction import beam_widths, predicted_averaging
    from hpe_rig.processing import NO_RECORDS, Estimates, estimate_run

    shots, without, places_m = list[ShotResult](), dict[int, str](), offsets_beside_m(run.plan)
    for scene, plan in places_of(run.scene, run.plan):
        try:
            averaging = predicted_averaging(scene, estimator, places_m)
            beams = beam_widths(scene, estimator, places_m)
        except ValueError as error:
            raise _no_estimate(run, str(error)) from error
        here = estimate_run(scene, plan, run.stored, estimator, averaging, beams)
        shots += here.shots
        without |= here.without
    swept = [point.values for point in run.scene.points]
    shots = [replace(shot, swept=swept[run.plan.shots[shot.shot].point]) for shot in shots]
    estimates = Estimates(tuple(shots), without)
    if estimates.shots:
        return estimates
    for why in estimates.without.values():
        if why != NO_RECORDS:
            raise _no_estimate(run, why)
    raise StoreError(
        f"{run.path} holds no records, the run is {run.stored.status}: it ended before the first came. "
        f"Try: hpe-rig resume {run.path}."
    )


def _profile(run: Run, estimator: Estimator) -> tuple[tuple[GateResult, ...], tuple[str, ...]]:
    """Return every shot at every gate over depth, and in words what has no result."""
    places_m = offsets_beside_m(run.plan)
    places = [
        _depth_profile(scene, plan, run.stored, estimator, places_m) for scene, plan in places_of(run.scene, run.plan)
    ]
    return tuple(each for found, _ in places for each in found), tuple(text for _, lost in places for text in lost)


def _depth_profile(
    scene: Scene, plan: Plan, stored: StoredRun, estimator: str, places_m: tuple[float, ...]
) -> tuple[list[GateResult], list[str]]:
    """Return what every gate over depth says of the shots of a place, and in words what has no result.

    The averaging over the beam is that of the focal plane, at the gate's own depth. Raises ``ValueError`` where no
    averaging can be predicted.
    """
    found, without = list[GateResult](), list[str]()
    gates = depth_gates(scene, plan.shots[0]) if plan.shots else ()
    if not gates:
        return found, without
    from hpe_rig.prediction import beam_widths, predicted_averaging
    from hpe_rig.processing import burst_period_motion, estimate_run

    # The truth that a twin stores is that of the focus.
    untold = replace(stored, true_displacement_m=None)
    for gate in gates:
        there = with_gate(scene, gate)
        shots = shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)
        averaging = predicted_averaging(there, estimator, places_m)
        beams = beam_widths(there, estimator, places_m)
        estimates = estimate_run(there, shots, untold, estimator, averaging, beams)
        motion = {shot.index: burst_period_motion(there, shot, stored) for shot in shots.shots}
        for shot in estimates.shots:
            time_s, moved_m = (values.tolist() for values in motion[shot.shot])
            trusted = replace(shot, motion=None, untrusted=stored.untrusted.get(shot.shot, ""))
            found.append(GateResult(gate.depth_m, gate.length_m, trusted, tuple(time_s), tuple(moved_m)))
        where = f"gate at {gate.depth_m * 1e3:.4g} mm, shot"
        without += [f"{where} {shot + 1} left out: {why}" for shot, why in estimates.without.items()]
    return found, without


def _no_estimate(run: Run, why: str) -> StoreError:
    return StoreError(f"{run.path} cannot be estimated ({why}). Try: another estimator, or more records.")


def _warnings(run: Run, estimates: Estimates) -> Iterator[str]:
    """Yield what a reader of the result must know of the whole run."""
    yield from (str(finding) for finding in run.findings if finding.level != "passed")
    yield from run.stored.damage
    yield from _scan_warnings(run)
    # The board cannot say which record it was; where some are skipped the gate's own codes decide.
    for shot in run.stored.clipped if run.scene.tracking.disturbed != "skip" else ():
        yield (
            f"shot {shot + 1}: the digitizer's input left its range of "
            f"{run.plan.shots[shot].capture.input_range_v:g} V, in "
            "the gate or outside it: raise acquisition.input_range_v"
        )
    for shot, why in run.stored.untrusted.items():
        yield f"shot {shot + 1} is not to be trusted: {why}"
    if run.stored.status != "complete":
        complete = run.stored.shot_complete
        yield f"the run is {run.stored.status}: {int(complete.sum())} of {complete.size} shots are complete"
    yield from incomplete_warnings(estimates)


def _scan_warnings(run: Run) -> Iterator[str]:
    """Yield what became of the file that `beams.excitation_scan` named when the run was measured."""
    if not run.stored.scan_sha256:
        return
    try:
        same = run.stored.scan_sha256 == sha256_of_scan(run.scene)
    except OSError as error:
        # Where nothing pushes nobody has asked for it before.
        yield (
            f"beams.excitation_scan: the file cannot be read ({unreadable(error)}), so nothing tells whether it is "
            "still the one that was there when the run was measured; put it where it was, or beside the run file"
        )
        return
    if not same:
        yield (
            "beams.excitation_scan: the file is no longer the one that was there when the run was measured; what is "
            "corrected and fitted goes by what it holds now"
        )


def incomplete_warnings(estimates: Estimates) -> Iterator[str]:
    """Yield which shots have no result, and why, and which have one from a part of their records."""
    for why in dict.fromkeys(estimates.without.values()):
        yield f"shot {_numbers(shot for shot, reason in estimates.without.items() if reason == why)} left out: {why}"
    if partial := dict.fromkeys(shot.shot for shot in estimates.shots if not shot.complete):
        yield f"shot {_numbers(partial)} is incomplete, estimated from the records that had arrived"


def _numbers(shots: Iterable[int]) -> str:
    """Return the numbers of ``shots`` for a reader, who counts from 1."""
    numbers = [shot + 1 for shot in shots]
    in_a_row = len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1
    return f"{numbers[0]} to {numbers[-1]}" if in_a_row else ", ".join(map(str, numbers))
