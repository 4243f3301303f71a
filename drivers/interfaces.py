"""Interfaces of the bench's instruments: tasks in, records out; SI units, the unit in every name.

In ``hpe_rig`` all but ``hpe_rig.bench`` and ``hpe_rig.plan.checks`` know the instruments by this file alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Setting = str | int | float | bool
"""Value of one setting as an instrument states it."""


class InstrumentError(Exception):
    """An instrument refused, changed or did not answer something; says what, why and what to try."""

    def __init__(self, role: str, what: str, why: str, remedy: str) -> None:
        super().__init__(f"{role}: {what}. {why[:1].upper()}{why[1:]}. Try: {remedy}.")
        self.role = role
        self.what = what
        self.why = why
        self.remedy = remedy

    def __reduce__(self) -> tuple[type[InstrumentError], tuple[str, str, str, str]]:
        """Return how it is made again: an error comes back from another process as it left."""
        return type(self), (self.role, self.what, self.why, self.remedy)


class DeadlineError(InstrumentError):
    """The records that were expected did not arrive in time."""


class Clock(Protocol):
    """Time as the bench knows it: the wall clock on metal, the world's clock on the twin."""

    def now_s(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class Connection(Protocol):
    """One text connection to a SCPI instrument. Messages carry no terminator."""

    def write(self, message: str) -> None: ...

    def read(self) -> str:
        """Return one reply line; raise ``TimeoutError`` when none comes."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class RemoteConnection(Protocol):
    """Additional interface of a connection to another device; one within the process does not have it."""

    timeout_s: float
    """The time that ``read`` waits for a reply."""

    @property
    def bus(self) -> str:
        """Name of the bus or adapter; connections on the same bus are used one after the other."""
        ...

    def reopen(self) -> None:
        """Open a lost connection again; raise ``ConnectionError`` if there is no answer."""
        ...


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answered: vendor, model, serial number and firmware as the instrument states them."""

    vendor: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True, slots=True)
class TriggerPulse:
    """The single pulse of the master trigger."""

    width_s: float
    high_v: float
    load_ohm: float


@dataclass(frozen=True, slots=True)
class PulseTrain:
    """A finite train of TTL pulses, started by an external trigger after ``delay_s``."""

    rate_hz: float
    count: int
    delay_s: float
    width_s: float
    high_v: float
    load_ohm: float


@dataclass(frozen=True, slots=True)
class Toneburst:
    """A finite sine burst, started by an external trigger after ``delay_s``."""

    carrier_hz: float
    cycles: int
    amplitude_vpp: float
    delay_s: float
    load_ohm: float


@dataclass(frozen=True, slots=True)
class ContinuousSine:
    """A sine without beginning or end, whatever is triggered."""

    frequency_hz: float
    amplitude_vpp: float
    load_ohm: float = 50.0


GeneratorTask = TriggerPulse | PulseTrain | Toneburst | ContinuousSine


@dataclass(frozen=True, slots=True)
class Capture:
    """One record a trigger, ``record_count`` of them; sample 0 comes ``trigger_delay_samples`` after the trigger.

    ``monitor_range_v`` is the range of the second input, which is recorded along with the echoes where it is given.
    """

    sample_rate_hz: float
    record_samples: int
    trigger_delay_samples: int
    record_count: int
    input_range_v: float
    trigger_level_v: float
    monitor_range_v: float | None = None

    @property
    def channels(self) -> int:
        """How many inputs are recorded."""
        return 1 if self.monitor_range_v is None else 2


@dataclass(frozen=True, slots=True)
class MonitorRecords:
    """Records of the second input: ``codes`` int16 (record, sample), in volts as those of ``RecordBlock``."""

    codes: NDArray[np.int16]
    volts_per_code: float
    volts_offset: float


@dataclass(frozen=True, slots=True)
class RecordBlock:
    """Consecutive records of one capture.

    ``codes`` int16 (record, sample), zero-centred; volts = ``codes * volts_per_code + volts_offset``. ``code_limits``
    are the lowest and the highest code of the digitizer: a sample at either is clipped.
    ``trigger_time_s`` float64 (record,), from the board's own counter, relative to its reset at arming; NaN where the
    way to capture states none. ``monitor`` holds the same records of the second input, where that is recorded.
    """

    first_record: int
    codes: NDArray[np.int16]
    trigger_time_s: NDArray[np.float64]
    volts_per_code: float
    volts_offset: float
    code_limits: tuple[int, int]
    monitor: MonitorRecords | None = None


class Instrument(Protocol):
    """What every instrument of the bench can do."""

    @property
    def role(self) -> str: ...

    def identify(self) -> Identity: ...

    def snapshot(self) -> Mapping[str, Setting]:
        """Return the settings as read back from the instrument."""
        ...

    def verify(self) -> Mapping[str, Setting]:
        """Return the settings as read back; raise ``InstrumentError`` where one is not as programmed."""
        ...

    def self_test(self) -> bool | None:
        """Return whether the instrument's own test passes, with its output off; None where it has none."""
        ...

    @property
    def line(self) -> str:
        """Name of the line that leads there; instruments of different lines may be spoken to at the same time."""
        ...

    def switch_off(self) -> None:
        """Send what switches the output off or aborts the capture, and wait for no answer."""
        ...

    def prove_off(self) -> str:
        """Return how the output is known to be off, after ``switch_off``; raise ``InstrumentError`` if it is not."""
        ...

    def make_safe(self) -> str:
        """Do both, stubbornly: in whatever state the instrument and the line to it are; return and raise likewise."""
        ...

    def close(self) -> None: ...


class MasterTrigger(Instrument, Protocol):
    """Starts everything: one pulse on software command."""

    def configure(self, task: TriggerPulse, /) -> None: ...

    def enable_output(self) -> None: ...

    def fire(self) -> None: ...

    def recheck(self) -> None:
        """Raise ``InstrumentError`` where output or settings are no longer as they were programmed and verified."""
        ...


class PulseGenerator(Instrument, Protocol):
    """A triggered train of TTL pulses."""

    def configure(self, task: PulseTrain, /) -> None: ...

    def enable_output(self) -> None: ...

    def recheck(self) -> None:
        """Raise ``InstrumentError`` where output or settings are no longer as they were programmed and verified."""
        ...


class ToneburstGenerator(Instrument, Protocol):
    """A triggered sine burst."""

    def configure(self, task: Toneburst, /) -> None: ...

    def enable_output(self) -> None: ...

    def recheck(self) -> None:
        """Raise ``InstrumentError`` where output or settings are no longer as they were programmed and verified."""
        ...


class Digitizer(Instrument, Protocol):
    """A triggered multi-record digitizer whose trigger output fires the tracking pulser."""

    def configure(self, capture: Capture) -> None: ...

    def arm(self) -> None: ...

    def records(self, deadline_s: float) -> Iterator[RecordBlock]:
        """Yield what was captured, in order; raise ``DeadlineError`` when the clock passes ``deadline_s``."""
        ...

    def clipped(self) -> bool:
        """Return whether an input left its range since arming."""
        ...
