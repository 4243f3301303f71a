"""Bench files from a path or text, their wiring checked, and the beams that a bench adds to a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from hpe_rig.bench.bench_file import NO_SERIAL, BenchFile
from hpe_rig.bench.resource_name import resource_names, shared_addresses
from hpe_rig.scene import (
    Mistake,
    Scene,
    SettingsError,
    mistakes_of,
    parse_toml,
    read_settings_text,
    unreadable,
)

IDENTIFY = "hpe-rig bench BENCH --identify, which enters it"


@dataclass(frozen=True, slots=True)
class BenchText:
    """A bench with the text it was read from, which run files store unchanged."""

    name: str
    text: str
    bench: BenchFile


def read_bench(path: Path | None = None, lenient: bool = False) -> BenchText:
    """Return the bench in the TOML file ``path``, by default the shipped simulated bench.

    Raises ``SettingsError`` with every mistake. A real bench with the title of the simulated one is refused, because
    reports would show it, and so are two roles at one instrument and values that no bench can mean. ``lenient``
    accepts all three, so that outputs can be switched off.
    """
    if path is None:
        shipped = resources.files("hpe_rig.bench") / "shipped" / "simulated.toml"
        return parse_bench("simulated", shipped.read_text(encoding="utf-8"))
    try:
        text = read_settings_text(path)
    except (OSError, ValueError) as error:
        mistake = unreadable(error)
        if isinstance(error, FileNotFoundError):
            remedy = "its path; hpe-rig new my-bench --like bench writes one"
            mistake = Mistake("", "there is no file of that name", remedy)
        raise SettingsError(f"bench {path}", [mistake]) from None
    bench_text = parse_bench(path.stem, text)
    bench = bench_text.bench
    if bench.recording is not None:
        what = "this bench file describes an imported recording, without instruments"
        raise SettingsError(f"bench {path.stem}", [Mistake("recording", what, "a bench file with instruments")])
    if lenient:
        return bench_text
    mistakes = list(wrong_values(bench))
    if not bench.simulated:
        mistakes += _wrong_on_metal(bench)
    if mistakes:
        raise SettingsError(f"bench {path.stem}", mistakes)
    return bench_text


def wrong_values(bench: BenchFile) -> Iterator[Mistake]:
    """Yield limits in the wrong order, serial numbers that no instrument has, and a lock that no board has."""
    yield from _reversed_bands(bench)
    yield from _impossible_serials(bench)
    if bench.digitizer.common_reference:
        what = f"the driver cannot lock an {bench.digitizer.model} to a 10 MHz reference"
        remedy = "no such key: common_reference of burst_train and tracking_train suffices"
        yield Mistake("digitizer.common_reference", what, remedy)


def _reversed_bands(bench: BenchFile) -> Iterator[Mistake]:
    for role, generator in bench.generators.by_role.items():
        low_hz, high_hz = generator.carrier_band_hz or (0.0, 0.0)
        if low_hz > high_hz:
            what = f"the lower limit, {low_hz:g} Hz, is above the upper one, {high_hz:g} Hz"
            yield Mistake(f"generators.{role}.carrier_band_hz", what, "the two exchanged")


def _impossible_serials(bench: BenchFile) -> Iterator[Mistake]:
    serials = {f"generators.{role}": item.serial for role, item in bench.generators.by_role.items()}
    for table, serial in (serials | {"digitizer": bench.digitizer.serial}).items():
        if serial is not None and not serial.strip():
            yield Mistake(f"{table}.serial", "the serial number is empty", f"{IDENTIFY}, or no such key")
        elif serial is not None and serial != NO_SERIAL and serial.strip().lower() == NO_SERIAL:
            what = f'{serial!r} would be compared as a serial number; did you mean "{NO_SERIAL}"?'
            yield Mistake(f"{table}.serial", what, f'"{NO_SERIAL}", or {IDENTIFY}')


def _wrong_on_metal(bench: BenchFile) -> list[Mistake]:
    mistakes = list(shared_addresses(bench, resource_names(bench)))
    if bench.title == read_bench().bench.title:
        what = "this is the title of the simulated bench, and every report of this real bench would show it"
        mistakes.append(Mistake("title", what, 'a title such as "HPE bench, room 12"'))
    return mistakes


def parse_bench(name: str, text: str) -> BenchText:
    """Return the bench in ``text``; raise ``SettingsError`` with every mistake."""
    tables = parse_toml(text, f"bench {name}")
    # The two kinds of files are easily exchanged on the command line.
    if {"tracking", "acquisition"} <= tables.keys():
        what, remedy = "this is a scene, not a bench file", "run the same command without --bench"
        remedy += "; hpe-rig new my-bench --like bench writes a bench file"
        raise SettingsError(f"bench {name}", [Mistake("", what, remedy)])
    mistakes = mistakes_of(BenchFile, tables)
    if not mistakes:
        bench = BenchFile.model_validate(tables)
        # Only a file with valid sections is checked as a whole.
        mistakes = _missing_addresses(bench) + _missing_cables(bench) + _crossed_cables(bench)
        mistakes += _wrong_transducer(bench) + _repeated_serials(bench) + _wrong_conditions(bench)
    if mistakes:
        raise SettingsError(f"bench {name}", mistakes)
    return BenchText(name, text, bench)


def _missing_addresses(bench: BenchFile) -> list[Mistake]:
    if bench.simulated or bench.recording is not None:
        return []
    mistakes = []
    if bench.transport:
        mistakes.append(Mistake("transport", "only the simulated bench has one", "remove it; the address is enough"))
    what, remedy = "this key is required on a real bench", 'a VISA name such as "GPIB0::10::INSTR"'
    for role, generator in bench.generators.by_role.items():
        if not generator.address:
            mistakes.append(Mistake(f"generators.{role}.address", what, remedy))
    return mistakes


def _repeated_serials(bench: BenchFile) -> list[Mistake]:
    roles: dict[str, list[str]] = {}
    for role, serial in bench.serials.items():
        # The number of a board may equal that of a generator.
        if role != "digitizer":
            roles.setdefault(serial, []).append(role)
    remedy = "hpe-rig bench BENCH --identify, which enters the right ones"
    return [
        Mistake(f"generators.{repeated[-1]}.serial", f"{serial} is stated for {' and '.join(repeated)}", remedy)
        for serial, repeated in roles.items()
        if len(repeated) > 1
    ]


def _missing_cables(bench: BenchFile) -> list[Mistake]:
    required = [
        ("master.output", "tracking_train.trigger"),
        ("tracking_train.output", "digitizer.trigger"),
        ("digitizer.aux", "tracking_pulser.trigger"),
        ("tracking_pulser.output", bench.tracked_by),
    ]
    if bench.generators.burst_train is not None and bench.generators.toneburst is not None:
        required += [
            ("master.output", "burst_train.trigger"),
            ("burst_train.output", "toneburst.trigger"),
            ("toneburst.output", "transducer.drive"),
        ]
    remedy = '[[wiring]] with source = "{}" and target = "{}"'
    return [
        Mistake("wiring", f"no cable from {source} to {target}", remedy.format(source, target))
        for source, target in required
        if math.isnan(bench.path_delay_s(source, target))
    ]


def _crossed_cables(bench: BenchFile) -> list[Mistake]:
    """Return the inputs with several sources; only a transducer can add two signals.

    Together with the required cables this excludes loops of triggers.
    """
    sources: dict[str, list[str]] = {}
    for cable in bench.wiring:
        sources.setdefault(cable.target, []).append(cable.source)
    return [
        Mistake("wiring", f"{target} has {len(outputs)} sources, {' and '.join(outputs)}", "one cable an input")
        for target, outputs in sources.items()
        if len(outputs) > 1 and target != "transducer.drive"
    ]


def _wrong_transducer(bench: BenchFile) -> list[Mistake]:
    """Return the cables to an absent transducer, from the pulser to the pushing one, from the toneburst to the other.

    A bench without [transducers] has one transducer for both.
    """
    ends = {(cable.source, cable.target) for cable in bench.wiring}
    if bench.transducers is None:
        if not any(target == "tracking_transducer.drive" for _, target in ends):
            return []
        what, remedy = "a cable goes to tracking_transducer.drive, and there is no [transducers]", "[transducers]"
        return [Mistake("wiring", what, remedy)]
    mistakes = []
    if ("tracking_pulser.output", "transducer.drive") in ends:
        what = "tracking_pulser.output drives the transducer that pushes, and [transducers] has another one that tracks"
        mistakes.append(Mistake("wiring", what, "its cable to tracking_transducer.drive alone, or no [transducers]"))
    if ("toneburst.output", "tracking_transducer.drive") in ends:
        what = "toneburst.output drives the transducer that tracks"
        mistakes.append(Mistake("wiring", what, "its cable to transducer.drive alone"))
    return mistakes


def _wrong_conditions(bench: BenchFile) -> list[Mistake]:
    """Return the conditions without one source, with a name used before, or with limits that no value satisfies."""
    mistakes, names = [], list[str]()
    for index, condition in enumerate(bench.conditions):
        path = f"conditions[{index}]"
        if bool(condition.command) == (condition.plugin is not None):
            what = f"{condition.name} needs a command or a plug-in, and not both"
            mistakes.append(Mistake(path, what, 'command = ["python", "thermometer.py"]'))
        if condition.name in names:
            mistakes.append(Mistake(f"{path}.name", f"{condition.name} occurs twice", "a name of its own"))
        if condition.min is not None and condition.max is not None and condition.min > condition.max:
            what = f"min = {condition.min:g} is above max = {condition.max:g}"
            mistakes.append(Mistake(f"{path}.min", what, "the two exchanged"))
        names.append(condition.name)
    return mistakes


def with_transducers(scene: Scene, bench: BenchFile) -> Scene:
    """Return ``scene`` with the beams of the bench's transducers added to its own.

    Raises ``SettingsError`` if the two differ, or if the scene has two transducers and the bench one.
    """
    beams = scene.beams
    if bench.transducers is None:
        # The bench of an imported recording is unknown, so that the scene's two transducers apply.
        if beams is None or beams.push_focus_depth_m is None or bench.recording is not None:
            return scene
        what = "the bench has one transducer that pushes and tracks"
        remedy = "no beams.push_focus_depth_m, or a bench file with [transducers]"
        raise SettingsError("the scene", [Mistake("beams.push_focus_depth_m", what, remedy)])
    # Values that scene and bench file both state must be equal; the bench file adds the others.
    scene_beams = {} if beams is None else beams.model_dump(exclude_none=True)
    bench_beams = bench.transducers.beams
    differences = [
        Mistake(f"beams.{key}", f"{scene_beams[key]} here and {value} in the bench file's [transducers]", "one of them")
        for key, value in bench_beams.items()
        if scene_beams.get(key, value) != value
    ]
    if differences:
        raise SettingsError("the scene", differences)
    return scene.with_({f"beams.{key}": value for key, value in bench_beams.items() if key not in scene_beams})
