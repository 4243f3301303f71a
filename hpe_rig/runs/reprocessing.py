"""Reprocessing of a stored run with other processing settings, or at several values of one; nothing is acquired."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from hpe_rig.bench import BenchFile
from hpe_rig.plan import CheckResult, Plan, check_plan, make_plan, refuse_conflicts
from hpe_rig.result import Result
from hpe_rig.scene import Axis, Mistake, Scene, SettingsError, with_default_specimen

GATE_KEYS = ("acquisition.gate_depth_m", "acquisition.gate_length_m")
PROCESSING_SECTIONS = ("processing", "beams")
PROFILE_KEY = "processing.gate_profile_step_m"
PROCESSING_TIMES = ("gate_offset_s", "reference_offset_s", "push_delay_s")
"""Times of a shot that depend on gates and beams, and not on the acquisition."""
Text = TypeVar("Text")


def points_of(scene: Scene, axes: Sequence[Axis], together: bool, source: str) -> list[Mapping[str, float]]:
    """Return the values, by key, at every point of ``axes``.

    ``together`` combines the n-th values of all axes, else each value is combined with each. Raises ``SettingsError``
    about the run file ``source`` for axes that vary the acquisition and for invalid values.
    """
    # Windows that the scene sweeps would count as another axis. They are dropped: see `_without_other_windows`.
    sweep = type(scene.sweep)(**scene.sweep.model_dump(exclude={"window_length_s"}, exclude_unset=True))
    values = {axis.name: list(axis.labels) for axis in axes}
    swept = {"sweep.axes": values, "sweep.combine": "zip" if together else "product"}
    points = scene.model_copy(update={"sweep": sweep}).with_(swept).points
    if PROFILE_KEY in points[0].values:
        remedy = "values of acquisition.gate_depth_m"
        raise SettingsError(source, [Mistake(f"sweep.{PROFILE_KEY}", "a sweep has no depth profile", remedy)])
    return [point.values for point in points]


def reprocessed(
    scene: Scene, bench: BenchFile, plan: Plan, values: Mapping[str, Any], source: str
) -> tuple[Scene, Plan, tuple[CheckResult, ...]]:
    """Return scene, plan and findings of a stored run with the processing settings ``values``.

    Raises ``SettingsError`` about the run file ``source`` for settings of the acquisition, and ``PlanError`` or
    ``SettingsError`` if the records do not contain the window or gate.
    """
    varied = scene.with_(values)
    _refuse_acquisition_keys(values, source)
    if "processing.window_length_s" in values:
        # It replaces the list of windows.
        varied = varied.model_copy(update={"sweep": varied.sweep.model_copy(update={"window_length_s": ()})})
    if bench.simulated:
        varied = with_default_specimen(varied)
    varied_plan = _with_gates_of(make_plan(varied, bench), plan, scene, source)
    findings = tuple(check_plan(varied, bench, varied_plan))
    refuse_conflicts(findings)
    return varied, varied_plan, findings


def without_gates_over_depth(scene: Scene) -> Scene:
    """Return the scene with its main gate only."""
    processing = scene.processing.model_copy(update={"gate_profile_step_m": None, "gates": ()})
    return scene.model_copy(update={"processing": processing})


def _refuse_acquisition_keys(keys: Iterable[str], source: str) -> None:
    """Raise ``SettingsError`` for every key that changes how records are acquired."""
    what = "cannot change after the measurement: the records hold one value"
    sections = "], [".join(PROCESSING_SECTIONS)
    remedy = f"keys of [{sections}], {' or '.join(GATE_KEYS)}; hpe-rig run measures again, also a [sweep]"
    mistakes = [
        Mistake(key, what, remedy)
        for key in keys
        if key not in GATE_KEYS and key.partition(".")[0] not in PROCESSING_SECTIONS
    ]
    if mistakes:
        raise SettingsError(source, mistakes)


def _with_gates_of(varied: Plan, plan: Plan, scene: Scene, source: str) -> Plan:
    """Return ``plan`` with the gates of the plan ``varied``; raise ``SettingsError`` if they leave the records."""
    shots = tuple(
        replace(
            shot,
            timeline=replace(shot.timeline, **{name: getattr(varied_shot.timeline, name) for name in PROCESSING_TIMES}),
        )
        for shot, varied_shot in zip(plan.shots, varied.shots, strict=True)
    )
    outside = [shot for shot in shots if shot.gate.start < 0 or shot.gate.stop > shot.capture.record_samples]
    if outside:
        # Depth is half the travelled distance.
        half_speed = scene.acquisition.sound_speed_m_per_s / 2
        start_mm, end_mm = (1e3 * half_speed * offset_s for offset_s in outside[0].timeline.record_offset_s)
        what = f"a gate leaves the records, which go from {start_mm:.4g} to {end_mm:.4g} mm"
        raise SettingsError(source, [Mistake("acquisition.gate_depth_m", what, "a depth or length inside")])
    return replace(plan, shots=shots)


def combine_results(results: Sequence[tuple[Mapping[str, float], Result]], failures: Mapping[str, str]) -> Result:
    """Return the ``results`` at several points, with the values of each, as one result.

    Each warning occurs once, with the points that it concerns unless it concerns all. ``failures`` are the errors of
    points without a result, by the text of the point.
    """
    # A run may have been measured as a sweep: its values are kept.
    shots = (replace(shot, swept={**shot.swept, **values}) for values, result in results for shot in result.shots)
    warnings = [(text, values) for values, result in results for text in result.warnings]
    without = [
        (shot_and_reason, values) for values, result in results for shot_and_reason in result.shots_without_result
    ]
    return replace(
        results[0][1],
        shots=tuple(shots),
        warnings=(
            *(f"{where}{text}" for text, where in _with_points(warnings, len(results))),
            *(f"at {point}: {error}" for point, error in failures.items()),
        ),
        shots_without_result=tuple(
            (shot, f"{where}{why}") for (shot, why), where in _with_points(without, len(results))
        ),
        profile=(),
    )


def _with_points(
    occurrences: Sequence[tuple[Text, Mapping[str, float]]], point_count: int
) -> Iterator[tuple[Text, str]]:
    """Yield each item once, with the text "at <its points>: ", or "" if it occurs at all points."""
    points_of = dict[Text, list[str]]()
    for item, values in occurrences:
        points_of.setdefault(item, []).append(point_text(values))
    for item, points in points_of.items():
        yield item, "" if len(points) == point_count else f"at {'; '.join(points)}: "


def point_text(values: Mapping[str, float]) -> str:
    """Return "KEY = VALUE, ..."."""
    return ", ".join(f"{key} = {value:g}" for key, value in values.items())
