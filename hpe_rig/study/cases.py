"""Cases of a study: every point of its axes and reading as a checked scene with its random numbers."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpe_rig.bench import check_declared, check_simulation, read_bench, twin_of, twin_settings
from hpe_rig.plan import PlanError
from hpe_rig.processing import Estimator, Options, spec_of
from hpe_rig.scene import (
    IN_TURN,
    Mistake,
    Scene,
    SettingsError,
    mistakes_of,
    parse_toml,
    path_of,
    plain_tables,
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
"""Raised whenever the same case gives other numbers: cases stored before are then not taken for finished."""

USED = {
    "tracking": ("pulse_rate_hz", "pulse_count", "delay_s", "carrier_hz"),
    "acquisition": ("gate_depth_m", "gate_length_m", "sound_speed_m_per_s", "sample_rate_hz"),
    "processing": ("frequencies_hz", "harmonic", "process_noise", "background_order"),
    "simulation": ("sound_speed_m_per_s", "motion", "beams", "scatterers"),
}
"""The scene keys that a study's echoes and estimates depend on, by section, and the SNR."""
USED_KEYS = (*(f"{section}.{key}" for section, keys in USED.items() for key in keys), "simulation.receiver.snr_db")

SET_BY_STUDY = ("simulation.seed", "acquisition.repeats")
"""Keys that whole measurements set for every realisation, beside [sweep]."""
_MEASURES = "which measures all of the scene"

Tables = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """One scene under one reading, with its realisations; equal cases of several studies have equal keys."""

    key: str
    """Hash of all that its numbers depend on; the name of its file."""
    echoes_key: str
    """Equal where the noise-free echoes are the same."""
    noise_key: str
    """Equal where the noise is the same, but for its level."""
    stream: int
    """Entropy of its random numbers."""
    train: Train
    twin: SimulationSettings
    gate_offset_s: float
    """Middle of the gate after the echo of the resting focus."""
    estimators: tuple[Estimator, ...]
    scatterers: int
    noise: int
    standard_error_m: float | None
    reading: Reading = "physical"

    @property
    def sharing(self) -> tuple[str, ...]:
        """What cases have in common that are computed together, first of all the noise."""
        return self.noise_key, self.echoes_key

    @property
    def cost(self) -> float:
        """How long it takes beside others of its kind."""
        return float(self.scatterers * self.noise * self.train.pulses)


AnyCase = Case | MeasuredCase


@dataclass(frozen=True, slots=True)
class GridPoint:
    """Where a case stands in a study: the shown value of every axis, and the reading of eq. (11)."""

    coordinates: dict[str, Any]
    reading: Reading
    case: AnyCase


@dataclass(frozen=True, slots=True)
class _Grid:
    """A definition with its base scene and, for every axis, values by key."""

    base: Tables
    definition: Definition
    columns: list[dict[str, list[Any]]]

    def common_place(self, place: tuple[int, ...]) -> tuple[int, ...]:
        """Return where the random numbers of ``place`` are taken from: along a common axis from its first value."""
        axes = self.definition.axes
        return tuple(0 if axis.name in self.definition.common else n for axis, n in zip(axes, place, strict=True))


def points_of(name: str, definition: Definition, folder: Path = Path()) -> list[GridPoint]:
    """Return every point of a study; raise ``SettingsError`` with all mistakes of all its scenes, each once."""
    shipped = definition.scene in shipped_scenes()
    base_name, text = scene_text(definition.scene if shipped else folder / definition.scene)
    base = parse_toml(text, f"scene {base_name}")
    grid = _Grid(base, definition, [axis.columns() for axis in definition.axes])
    shown = [axis.values() for axis in definition.axes]
    whole = _is_measured(grid)
    make, wrong = (_measured_case, _wrong_for_bench) if whole else (_case, _wrong_for_gate)
    found: dict[str, Mistake] = {str(mistake): mistake for mistake in (*wrong(definition), *_repeated(definition))}
    out: list[GridPoint] = []
    streams: dict[str, int] = {}
    for reading in definition.readings:
        for place in itertools.product(*(range(len(each)) for each in shown)):
            try:
                case = make(grid, reading, place, streams)
            except SettingsError as error:
                found |= {str(mistake): mistake for mistake in error.mistakes}
                continue
            values = zip(definition.axes, shown, place, strict=True)
            out.append(GridPoint({axis.name: each[n] for axis, each, n in values}, reading, case))
    if found:
        raise SettingsError(f"study {name}", list(found.values()))
    return out


def _is_measured(grid: _Grid) -> bool:
    """Return whether every realisation is a whole measurement: as told, else where the base scene needs it."""
    if grid.definition.simulate is not None:
        return grid.definition.simulate == "bench"
    try:
        tables = with_values(grid.base, {path_of(key): value for key, value in grid.definition.set.items()})
        scene = Scene.model_validate(tables)
        return any(_beyond_gate(scene, twin_settings(scene)))
    except ValueError:
        # What is wrong with it is told with the mistakes of all points.
        return False


def _wrong_for_gate(definition: Definition) -> Iterator[Mistake]:
    """Yield what a study of the gate alone does not depend on."""
    for key in dict.fromkeys((*definition.set, *(key for axis in definition.axes for key in axis.keys))):
        if not any(key == used or key.startswith((f"{used}.", f"{used}[")) for used in USED_KEYS):
            what = "a study of the gate alone does not depend on it"
            yield Mistake(key, what, f'simulate = "bench", which measures all of the scene, or {", ".join(USED_KEYS)}')
    for name in definition.readings.get("as_printed", ()):
        if not spec_of(name).published:
            what = f"{name} has no gain of a difference of pulses to leave in"
            yield Mistake("readings.as_printed", what, '["cross_spectrum"]')
    if definition.corrected:
        yield Mistake("corrected", "a study of the gate alone corrects nothing", f'simulate = "bench", {_MEASURES}')


def _wrong_for_bench(definition: Definition) -> Iterator[Mistake]:
    """Yield what a study by whole measurements sets by itself, and readings that it does not know."""
    for key in dict.fromkeys((*definition.set, *(key for axis in definition.axes for key in axis.keys))):
        if key.partition(".")[0] == "sweep" or key in SET_BY_STUDY:
            yield Mistake(key, "a study says by itself what it repeats and varies", "its axes, scatterers and noise")
    for reading in sorted(definition.readings.keys() - {"physical"}):
        what = "the paper is read otherwise by the gate alone, and this study measures whole scenes"
        yield Mistake(
            f"readings.{reading}", what, 'the reading "physical", or simulate = "gate" with prescribed motion'
        )


def _repeated(definition: Definition) -> Iterator[Mistake]:
    varied = Counter(itertools.chain(*(axis.keys for axis in definition.axes)))
    for key, count in varied.items():
        if count > 1:
            yield Mistake(key, f"{count} axes vary it, and the last one alone would count", "one axis for it")


def _measured_case(grid: _Grid, reading: Reading, place: tuple[int, ...], streams: dict[str, int]) -> MeasuredCase:
    definition, estimators = grid.definition, grid.definition.readings[reading]
    scene = _whole_scene(grid, place, definition.corrected)
    own = plain_tables(scene)
    stream = _stream(grid, reading, place, own, streams, lambda at: plain_tables(_whole_scene(grid, at)))
    sizes = definition.scatterers, definition.noise, definition.standard_error_m
    # All of the program has a part in its numbers, and so has the bench on which it is measured.
    program = version("hpe-rig"), read_bench().text
    key = _hash([ENGINE, "bench", program, own, list(estimators), sizes, stream, definition.corrected])
    case = MeasuredCase(key, stream, scene, estimators, *sizes, definition.corrected)
    try:
        first_setup(case)
    except PlanError as error:
        raise SettingsError(
            "study", [Mistake(each.check, each.text, each.remedy) for each in error.conflicts]
        ) from None
    return case


def _whole_scene(grid: _Grid, place: tuple[int, ...], corrected: bool = False) -> Scene:
    """Return the scene at a place of the axes, one shot of it; raise with every mistake."""
    tables = _tables_at(grid, place)
    # what the study says counts, and not what the scene takes in turn in its place
    said = {*grid.definition.set, *(key for columns in grid.columns for key in columns)}
    turns = {name for key, name in IN_TURN.items() if key in said}
    if turns and isinstance(sweep := tables.get("sweep"), dict):
        tables["sweep"] = {name: values for name, values in sweep.items() if name not in turns}
    mistakes = mistakes_of(Scene, tables) + check_simulation(tables)
    if not mistakes:
        scene = Scene.model_validate(tables)
        mistakes = check_declared(scene)
    if not mistakes and corrected and scene.beams is None:
        mistakes = [Mistake("corrected", "without [beams] nothing is corrected", "a scene with [beams], or false")]
    if not mistakes and not scene.wanted_frequencies_hz:
        what = "no vibration frequency is wanted, so that there is no amplitude"
        mistakes = [Mistake("processing.frequencies_hz", what, "frequencies_hz = [200.0]")]
    if mistakes:
        raise SettingsError("study", mistakes)
    return one_shot(scene)


def _case(grid: _Grid, reading: Reading, place: tuple[int, ...], streams: dict[str, int]) -> Case:
    definition, estimators = grid.definition, grid.definition.readings[reading]
    scene, twin = _checked(_tables_at(grid, place), reading)
    train = _train(scene)
    try:
        refuse_unusable(train, estimators)
    except ValueError as error:
        what, _, remedy = str(error).rpartition("; ")
        raise SettingsError("study", [Mistake("", what or remedy, remedy.removeprefix("try "))]) from None
    own = _dump(scene, twin)
    silent = own | {"simulation": {key: value for key, value in own["simulation"].items() if key != "snr_db"}}
    stream = _stream(grid, reading, place, own, streams, lambda at: _dump(*_checked(_tables_at(grid, at), reading)))
    # Without noise one realisation of it says all.
    scatterers, noise = definition.scatterers, definition.noise if twin.receiver.snr_db is not None else 1
    if reading == "one_draw":
        scatterers, noise = 1, scatterers * noise
    sizes = [scatterers, noise, definition.standard_error_m]
    # "physical" and "literal" differ in the settings already; what these two make of equal echoes differs besides.
    told_apart = [reading] if reading in ("as_printed", "one_draw") else []
    return Case(
        key=_hash([ENGINE, own, list(estimators), sizes, stream, *told_apart]),
        echoes_key=_hash([silent, stream]),
        noise_key=_hash([own["tracking"], own["acquisition"], sizes, list(estimators), stream]),
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
    grid: _Grid,
    reading: Reading,
    place: tuple[int, ...],
    own: Tables,
    known: dict[str, int],
    tables_at: Callable[[tuple[int, ...]], Tables],
) -> int:
    """Return the entropy of a case's random numbers, from its definition or from what it has in common."""
    seed = grid.definition.seed
    if grid.definition.common == "all":
        return int(_hash([seed]), 16)
    shared = grid.common_place(place)
    if (name := f"{reading} {shared}") not in known:
        known[name] = int(_hash([seed, own if shared == place else tables_at(shared)]), 16)
    return known[name]


def _tables_at(grid: _Grid, place: tuple[int, ...]) -> Tables:
    everywhere = {path_of(key): value for key, value in grid.definition.set.items()}
    here = {
        path_of(key): values[n]
        for columns, n in zip(grid.columns, place, strict=True)
        for key, values in columns.items()
    }
    return with_values(with_values(grid.base, everywhere), here)


def _checked(tables: Tables, reading: Reading) -> tuple[Scene, SimulationSettings]:
    """Return the scene and the twin's settings under a reading of eq. (11); raise with every mistake."""
    mistakes = mistakes_of(Scene, tables) + check_simulation(tables)
    if not mistakes:
        scene = Scene.model_validate(tables)
        mistakes = check_declared(scene)
    if not mistakes:
        twin = twin_settings(scene)
        mistakes = list(_unfit(scene, twin))
    if not mistakes:
        return scene, _literal(scene, twin) if reading in ("literal", "as_printed") else twin
    raise SettingsError("study", mistakes)


def _beyond_gate(scene: Scene, twin: SimulationSettings) -> Iterator[tuple[str, str]]:
    """Yield what the scene has beyond the echoes of a gate under prescribed motion, by key and in words."""
    if not twin.motion:
        yield "simulation.motion", "its true motion must be prescribed, and this scene prescribes none"
    beyond = {
        "excitation": (scene.excitation is not None, "it knows no tonebursts"),
        "simulation.background": (bool(twin.background), "it knows no motion of the whole specimen"),
        "simulation.scatterers.reflectors": (bool(twin.scatterers.reflectors), "it draws scatterers alone"),
        "simulation.receive_chain": (twin.receive_chain is not None, "its noise is white, as snr_db says"),
        "simulation.instruments.trigger_jitter_s": (twin.instruments.trigger_jitter_s > 0, "it knows no jitter"),
        "processing.follow_gate": (scene.processing.follow_gate, "its gate stands still"),
    }
    yield from ((key, why) for key, (there, why) in beyond.items() if there)


def _unfit(scene: Scene, twin: SimulationSettings) -> Iterator[Mistake]:
    for key, why in _beyond_gate(scene, twin):
        yield Mistake(key, f"of a study of the gate alone {why}", f'simulate = "bench", {_MEASURES}, or table-1')
    if scene.tracking.pulse_count is None:
        yield Mistake("tracking.pulse_count", "a study needs it, and it is absent", 'set."tracking.pulse_count" = 100')
    known_hz = [part.frequency_hz for part in twin.motion or ()]
    for hz in scene.processing.frequencies_hz or ():
        if hz not in known_hz and known_hz:
            what = f"{hz:g} Hz is wanted and no part of the motion, so its phase has no true value"
            yield Mistake("processing.frequencies_hz", what, f"from {', '.join(f'{each:g}' for each in known_hz)}")


def _literal(scene: Scene, twin: SimulationSettings) -> SimulationSettings:
    """Return eq. (11) read literally: no delay of depth, so that what lies in the gate must be said: its scatterers."""
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


def _dump(scene: Scene, twin: SimulationSettings) -> Tables:
    """Return the values that `USED` names, as JSON knows them."""
    own = {section: set(keys) for section, keys in USED.items()}
    simulation = twin.model_dump(include=own.pop("simulation")) | {"snr_db": twin.receiver.snr_db}
    return {**scene.model_dump(include=own), "simulation": simulation}


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:24]
