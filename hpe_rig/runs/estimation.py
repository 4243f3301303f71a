"""Estimates from stored records: amplitude and phase of every shot, and of every gate over depth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hpe_rig.plan import DepthGate, Plan, depth_gates, off_axis_offsets_m, plans_at_offsets, shots_with_gate, with_gate
from hpe_rig.result import GateResult, ShotResult
from hpe_rig.scene import Estimator, Processing, Scene, SettingsError, mistakes_of
from hpe_rig.store import MARKED_BAD, StoredRun, StoreError

if TYPE_CHECKING:
    from hpe_rig.processing import Estimates


def chosen_estimator(name: str | None, scene: Scene | None = None) -> Estimator:
    """Return the estimator ``name``, or the scene's for None; raise ``SettingsError`` if it does not exist."""
    if name is None and scene is not None:
        return scene.processing.estimator
    settings = {"estimator": name}
    mistakes = mistakes_of(Processing, settings, ("processing",))
    if mistakes:
        raise SettingsError("estimator", mistakes)
    return Processing.model_validate(settings).estimator


def estimate_shots(scene: Scene, plan: Plan, stored: StoredRun, estimator: Estimator) -> Estimates:
    """Return the estimates of every shot; raise ``StoreError`` if no shot has one."""
    from hpe_rig.prediction import beam_widths, predicted_averaging
    from hpe_rig.processing import NO_RECORDS, Estimates, estimate_run

    shots, failures, lateral_offsets_m = list[ShotResult](), dict[int, str](), off_axis_offsets_m(plan)
    for place_scene, place_plan in plans_at_offsets(scene, plan):
        try:
            averaging = predicted_averaging(place_scene, estimator, lateral_offsets_m)
            beams = beam_widths(place_scene, estimator, lateral_offsets_m)
        except ValueError as error:
            raise no_estimate(stored, str(error)) from error
        estimates = estimate_run(place_scene, place_plan, stored, estimator, averaging, beams)
        shots += estimates.shots
        failures |= estimates.failures
    # The estimates know their shot; the plan knows its point of the sweep.
    swept = [point.values for point in scene.points]
    shots = [replace(shot, swept=swept[plan.shots[shot.index].point]) for shot in shots]
    if shots:
        return Estimates(tuple(shots), failures)
    # No shot has an estimate. Report the first reason other than missing records.
    for why in failures.values():
        if why.startswith(MARKED_BAD):
            remedy = "hpe-rig mark RUN.h5 SHOT --good, which takes a mark back"
            raise StoreError(f"{stored.path} has no shot left, one of them {why}. Try: {remedy}.")
        if why != NO_RECORDS:
            raise no_estimate(stored, why)
    raise StoreError(
        f"{stored.path} holds no records, the run is {stored.status}: it ended before the first came. "
        f"Try: hpe-rig resume {stored.path}."
    )


def no_estimate(stored: StoredRun, why: str) -> StoreError:
    """Return the error of a run without estimates."""
    from hpe_rig.processing import DAMAGED

    remedy = "another estimator, or more records"
    if DAMAGED in why:
        remedy = "another copy of the file, or hpe-rig resume, which measures damaged shots again"
    return StoreError(f"{stored.path} cannot be estimated ({why}). Try: {remedy}.")


def estimate_profile(
    scene: Scene, plan: Plan, stored: StoredRun, estimator: Estimator
) -> tuple[list[GateResult], list[str]]:
    """Return the estimates of every shot at every gate over depth, and a text for each shot and gate without one.

    The beam averaging of the focal plane is assumed at all depths. Raises ``ValueError`` if it cannot be predicted.
    """
    gates, failures = list[GateResult](), list[str]()
    lateral_offsets_m = off_axis_offsets_m(plan)
    # The true displacement stored by the twin belongs to the focus.
    stored = replace(stored, true_displacement_m=None)
    for place_scene, place_plan in plans_at_offsets(scene, plan):
        for gate in depth_gates(place_scene, place_plan.shots[0]) if place_plan.shots else ():
            results, texts = _estimate_gate(gate, place_scene, place_plan, stored, estimator, lateral_offsets_m)
            gates += results
            failures += texts
    return gates, failures


def _estimate_gate(
    gate: DepthGate,
    scene: Scene,
    plan: Plan,
    stored: StoredRun,
    estimator: Estimator,
    lateral_offsets_m: tuple[float, ...],
) -> tuple[list[GateResult], list[str]]:
    """Return the estimates of the shots of ``plan`` at one gate, and a text for each shot without one."""
    from hpe_rig.prediction import beam_widths, predicted_averaging
    from hpe_rig.processing import burst_period_motion, estimate_run

    # The shots are estimated as if this gate were the only one.
    scene = with_gate(scene, gate)
    plan = shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)
    averaging = predicted_averaging(scene, estimator, lateral_offsets_m)
    beams = beam_widths(scene, estimator, lateral_offsets_m)
    estimates = estimate_run(scene, plan, stored, estimator, averaging, beams)
    motion = {shot.index: burst_period_motion(scene, shot, stored) for shot in plan.shots if not shot.is_control}
    gates = []
    for shot in estimates.shots:
        time_s, displacement_m = (values.tolist() for values in motion[shot.index])
        shot_result = replace(shot, motion=None, influences=())
        gates.append(GateResult(gate.depth_m, gate.length_m, shot_result, tuple(time_s), tuple(displacement_m)))
    where = f"gate at {gate.depth_m * 1e3:.4g} mm, shot"
    return gates, [
        f"{where} {shot + 1} left out: {why}" for shot, why in estimates.failures.items() if shot not in stored.marks
    ]
