"""Programs of a 33250A: the registers of a task, in groups and in an order without intermediate conflicts.

Headers are the 33250A's (docs/explanation/instruments.md, 1.4; order: 1.6); the driver translates them for siblings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

from drivers.agilent.models import GeneratorModel
from drivers.agilent.read_back import Readable, Register, number, short_form, switch, whole_number
from drivers.interfaces import ContinuousSine, GeneratorTask, PulseTrain, Toneburst, TriggerPulse

RESET_WIDTH_S: Final = 100e-6
RESET_PERIOD_S: Final = 1e-3
# Settings that rescale or limit others: when one changes, the instrument is programmed from its reset state.
FROM_RESET: Final = frozenset({"OUTP:LOAD", "VOLT:UNIT", "FUNC", "TRIG:SOUR", "BURS:MODE"})
COUPLED: Final = frozenset({"FREQ", "PULS:WIDT"})
# The instrument computes levels from amplitude and offset, so zero comes back as a small difference.
LEVEL_TOLERANCE_V: Final = 1e-9

READABLE: Final = (
    Readable("output_on", "OUTP", switch),
    Readable("load_ohm", "OUTP:LOAD", number),
    Readable("polarity", "OUTP:POL", short_form),
    Readable("trigger_output_on", "OUTP:TRIG", switch),
    Readable("sync_output_on", "OUTP:SYNC", switch),
    Readable("function", "FUNC", short_form),
    Readable("frequency_hz", "FREQ", number),
    Readable("period_s", "PULS:PER", number),
    Readable("width_s", "PULS:WIDT", number),
    Readable("edge_s", "PULS:TRAN", number),
    Readable("amplitude_unit", "VOLT:UNIT", short_form),
    Readable("amplitude_vpp", "VOLT", number),
    Readable("offset_v", "VOLT:OFFS", number),
    Readable("low_v", "VOLT:LOW", number),
    Readable("high_v", "VOLT:HIGH", number),
    Readable("burst_on", "BURS:STAT", switch),
    Readable("burst_mode", "BURS:MODE", short_form),
    Readable("cycles", "BURS:NCYC", whole_number),
    Readable("burst_phase_deg", "BURS:PHAS", number),
    Readable("trigger_source", "TRIG:SOUR", short_form),
    Readable("trigger_slope", "TRIG:SLOP", short_form),
    Readable("delay_s", "TRIG:DEL", number),
)

Group = tuple[str, tuple[Register, ...]]
"""Name for messages, and registers that are sent and read back together."""

CONTINUOUS: Final[Group] = ("burst", (Register("burst_on", "BURS:STAT", False),))
"""No burst, so the output is continuous. Sent first, because a counted burst limits the frequency."""


def program(task: GeneratorTask, model: GeneratorModel) -> list[Group]:
    """Return the registers of ``task`` on ``model``, without the output switch."""
    match task:
        case TriggerPulse():
            # One burst of one period, long enough for the pulse.
            rate_hz = 1.0 / max(RESET_PERIOD_S, 2 * task.width_s)
            shape = [pulses(rate_hz, task.width_s, model.edge_s), levels(task.high_v)]
            return [load(task.load_ohm), *shape, trigger("BUS"), burst(1, 0.0)]
        case PulseTrain():
            shape = [pulses(task.rate_hz, task.width_s, model.edge_s), levels(task.high_v)]
            return [load(task.load_ohm), *shape, trigger("EXT"), burst(task.count, task.delay_s)]
        case Toneburst():
            shape = [sine(task.carrier_hz, task.amplitude_vpp)]
            return [load(task.load_ohm), *shape, trigger("EXT"), burst(task.cycles, task.delay_s)]
        case ContinuousSine():
            return [load(task.load_ohm), CONTINUOUS, sine(task.frequency_hz, task.amplitude_vpp)]


def load(load_ohm: float) -> Group:
    """Return load, unit and polarity; first, because the load rescales all levels and ``VOLT?`` has no unit."""
    return "load", (
        Register("load_ohm", "OUTP:LOAD", float(load_ohm)),
        Register("amplitude_unit", "VOLT:UNIT", "VPP"),
        Register("polarity", "OUTP:POL", "NORM"),
    )


def changed(before: Sequence[Register], after: Sequence[Register]) -> tuple[Register, ...] | None:
    """Return the registers of ``after`` that differ from ``before``; None if they cannot be changed one by one."""
    programmed = {register.header: register for register in before}
    differing = tuple(register for register in after if programmed.get(register.header) != register)
    headers = {register.header for register in differing}
    if headers & FROM_RESET or headers >= COUPLED or not headers <= programmed.keys():
        return None
    return differing


def pulses(rate_hz: float, width_s: float, edge_s: float) -> Group:
    """Return rate and width, ordered so that the width after a reset, 100 us, always fits the period."""
    rate = Register("rate_hz", "FREQ", float(rate_hz))
    width = Register("width_s", "PULS:WIDT", float(width_s))
    order = (width, rate) if width_s <= RESET_WIDTH_S else (rate, width)
    return "pulse", (Register("function", "FUNC", "PULS"), Register("edge_s", "PULS:TRAN", edge_s), *order)


def sine(carrier_hz: float, amplitude_vpp: float) -> Group:
    """Return a sine without offset."""
    return "sine", (
        Register("function", "FUNC", "SIN"),
        Register("carrier_hz", "FREQ", float(carrier_hz)),
        Register("amplitude_vpp", "VOLT", float(amplitude_vpp)),
        Register("offset_v", "VOLT:OFFS", 0.0, LEVEL_TOLERANCE_V),
    )


def levels(high_v: float) -> Group:
    """Return the levels of pulses between 0 V and ``high_v``."""
    low = Register("low_v", "VOLT:LOW", 0.0, LEVEL_TOLERANCE_V)
    return "levels", (low, Register("high_v", "VOLT:HIGH", float(high_v), LEVEL_TOLERANCE_V))


def trigger(source: Literal["BUS", "EXT"]) -> Group:
    """Return the trigger source; the shared trigger connector stops being an output first."""
    return "trigger", (
        Register("trigger_output_on", "OUTP:TRIG", False),
        Register("trigger_source", "TRIG:SOUR", source),
        Register("trigger_slope", "TRIG:SLOP", "POS"),
    )


def burst(count: int, delay_s: float) -> Group:
    """Return a burst of ``count`` periods, ``delay_s`` after its trigger; it is switched on last."""
    return "burst", (
        Register("burst_mode", "BURS:MODE", "TRIG"),
        Register("cycles", "BURS:NCYC", count),
        Register("burst_phase_deg", "BURS:PHAS", 0.0),
        Register("delay_s", "TRIG:DEL", float(delay_s)),
        Register("burst_on", "BURS:STAT", True),
    )
