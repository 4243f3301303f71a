"""Stored run: opened from its run file, planned again, estimated, swept over its processing settings."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import BenchFile
from hpe_rig.measurement import setup_of_run
from hpe_rig.plan import (
    CheckResult,
    Plan,
    gates_over_depth,
    omissions,
    phase_definition,
    plans_at_offsets,
    reference_gate,
    refuse_conflicts,
    scene_of_shot,
    select,
)
from hpe_rig.result import Result, Stages
from hpe_rig.runs.arguments import require_axes, require_numbers
from hpe_rig.runs.checked_scene import plan_html
from hpe_rig.runs.estimation import chosen_estimator, estimate_profile, estimate_shots
from hpe_rig.runs.result_warnings import condition_summaries, condition_warnings, conditions_of_shot, run_warnings
from hpe_rig.scene import Axis, Estimator, Mistake, Processing, Scene, SettingsError, mistakes_of
from hpe_rig.store import (
    StoredRecords,
    StoredRun,
    StoreError,
    read_run,
    recover,
    refuse_unwritable,
    result_path,
    versions,
    write_result,
)

if TYPE_CHECKING:
    from hpe_rig.processing import EchoGate


@dataclass(frozen=True, slots=True)
class Run:
    """A stored run. Its records are read on demand, so that a long run needs little memory.

    ``findings``: of the checks of its plan; ``stored``: content of the file when it was opened, with the texts of scene
    and bench file; ``changes``: values of settings that replace those of the stored scene, by their full path.

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
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def records(self) -> StoredRecords:
        """The digitizer's codes of every shot, each int16 (pulse, sample), with their scale to volts."""
        return self.stored.records

    def __repr__(self) -> str:
        """Return path, title and state; the texts and the plan would fill a screen."""
        return f"<Run {str(self.path)!r}: {self.scene.title!r}, {self._state}>"

    @property
    def _state(self) -> str:
        complete, simulated = self.stored.shot_complete, ", simulated" if self.stored.simulated else ""
        return f"{self.stored.status}, {int(complete.sum())} of {complete.size} shots{simulated}"

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: state, timing of the first shot, checks of the plan. Nothing is estimated."""
        return plan_html(self.scene.title, f"{self.path}: {self._state}", self.plan.shots[0], self.findings)

    def displacement_m(self, shot: int = 0) -> FloatArray:
        """Return the displacement of every tracking pulse of ``shot``, counted from 0; (pulse,), m.

        It is known up to a constant, estimated by the scene's estimator from the whole train, and positive away from
        the transducer, at the times ``plan.shots[shot].timeline.sensing_s``. It is NaN for missing records and omitted
        pulses. Raises ``IndexError`` if the shot does not exist, ``ValueError`` if no displacement can be estimated.
        """
        from hpe_rig.processing import coherent, relative_to, shot_motion, spec_of

        require_numbers("displacement_m", whole=True, shot=shot)
        count = len(self.plan.shots)
        if not -count <= shot < count:
            raise IndexError(f"shot {shot} does not exist: the run has {count}, counted from 0")
        scene = scene_of_shot(self.scene, self.plan.shots[shot])
        estimator = spec_of(scene.processing.estimator)
        motion = shot_motion(scene, self.plan.shots[shot], self._echoes(shot), estimator.motion)
        # With a reference gate the displacement is relative to the motion in that gate.
        reference = reference_gate(scene, self.plan.shots[shot])
        if reference is not None:
            motion = relative_to(motion, coherent(self._echoes(shot, reference)))
        return motion.displacement_m

    def estimate(self, estimator: str | None = None, stages: Stages | None = None) -> Result:
        """Return amplitude and phase of every shot, by ``estimator`` or the scene's.

        ``stages`` records the wall time. Raises ``SettingsError`` for an unknown estimator, and ``StoreError`` if the
        records allow no estimate.
        """
        stages = stages or Stages()
        stages.come_after(self.stored.run_time_s)
        name = chosen_estimator(estimator, self.scene)
        with stages("process"):
            estimates = estimate_shots(self.scene, self.plan, self.stored, name)
            gates, gate_failures = estimate_profile(self.scene, self.plan, self.stored, name)
        warnings = run_warnings(self.scene, self.plan, self.findings, self.stored, estimates)
        return Result(
            title=self.scene.title,
            run_file=self.path.name,
            simulated=self.stored.simulated,
            status=self.stored.status,
            estimator=name,
            phase_reference=phase_definition(self.scene, imported=self.bench.recording is not None),
            shots=tuple(
                replace(shot, conditions=conditions_of_shot(self.stored, shot.index)) for shot in estimates.shots
            ),
            warnings=(
                *self._changes_in_words(),
                *warnings,
                *condition_warnings(self.bench, self.stored),
                *gate_failures,
            ),
            conditions=condition_summaries(self.bench, self.stored),
            omitted=(*omissions(_with_estimator(self.scene, name), self.bench), *self._omitted_truth()),
            versions=versions(),
            run_time_s=stages.run_time_s,
            simulated_specimen=self.scene.default_specimen,
            shots_without_result=tuple((index + 1, why) for index, why in estimates.failures.items()),
            imported=None if self.bench.recording is None else self.bench.recording.words,
            notes=self.scene.notes,
            provenance=self.stored.provenance,
            profile=tuple(gates),
        )

    def _changes_in_words(self) -> Iterator[str]:
        if self.changes:
            values = ", ".join(f"{key} = {value}" for key, value in self.changes.items())
            yield f"estimated with other settings than the scene's: {values}"

    def _omitted_truth(self) -> Iterator[tuple[str, str]]:
        if self.stored.simulated and self.stored.true_displacement_m is None:
            yield "comparison with true values", "the run file holds those of other frequencies or another depth"

    def sweep(
        self, axes: Mapping[str, Sequence[float]], *, together: bool = False, estimator: str | None = None
    ) -> Result:
        """Return the estimates at every value of the ``axes`` from the stored records; nothing is acquired.

        ``axes``: values by the key of a number of [processing] or [beams], or of the gate. Each value is combined with
        each; with ``together`` the n-th values of all axes are combined. All points are checked before the first is
        estimated. Raises ``SettingsError`` for other keys and invalid values, ``PlanError`` if the records do not
        contain a window or gate, and as ``estimate``.

        >>> run.sweep({"gate_length_m": [0.5e-3, 1e-3]}).to_frame()[["acquisition.gate_length_m", "amplitude_m"]]
        """
        require_axes(axes)
        points = points_over(self, [Axis.of_key(key, values) for key, values in axes.items()], together)
        return estimate_points(points, estimator)

    def with_(self, values: Mapping[str, Any]) -> Run:
        """Return the run with other settings, by their full path, of [processing], [beams] or the gate.

        Its results state the ``values`` in a warning. Raises as ``sweep``.

        >>> open_run("bovine-muscle.h5").with_({"processing.harmonic": "kalman"}).estimate()
        """
        changed = replace(self, changes={**self.changes, **values})
        return changed._reprocessed(values) if values else self

    def with_drift(self, drift: str | None) -> Run:
        """Return the run with another processing.drift: the earlier name of ``with_``, with a warning."""
        warn("with_drift is with_({'processing.drift': ...}) since version 1.0", FutureWarning, stacklevel=2)
        return self if drift is None else self.with_({"processing.drift": drift})

    def _reprocessed(self, values: Mapping[str, Any]) -> Run:
        from hpe_rig.runs.reprocessing import reprocessed

        scene, plan, findings = reprocessed(self.scene, self.bench, self.plan, values, self.path.name)
        stored, frequencies_hz = self.stored, scene.wanted_frequencies_hz
        # The file holds true amplitudes and phases at the frequencies and the gate depth that it was measured with.
        same_depth = scene.acquisition.gate_depth_m == self.scene.acquisition.gate_depth_m
        if not same_depth or frequencies_hz != self.scene.wanted_frequencies_hz[: len(frequencies_hz)]:
            stored = replace(stored, true_displacement_m=None)
        return replace(self, scene=scene, plan=plan, findings=findings, stored=stored)

    def with_profile(self, step_m: float | None) -> Run:
        """Return the run with gates every ``step_m`` over the depth of its records; None returns it unchanged.

        Raises ``PlanError`` if the gates do not fit into the records, and ``SettingsError`` for an invalid step.
        """
        if step_m is None:
            return self
        settings = {"gate_profile_step_m": step_m}
        if mistakes := mistakes_of(Processing, settings, ("processing",)):
            raise SettingsError("gate profile", mistakes)
        if self.scene.processing.follow_gate:
            what = "gates over depth are fixed, and processing.follow_gate moves the gate"
            raise SettingsError("gate profile", [Mistake("processing.follow_gate", what, "a run without it")])
        if self.scene.sphere is not None:
            what = "gates over depth measure the medium, and its motion differs from that of the sphere"
            raise SettingsError("gate profile", [Mistake("sphere", what, "a run of the medium without a sphere")])
        processing = self.scene.processing.model_copy(update=settings | {"gates": ()})
        scene = self.scene.model_copy(update={"processing": processing})
        findings = dict.fromkeys(
            finding
            for place_scene, place_plan in plans_at_offsets(scene, self.plan)
            for finding in gates_over_depth(place_scene, self.bench, place_plan)
        )
        refuse_conflicts(list(findings))
        return replace(self, scene=scene)

    def save(self, result: Result) -> Path:
        """Write ``result`` to the folder of the run file, replacing one of the same estimator, and return its path."""
        path = result_path(self.path, result.estimator)
        write_result(path, result, self.identity)
        return path

    def mark(self, shot: int, bad: str | None) -> Run:
        """Mark ``shot``, counted from 0, as bad for the reason ``bad``, or as good for None; return the run with it.

        Results leave a bad shot out. The marks are in RUN.marks.json, the run file stays unchanged. Raises
        ``IndexError`` if the shot does not exist, and ``StoreError`` if the marks cannot be written.
        """
        if not 0 <= shot < len(self.plan.shots):
            raise IndexError(f"shot {shot} does not exist: the run has {len(self.plan.shots)}, counted from 0")
        read_run(self.path).mark([shot], bad)
        return self.refreshed()

    def _echoes(self, shot: int, gate: slice | None = None) -> EchoGate:
        """Return the echoes of every pulse of ``shot``, (pulse, sample), also outside the processing window."""
        from hpe_rig.processing import assign_pulses, margin_needed, samples_needed, shot_echoes

        whole_train = {"window_start_s": 0.0, "window_length_s": None}
        planned_shot = self.plan.shots[shot]
        scene = scene_of_shot(self.scene, planned_shot)
        unwindowed = scene.model_copy(update={"processing": scene.processing.model_copy(update=whole_train)})
        samples = gate or samples_needed(scene, planned_shot)
        placement = assign_pulses(planned_shot, self.stored).placement
        records = self.records.gated(shot, samples, margin=margin_needed(scene, planned_shot), placement=placement)
        return shot_echoes(unwindowed, planned_shot, records, select(unwindowed, planned_shot))

    @property
    def identity(self) -> str:
        """Hexadecimal digits that differ between two runs, also of one scene into one file."""
        return self.stored.digest

    def refreshed(self) -> Run:
        """Read the run file again, for a run that is still being written; another run in its place is opened."""
        stored = read_run(self.path)
        if stored.digest != self.identity:
            return open_run(self.path)
        # Scene, plan and whether there are true values for it stay the same while records arrive.
        if self.stored.true_displacement_m is None:
            stored = replace(stored, true_displacement_m=None)
        return replace(self, stored=stored, plan=_with_stored_forces(self.plan, stored))


def open_run(path: str | os.PathLike[str]) -> Run:
    """Return the run in the run file ``path``, which may be unfinished.

    The log of a killed run becomes a run file in HDF5 first, where the folder can be written.
    Raises ``StoreError`` if it is no run file or its records do not fit its scene, ``SettingsError`` if scene and bench
    file lead to no plan, and ``TypeError`` if ``path`` is no path.

    >>> open_run("bovine-muscle.h5").estimate().shots[0].estimates[0].amplitude_m
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"expected the path of a run file, not {type(path).__name__}")
    recover(Path(path))
    stored = read_run(Path(path))
    setup = setup_of_run(stored)
    plan = _with_stored_forces(setup.plan, stored)
    if setup.bench.bench.recording is not None:
        plan = _with_stored_times(plan, stored)
    return Run(stored.path, setup.scene.scene, setup.bench.bench, plan, setup.findings, stored)


def _with_stored_forces(plan: Plan, stored: StoredRun) -> Plan:
    """Return ``plan`` with the forces read back: the generator rounds its amplitude."""
    pairs = zip(plan.shots, stored.force_set.tolist(), strict=True)
    shots = (replace(shot, force_fraction=force) if math.isfinite(force) else shot for shot, force in pairs)
    return replace(plan, shots=tuple(shots))


def _with_stored_times(plan: Plan, stored: StoredRun) -> Plan:
    """Return ``plan`` with the pulse times of an imported recording, if it states them."""
    # All shots of a recording have the times of the first one.
    onset_s = stored.rows(0)["records/pulse_onset_s"]
    if not np.isfinite(onset_s).all():
        return plan
    shots = (replace(shot, timeline=replace(shot.timeline, pulse_onset_s=onset_s)) for shot in plan.shots)
    return replace(plan, shots=tuple(shots))


def process(
    path: Path,
    estimator: str | None = None,
    stages: Stages | None = None,
    profile_step_m: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Result:
    """Return the result of the run in ``path`` and write it to the folder of the run file.

    ``profile_step_m``: step of additional gates over depth; it replaces the gates of the scene. ``settings``: values
    instead of the scene's, as for ``Run.with_``.
    """
    stages = stages or Stages()
    with stages("read"):
        run = open_run(path).with_(settings or {}).with_profile(profile_step_m)
    refuse_unwritable(result_path(path, chosen_estimator(estimator, run.scene)))
    result = run.estimate(estimator, stages)
    with stages("write result"):
        run.save(result)
    return result


def points_over(run: Run, axes: Sequence[Axis], together: bool = False) -> list[tuple[Mapping[str, float], Run]]:
    """Return the values, by key, at every point of ``axes``, and ``run`` with them; raises as ``Run.sweep``."""
    from hpe_rig.runs.reprocessing import points_of, without_gates_over_depth

    points = points_of(run.scene, axes, together, run.path.name)
    one_gate = replace(run, scene=without_gates_over_depth(run.scene))
    # All points are checked before the first one is estimated.
    return [(values, one_gate._reprocessed(values)) for values in points]


def estimate_points(points: Sequence[tuple[Mapping[str, float], Run]], estimator: str | None = None) -> Result:
    """Return the estimates at all points of ``points_over`` as one result; raise ``StoreError`` if there are none."""
    from hpe_rig.runs.reprocessing import combine_results, point_text

    results, failures = list[tuple[Mapping[str, float], Result]](), dict[str, str]()
    for values, run in points:
        try:
            results.append((values, run.estimate(estimator)))
        except StoreError as error:
            if len(points) == 1:
                raise
            failures[point_text(values)] = str(error)
    if not results:
        raise StoreError("; ".join(f"at {point}: {error}" for point, error in failures.items()))
    return combine_results(results, failures)


def _with_estimator(scene: Scene, estimator: Estimator) -> Scene:
    return scene.model_copy(update={"processing": scene.processing.model_copy(update={"estimator": estimator})})
