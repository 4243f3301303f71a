"""Bench file: which instruments, at which addresses, wired how, within which limits, with which calibration."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from drivers.alazar import BoardModel, model_named
from hpe_rig.scene import (
    Count,
    DelayS,
    DurationS,
    FrequencyHz,
    IntensityWPerM2,
    KeyPath,
    LatencyS,
    LengthM,
    Mistake,
    PressurePa,
    Scene,
    Section,
    SettingsError,
    Title,
    VoltageV,
    Widths,
    dotted,
    mistakes_of,
    parse_toml,
    read_settings_text,
    unreadable,
    with_values,
)

GeneratorRole = Literal["master", "burst_train", "toneburst", "tracking_train", "tracking_pulser"]
GENERATOR_ROLES: tuple[GeneratorRole, ...] = get_args(GeneratorRole)
EXCITATION_ROLES: tuple[GeneratorRole, ...] = ("burst_train", "toneburst")

Transport = Literal["socket", "serial", "hislip", "vxi11", "prologix"]
TRANSPORTS: tuple[Transport, ...] = get_args(Transport)

Outlet = Literal[
    "master.output",
    "burst_train.output",
    "toneburst.output",
    "tracking_train.output",
    "tracking_pulser.output",
    "digitizer.aux",
]
Inlet = Literal[
    "burst_train.trigger",
    "toneburst.trigger",
    "tracking_train.trigger",
    "tracking_pulser.trigger",
    "digitizer.trigger",
    "transducer.drive",
    "tracking_transducer.drive",
]


class Generator(Section):
    """One function generator."""

    model: Literal["33250A", "33220A", "33500B", "33600A"] = "33250A"
    """Model, or series, that plays the role and must answer at the address."""
    address: str | None = None
    """VISA resource name; not used on the simulated bench."""
    interface: str | None = None
    """VISA resource name of the adapter in front of it, such as PRLGX-TCPIP0::host::1234::INTFC; absent: none."""
    latency_s: LatencyS = 0.0
    """Trigger input to first output edge."""
    load_ohm: Annotated[float, Field(ge=1, allow_inf_nan=True, strict=True)] = 50.0
    """Load at the output; inf for a high-impedance input."""
    amplitude_vpp: VoltageV | None = None
    """Output amplitude of the tracking pulser."""
    max_vpp: VoltageV | None = None
    """Largest swing into the load that what hangs on the output bears; its driver refuses more."""


class Generators(Section):
    """The generators by role."""

    master: Generator
    """Master trigger: one pulse starts everything."""
    burst_train: Generator | None = None
    """Pulse train at f_r that triggers the toneburst generator."""
    toneburst: Generator | None = None
    """Toneburst generator."""
    tracking_train: Generator
    """Delayed pulse train at f_prf that triggers the digitizer."""
    tracking_pulser: Generator
    """Generator of the tracking pulse, fired by the digitizer's trigger output."""

    @property
    def by_role(self) -> dict[str, Generator]:
        """The generators that there are, by role."""
        pairs = ((role, getattr(self, role)) for role in GENERATOR_ROLES)
        return {role: generator for role, generator in pairs if generator is not None}


class DigitizerBoard(Section):
    """The digitizer."""

    model: Literal["ATS460", "ATS9350", "ATS9440", "ATS9462", "ATS9870"] = "ATS460"
    """Board model."""
    system_id: Count = 1
    """Alazar system number."""
    board_id: Count = 1
    """Alazar board number in its system."""
    dual_port_memory: Annotated[bool, Field(strict=True)] = False
    """Whether an ATS460 has the optional dual-port memory, so that records stream out while others come in."""
    samples_per_channel: Annotated[int, Field(ge=1024, le=2**40, strict=True)] = 8_388_608
    """On-board memory; bounds a capture where there is no dual-port memory."""
    max_records: Annotated[int, Field(ge=1, le=2**32, strict=True)] = model_named("ATS460").stamped_records
    """Most records of a single-port capture. The library states the trigger time of the first 1000 alone, and FPGA
    version 18 and below hold no more; with more, records from 1001 on are placed by counting."""
    latency_s: LatencyS = 0.0
    """Trigger input to sample 0 without trigger delay."""
    aux_latency_s: LatencyS = 0.0
    """Trigger input to rising edge of the trigger output."""
    aux_waits_for_trigger_delay: Annotated[bool, Field(strict=True)] = False
    """Whether the trigger output rises only after the trigger delay (not established for the ATS460)."""
    trigger_level_v: VoltageV = 1.5
    """Level of the external trigger input."""
    library: str | None = None
    """Name or path of the vendor's library; absent: ATSApi.dll or libATSApi.so, as installed."""
    acquisition_mode: Literal["single_port", "traditional", "npt"] | None = None
    """Way to capture; absent: AutoDMA with record headers where there is dual-port memory, else single port."""
    monitor_range_v: VoltageV | None = None
    """Input range of channel B, which is then recorded along with the echoes of channel A; absent: it is not."""

    @property
    def mode(self) -> Literal["single_port", "traditional", "npt"]:
        """The way to capture."""
        return self.acquisition_mode or ("traditional" if self.has_dual_port_memory else "single_port")

    @property
    def has_dual_port_memory(self) -> bool:
        """Whether the board has dual-port memory, as an option or because every board of its model has."""
        return self.dual_port_memory or self.board_model.always_dual_port

    @property
    def board_model(self) -> BoardModel:
        """What the model can do, as its driver says."""
        return model_named(self.model)


class Cable(Section):
    """One cable from an output to an input."""

    source: Outlet
    """Where the cable starts."""
    target: Inlet
    """Where it ends."""
    delay_s: LatencyS = 0.0
    """Propagation delay of the cable and of what stands in it."""


class PushingTransducer(Section):
    """The transducer that pushes."""

    focus_depth_m: LengthM
    """Distance to the common focus."""
    width_m: Widths
    """Sigmas of its force, beams.excitation_width_m of a scene."""


class TrackingTransducer(Section):
    """The transducer that tracks."""

    focus_depth_m: LengthM
    """Distance to the common focus; gates count from this transducer."""
    width_m: Widths
    """Sigmas of its beam, beams.tracking_width_m of a scene."""
    pulse_length_m: Annotated[LengthM, Field(le=0.1)] | None = None
    """Axial length of its pulse as received; absent: that of its cycles."""
    diameter_m: Annotated[LengthM, Field(le=1.0)] | None = None
    """Diameter of its focused aperture; absent: plane waves."""


class Transducers(Section):
    """The transducers of a bench where one pushes and another one tracks."""

    push: PushingTransducer
    """The transducer that pushes, on the cable to transducer.drive."""
    tracking: TrackingTransducer
    """The transducer that tracks, on the cable to tracking_transducer.drive."""

    @property
    def beams(self) -> dict[str, Any]:
        """What they say of a scene's [beams], by its keys."""
        push, tracking = self.push, self.tracking
        own = {
            "excitation_width_m": push.width_m,
            "tracking_width_m": tracking.width_m,
            "focus_depth_m": tracking.focus_depth_m,
            "push_focus_depth_m": push.focus_depth_m,
            "pulse_length_m": tracking.pulse_length_m,
            "transducer_diameter_m": tracking.diameter_m,
        }
        return {key: value for key, value in own.items() if value is not None}


class OutputLimits(Section):
    """What the bench must never exceed."""

    full_drive_vpp: VoltageV
    """Toneburst amplitude at the generator that gives the force F_0."""
    max_duty: Annotated[float, Field(gt=0, le=1, strict=True)]
    """Largest f_r T_b."""
    max_burst_length_s: DurationS
    """Longest toneburst."""
    max_bursts: Count
    """Most tonebursts in a train."""
    max_drive_vpp: VoltageV | None = None
    """Largest amplitude of a generator that drives the transducer; absent: the instrument's own limit."""
    max_mechanical_index: Annotated[float, Field(gt=0, le=100, strict=True)] = 1.9
    """Largest derated mechanical index (FDA, track 3)."""
    max_sppa_w_per_m2: IntensityWPerM2 = 1.9e6
    """Largest derated pulse-average intensity; within it the mechanical index may be exceeded (FDA, track 3)."""
    max_spta_w_per_m2: IntensityWPerM2 = 7.2e3
    """Largest derated time-average intensity (FDA, track 3)."""


class DriveCalibration(Section):
    """What a hydrophone in water measured at the focus for one kind of drive."""

    carrier_hz: FrequencyHz
    """Carrier that was driven."""
    amplitude_vpp: VoltageV
    """Generator amplitude that was set."""
    rarefaction_pa: PressurePa
    """Peak rarefactional pressure, not derated."""
    sppa_w_per_m2: IntensityWPerM2
    """Pulse-average intensity, not derated."""


class Calibration(Section):
    """Acoustic output of transducer, amplifier and generator together, from which every plan's output is estimated."""

    source: str
    """Who measured what when, or that it is assumed."""
    focus_depth_m: LengthM
    """Distance between transducer and focus; the way over which the output is derated."""
    toneburst: DriveCalibration | None = None
    """The toneburst that pushes."""
    tracking_pulse: DriveCalibration | None = None
    """The pulse that tracks."""


class ForeignRecording(Section):
    """Where the records come from that were imported instead of measured; the bench then stands for another one."""

    source: Annotated[str, Field(max_length=1000)]
    """Name of the file, or "array"."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """SHA-256 of its bytes."""
    format: str
    """Format it was read as."""
    first_sample_s: DelayS
    """Time of a record's first sample after the onset of its tracking pulse."""
    inferred: tuple[str, ...] = ()
    """What was not stated, in words, with where it was taken from."""

    @property
    def words(self) -> str:
        """Where the records come from, as results name it."""
        return f"{self.source}, SHA-256 {self.sha256}"


class BenchFile(Section):
    """One bench."""

    title: Title
    """One line that says which bench this is."""
    simulated: Annotated[bool, Field(strict=True)]
    """True for the twin; decides what the drivers stand on and is written into every file."""
    transport: Transport | None = None
    """How VISA reaches the simulated generators, by loopback; absent: they are called in process."""
    limits: OutputLimits
    """What the bench must never exceed."""
    calibration: Calibration | None = None
    """Acoustic output; absent: it is not estimated, and said so."""
    generators: Generators
    """The generators by role."""
    digitizer: DigitizerBoard
    """The digitizer."""
    wiring: tuple[Cable, ...]
    """The cables."""
    transducers: Transducers | None = None
    """The transducers where one pushes and another one tracks; absent: one does both, and scenes have [beams]."""
    recording: ForeignRecording | None = None
    """Where imported records come from; only in run files that hpe-rig import wrote."""
    store_user: Annotated[bool, Field(strict=True)] = True
    """Whether the name of the account that measures is stored in run files; hpe-rig never sends it anywhere."""

    def with_(self, values: Mapping[KeyPath, int | float]) -> BenchFile:
        """Return the bench with ``values`` by path, as a scene's sweep asks for them.

        A real bench keeps what protects the specimen: a limit may be lowered and not raised, and what a hydrophone
        measured is as it was measured. Raises ``SettingsError`` with every mistake.
        """
        if not values:
            return self
        mistakes = [] if self.simulated else list(_loosened(self, values))
        tables = with_values(_plain_tables(self.model_dump(exclude_unset=True, exclude_none=True)), values)
        mistakes += mistakes_of(BenchFile, tables, ("bench",))
        if mistakes:
            raise SettingsError("the sweep", mistakes)
        return BenchFile.model_validate(tables)

    @property
    def tracked_by(self) -> Inlet:
        """The input of the transducer that tracks."""
        return "transducer.drive" if self.transducers is None else "tracking_transducer.drive"

    def path_delay_s(self, source: str, target: str) -> float:
        """Return the delay of the cable from ``source`` to ``target``; NaN where there is none."""
        delays = [cable.delay_s for cable in self.wiring if (cable.source, cable.target) == (source, target)]
        return delays[0] if delays else math.nan


@dataclass(frozen=True, slots=True)
class BenchText:
    """A bench with the text that it was read from, kept verbatim for the run file."""

    name: str
    text: str
    bench: BenchFile


def parse_bench(name: str, text: str) -> BenchText:
    """Return the bench in ``text``; raise ``SettingsError`` with every mistake."""
    tables = parse_toml(text, f"bench {name}")
    if {"tracking", "acquisition"} <= tables.keys():
        what, remedy = "this is a scene, not a bench file", "it without --bench; hpe-rig new my-bench --like bench"
        raise SettingsError(f"bench {name}", [Mistake("", what, remedy)])
    mistakes = mistakes_of(BenchFile, tables)
    if not mistakes:
        bench = BenchFile.model_validate(tables)
        mistakes = _missing_addresses(bench) + _missing_cables(bench) + _crossed_cables(bench)
        mistakes += _wrong_transducer(bench)
    if mistakes:
        raise SettingsError(f"bench {name}", mistakes)
    return BenchText(name, text, bench)


def read_bench(path: Path | None = None, any_title: bool = False) -> BenchText:
    """Return the bench in the TOML file ``path``, or the shipped simulated bench where that is None.

    ``any_title``: also a real bench that still has the simulated one's title.
    """
    if path is None:
        shipped = resources.files("hpe_rig.bench") / "shipped" / "simulated.toml"
        return parse_bench("simulated", shipped.read_text(encoding="utf-8"))
    try:
        found = parse_bench(path.stem, read_settings_text(path))
    except (OSError, ValueError) as error:
        mistake = unreadable(error)
        if isinstance(error, FileNotFoundError):
            remedy = "its path; hpe-rig new my-bench --like bench writes one"
            mistake = Mistake("", "there is no file of that name", remedy)
        raise SettingsError(f"bench {path}", [mistake]) from None
    return found if any_title else _own(found)


def _loosened(bench: BenchFile, values: Mapping[KeyPath, int | float]) -> Iterator[Mistake]:
    """Yield which of ``values`` would have a real bench do more than its own file allows."""
    for path, value in values.items():
        name = dotted(("bench", *path))
        if path[0] == "calibration":
            yield Mistake(name, "what a hydrophone measured is not swept on a real bench", "the bench file")
        elif path[0] == "limits" or str(path[-1]).startswith("max_"):
            own: Any = bench
            for part in path:
                own = own[part] if isinstance(part, int) else getattr(own, part, None)
            if own is None or value > own:
                what = f"{value:g} is above what the bench file allows"
                yield Mistake(name, what, "at most its own" if own is None else f"at most {own:g}")


def with_transducers(scene: Scene, bench: BenchFile) -> Scene:
    """Return ``scene`` with the beams of the bench's transducers where it says none of its own.

    Raises ``SettingsError`` where it says others, or of a second transducer that the bench does not have.
    """
    beams = scene.beams
    if bench.transducers is None:
        if beams is None or beams.push_focus_depth_m is None or bench.recording is not None:
            # of an imported recording the scene alone says with how many it was taken
            return scene
        what = "the bench has one transducer that pushes and tracks"
        remedy = "no beams.push_focus_depth_m, or a bench file with [transducers]"
        raise SettingsError("the scene", [Mistake("beams.push_focus_depth_m", what, remedy)])
    own = {} if beams is None else beams.model_dump(exclude_none=True)
    known = bench.transducers.beams
    unlike = [
        Mistake(f"beams.{key}", f"{own[key]} here and {known[key]} in the bench file's [transducers]", "one of them")
        for key in known
        if own.get(key, known[key]) != known[key]
    ]
    if unlike:
        raise SettingsError("the scene", unlike)
    return scene.with_({f"beams.{key}": value for key, value in known.items() if key not in own})


def _plain_tables(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain_tables(inner) for key, inner in value.items()}
    return [_plain_tables(inner) for inner in value] if isinstance(value, list | tuple) else value


def titled(text: str, title: str) -> str:
    """Return the text of a bench file with another title."""
    return re.sub(r"^title\s*=.*$", lambda _: f"title = {json.dumps(title)}", text, count=1, flags=re.MULTILINE)


def _own(found: BenchText) -> BenchText:
    """Return ``found``; raise ``SettingsError`` for a real bench by the name of the simulated one.

    Here and not among the mistakes of a bench file, so that every run that was ever measured can be opened.
    """
    if not found.bench.simulated and found.bench.title == read_bench().bench.title:
        what = "this is the title of the simulated bench, and it would stand on every report of this real one"
        raise SettingsError(f"bench {found.name}", [Mistake("title", what, 'a title such as "HPE bench, room 12"')])
    return found


def _missing_addresses(bench: BenchFile) -> list[Mistake]:
    if bench.simulated or bench.recording is not None:
        return []
    simulated_only = [Mistake("transport", "only the simulated bench has one", "remove it: the address says it all")]
    what, remedy = "this key is required on a real bench", 'a VISA name such as "GPIB0::10::INSTR"'
    return (simulated_only if bench.transport else []) + [
        Mistake(f"generators.{role}.address", what, remedy)
        for role, generator in bench.generators.by_role.items()
        if not generator.address
    ]


def _missing_cables(bench: BenchFile) -> list[Mistake]:
    needed = [
        ("master.output", "tracking_train.trigger"),
        ("tracking_train.output", "digitizer.trigger"),
        ("digitizer.aux", "tracking_pulser.trigger"),
        ("tracking_pulser.output", bench.tracked_by),
    ]
    if bench.generators.burst_train is not None and bench.generators.toneburst is not None:
        needed += [
            ("master.output", "burst_train.trigger"),
            ("burst_train.output", "toneburst.trigger"),
            ("toneburst.output", "transducer.drive"),
        ]
    remedy = '[[wiring]] with source = "{}" and target = "{}"'
    return [
        Mistake("wiring", f"no cable from {source} to {target}", remedy.format(source, target))
        for source, target in needed
        if math.isnan(bench.path_delay_s(source, target))
    ]


def _wrong_transducer(bench: BenchFile) -> list[Mistake]:
    """Return the cables to a transducer that is not there, and the pulser's to one that does not track."""
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


def _crossed_cables(bench: BenchFile) -> list[Mistake]:
    """Return the inputs with two sources; only the transducer takes a sum. With the needed cables no loop is left."""
    sources: dict[str, list[str]] = {}
    for cable in bench.wiring:
        sources.setdefault(cable.target, []).append(cable.source)
    return [
        Mistake("wiring", f"{target} has {len(found)} sources, {' and '.join(found)}", "one cable an input")
        for target, found in sources.items()
        if len(found) > 1 and target != "transducer.drive"
    ]
