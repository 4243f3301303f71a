"""Sweep over what is made of records that are there: a stored run, measured or imported, at every value of the axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from hpe_rig.plan import Plan, check_plan, make_plan, refuse_conflicts
from hpe_rig.result import Result
from hpe_rig.runs.run import Run
from hpe_rig.scene import Mistake, Scene, ScenePoint, SettingsError, with_default_specimen
from hpe_rig.store import StoreError

PROCESSED = ("acquisition.gate_depth_m", "acquisition.gate_length_m")
PROCESSED_SECTIONS = ("processing", "beams")
"""Keys, and sections of keys, that only say what is made of records."""
What = TypeVar("What")
PROFILE = "processing.gate_profile_step_m"


@dataclass(frozen=True, slots=True)
class StoredPoint:
    """A run as if its scene had asked for the ``values`` of one point."""

    values: Mapping[str, float]
    run: Run


def estimate_over(
    run: Run, axes: Mapping[str, Sequence[float]], estimator: str | None = None, together: bool = False
) -> Result:
    """Return the estimates of ``run`` at every point of ``axes``, of the same records, a row a shot and point.

    Every point is checked before the first is estimated. Raises ``SettingsError`` with every axis that is no number of
    the processing and every value that cannot be, ``PlanError`` where a point's window or gate is not in the records,
    and ``StoreError`` where no point carries an estimate.
    """
    return estimate_points(points_over(run, axes, together), estimator)


def points_over(run: Run, axes: Mapping[str, Sequence[float]], together: bool = False) -> tuple[StoredPoint, ...]:
    """Return ``run`` at every point of ``axes``, all checked; raises as ``estimate_over``."""
    return tuple(_points(run, axes, together))


def estimate_points(points: Sequence[StoredPoint], estimator: str | None = None) -> Result:
    """Return the estimates at all ``points`` as one result; raise ``StoreError`` where none carries an estimate."""
    found, lost = list[tuple[StoredPoint, Result]](), list[str]()
    for point in points:
        try:
            found.append((point, point.run.estimate(estimator)))
        except StoreError as error:
            if len(points) == 1:
                raise
            lost.append(f"at {_words(point.values)}: {error}")
    if not found:
        raise StoreError("; ".join(lost))
    first = found[0][1]
    shots = (replace(shot, swept={**shot.swept, **point.values}) for point, result in found for shot in result.shots)
    said = [(text, point) for point, result in found for text in result.warnings]
    without = [(pair, point) for point, result in found for pair in result.shots_without_result]
    return replace(
        first,
        shots=tuple(shots),
        warnings=(*(f"{where}{text}" for text, where in _where(said, len(found))), *lost),
        shots_without_result=tuple((at, f"{where}{why}") for (at, why), where in _where(without, len(found))),
        profile=(),
    )


def _where(said: Sequence[tuple[What, StoredPoint]], points: int) -> Iterator[tuple[What, str]]:
    """Yield each of what was ``said`` once, and the points that say it, in words; none where all do."""
    by = dict[What, list[str]]()
    for what, point in said:
        by.setdefault(what, []).append(_words(point.values))
    for what, places in by.items():
        yield what, "" if len(places) == points else f"at {'; '.join(places)}: "


def parse_axes(texts: Sequence[str]) -> dict[str, list[float]]:
    """Return axes from options such as "gate_length_m=0.5e-3,1e-3"; raise ``SettingsError`` with all that are none."""
    found: dict[str, list[float]] = {}
    mistakes = []
    for text in texts:
        name, _, listed = text.partition("=")
        try:
            values = [float(each) for each in listed.split(",")]
        except ValueError:
            mistakes.append(Mistake("--sweep", f"{text!r} is no axis", "KEY=NUMBER,NUMBER without spaces"))
            continue
        if name in found:
            mistakes.append(Mistake("--sweep", f"{name} is given twice", "all its values at once"))
        found[name] = values
    if mistakes:
        raise SettingsError("command line", mistakes)
    return found


def _points(run: Run, axes: Mapping[str, Sequence[float]], together: bool) -> Iterator[StoredPoint]:
    taken = {"sweep.axes": dict(axes), "sweep.combine": "zip" if together else "product"}
    # windows that the run's scene takes in turn stand for another axis than the window's: see `_one_estimate`
    sweep = type(run.scene.sweep)(**run.scene.sweep.model_dump(exclude={"window_length_s"}, exclude_unset=True))
    asked = run.scene.model_copy(update={"sweep": sweep}).with_(taken).points
    _refuse_acquired(asked[0], run.path.name)
    for point in asked:
        scene = _one_estimate(run.scene.with_(point.values), point.values)
        if run.bench.simulated:
            scene = with_default_specimen(scene)
        plan = _regated(run, make_plan(scene, run.bench))
        findings = tuple(check_plan(scene, run.bench, plan))
        refuse_conflicts(findings)
        yield StoredPoint(point.values, replace(run, scene=scene, plan=plan, findings=findings))


def _one_estimate(scene: Scene, values: Mapping[str, float]) -> Scene:
    """Return the scene without gates over depth, and without a list of windows where ``values`` have the window."""
    processing = scene.processing.model_copy(update={"gate_profile_step_m": None, "gates": ()})
    sweep = scene.sweep
    if "processing.window_length_s" in values:
        sweep = sweep.model_copy(update={"window_length_s": ()})
    return scene.model_copy(update={"processing": processing, "sweep": sweep})


def _refuse_acquired(point: ScenePoint, source: str) -> None:
    """Raise ``SettingsError`` for every axis that says how records are taken: those of ``source`` have been."""
    mistakes = [
        Mistake(f"sweep.{name}", "the records are there, and were taken with one value of it", _REMEDY)
        for name in point.values
        if name not in PROCESSED and name.partition(".")[0] not in PROCESSED_SECTIONS
    ]
    if PROFILE in point.values:
        what = "no depth profile is made at the points of a sweep"
        mistakes.append(Mistake(f"sweep.{PROFILE}", what, "values of acquisition.gate_depth_m"))
    if mistakes:
        raise SettingsError(source, mistakes)


_REMEDY = f"numbers of [{'], ['.join(PROCESSED_SECTIONS)}], {' or '.join(PROCESSED)}; hpe-rig run measures a [sweep]"


_OF_SCENE = ("gate_offset_s", "reference_offset_s", "push_later_s")
"""What of a shot's instants gates and beams say, and no instrument."""


def _regated(run: Run, asked: Plan) -> Plan:
    """Return the run's plan with the gates of the ``asked`` one; raise where they are not in the records."""
    shots = tuple(
        replace(shot, timeline=replace(shot.timeline, **{name: getattr(other.timeline, name) for name in _OF_SCENE}))
        for shot, other in zip(run.plan.shots, asked.shots, strict=True)
    )
    outside = [s for s in shots if s.gate.start < 0 or s.gate.stop > s.capture.record_samples]
    if outside:
        half_speed = run.scene.acquisition.sound_speed_m_per_s / 2
        start_mm, end_mm = (1e3 * half_speed * offset_s for offset_s in outside[0].timeline.record_offset_s)
        what = f"a gate leaves the records, which go from {start_mm:.4g} to {end_mm:.4g} mm"
        raise SettingsError(run.path.name, [Mistake("acquisition.gate_depth_m", what, "a depth or length inside")])
    return replace(run.plan, shots=shots)


def _words(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())
