"""Programs of a 33250A: the registers of a task, in groups and in the order that avoids conflicts on the way.

Headers are the 33250A's (docs/explanation/instruments.md, 1.4; the order is 1.6's); a sibling's spelling is put in when they
are sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

from drivers.agilent.models import GeneratorModel
from drivers.agilent.read_back import Readable, Register, number, short_form, switch, whole_number
from drivers.interfaces import ContinuousSine, GeneratorTask, PulseTrain, Toneburst, TriggerPulse

RESET_WIDTH_S: Final = 100e-6
RESET_PERIOD_S: Final = 1e-3
# What rescales other settings or limits them: where it changes, the instrument is programmed from its reset state.
FROM_RESET: Final = frozenset({"OUTP:LOAD", "VOLT:UNIT", "FUNC", "TRIG:SOUR", "BURS:MODE"})
COUPLED: Final = frozenset({"FREQ", "PULS:WIDT"})
# Levels are made of amplitude and offset, so that zero comes back as a small difference.
LEVEL_TOLERANCE_V: Final = 1e-9

READABLE: Final = (
    Readable("output_on", "OUTP", switch),
    Readable("load_ohm", "OUTP:LOAD", number),
    Readable("polarity", "OUTP:POL", short_form),
    Readable("trigger_output_on", "OUTP:TRIG", switch),
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
"""Registers that are sent and read back together, with a name for messages."""

CONTINUOUS: Final[Group] = ("burst", (Register("burst_on", "BURS:STAT", False),))
"""No burst: the output goes on by itself. Sent first, since a counted burst bounds the frequency."""


def program(task: GeneratorTask, model: GeneratorModel) -> list[Group]:
    """Return the registers that make ``model`` do ``task``; the output itself is not among them."""
    match task:
        case TriggerPulse():
            # One burst of one period: the period only has to hold the pulse.
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
    """Declare the load first, since it rescales all levels, and the unit, since ``VOLT?`` states none."""
    return "load", (
        Register("load_ohm", "OUTP:LOAD", float(load_ohm)),
        Register("amplitude_unit", "VOLT:UNIT", "VPP"),
        Register("polarity", "OUTP:POL", "NORM"),
    )


def changed(before: Sequence[Register], after: Sequence[Register]) -> tuple[Register, ...] | None:
    """Return what of ``after`` is not held already; None where it cannot be changed one by one."""
    held = {register.header: register for register in before}
    changed = tuple(register for register in after if held.get(register.header) != register)
    headers = {register.header for register in changed}
    if headers & FROM_RESET or headers >= COUPLED or not headers <= held.keys():
        return None
    return changed


def pulses(rate_hz: float, width_s: float, edge_s: float) -> Group:
    """Order rate and width so that the width after a reset, 100 us, never meets a period too short for it."""
    rate = Register("rate_hz", "FREQ", float(rate_hz))
    width = Register("width_s", "PULS:WIDT", float(width_s))
    order = (width, rate) if width_s <= RESET_WIDTH_S else (rate, width)
    return "pulse", (Register("function", "FUNC", "PULS"), Register("edge_s", "PULS:TRAN", edge_s), *order)


def sine(carrier_hz: float, amplitude_vpp: float) -> Group:
    """Return a sine about zero volts."""
    return "sine", (
        Register("function", "FUNC", "SIN"),
        Register("carrier_hz", "FREQ", float(carrier_hz)),
        Register("amplitude_vpp", "VOLT", float(amplitude_vpp)),
        Register("offset_v", "VOLT:OFFS", 0.0, LEVEL_TOLERANCE_V),
    )


def levels(high_v: float) -> Group:
    """Return the levels of pulses from zero volts up."""
    low = Register("low_v", "VOLT:LOW", 0.0, LEVEL_TOLERANCE_V)
    return "levels", (low, Register("high_v", "VOLT:HIGH", float(high_v), LEVEL_TOLERANCE_V))


def trigger(source: Literal["BUS", "EXT"]) -> Group:
    """Free the trigger connector, which is input and output at once, before it becomes the input."""
    return "trigger", (
        Register("trigger_output_on", "OUTP:TRIG", False),
        Register("trigger_source", "TRIG:SOUR", source),
        Register("trigger_slope", "TRIG:SLOP", "POS"),
    )


def burst(count: int, delay_s: float) -> Group:
    """Return a burst of ``count`` periods, ``delay_s`` after its trigger; switched on last."""
    return "burst", (
        Register("burst_mode", "BURS:MODE", "TRIG"),
        Register("cycles", "BURS:NCYC", count),
        Register("burst_phase_deg", "BURS:PHAS", 0.0),
        Register("delay_s", "TRIG:DEL", float(delay_s)),
        Register("burst_on", "BURS:STAT", True),
    )
