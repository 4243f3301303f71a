"""Cases of a study: every point of its axes and reading as a checked scene with its random numbers."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpe_rig.bench import check_declared, check_simulation, twin_of, twin_settings
from hpe_rig.processing import Estimator, Options, spec_of
from hpe_rig.scene import (
    Mistake,
    Scene,
    SettingsError,
    mistakes_of,
    parse_toml,
    path_of,
    scene_text,
    shipped_scenes,
    with_values,
)
from hpe_rig.study.definition import Definition, Reading
from hpe_rig.study.kernels import Train, refuse_unusable

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


@dataclass(frozen=True, slots=True)
class GridPoint:
    """Where a case stands in a study: the shown value of every axis, and the reading of eq. (11)."""

    coordinates: dict[str, Any]
    reading: Reading
    case: Case


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
    found: dict[str, Mistake] = {str(mistake): mistake for mistake in _wrong_keys(definition)}
    out: list[GridPoint] = []
    streams: dict[str, int] = {}
    for reading in definition.readings:
        for place in itertools.product(*(range(len(each)) for each in shown)):
            try:
                case = _case(grid, reading, place, streams)
            except SettingsError as error:
                found |= {str(mistake): mistake for mistake in error.mistakes}
                continue
            values = zip(definition.axes, shown, place, strict=True)
            out.append(GridPoint({axis.name: each[n] for axis, each, n in values}, reading, case))
    if found:
        raise SettingsError(f"study {name}", list(found.values()))
    return out


def _wrong_keys(definition: Definition) -> Iterator[Mistake]:
    varied = Counter(itertools.chain(*(axis.keys for axis in definition.axes)))
    for key in (*definition.set, *varied):
        if not any(key == used or key.startswith((f"{used}.", f"{used}[")) for used in USED_KEYS):
            yield Mistake(key, "a study's echoes and estimates do not depend on it", f"one of {', '.join(USED_KEYS)}")

    for name in definition.readings.get("as_printed", ()):
        if not spec_of(name).published:
            what = f"{name} has no gain of a difference of pulses to leave in"
            yield Mistake("readings.as_printed", what, '["cross_spectrum"]')
    for key, count in varied.items():
        if count > 1:
            yield Mistake(key, f"{count} axes vary it, and the last one alone would count", "one axis for it")


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
    stream = _stream(grid, reading, place, own, streams)
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
        gate_offset_s=2 * (scene.acquisition.gate_depth_m - twin.beams.focus_depth_m) / twin.sound_speed_m_per_s,
        estimators=estimators,
        scatterers=scatterers,
        noise=noise,
        standard_error_m=definition.standard_error_m,
        reading=reading,
    )


def _stream(grid: _Grid, reading: Reading, place: tuple[int, ...], own: Tables, known: dict[str, int]) -> int:
    """Return the entropy of a case's random numbers, from its definition or from what it has in common."""
    seed = grid.definition.seed
    if grid.definition.common == "all":
        return int(_hash([seed]), 16)
    shared = grid.common_place(place)
    if (name := f"{reading} {shared}") not in known:
        first = own if shared == place else _dump(*_checked(_tables_at(grid, shared), reading))
        known[name] = int(_hash([seed, first]), 16)
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


def _unfit(scene: Scene, twin: SimulationSettings) -> Iterator[Mistake]:
    if not twin.motion:
        yield Mistake(
            "simulation.motion",
            "a study needs a motion whose true amplitude is known, and this scene prescribes none",
            "a base scene with [[simulation.motion]], such as table-1",
        )
    if scene.tracking.pulse_count is None:
        yield Mistake("tracking.pulse_count", "a study needs it, and it is absent", 'set."tracking.pulse_count" = 100')
    if twin.scatterers.reflectors:
        yield Mistake("simulation.scatterers.reflectors", "a study draws scatterers alone", "a scene without them")
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
