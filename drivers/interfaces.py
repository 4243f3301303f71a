"""Interfaces of the bench's instruments: tasks in, records out; SI units, the unit in every name.

In ``hpe_rig`` only ``hpe_rig.bench`` and ``hpe_rig.plan.checks`` import more of the drivers than this module.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Setting = str | int | float | bool
"""Value of one setting as reported by an instrument."""


class InstrumentError(Exception):
    """Failure of an instrument: what happened, the likely cause (``why``) and what to try (``remedy``)."""

    def __init__(self, role: str, what: str, why: str, remedy: str) -> None:
        super().__init__(f"{role}: {what}. {why[:1].upper()}{why[1:]}. Try: {remedy}.")
        self.role = role
        self.what = what
        self.why = why
        self.remedy = remedy

    def __reduce__(self) -> tuple[type[InstrumentError], tuple[str, str, str, str]]:
        """Return the constructor call for pickle, which cannot restore the four arguments on its own."""
        return type(self), (self.role, self.what, self.why, self.remedy)


class DeadlineError(InstrumentError):
    """Expected records did not arrive in time."""


class Clock(Protocol):
    """Time of the bench: the wall clock, or the clock of the simulated world."""

    def now_s(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class Connection(Protocol):
    """One text connection to a SCPI instrument. Messages carry no terminator."""

    def write(self, message: str) -> None: ...

    def read(self) -> str:
        """Return one reply line; raise ``TimeoutError`` if none arrives."""
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
    """Vendor, model, serial number and firmware as reported by the instrument."""

    vendor: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True, slots=True)
class TriggerPulse:
    """A single pulse, started by software: the master trigger."""

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
    """A continuous sine, independent of triggers."""

    frequency_hz: float
    amplitude_vpp: float
    load_ohm: float = 50.0


GeneratorTask = TriggerPulse | PulseTrain | Toneburst | ContinuousSine


@dataclass(frozen=True, slots=True)
class Capture:
    """``record_count`` records, one a trigger; sample 0 comes ``trigger_delay_samples`` after the trigger.

    ``monitor_range_v`` is the range of the second input; None: only the first input, the echoes, is recorded.
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
        """Number of recorded inputs."""
        return 1 if self.monitor_range_v is None else 2


@dataclass(frozen=True, slots=True)
class MonitorRecords:
    """Records of the second input: ``codes`` int16 (record, sample), scaled as in ``RecordBlock``."""

    codes: NDArray[np.int16]
    volts_per_code: float
    volts_offset: float


@dataclass(frozen=True, slots=True)
class RecordBlock:
    """Consecutive records of one capture.

    Attributes:
        codes: int16 (record, sample), zero-centred; volts = ``codes * volts_per_code + volts_offset``.
        trigger_time_s: float64 (record,), by the board's counter, which starts at zero when the board is armed; NaN
            if the acquisition mode does not provide it.
        code_limits: the lowest and the highest code of the digitizer; a sample at either is clipped.
        monitor: the same records of the second input, None if it is not recorded.
    """

    first_record: int
    codes: NDArray[np.int16]
    trigger_time_s: NDArray[np.float64]
    volts_per_code: float
    volts_offset: float
    code_limits: tuple[int, int]
    monitor: MonitorRecords | None = None


class Instrument(Protocol):
    """Methods of every instrument of the bench."""

    @property
    def role(self) -> str: ...

    def identify(self) -> Identity: ...

    def serial_number(self) -> str:
        """Return the serial number, or the stored label of a model without one; empty if there is neither."""
        ...

    def snapshot(self) -> Mapping[str, Setting]:
        """Return the settings, read back from the instrument."""
        ...

    def snapshot_and_errors(self) -> tuple[Mapping[str, Setting], tuple[str, ...]]:
        """Return the settings that stay during a shot, read back after it, and the errors queued since, in words."""
        ...

    def verify(self) -> Mapping[str, Setting]:
        """Return the settings, read back; raise ``InstrumentError`` if one differs from the programmed value."""
        ...

    def self_test(self) -> bool | None:
        """Return whether the instrument's self-test passes, with the output off; None if it has no self-test."""
        ...

    @property
    def bus(self) -> str:
        """Name of its bus; instruments on different buses may be addressed at the same time."""
        ...

    def switch_off(self) -> None:
        """Send the command that switches the output off or aborts the capture, without waiting for a reply."""
        ...

    def prove_off(self) -> str:
        """After ``switch_off``, return how the output is proven to be off; raise ``InstrumentError`` if it is not."""
        ...

    def make_safe(self) -> str:
        """Do ``switch_off`` and ``prove_off`` in any state of instrument and connection, with the same result."""
        ...

    def close(self) -> None: ...


class Generator(Instrument, Protocol):
    """A function generator, programmed with its output off."""

    def display(self, text: str) -> None:
        """Show ``text`` on the front panel; empty: the settings as usual."""
        ...

    def store_label(self, label: str) -> None:
        """Store ``label`` in non-volatile memory, for ``serial_number`` of a model without a serial number."""
        ...

    def enable_output(self) -> None: ...

    def recheck(self) -> None:
        """Raise ``InstrumentError`` if output or settings differ from the verified ones."""
        ...


class MasterTrigger(Generator, Protocol):
    """Source of the first edge: one pulse on software command."""

    def configure(self, task: TriggerPulse, /) -> None: ...

    def fire(self) -> None: ...


class PulseGenerator(Generator, Protocol):
    """A triggered train of TTL pulses."""

    def configure(self, task: PulseTrain, /) -> None: ...


class ToneburstGenerator(Generator, Protocol):
    """A triggered sine burst."""

    def configure(self, task: Toneburst, /) -> None: ...


class Digitizer(Instrument, Protocol):
    """A triggered multi-record digitizer; its trigger output fires the tracking pulser."""

    def configure(self, capture: Capture) -> None: ...

    def arm(self) -> None: ...

    def records(self, deadline_s: float) -> Iterator[RecordBlock]:
        """Yield the records in order; raise ``DeadlineError`` when the clock passes ``deadline_s``."""
        ...

    def clipped(self) -> bool:
        """Return whether an input left its range since arming."""
        ...
