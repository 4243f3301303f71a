"""Cases of a study: every point of its axes and reading as a checked scene with its random numbers."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpe_rig.bench import check_declared, check_simulation, read_bench, twin_of, twin_settings
from hpe_rig.plan import PlanError
from hpe_rig.processing import Options, spec_of
from hpe_rig.scene import (
    SWEPT_LISTS,
    Axis,
    Estimator,
    Mistake,
    Scene,
    SettingsError,
    parse_toml,
    path_of,
    plain_tables,
    scene_mistakes,
    scene_text,
    shipped_scenes,
    with_values,
)
from hpe_rig.study.definition import Definition, Reading
from hpe_rig.study.kernels import Train, refuse_unusable
from hpe_rig.study.measured_case import MeasuredCase, first_setup, one_shot

if TYPE_CHECKING:
    from sim_backend.settings import SimulationSettings

ENGINE = 2
"""Version of the numbers: it increases whenever a case gives other numbers, which invalidates stored cases."""

USED = {
    "tracking": ("pulse_rate_hz", "pulse_count", "delay_s", "carrier_hz"),
    "acquisition": ("gate_depth_m", "gate_length_m", "sound_speed_m_per_s", "sample_rate_hz"),
    "processing": ("frequencies_hz", "harmonic", "process_noise", "background_order"),
    "simulation": ("sound_speed_m_per_s", "motion", "beams", "scatterers"),
}
"""The scene keys, by section, that the gate's echoes and estimates depend on; the SNR is another."""
USED_KEYS = (*(f"{section}.{key}" for section, keys in USED.items() for key in keys), "simulation.receiver.snr_db")

SET_BY_STUDY = ("simulation.seed", "acquisition.repeats")
"""Keys that whole measurements set for every realisation, in addition to [sweep]."""
_USE_BENCH = 'simulate = "bench", which measures the whole scene'

Tables = dict[str, Any]
Indices = tuple[int, ...]
"""Index of a point along every axis."""


@dataclass(frozen=True, slots=True)
class Case:
    """One scene under one reading, with its realisations; equal cases of several studies have equal keys."""

    key: str
    """Hash of everything that its numbers depend on; the name of its file."""
    echoes_key: str
    """Equal for cases with the same noise-free echoes."""
    noise_key: str
    """Equal for cases with the same unit noise."""
    stream: int
    """Entropy of its random numbers."""
    train: Train
    twin: SimulationSettings
    gate_offset_s: float
    """Centre of the gate after the echo of the focus at rest."""
    estimators: tuple[Estimator, ...]
    scatterers: int
    noise: int
    standard_error_m: float | None
    reading: Reading = "physical"

    @property
    def batch_key(self) -> tuple[str, ...]:
        """Sort key of batches: noise, then echoes."""
        return self.noise_key, self.echoes_key

    @property
    def cost(self) -> float:
        """Computing time relative to other cases of the gate."""
        return float(self.scatterers * self.noise * self.train.pulses)


AnyCase = Case | MeasuredCase


@dataclass(frozen=True, slots=True)
class GridPoint:
    """One case of a study: the displayed value of every axis, and the reading of eq. (11)."""

    coordinates: dict[str, Any]
    reading: Reading
    case: AnyCase


@dataclass(frozen=True, slots=True)
class _Grid:
    """A definition with its base scene, its axes, and the random streams so far."""

    base: Tables
    definition: Definition
    axes: tuple[Axis, ...]
    streams: dict[str, int]

    @property
    def keys(self) -> list[str]:
        """Every scene key that the study sets or varies."""
        return list(dict.fromkeys((*self.definition.set, *(key for axis in self.axes for key in axis.columns))))

    def stream_indices(self, indices: Indices) -> Indices:
        """Return the point that provides the random numbers of ``indices``: the first along each common axis."""
        common = self.definition.common
        return tuple(0 if axis.name in common else index for axis, index in zip(self.axes, indices, strict=True))

    def tables_at(self, indices: Indices) -> Tables:
        """Return the scene's tables at a point."""
        fixed = {path_of(key): value for key, value in self.definition.set.items()}
        varied = {
            path_of(key): value
            for axis, index in zip(self.axes, indices, strict=True)
            for key, value in axis.settings(index).items()
        }
        return with_values(with_values(self.base, fixed), varied)


def points_of(name: str, definition: Definition, folder: Path = Path()) -> list[GridPoint]:
    """Return every point of a study; raise ``SettingsError`` with all mistakes of all its scenes, each once."""
    shipped = definition.scene in shipped_scenes()
    base_name, text = scene_text(definition.scene if shipped else folder / definition.scene)
    base = parse_toml(text, f"scene {base_name}")
    axes = definition.sweep_axes
    grid = _Grid(base, definition, axes, {})
    make_case, mistakes_in = (_measured_case, _bench_mistakes) if _needs_bench(grid) else (_gate_case, _gate_mistakes)
    mistakes = {str(mistake): mistake for mistake in (*mistakes_in(grid), *_repeated_keys(axes))}
    points: list[GridPoint] = []
    for reading in definition.readings:
        for indices in itertools.product(*(range(len(axis)) for axis in axes)):
            try:
                case = make_case(grid, reading, indices)
            except SettingsError as error:
                mistakes |= {str(mistake): mistake for mistake in error.mistakes}
                continue
            coordinates = {axis.name: axis.labels[index] for axis, index in zip(axes, indices, strict=True)}
            points.append(GridPoint(coordinates, reading, case))
    if mistakes:
        raise SettingsError(f"study {name}", list(mistakes.values()))
    return points


def _needs_bench(grid: _Grid) -> bool:
    """Return whether every realisation is a whole measurement: by the key simulate, else by the base scene."""
    if grid.definition.simulate is not None:
        return grid.definition.simulate == "bench"
    try:
        tables = with_values(grid.base, {path_of(key): value for key, value in grid.definition.set.items()})
        scene = Scene.model_validate(tables)
        return any(_beyond_gate(scene, twin_settings(scene)))
    except ValueError:
        # The checks of all points report the mistakes of the base scene.
        return False


def _gate_mistakes(grid: _Grid) -> Iterator[Mistake]:
    """Yield the settings of a definition that a study of the gate alone cannot use."""
    for key in grid.keys:
        if not any(key == used or key.startswith((f"{used}.", f"{used}[")) for used in USED_KEYS):
            what = "a study of the gate alone does not depend on it"
            yield Mistake(key, what, f"{_USE_BENCH}, or {', '.join(USED_KEYS)}")
    for name in grid.definition.readings.get("as_printed", ()):
        if not spec_of(name).published:
            what = f"the amplitude of {name} has no gain of a difference of pulses"
            yield Mistake("readings.as_printed", what, '["cross_spectrum"]')
    if grid.definition.corrected:
        yield Mistake("corrected", "a study of the gate alone corrects nothing", _USE_BENCH)


def _bench_mistakes(grid: _Grid) -> Iterator[Mistake]:
    """Yield the settings that a study by whole measurements sets itself, and the readings that it does not support."""
    for key in grid.keys:
        if key.partition(".")[0] == "sweep" or key in SET_BY_STUDY:
            yield Mistake(key, "a study sets repeats and varied values itself", "its axes, scatterers and noise")
    for reading in sorted(grid.definition.readings.keys() - {"physical"}):
        what = "only a study of the gate alone supports it, and this study measures whole scenes"
        remedy = 'the reading "physical", or simulate = "gate" with prescribed motion'
        yield Mistake(f"readings.{reading}", what, remedy)


def _repeated_keys(axes: Sequence[Axis]) -> Iterator[Mistake]:
    counts = Counter(itertools.chain(*(axis.columns for axis in axes)))
    for key, count in counts.items():
        if count > 1:
            yield Mistake(key, f"{count} axes vary it, and only the last one would apply", "one axis for it")


def _measured_case(grid: _Grid, reading: Reading, indices: Indices) -> MeasuredCase:
    definition, estimators = grid.definition, grid.definition.readings[reading]
    scene = _whole_scene(grid, indices, definition.corrected)
    tables = plain_tables(scene)
    stream = _stream(grid, reading, indices, tables, lambda point: plain_tables(_whole_scene(grid, point)))
    sizes = definition.scatterers, definition.noise, definition.standard_error_m
    # The numbers depend on the whole program and on the bench.
    program = version("hpe-rig"), read_bench().text
    key = _hash([ENGINE, "bench", program, tables, list(estimators), sizes, stream, definition.corrected])
    case = MeasuredCase(key, stream, scene, estimators, *sizes, definition.corrected)
    try:
        first_setup(case)
    except PlanError as error:
        mistakes = [Mistake(conflict.check, conflict.text, conflict.remedy) for conflict in error.conflicts]
        raise SettingsError("study", mistakes) from None
    return case


def _whole_scene(grid: _Grid, indices: Indices, corrected: bool = False) -> Scene:
    """Return one shot of the scene at a point; raise ``SettingsError`` with every mistake."""
    tables = grid.tables_at(indices)
    # A key of the study overrides the scene's sweep of the same quantity.
    overridden = {name for key, name in SWEPT_LISTS.items() if key in grid.keys}
    if overridden and isinstance(sweep := tables.get("sweep"), dict):
        tables["sweep"] = {name: values for name, values in sweep.items() if name not in overridden}
    scene, mistakes = _validated(tables)
    if scene is not None and corrected and scene.beams is None:
        mistakes = [Mistake("corrected", "without [beams] there is no correction", "a scene with [beams], or false")]
    elif scene is not None and not scene.wanted_frequencies_hz:
        what = "there is no vibration frequency to estimate an amplitude at"
        mistakes = [Mistake("processing.frequencies_hz", what, "frequencies_hz = [200.0]")]
    if scene is None or mistakes:
        raise SettingsError("study", mistakes)
    return one_shot(scene)


def _gate_case(grid: _Grid, reading: Reading, indices: Indices) -> Case:
    definition, estimators = grid.definition, grid.definition.readings[reading]
    scene, twin = _checked(grid.tables_at(indices), reading)
    train = _train(scene)
    try:
        refuse_unusable(train, estimators)
    except ValueError as error:
        what, _, remedy = str(error).rpartition("; ")
        raise SettingsError("study", [Mistake("", what or remedy, remedy.removeprefix("try "))]) from None
    used = _used_values(scene, twin)
    noise_free = used | {"simulation": {key: value for key, value in used["simulation"].items() if key != "snr_db"}}
    stream = _stream(
        grid, reading, indices, used, lambda point: _used_values(*_checked(grid.tables_at(point), reading))
    )
    # Without noise all its realisations are equal.
    scatterers, noise = definition.scatterers, definition.noise if twin.receiver.snr_db is not None else 1
    if reading == "one_draw":
        scatterers, noise = 1, scatterers * noise
    sizes = [scatterers, noise, definition.standard_error_m]
    # "physical" and "literal" differ in their settings; the other two process equal echoes differently.
    reading_in_key = [reading] if reading in ("as_printed", "one_draw") else []
    return Case(
        key=_hash([ENGINE, used, list(estimators), sizes, stream, *reading_in_key]),
        echoes_key=_hash([noise_free, stream]),
        noise_key=_hash([used["tracking"], used["acquisition"], sizes, list(estimators), stream]),
        stream=stream,
        train=train,
        twin=twin,
        gate_offset_s=2 * (scene.acquisition.gate_depth_m - twin.beams.tracked_from_m) / twin.sound_speed_m_per_s,
        estimators=estimators,
        scatterers=scatterers,
        noise=noise,
        standard_error_m=definition.standard_error_m,
        reading=reading,
    )


def _stream(
    grid: _Grid, reading: Reading, indices: Indices, tables: Tables, tables_at: Callable[[Indices], Tables]
) -> int:
    """Return the entropy of a case's random numbers, from its tables or from those of its stream's point."""
    seed = grid.definition.seed
    if grid.definition.common == "all":
        return int(_hash([seed]), 16)
    point = grid.stream_indices(indices)
    if (name := f"{reading} {point}") not in grid.streams:
        grid.streams[name] = int(_hash([seed, tables if point == indices else tables_at(point)]), 16)
    return grid.streams[name]


def _validated(tables: Tables) -> tuple[Scene | None, list[Mistake]]:
    """Return the scene, None with mistakes in its tables; all mistakes of tables and declared values."""
    if mistakes := scene_mistakes(tables) + check_simulation(tables):
        return None, mistakes
    scene = Scene.model_validate(tables)
    mistakes = check_declared(scene)
    return (None if mistakes else scene), mistakes


def _checked(tables: Tables, reading: Reading) -> tuple[Scene, SimulationSettings]:
    """Return the scene and the twin's settings under a reading of eq. (11); raise with every mistake."""
    scene, mistakes = _validated(tables)
    if scene is not None:
        twin = twin_settings(scene)
        mistakes = list(_unsuitable(scene, twin))
        if not mistakes:
            return scene, _literal(scene, twin) if reading in ("literal", "as_printed") else twin
    raise SettingsError("study", mistakes)


def _beyond_gate(scene: Scene, twin: SimulationSettings) -> Iterator[tuple[str, str]]:
    """Yield the key of each part of the scene beyond a gate under prescribed motion, and the reason in words."""
    if not twin.motion:
        yield "simulation.motion", "its true motion must be prescribed, and this scene prescribes none"
    beyond = {
        "excitation": (scene.excitation is not None, "it has no tonebursts"),
        "simulation.background": (bool(twin.background), "it has no motion of the whole specimen"),
        "simulation.scatterers.reflectors": (bool(twin.scatterers.reflectors), "it draws only scatterers"),
        "simulation.receive_chain": (twin.receive_chain is not None, "its noise is white, with the given snr_db"),
        "simulation.instruments.trigger_jitter_s": (twin.instruments.trigger_jitter_s > 0, "it has no jitter"),
        "processing.follow_gate": (scene.processing.follow_gate, "its gate is fixed"),
    }
    yield from ((key, reason) for key, (applies, reason) in beyond.items() if applies)


def _unsuitable(scene: Scene, twin: SimulationSettings) -> Iterator[Mistake]:
    for key, reason in _beyond_gate(scene, twin):
        yield Mistake(key, f"in a study of the gate alone {reason}", f"{_USE_BENCH}, or table-1")
    if scene.tracking.pulse_count is None:
        yield Mistake("tracking.pulse_count", "a study needs it, and it is absent", 'set."tracking.pulse_count" = 100')
    true_hz = [motion.frequency_hz for motion in twin.motion or ()]
    for hz in scene.processing.frequencies_hz or ():
        if hz not in true_hz and true_hz:
            what = f"the motion has no component at {hz:g} Hz, so its phase has no true value"
            yield Mistake("processing.frequencies_hz", what, f"from {', '.join(f'{value:g}' for value in true_hz)}")


def _literal(scene: Scene, twin: SimulationSettings) -> SimulationSettings:
    """Return the twin for eq. (11) read literally: no axial delay, and scatterers within the gate only."""
    x_m, y_m, z_m = twin.scatterers.volume_m
    volume_m = (x_m, y_m, min(z_m, scene.acquisition.gate_length_m))
    scatterers = twin.scatterers.model_copy(update={"axial_delay": "none", "volume_m": volume_m})
    return twin.model_copy(update={"scatterers": scatterers})


def _train(scene: Scene) -> Train:
    acquisition, processing = scene.acquisition, scene.processing
    two_way_s = 2 * acquisition.gate_length_m / acquisition.sound_speed_m_per_s
    twin = twin_of(scene)
    return Train(
        pulse_rate_hz=scene.tracking.pulse_rate_hz,
        pulses=scene.tracking.pulse_count or 0,
        delay_s=scene.tracking.delay_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=acquisition.sound_speed_m_per_s,
        sample_rate_hz=acquisition.sample_rate_hz,
        samples=round(two_way_s * acquisition.sample_rate_hz),
        frequencies_hz=processing.frequencies_hz or tuple(hz for hz, _ in (twin.prescribed if twin else ())),
        options=Options(processing.background_order, processing.harmonic or "least_squares", processing.process_noise),
    )


def _used_values(scene: Scene, twin: SimulationSettings) -> Tables:
    """Return the values of `USED` and the SNR as JSON values."""
    keys = {section: set(names) for section, names in USED.items()}
    simulation = twin.model_dump(include=keys.pop("simulation")) | {"snr_db": twin.receiver.snr_db}
    return {**scene.model_dump(include=keys), "simulation": simulation}


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:24]
