"""Bench file: instruments and their addresses, cables, limits and calibration of one bench."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args

from pydantic import Field

from drivers.agilent import MODEL_NAMES, MODELS
from drivers.alazar import BOARD_NAMES, BoardModel, model_named
from drivers.visa import Handshake, Termination
from hpe_rig.scene import (
    Count,
    DurationS,
    FrequencyHz,
    IntensityWPerM2,
    KeyPath,
    LatencyS,
    LengthM,
    Mistake,
    PressurePa,
    SampleTimeS,
    Section,
    SettingsError,
    Title,
    VoltageV,
    Widths,
    dotted,
    mistakes_of,
    plain_tables,
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
    "digitizer.channel_b",
    "transducer.drive",
    "tracking_transducer.drive",
]


Day = Annotated[date, Field(strict=True)]
"""A date of TOML, such as 2026-03-05."""
if TYPE_CHECKING:
    BoardName = str
    GeneratorName = str
else:
    # Names of the boards and of the generators, or series of generators, that have a driver.
    BoardName = Literal[BOARD_NAMES]
    GeneratorName = Literal[MODEL_NAMES]

ClockAccuracy = Annotated[float, Field(gt=0, le=1e-2, strict=True)]
"""Relative error of a clock's rate."""
Serial = Annotated[str, Field(pattern=r"^[ -~]{0,64}$", strict=True)]
"""Serial number or label of an instrument, in printable ASCII."""
NO_SERIAL = "none"
"""Serial of an instrument that keeps neither a serial number nor a label."""
INSTRUMENT_KEYS: Final = {"model", "address", "interface", "serial", "system_id", "board_id"}
"""Keys that say which instrument has a role."""


class Generator(Section):
    """One function generator."""

    model: GeneratorName = "33250A"
    """Model or series in this role, which must answer at the address."""
    address: str | None = None
    """VISA resource name; not needed on the simulated bench."""
    interface: str | None = None
    """VISA resource name of the adapter before it, such as PRLGX-TCPIP0::host::1234::INTFC; default: none."""
    baud: Annotated[int, Field(ge=300, le=1_000_000, strict=True)] = 57600
    """Speed of an RS-232 line, as at the instrument's front panel; 8 data bits, no parity, 1 stop bit."""
    handshake: Handshake = "dtr_dsr"
    """Handshake of an RS-232 line, as at the front panel; whichever it is, the line is paced by queries too."""
    termination: Termination = "lf"
    """Line end of commands and replies on an RS-232 line."""
    serial: Serial | None = None
    """Serial number, or label of a model without one; hpe-rig bench BENCH --identify enters it. Default: not compared.
    "none": this instrument keeps neither, and its role is taken on trust."""
    latency_s: LatencyS = 0.0
    """Delay from the trigger input to the first output edge."""
    load_ohm: Annotated[float, Field(ge=1, allow_inf_nan=True, strict=True)] = 50.0
    """Load at the output; inf for a high-impedance input."""
    amplitude_vpp: VoltageV | None = None
    """Output amplitude of the tracking pulser."""
    max_vpp: VoltageV | None = None
    """Largest voltage into the load that the connected device tolerates; the driver refuses more."""
    carrier_band_hz: tuple[FrequencyHz, FrequencyHz] | None = None
    """Lowest and highest carrier that the transducer at this output may be driven with; default: not limited."""
    clock_accuracy: ClockAccuracy | None = None
    """Relative standard uncertainty of its internal clock's rate; default: the limit in the model's data sheet."""
    common_reference: Annotated[bool, Field(strict=True)] | Literal["source"] = False
    """Whether its clock is locked to a shared reference at its 10 MHz input, which is verified before and after each
    shot; "source": its 10 MHz output is that reference."""

    @property
    def clock_uncertainty(self) -> float:
        """Relative standard uncertainty of the internal clock, the model's default filled in."""
        by_model = {model.name: model.clock_accuracy for model in MODELS}
        return self.clock_accuracy or by_model[self.model]


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
    """Generator of the tracking pulse, triggered by the digitizer's trigger output."""

    @property
    def by_role(self) -> dict[str, Generator]:
        """The generators of the bench, by role."""
        pairs = ((role, getattr(self, role)) for role in GENERATOR_ROLES)
        return {role: generator for role, generator in pairs if generator is not None}


class DigitizerBoard(Section):
    """The digitizer."""

    model: BoardName = "ATS460"
    """Board model."""
    system_id: Count = 1
    """Alazar system number."""
    board_id: Count = 1
    """Alazar board number in its system."""
    serial: Serial | None = None
    """Serial number of the board; hpe-rig bench BENCH --identify enters it. Default: not compared."""
    dual_port_memory: Annotated[bool, Field(strict=True)] = False
    """Whether an ATS460 has the optional dual-port memory, so that records are read during the capture."""
    samples_per_channel: Annotated[int, Field(ge=1024, le=2**40, strict=True)] = 8_388_608
    """On-board memory; it limits a capture without dual-port memory."""
    max_records: Annotated[int, Field(ge=1, le=2**32, strict=True)] = model_named("ATS460").stamped_records
    """Largest number of records of a single-port capture. The library states the trigger times of the first 1000 only,
    and FPGA versions up to 18 hold no more; the times of further records follow from counting."""
    latency_s: LatencyS = 0.0
    """Delay from the trigger input to sample 0 without trigger delay."""
    aux_latency_s: LatencyS = 0.0
    """Delay from the trigger input to the rising edge of the trigger output."""
    aux_waits_for_trigger_delay: Annotated[bool, Field(strict=True)] = False
    """Whether the trigger output rises only after the trigger delay (not established for the ATS460)."""
    trigger_level_v: VoltageV = 1.5
    """Level of the external trigger input."""
    library: str | None = None
    """Name or path of the vendor's library; default: the installed ATSApi.dll or libATSApi.so."""
    acquisition_mode: Literal["single_port", "traditional", "npt"] | None = None
    """Capture mode; default: AutoDMA with record headers if there is dual-port memory, otherwise single port."""
    monitor_range_v: VoltageV | None = None
    """Input range of channel B, which is recorded in addition to the echoes on channel A; default: not recorded."""
    clock_accuracy: ClockAccuracy | None = None
    """Relative standard uncertainty of its internal clock's rate; default: the limit in the model's data sheet."""
    common_reference: Annotated[bool, Field(strict=True)] = False
    """Whether its clock is locked to the reference of the generators; refused, as the driver cannot lock a board."""

    @property
    def clock_uncertainty(self) -> float:
        """Relative standard uncertainty of the internal clock, the model's default filled in."""
        return self.clock_accuracy or self.board_model.clock_accuracy

    @property
    def mode(self) -> Literal["single_port", "traditional", "npt"]:
        """The capture mode, its default filled in."""
        return self.acquisition_mode or ("traditional" if self.has_dual_port_memory else "single_port")

    @property
    def has_dual_port_memory(self) -> bool:
        """Whether the board has dual-port memory, as an option or as every board of its model."""
        return self.dual_port_memory or self.board_model.always_dual_port

    @property
    def board_model(self) -> BoardModel:
        """Capabilities of the board, from its driver."""
        return model_named(self.model)


class Cable(Section):
    """One cable from an output to an input."""

    source: Outlet
    """Where the cable starts."""
    target: Inlet
    """Where it ends."""
    delay_s: LatencyS = 0.0
    """Propagation delay of the cable and of the devices in it."""
    delay_u_s: LatencyS | None = None
    """Standard uncertainty of the delay, from hpe-rig commission; default: it was not measured."""


class Commissioning(Section):
    """What hpe-rig commission proved; it writes this table."""

    date: Day
    """Day of the commissioning."""
    program: Annotated[str, Field(max_length=100)]
    """Program and version."""
    digest: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    """Digest of instruments and cables, which differs if they were changed in the bench file since."""
    cables: tuple[str, ...]
    """The cables that lead where [[wiring]] says, with the right polarity."""


class PushingTransducer(Section):
    """The transducer that pushes."""

    focus_depth_m: LengthM
    """Distance to the common focus."""
    width_m: Widths
    """Standard deviations of its force, beams.excitation_width_m of a scene."""


class TrackingTransducer(Section):
    """The transducer that tracks."""

    focus_depth_m: LengthM
    """Distance to the common focus; depths of gates count from this transducer."""
    width_m: Widths
    """Standard deviations of its beam, beams.tracking_width_m of a scene."""
    pulse_length_m: Annotated[LengthM, Field(le=0.1)] | None = None
    """Axial length of its received pulse; default: from its cycles."""
    diameter_m: Annotated[LengthM, Field(le=1.0)] | None = None
    """Diameter of its focused aperture; default: plane waves."""


class Transducers(Section):
    """The transducers of a bench with one that pushes and another one that tracks."""

    push: PushingTransducer
    """The transducer that pushes, on the cable to transducer.drive."""
    tracking: TrackingTransducer
    """The transducer that tracks, on the cable to tracking_transducer.drive."""

    @property
    def beams(self) -> dict[str, Any]:
        """Values of a scene's [beams] that follow from the transducers, by key."""
        push, tracking = self.push, self.tracking
        values = {
            "excitation_width_m": push.width_m,
            "tracking_width_m": tracking.width_m,
            "focus_depth_m": tracking.focus_depth_m,
            "push_focus_depth_m": push.focus_depth_m,
            "pulse_length_m": tracking.pulse_length_m,
            "transducer_diameter_m": tracking.diameter_m,
        }
        return {key: value for key, value in values.items() if value is not None}


class OutputLimits(Section):
    """Limits that the bench must never exceed."""

    full_drive_vpp: VoltageV
    """Toneburst amplitude at the generator that gives the force F_0."""
    max_duty: Annotated[float, Field(gt=0, le=1, strict=True)]
    """Largest f_r T_b."""
    max_burst_length_s: DurationS
    """Longest toneburst."""
    max_bursts: Count
    """Largest number of tonebursts in a train."""
    max_drive_vpp: VoltageV | None = None
    """Largest amplitude of a generator that drives the transducer; default: the instrument's limit."""
    max_mechanical_index: Annotated[float, Field(gt=0, le=100, strict=True)] = 1.9
    """Largest derated mechanical index (FDA, track 3)."""
    max_sppa_w_per_m2: IntensityWPerM2 = 1.9e6
    """Largest derated pulse-average intensity; below it the mechanical index may be exceeded (FDA, track 3)."""
    max_spta_w_per_m2: IntensityWPerM2 = 7.2e3
    """Largest derated time-average intensity (FDA, track 3)."""


class DriveCalibration(Section):
    """Output at the focus that a hydrophone in water measured for one drive."""

    carrier_hz: FrequencyHz
    """Carrier frequency of the drive."""
    amplitude_vpp: VoltageV
    """Amplitude of the generator."""
    rarefaction_pa: PressurePa
    """Peak rarefactional pressure, not derated."""
    sppa_w_per_m2: IntensityWPerM2
    """Pulse-average intensity, not derated."""


class Calibration(Section):
    """Acoustic output of transducer, amplifier and generator together; plans estimate their output from it."""

    source: str
    """Who measured what and when, or "assumed"."""
    date: Day | None = None
    """Day of the measurement."""
    who: str | None = None
    """Who measured."""
    u: Annotated[float, Field(gt=0, le=1, strict=True)] | None = None
    """Relative standard uncertainty of the pressures; that of the intensities is twice as large."""
    valid_until: Day | None = None
    """Last day on which a real bench may use the calibration; default: it does not expire."""
    focus_depth_m: LengthM
    """Distance between transducer and focus, over which the output is derated."""
    toneburst: DriveCalibration | None = None
    """The toneburst that pushes."""
    tracking_pulse: DriveCalibration | None = None
    """The pulse that tracks."""


class Condition(Section):
    """A quantity that is read before and after each shot, with outputs off: by a command or by a plug-in."""

    name: Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    """Name in run files, results and lists."""
    unit: Annotated[str, Field(max_length=16)] = ""
    """Unit of the number that is read."""
    command: tuple[str, ...] = ()
    """Program and its arguments, started without a shell; it prints one number."""
    plugin: str | None = None
    """Entry point in the group hpe_rig.conditions: a function without arguments that returns the number."""
    timeout_s: DurationS = 5.0
    """Time after which the quantity counts as not read."""
    min: Annotated[float, Field(strict=True)] | None = None
    """Lower limit: below it the next shot waits with outputs off."""
    max: Annotated[float, Field(strict=True)] | None = None
    """Upper limit: above it the next shot waits with outputs off."""
    max_wait_s: DurationS = 600.0
    """Longest wait for a value within the limits, after which the run ends."""

    @property
    def has_limits(self) -> bool:
        """Whether the run waits for a value within limits."""
        return self.min is not None or self.max is not None

    def accepts(self, value: float) -> bool:
        """Return whether a shot may begin at ``value``, NaN if it was not read."""
        low, high = (-math.inf if self.min is None else self.min), (math.inf if self.max is None else self.max)
        return not self.has_limits or low <= value <= high

    @property
    def limits_text(self) -> str:
        """The limits in words; "" without any."""
        low, high = (None if bound is None else f"{bound:g}" for bound in (self.min, self.max))
        if low is not None and high is not None:
            return f"{low} to {high} {self.unit}".strip()
        bound = f"at least {low}" if low is not None else f"at most {high}"
        return f"{bound} {self.unit}".strip() if self.has_limits else ""

    def value_text(self, value: float) -> str:
        """Return ``value`` with its unit, "not read" for NaN."""
        return "not read" if math.isnan(value) else f"{value:.6g} {self.unit}".strip()


class ForeignRecording(Section):
    """Source of records that were imported instead of measured; the bench then represents an unknown one."""

    source: Annotated[str, Field(max_length=1000)]
    """Name of the file, or "array"."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """SHA-256 of its bytes."""
    format: str
    """Format of the file."""
    first_sample_s: SampleTimeS
    """Time of a record's first sample after the onset of its tracking pulse."""
    inferred: tuple[str, ...] = ()
    """Values that were not stated, in words, with their source."""

    @property
    def words(self) -> str:
        """The source of the records, as results name it."""
        return f"{self.source}, SHA-256 {self.sha256}"


class BenchFile(Section):
    """One bench."""

    title: Title
    """One line that identifies the bench."""
    simulated: Annotated[bool, Field(strict=True)]
    """True for the twin; it selects the connections under the drivers and is written into every file."""
    transport: Transport | None = None
    """How VISA reaches the simulated generators, by loopback; default: they are called in the same process."""
    emulated: Annotated[bool, Field(strict=True)] = False
    """Whether the instruments of a simulated bench answer with the serial numbers of this file; hpe-rig emulate writes
    it for a real bench."""
    limits: OutputLimits
    """Limits that the bench must never exceed."""
    calibration: Calibration | None = None
    """Acoustic output; default: it is not estimated, and checks report so."""
    generators: Generators
    """The generators by role."""
    digitizer: DigitizerBoard
    """The digitizer."""
    wiring: tuple[Cable, ...]
    """The cables."""
    commissioning: Commissioning | None = None
    """What hpe-rig commission proved; default: nothing, and checks of a real bench report so."""
    transducers: Transducers | None = None
    """The transducers if one pushes and another one tracks; default: one does both, and scenes have [beams]."""
    conditions: Annotated[tuple[Condition, ...], Field(max_length=64)] = ()
    """Quantities such as the temperature of the water that are read before and after each shot."""
    recording: ForeignRecording | None = None
    """Source of imported records; only in run files that hpe-rig import wrote."""
    store_user: Annotated[bool, Field(strict=True)] = True
    """Whether the name of the user account is stored in run files; hpe-rig never sends it anywhere."""

    def with_(self, values: Mapping[KeyPath, int | float]) -> BenchFile:
        """Return the bench with ``values`` by path, at one point of a scene's sweep.

        On a real bench a sweep may lower a limit but not raise it, and may not change the calibration. Raises
        ``SettingsError`` with every mistake.
        """
        if not values:
            return self
        # No limit protects anything on the twin.
        mistakes = [] if self.simulated else list(_raised_limits(self, values))
        tables = with_values(plain_tables(self), values)
        mistakes += mistakes_of(BenchFile, tables, ("bench",))
        if mistakes:
            raise SettingsError("the sweep", mistakes)
        return BenchFile.model_validate(tables)

    @property
    def serials(self) -> dict[str, str]:
        """The stated serial numbers and labels, by role."""
        serials = {role: generator.serial for role, generator in self.generators.by_role.items()}
        serials["digitizer"] = self.digitizer.serial
        return {role: serial for role, serial in serials.items() if serial and serial != NO_SERIAL}

    @property
    def commissioned_digest(self) -> str:
        """Digest of instruments and wiring, which a commissioning proves: 16 hexadecimal digits."""
        instruments = {**self.generators.by_role, "digitizer": self.digitizer}
        proven = {
            "simulated": self.simulated,
            "instruments": {
                role: item.model_dump(mode="json", include=INSTRUMENT_KEYS, exclude_none=True)
                for role, item in instruments.items()
            },
            "wiring": sorted([cable.source, cable.target, f"{cable.delay_s:.12g}"] for cable in self.wiring),
        }
        return hashlib.sha256(json.dumps(proven, sort_keys=True).encode()).hexdigest()[:16]

    def address_text(self, role: str) -> str:
        """Return in words how the instrument of ``role`` is reached."""
        if role == "digitizer":
            return f"system {self.digitizer.system_id}, board {self.digitizer.board_id}"
        if self.simulated:
            return f"{self.transport} loopback" if self.transport else "in process"
        return self.generators.by_role[role].address or "-"

    @property
    def tracked_by(self) -> Inlet:
        """The input of the tracking transducer."""
        return "transducer.drive" if self.transducers is None else "tracking_transducer.drive"

    def path_delay_s(self, source: str, target: str) -> float:
        """Return the delay of the cable from ``source`` to ``target``; NaN if there is none."""
        delays = [cable.delay_s for cable in self.wiring if (cable.source, cable.target) == (source, target)]
        return delays[0] if delays else math.nan


def _raised_limits(bench: BenchFile, values: Mapping[KeyPath, int | float]) -> Iterator[Mistake]:
    """Yield each of ``values`` that lets a real bench exceed the limits of its bench file."""
    for path, value in values.items():
        key = dotted(("bench", *path))
        if path[0] == "calibration":
            yield Mistake(key, "a sweep cannot change the calibration of a real bench", "the bench file")
        elif path[0] == "limits" or str(path[-1]).startswith("max_"):
            limit: Any = bench
            # A limit that the bench file does not state is None and must not be added by a sweep.
            for key_or_index in path:
                limit = limit[key_or_index] if isinstance(key_or_index, int) else getattr(limit, key_or_index, None)
            if limit is None or value > limit:
                what = f"{value:g} is above the limit of the bench file"
                yield Mistake(key, what, "no sweep of it" if limit is None else f"at most {limit:g}")
