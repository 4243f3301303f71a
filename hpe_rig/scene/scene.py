"""Scene: one measurement, and the scenes that a sweep expands it into.

scene.points    the scene at each point of the sweep's axes
scene.places    the scene at each offset of the tracking transducer and the gate
scene.rates     the scene at each pulse rate
scene.windows   the scene with each slow-time window of the same records
"""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from hpe_rig.scene.axis import Axis, settings_at_points
from hpe_rig.scene.keys import Key, Number, keys_of, plain_tables, resolve, with_values
from hpe_rig.scene.mistakes import KeyPath, Mistake, SettingsError, path_of
from hpe_rig.scene.quantities import Notes, Title
from hpe_rig.scene.sections import (
    SWEPT_LISTS,
    Acquisition,
    Beams,
    Excitation,
    Medium,
    Processing,
    Sphere,
    Sweep,
    Tracking,
    refuse_first,
)
from hpe_rig.scene.usual_values import likely_value
from hpe_rig.scene.validation import STORED, Section, mistakes_of

MAX_POINTS = 1000
"""Points of a sweep in one run."""
BENCH_PREFIX = "bench."
"""Beginning of an axis's name if its key is in the bench file."""
MAX_GATE_OFFSET_WIDTHS = 8.0
"""Largest offset of the gate from a Gaussian force, in standard deviations; there the displacement is 1e-14."""
HIGHEST_DEFAULT_HARMONIC = 10


class Scene(Section):
    """One measurement."""

    title: Title
    """One line that describes the measurement."""
    excitation: Excitation | None = None
    """The tonebursts that push."""
    tracking: Tracking
    """The pulses that track."""
    acquisition: Acquisition
    """The records of the digitizer."""
    beams: Beams | None = None
    """Shapes of the beams."""
    medium: Medium | None = None
    """Known properties of the specimen, for beam averaging and the prior of media."""
    sphere: Sphere | None = None
    """A rigid sphere that is pushed and tracked instead of the medium."""
    processing: Processing = Processing()
    """How amplitude and phase are estimated from the records."""
    sweep: Sweep = Sweep()
    """Pulse rates, windows, offsets and other numbers that vary within the run."""
    notes: Notes = Field(default_factory=dict)
    """Operator, sample, temperature or anything else, under any name; stored with run, result and report."""
    simulation: dict[str, Any] | None = None
    """Settings of the twin; a real bench does not need them."""
    _default_specimen: str | None = PrivateAttr(default=None)

    @property
    def default_specimen(self) -> str | None:
        """Name of the specimen that ``with_default_specimen`` added; None if the scene has its own [simulation]."""
        return self._default_specimen

    def with_(self, values: Mapping[str, Any]) -> Scene:
        """Return the scene with ``values`` by their full path; absent sections are added.

        ``scene.with_({"tracking.pulse_rate_hz": 4000.0, "excitation.force_fraction": [0.5, 1.0]})``; an entry of a list
        is ``"excitation.force_fraction[0]"``. Raises ``SettingsError`` with every mistake, ``TypeError`` if ``values``
        is no mapping from text to values.
        """
        if not isinstance(values, Mapping):
            raise TypeError(f"settings must be a mapping from path to value, not {type(values).__name__}")
        for name in values:
            if not isinstance(name, str):
                raise TypeError(f"the path of a setting must be text, not {type(name).__name__} {name!r}")
        # Validated anew from the given settings, so that every rule is checked.
        tables = with_values(plain_tables(self), {path_of(name): value for name, value in values.items()})
        if mistakes := scene_mistakes(tables):
            raise SettingsError("the scene", mistakes)
        return Scene.model_validate(tables)

    @property
    def wanted_frequencies_hz(self) -> tuple[float, ...]:
        """Vibration frequencies to estimate, in Hz: those of [processing], or multiples of the burst rate."""
        if self.processing.frequencies_hz is not None:
            return self.processing.frequencies_hz
        if self.excitation is None:
            return ()
        # The slowest pulse rate of a sweep limits the harmonics, so that all rates estimate equal frequencies.
        rate_hz, slowest_hz = self.excitation.burst_rate_hz, min(self.pulse_rates_hz)
        return tuple(n * rate_hz for n in range(1, HIGHEST_DEFAULT_HARMONIC + 1) if n * rate_hz < slowest_hz / 2)

    @property
    def without_prior(self) -> str | None:
        """Reason why no prior of media can replace the harmonics of the tonebursts; None if one can."""
        if self.excitation is None:
            return "the scene has no [excitation]"
        if self.excitation.burst_count == 1:
            return "excitation.burst_count is 1, and one toneburst makes no periodic motion"
        if self.beams is None and self.sphere is None:
            return "the scene has no [beams]"
        harmonics = [hz / self.excitation.burst_rate_hz for hz in self.wanted_frequencies_hz]
        if any(round(n) == 0 or not math.isclose(n, round(n), rel_tol=1e-6) for n in harmonics):
            return "processing.frequencies_hz are not all multiples of excitation.burst_rate_hz"
        return None

    @property
    def gate_depth_m(self) -> float:
        """Distance from the transducer to the centre of the gate, its axial offset included."""
        return self.acquisition.gate_depth_m + self.tracking.axial_offset_m

    @property
    def pulse_rates_hz(self) -> tuple[float, ...]:
        """All pulse rates of the run."""
        return self.sweep.pulse_rate_hz or (self.tracking.pulse_rate_hz,)

    @property
    def burst_train_pulses(self) -> int | None:
        """Number of tracking pulses during the burst train; None without tonebursts."""
        return None if self.excitation is None else _pulses_in_train(self.excitation, self.tracking.pulse_rate_hz)

    @property
    def points(self) -> tuple[ScenePoint, ...]:
        """The scene at each point of the sweep's axes, the last axis fastest; one point if there are no axes.

        All points have equally many pulses, unless tracking.pulse_count is set. Raises ``SettingsError`` with every
        axis that is not a number of the scene and every value out of the bounds of its key.
        """
        if not self.sweep.axes:
            return (ScenePoint(self),)
        # Cached by content, because a plan asks for the same points at each of its shots.
        return _points(json.dumps(plain_tables(self), sort_keys=False), self.default_specimen)

    @property
    def windows(self) -> tuple[Scene, ...]:
        """The scene with each slow-time window of the same records."""
        lengths_s = self.sweep.window_length_s or (self.processing.window_length_s,)
        sections = (self.processing.model_copy(update={"window_length_s": length_s}) for length_s in lengths_s)
        return tuple(self.model_copy(update={"processing": processing}) for processing in sections)

    @property
    def places(self) -> tuple[Scene, ...]:
        """The scene at each lateral and axial offset, all other settings equal."""
        sweep, tracking = self.sweep, self.tracking
        if not (sweep.lateral_offset_m or sweep.axial_offset_m):
            return (self,)
        unswept = sweep.model_copy(update={"lateral_offset_m": (), "axial_offset_m": ()})
        lateral_m, axial_m = sweep.lateral_offset_m or (tracking.lateral_offset_m,), sweep.axial_offset_m
        offsets_m = itertools.product(lateral_m, axial_m or (tracking.axial_offset_m,))
        sections = (tracking.model_copy(update={"lateral_offset_m": x, "axial_offset_m": z}) for x, z in offsets_m)
        return tuple(self.model_copy(update={"sweep": unswept, "tracking": section}) for section in sections)

    @property
    def rates(self) -> tuple[Scene, ...]:
        """The scene at each pulse rate, with equal frequencies and equally many pulses."""
        if not self.sweep.pulse_rate_hz:
            return (self,)
        # Fixed here, because the default frequencies depend on the pulse rate.
        processing = self.processing.model_copy(update={"frequencies_hz": self.wanted_frequencies_hz or None})
        count = self.tracking.pulse_count
        if count is None and self.excitation is not None:
            # The fastest train determines the count, so that one run file holds the records of all.
            count = _pulses_in_train(self.excitation, max(self.sweep.pulse_rate_hz))
        unswept = {"processing": processing, "sweep": self.sweep.model_copy(update={"pulse_rate_hz": ()})}
        sections = (
            self.tracking.model_copy(update={"pulse_rate_hz": rate_hz, "pulse_count": count})
            for rate_hz in self.sweep.pulse_rate_hz
        )
        return tuple(self.model_copy(update={**unswept, "tracking": tracking}) for tracking in sections)

    @model_validator(mode="after")
    def _sections_fit_together(self, info: ValidationInfo) -> Scene:
        refuse_first(_conflicts(self), info)
        return self


def scene_mistakes(tables: Mapping[str, Any], stored: bool = False) -> list[Mistake]:
    """Return all mistakes of a scene's ``tables``, except those in [simulation].

    In a ``stored`` scene, of a run file, rules on which settings go together do not apply: they may be younger than the
    run.
    """
    hint = functools.partial(likely_value, Scene)
    return mistakes_of(Scene, tables, context=STORED if stored else None, hint=hint)


def _conflicts(scene: Scene) -> Iterator[str]:
    """Yield the conflicts between settings of different sections."""
    processing = scene.processing
    if processing.harmonic == "medium_prior" and scene.without_prior is not None:
        yield f'processing.harmonic = "medium_prior" needs more, {scene.without_prior}: set harmonic = "least_squares"'
    if scene.acquisition.control and scene.excitation is None:
        yield "acquisition.control repeats shots with tonebursts off, and there is no [excitation]: remove control"
    if scene.sphere is not None and scene.beams is not None:
        yield "[sphere] moves as a whole, so that [beams] do not average its motion: remove one of the two"
    if scene.sphere is not None and (processing.gates or processing.gate_profile_step_m is not None):
        yield "gates over depth measure the medium, and [sphere] moves as a whole: remove one of the two"
    if scene.beams is not None:
        yield from _beam_conflicts(scene, scene.beams)
    if scene.sweep.pulse_rate_hz and None in (scene.sweep.window_length_s or (processing.window_length_s,)):
        yield (
            "sweep.pulse_rate_hz gives slower trains that outlast the tonebursts: set processing.window_length_s "
            "or sweep.window_length_s, so that the estimates use the same stretch of time"
        )


def _beam_conflicts(scene: Scene, beams: Beams) -> Iterator[str]:
    diameter_m, focus_m = beams.transducer_diameter_m, beams.focus_depth_m or scene.acquisition.gate_depth_m
    if diameter_m is not None and diameter_m >= 2 * focus_m:
        yield (
            f"beams.transducer_diameter_m is {diameter_m:g} m, and a bowl that focuses at {focus_m:g} m "
            f"(beams.focus_depth_m, else the gate's depth) is less than {2 * focus_m:g} m across"
        )
    if beams.focus_depth_m is not None:
        offset_m, width_m = abs(scene.acquisition.gate_depth_m - beams.focus_depth_m), beams.excitation_width_m[2]
        if offset_m > MAX_GATE_OFFSET_WIDTHS * width_m:
            yield (
                f"acquisition.gate_depth_m is {offset_m:.3g} m from beams.focus_depth_m, {offset_m / width_m:.3g} "
                "times beams.excitation_width_m along the beam, where nothing moves: equal depths, or no focus_depth_m"
            )
    half_wave_m = scene.acquisition.sound_speed_m_per_s / (2 * scene.tracking.carrier_hz)
    if beams.pulse_length_m is not None and beams.pulse_length_m < half_wave_m:
        yield (
            f"beams.pulse_length_m is {beams.pulse_length_m:g} m, and a single cycle of tracking.carrier_hz is "
            f"{half_wave_m:.3g} m long: a larger value, or none for that of tracking.cycles"
        )


def _pulses_in_train(excitation: Excitation, pulse_rate_hz: float) -> int:
    """Return the number of pulse periods that the burst train lasts, at least 1."""
    train_s = excitation.burst_count / excitation.burst_rate_hz
    # 1e-6 periods absorb the rounding of a whole number of periods.
    return max(1, math.floor(train_s * pulse_rate_hz + 1e-6))


@dataclass(frozen=True, slots=True)
class ScenePoint:
    """One point of a sweep: the scene there, without axes, and the swept values by their full names.

    ``bench`` holds the values of the bench file by path.
    """

    scene: Scene
    values: Mapping[str, Number] = field(default_factory=dict)
    bench: Mapping[KeyPath, Number] = field(default_factory=dict)


@lru_cache(maxsize=8)
def _points(tables_json: str, specimen: str | None) -> tuple[ScenePoint, ...]:
    """Return the points of the scene with the tables in JSON; ``specimen`` names its default specimen."""
    tables = json.loads(tables_json)
    scene = Scene.model_validate(tables, context=STORED)
    axes = _resolved_axes(scene)
    # A point has no axes; its lists, such as pulse rates, remain.
    tables["sweep"] = {name: values for name, values in tables["sweep"].items() if name not in ("axes", "combine")}
    points, mistakes = list[ScenePoint](), dict[str, Mistake]()
    for values in settings_at_points(axes, scene.sweep.combine, MAX_POINTS, "the sweep"):
        # Keys of the bench file are applied to the bench of the point, without their prefix.
        scene_values = {path_of(name): value for name, value in values.items() if not name.startswith(BENCH_PREFIX)}
        bench = {path_of(name)[1:]: value for name, value in values.items() if name.startswith(BENCH_PREFIX)}
        try:
            # The rules on which settings go together were checked on the whole scene.
            point_tables = with_values(tables, scene_values)
            if point_mistakes := scene_mistakes(point_tables, stored=True):
                raise SettingsError("the sweep", point_mistakes)
            point_scene = Scene.model_validate(point_tables, context=STORED)
            point_scene._default_specimen = specimen
            points.append(ScenePoint(point_scene, values, bench))
        except SettingsError as error:
            where = ", ".join(f"{name} = {value:g}" for name, value in values.items())
            for mistake in error.mistakes:
                mistakes.setdefault(str(mistake), replace(mistake, what=f"at {where}: {mistake.what}"))
    if mistakes:
        raise SettingsError("the sweep", list(mistakes.values()))
    return tuple(_with_equal_pulse_counts(points))


def _resolved_axes(scene: Scene) -> list[Axis]:
    """Return the scene's axes by full name, whole numbers as such.

    Raises ``SettingsError`` with every axis that is not a number of the scene, or that another axis sweeps too.
    """
    axes: dict[str, Axis] = {}
    mistakes = axes_replaced_by_lists(scene)
    replaced = {mistake.path for mistake in mistakes}
    for name, key in _keys_of_axes(scene):
        full_name, values = str(key), scene.sweep.axes[name]
        if isinstance(key, Mistake):
            mistakes.append(Mistake(f"sweep.{name}", key.what, key.remedy))
        elif full_name in axes:
            mistakes.append(
                Mistake(f"sweep.{name}", f"{full_name} is swept by another axis already", "one axis for it")
            )
        elif f"sweep.{name}" not in replaced:
            is_integer = isinstance(key, Key) and key.is_integer
            # 3.0 is written as 3 if the key takes whole numbers.
            values = tuple(int(value) if is_integer and value == int(value) else value for value in values)
            axes[full_name] = Axis.of_key(full_name, values)
    if mistakes:
        raise SettingsError("the sweep", mistakes)
    return list(axes.values())


def axes_replaced_by_lists(scene: Scene) -> list[Mistake]:
    """Return a mistake for every axis over a key that a list in [sweep] replaces, so that the axis has no effect."""
    mistakes = []
    for name, key in _keys_of_axes(scene):
        list_key = SWEPT_LISTS.get(str(key), "")
        if isinstance(key, Key) and (values := getattr(scene.sweep, list_key, ())):
            what = f"sweep.{list_key} = {list(values)} replaces {key}, so that the axis has no effect"
            mistakes.append(Mistake(f"sweep.{name}", what, f"one of the two: without sweep.{list_key}, or the axis"))
    return mistakes


def _keys_of_axes(scene: Scene) -> Iterator[tuple[str, Key | Mistake | str]]:
    """Yield each axis's name with its key, the mistake in the name, or the name itself if it is of the bench file."""
    keys = [key for key in keys_of(scene, plain_tables(scene)) if key.path[0] not in ("sweep", "notes")]
    for name in scene.sweep.axes:
        yield name, name if name.startswith(BENCH_PREFIX) else resolve(name, keys)


def _with_equal_pulse_counts(points: Iterable[ScenePoint]) -> Iterator[ScenePoint]:
    """Yield the points with the largest of their pulse counts, so that one run file holds all of their records."""
    counts = [point.scene.tracking.pulse_count or point.scene.burst_train_pulses or 1 for point in points]
    for point in points:
        tracking = point.scene.tracking
        if tracking.pulse_count is None and point.scene.excitation is not None:
            tracking = tracking.model_copy(update={"pulse_count": max(counts)})
            yield replace(point, scene=point.scene.model_copy(update={"tracking": tracking}))
        else:
            yield point
