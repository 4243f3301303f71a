"""Points of a sweep over any numbers: the scene at each, and what of the bench file differs there."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from hpe_rig.scene.keys import Key, Number, keys_of, resolve, with_values
from hpe_rig.scene.scene import Scene, Sweep, plain_tables
from hpe_rig.scene.validation import STORED, KeyPath, Mistake, SettingsError, mistakes_of, path_of

MOST_POINTS = 1000
IN_TURN: Mapping[str, str] = {
    "tracking.pulse_rate_hz": "pulse_rate_hz",
    "processing.window_length_s": "window_length_s",
    "tracking.lateral_offset_m": "lateral_offset_m",
    "tracking.axial_offset_m": "axial_offset_m",
}
"""Keys in whose place [sweep] takes values in turn, and the key of [sweep] that has these."""
BENCH = "bench."
"""Beginning of the name of a key that stands in the bench file."""


@dataclass(frozen=True, slots=True)
class ScenePoint:
    """One point of a sweep: the scene there, which sweeps no further axis, and the swept values by their full names.

    ``bench`` holds those of the bench file, by path.
    """

    scene: Scene
    values: Mapping[str, Number] = field(default_factory=dict)
    bench: Mapping[KeyPath, Number] = field(default_factory=dict)


def points_of_sweep(scene: Scene) -> tuple[ScenePoint, ...]:
    """Return the points of the scene's sweep in order, the last axis fastest; the scene itself where it has no axes.

    Trains have equally many pulses at all points, unless tracking.pulse_count says how many. Raises ``SettingsError``
    with every axis that is none and every value that its key cannot have.
    """
    if not scene.sweep.axes:
        return (ScenePoint(scene),)
    # By content, and kept: whoever looks at the shots of a long sweep asks for the same points again and again.
    return _kept_points(json.dumps(plain_tables(scene), sort_keys=False), scene.default_specimen)


@lru_cache(maxsize=8)
def _kept_points(text: str, specimen: str | None) -> tuple[ScenePoint, ...]:
    """Return the points of the scene whose tables are the JSON ``text``."""
    scene = Scene.model_validate(json.loads(text), context=STORED)
    scene._default_specimen = specimen
    whole = _full_names(scene)
    names, places = list(whole), _places(scene.sweep)
    tables = plain_tables(scene)
    tables["sweep"] = {name: values for name, values in tables["sweep"].items() if name not in ("axes", "combine")}
    points, mistakes = list[ScenePoint](), dict[str, Mistake]()
    for place in places:
        values = {name: _as_written(value, whole[name]) for name, value in zip(names, place, strict=True)}
        own = {path_of(name): value for name, value in values.items() if not name.startswith(BENCH)}
        bench = {path_of(name)[1:]: value for name, value in values.items() if name.startswith(BENCH)}
        try:
            points.append(ScenePoint(_scene_at(scene, with_values(tables, own)), values, bench))
        except SettingsError as error:
            where = ", ".join(f"{name} = {value:g}" for name, value in values.items())
            for each in error.mistakes:
                mistakes.setdefault(str(each), Mistake(each.path, f"at {where}: {each.what}", each.remedy))
    if mistakes:
        raise SettingsError("the sweep", list(mistakes.values()))
    return tuple(_with_as_many_pulses(points))


def _scene_at(scene: Scene, tables: dict[str, object]) -> Scene:
    # Rules on which settings go together are asked of the scene as a whole; a stored one was measured by them.
    if mistakes := mistakes_of(Scene, tables, context=STORED):
        raise SettingsError("the sweep", mistakes)
    point = Scene.model_validate(tables, context=STORED)
    point._default_specimen = scene.default_specimen
    return point


def _as_written(value: Number, whole: bool) -> Number:
    """Return 3.0 as 3 where a whole number is asked for."""
    return int(value) if whole and value == int(value) else value


def _full_names(scene: Scene) -> dict[str, bool]:
    """Return the axes' names as full paths, and whether each takes whole numbers.

    Raises ``SettingsError`` with every one that names no number, or a number twice.
    """
    keys = _numbers(scene)
    found: dict[str, bool] = {}
    mistakes = []
    for name in scene.sweep.axes:
        resolved = name if name.startswith(BENCH) else resolve(name, keys)
        if isinstance(resolved, Mistake):
            mistakes.append(Mistake(f"sweep.{name}", resolved.what, resolved.remedy))
        elif (full := str(resolved)) in found:
            mistakes.append(Mistake(f"sweep.{name}", f"{full} is swept by another axis already", "one axis for it"))
        elif in_turn := _taken_in_turn(scene, name, full):
            mistakes.append(in_turn)
        else:
            found[full] = isinstance(resolved, Key) and resolved.whole
    if mistakes:
        raise SettingsError("the sweep", mistakes)
    return found


def _taken_in_turn(scene: Scene, name: str, full: str) -> Mistake | None:
    """Return what is wrong with the axis ``name`` over ``full`` where [sweep] has values in its place; else None."""
    listed = getattr(scene.sweep, IN_TURN.get(full, ""), ())
    if not listed:
        return None
    own = f"sweep.{IN_TURN[full]}"
    what = f"{own} = {list(listed)} is taken in place of {full}, whatever the axis says"
    return Mistake(f"sweep.{name}", what, f"one of the two: without {own}, or the axis")


def swept_twice(scene: Scene) -> list[Mistake]:
    """Return the axes over keys in whose place [sweep] has values too."""
    keys = _numbers(scene)
    found = ((name, resolve(name, keys)) for name in scene.sweep.axes if not name.startswith(BENCH))
    twice = (_taken_in_turn(scene, name, str(key)) for name, key in found if isinstance(key, Key))
    return [mistake for mistake in twice if mistake is not None]


def _numbers(scene: Scene) -> list[Key]:
    return [key for key in keys_of(scene, plain_tables(scene)) if key.path[0] not in ("sweep", "notes")]


def _places(sweep: Sweep) -> list[tuple[Number, ...]]:
    counts = {name: len(values) for name, values in sweep.axes.items()}
    if sweep.combine == "zip":
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{name} {count}" for name, count in counts.items())
            what = f"axes taken together need equally many values, not {listed}"
            raise SettingsError("the sweep", [Mistake("sweep", what, 'as many values each, or combine = "product"')])
        return list(zip(*sweep.axes.values(), strict=True))
    if (points := math.prod(counts.values())) > MOST_POINTS:
        what = f"its axes have {points} points, a run at most {MOST_POINTS}"
        raise SettingsError("the sweep", [Mistake("sweep", what, "fewer values, or several runs")])
    return list(itertools.product(*sweep.axes.values()))


def _with_as_many_pulses(points: list[ScenePoint]) -> Iterator[ScenePoint]:
    most = max((_pulses(point.scene) for point in points), default=0)
    for point in points:
        tracking = point.scene.tracking
        if tracking.pulse_count is None and point.scene.excitation is not None:
            counted = tracking.model_copy(update={"pulse_count": most})
            yield ScenePoint(point.scene.model_copy(update={"tracking": counted}), point.values, point.bench)
        else:
            yield point


def _pulses(scene: Scene) -> int:
    """Return as many tracking pulses as the burst train lasts, or as are asked for."""
    if scene.tracking.pulse_count is not None or scene.excitation is None:
        return scene.tracking.pulse_count or 1
    train_s = scene.excitation.burst_count / scene.excitation.burst_rate_hz
    return max(1, math.floor(train_s * scene.tracking.pulse_rate_hz + 1e-6))
