"""What a 33250A holds, and how it bends a setting that does not fit: pure functions from registers to registers.

The instrument clips or substitutes and queues an error, it never refuses a number (reference, 1.6). Levels are kept as
open-circuit voltages, so that a change of the declared load rescales what is displayed and nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

Error = tuple[int, str]

PEAK_V = 10.0
"""Largest open-circuit voltage: 5 V into 50 ohm (manual)."""
SMALLEST_VPP = 2e-3
"""Smallest open-circuit amplitude: 1 mVpp into 50 ohm (a driver's argument limits, taken from the manual)."""
LEVEL_GAP_V = 1e-3
"""Least distance of the high from the low level, as displayed."""
FREQUENCY_LIMITS_HZ = {
    "SIN": (1e-6, 80e6),
    "SQU": (1e-6, 80e6),
    "RAMP": (1e-6, 1e6),
    "PULS": (500e-6, 50e6),
    "USER": (1e-6, 25e6),
    "NOIS": (1e-6, 80e6),
    "DC": (1e-6, 80e6),
}
"""Frequency limits by function (manual; noise and DC have none of their own)."""
FINITE_BURST_CEILING_HZ = 25e6
"""Above it sine and square can only burst without end (manual)."""
MOST_CYCLES = 1_000_000
WIDTH_LIMITS_S = (8e-9, 2000.0)
EDGE_LIMITS_S = (5e-9, 1e-3)
BURST_PERIOD_LIMITS_S = (1e-6, 500.0)
DELAY_LIMITS_S = (0.0, 85.0)
LOAD_LIMITS_OHM = (1.0, 10_000.0)

# Assumed: no source was found for these.
EDGE_SHARE_OF_WIDTH = 0.625
EDGES_IN_PERIOD = 1.6
BURST_MARGIN_S = 200e-9
WIDEST_AT_PERIOD_S = ((200.0, 2e-6), (20.0, 200e-9))
"""Longest period -> smallest pulse width beyond it."""

ROUNDING = 1e-12
"""A limit that is itself computed counts as kept within this relative error."""


@dataclass(frozen=True, slots=True)
class Registers:
    """Everything a program can set; the defaults are the power-on state. Levels are open-circuit volts."""

    function: str = "SIN"
    frequency_hz: float = 1e3
    high_v: float = 0.1
    low_v: float = -0.1
    unit: str = "VPP"
    range_auto: str = "1"
    duty_percent: float = 50.0
    symmetry_percent: float = 100.0
    width_s: float = 100e-6
    edge_s: float = 5e-9
    output: bool = False
    load_ohm: float = 50.0
    polarity: str = "NORM"
    sync: bool = True
    trigger_output: bool = False
    trigger_output_slope: str = "POS"
    burst: bool = False
    burst_mode: str = "TRIG"
    cycles: float = 1.0
    burst_period_s: float = 10e-3
    burst_phase_deg: float = 0.0
    gate_polarity: str = "NORM"
    modulation: str = ""
    trigger_source: str = "IMM"
    trigger_slope: str = "POS"
    delay_s: float = 0.0
    angle_unit: str = "DEG"
    display: bool = True
    display_text: str = ""
    beeper: bool = True

    @property
    def amplitude_v(self) -> float:
        """Open-circuit peak-to-peak amplitude."""
        return self.high_v - self.low_v

    @property
    def offset_v(self) -> float:
        """Open-circuit offset."""
        return (self.high_v + self.low_v) / 2

    @property
    def burst_s(self) -> float:
        """Duration of a burst; inf where it never ends."""
        return self.cycles / self.frequency_hz


@dataclass(frozen=True, slots=True)
class Coerced:
    """Registers after a setting, with what the error queue was told."""

    registers: Registers
    errors: tuple[Error, ...] = ()

    def changed(self, conflict: str = "", **settings: object) -> Coerced:
        """Return these with ``settings``, and the settings conflict that forced them if there was one."""
        told = ((-221, f"Settings conflict; {conflict}"),) if conflict else ()
        return Coerced(replace(self.registers, **settings), self.errors + told)  # type: ignore[arg-type]


def load_share(registers: Registers) -> float:
    """Return displayed over open-circuit voltage for the declared load."""
    return 1.0 if math.isinf(registers.load_ohm) else registers.load_ohm / (registers.load_ohm + 50.0)


def clipped(value: float, low: float, high: float, quantity: str) -> tuple[float, tuple[Error, ...]]:
    """Return ``value`` within the limits, and the error that says which of them it hit."""
    slack = ROUNDING * max(abs(low), abs(high) if math.isfinite(high) else 0.0)
    if value > high + slack:
        return high, ((-222, f"Data out of range; {quantity}; value clipped to upper limit"),)
    if value < low - slack:
        return low, ((-222, f"Data out of range; {quantity}; value clipped to lower limit"),)
    return min(max(value, low), high), ()


def width_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the pulse widths that the period leaves room for."""
    period_s = 1 / registers.frequency_hz
    lowest = next((width for longest, width in WIDEST_AT_PERIOD_S if period_s > longest), WIDTH_LIMITS_S[0])
    return lowest, min(WIDTH_LIMITS_S[1], period_s - EDGES_IN_PERIOD * registers.edge_s)


def edge_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the edge times that pulse width and period leave room for."""
    room_s = (1 / registers.frequency_hz - registers.width_s) / EDGES_IN_PERIOD
    return EDGE_LIMITS_S[0], max(
        EDGE_LIMITS_S[0], min(EDGE_LIMITS_S[1], EDGE_SHARE_OF_WIDTH * registers.width_s, room_s)
    )


def duty_limits_percent(registers: Registers) -> tuple[float, float]:
    """Return the duty cycles of the square wave at its frequency."""
    if registers.frequency_hz > 50e6:
        return 50.0, 50.0
    return (40.0, 60.0) if registers.frequency_hz > 25e6 else (20.0, 80.0)


def frequency_limits_hz(registers: Registers) -> tuple[float, float]:
    """Return the frequencies of the present function."""
    return FREQUENCY_LIMITS_HZ[registers.function]


def set_function(registers: Registers, function: str) -> Coerced:
    """Return the registers with another function; the frequency and what hangs on it may give way."""
    state = Coerced(registers).changed(function=function)
    low, high = FREQUENCY_LIMITS_HZ[function]
    frequency_hz = min(max(registers.frequency_hz, low), high)
    if frequency_hz != registers.frequency_hz:
        verb = "reduced" if frequency_hz < registers.frequency_hz else "increased"
        state = state.changed(f"frequency {verb} for {function} function", frequency_hz=frequency_hz)
    if registers.burst and function in ("DC", "NOIS"):
        state = state.changed("burst turned off, not able to burst this function", burst=False)
    return settle_frequency(state)


def settle_frequency(state: Coerced) -> Coerced:
    """Return what a new frequency or period makes of pulse, duty cycle and burst."""
    registers = state.registers
    if registers.function == "PULS":
        state = settle_pulse(state)
    low, high = duty_limits_percent(registers)
    if registers.function == "SQU" and not low <= registers.duty_percent <= high:
        duty = min(max(registers.duty_percent, low), high)
        state = state.changed("duty cycle changed due to frequency", duty_percent=duty)
    return settle_burst(state) if registers.burst else state


def settle_pulse(state: Coerced) -> Coerced:
    """Return a pulse that fits its period: the edge gives way first, then the width."""
    registers = state.registers
    _, edge_s = edge_limits_s(registers)
    if registers.edge_s > edge_s * (1 + ROUNDING):
        state = state.changed("pulse edge time decreased due to period", edge_s=edge_s)
    lowest, width_s = width_limits_s(state.registers)
    if registers.width_s > width_s * (1 + ROUNDING):
        state = state.changed("pulse width decreased due to period", width_s=max(width_s, lowest))
    elif registers.width_s < lowest:
        state = state.changed("pulse width increased due to period", width_s=lowest)
    return state


def set_width(registers: Registers, width_s: float) -> Coerced:
    """Return the registers with another pulse width; the edge time may give way."""
    width_s, errors = clipped(width_s, *width_limits_s(registers), "pulse width")
    state = Coerced(replace(registers, width_s=width_s), errors)
    edge_s = max(EDGE_LIMITS_S[0], EDGE_SHARE_OF_WIDTH * width_s)
    if registers.edge_s > edge_s * (1 + ROUNDING):
        state = state.changed("pulse edge time decreased due to pulse width", edge_s=edge_s)
    return state


def set_amplitude(registers: Registers, amplitude_v: float) -> Coerced:
    """Return the registers with another open-circuit amplitude; the offset may give way."""
    amplitude_v, errors = clipped(amplitude_v, SMALLEST_VPP, 2 * PEAK_V, "amplitude")
    offset_v, room_v = registers.offset_v, PEAK_V - amplitude_v / 2
    state = Coerced(registers, errors)
    if abs(offset_v) > room_v + ROUNDING:
        offset_v = math.copysign(room_v, offset_v)
        state = state.changed("offset changed due to amplitude")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_offset(registers: Registers, offset_v: float) -> Coerced:
    """Return the registers with another open-circuit offset; the amplitude may give way."""
    offset_v, errors = clipped(offset_v, -PEAK_V + SMALLEST_VPP / 2, PEAK_V - SMALLEST_VPP / 2, "offset")
    amplitude_v, room_v = registers.amplitude_v, 2 * (PEAK_V - abs(offset_v))
    state = Coerced(registers, errors)
    if amplitude_v > room_v + ROUNDING:
        amplitude_v = room_v
        state = state.changed("amplitude changed due to offset")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_high(registers: Registers, high_v: float) -> Coerced:
    """Return the registers with another open-circuit high level; the low level may give way."""
    gap_v = LEVEL_GAP_V / load_share(registers)
    high_v, errors = clipped(high_v, -PEAK_V + gap_v, PEAK_V, "high level")
    state = Coerced(replace(registers, high_v=high_v), errors)
    if high_v - registers.low_v < gap_v * (1 - 1e-9):
        state = state.changed("low level changed due to high level", low_v=high_v - gap_v)
    return state


def set_low(registers: Registers, low_v: float) -> Coerced:
    """Return the registers with another open-circuit low level; the high level may give way."""
    gap_v = LEVEL_GAP_V / load_share(registers)
    low_v, errors = clipped(low_v, -PEAK_V, PEAK_V - gap_v, "low level")
    state = Coerced(replace(registers, low_v=low_v), errors)
    if registers.high_v - low_v < gap_v * (1 - 1e-9):
        state = state.changed("high level changed due to low level", high_v=low_v + gap_v)
    return state


def set_load(registers: Registers, load_ohm: float) -> Coerced:
    """Return the registers with another declared load; it is a declaration, the output itself does not change."""
    errors: tuple[Error, ...] = ()
    if not math.isinf(load_ohm):
        load_ohm, errors = clipped(load_ohm, *LOAD_LIMITS_OHM, "output load")
    state = Coerced(replace(registers, load_ohm=load_ohm), errors)
    if math.isinf(load_ohm) and registers.unit == "DBM":
        state = state.changed("amplitude units changed to Vpp due to high-Z load", unit="VPP")
    return state


def set_unit(registers: Registers, unit: str) -> Coerced:
    """Return the registers with another amplitude unit; dBm needs a declared load."""
    if unit == "DBM" and math.isinf(registers.load_ohm):
        return Coerced(registers).changed("amplitude units cannot be dBm at high-Z load")
    return Coerced(replace(registers, unit=unit))


def set_burst(registers: Registers, on: bool) -> Coerced:
    """Return the registers with the burst on or off; it excludes modulation and needs a function that can burst."""
    if not on:
        return Coerced(replace(registers, burst=False))
    state = Coerced(registers)
    if registers.function == "DC" or (registers.function == "NOIS" and registers.burst_mode == "TRIG"):
        return state.changed("not able to burst this function")
    if registers.modulation:
        state = state.changed("modulation turned off by selection of other mode", modulation="")
    return settle_burst(state.changed(burst=True))


def set_modulation(registers: Registers, mode: str, on: bool) -> Coerced:
    """Return the registers with a modulation or the sweep on or off; one mode excludes the others."""
    state = Coerced(registers)
    if not on:
        return state.changed(modulation="" if registers.modulation == mode else registers.modulation)
    if registers.burst or registers.modulation not in ("", mode):
        state = state.changed("previous mode turned off by selection of other mode")
    return state.changed(burst=False, modulation=mode)


def set_cycles(registers: Registers, cycles: float) -> Coerced:
    """Return the registers with another burst count; inf and an internal trigger exclude each other."""
    errors: tuple[Error, ...] = ()
    if not math.isinf(cycles):
        cycles, errors = clipped(round(cycles), 1, MOST_CYCLES, "burst count")
    state = Coerced(replace(registers, cycles=cycles), errors)
    if math.isinf(cycles) and registers.trigger_source == "IMM":
        state = state.changed("trigger source changed to BUS due to infinite burst", trigger_source="BUS")
    return settle_burst(state)


def set_source(registers: Registers, source: str) -> Coerced:
    """Return the registers with another trigger source; Trig In and Trig Out share one connector."""
    state = Coerced(replace(registers, trigger_source=source))
    if source == "EXT" and registers.trigger_output:
        state = state.changed("trigger output turned off by external trigger", trigger_output=False)
    if source == "IMM" and math.isinf(registers.cycles):
        state = state.changed("burst count changed due to immediate trigger", cycles=float(MOST_CYCLES))
    return settle_burst(state)


def set_trigger_output(registers: Registers, on: bool) -> Coerced:
    """Return the registers with Trig Out on or off; it stays off where the connector is an input."""
    if on and (registers.trigger_source == "EXT" or (registers.burst and registers.burst_mode == "GAT")):
        return Coerced(registers).changed("trigger output not possible with external trigger")
    return Coerced(replace(registers, trigger_output=on))


def set_burst_mode(registers: Registers, mode: str) -> Coerced:
    """Return the registers with triggered or gated bursts; gated takes the trigger connector."""
    state = Coerced(replace(registers, burst_mode=mode))
    if mode == "GAT" and registers.trigger_output:
        state = state.changed("trigger output turned off by gated burst", trigger_output=False)
    return settle_burst(state)


def set_burst_period(registers: Registers, period_s: float) -> Coerced:
    """Return the registers with another internal burst period."""
    lowest, highest = BURST_PERIOD_LIMITS_S
    if registers.trigger_source == "IMM" and math.isfinite(registers.cycles):
        lowest = min(highest, max(lowest, registers.burst_s + BURST_MARGIN_S))
    period_s, errors = clipped(period_s, lowest, highest, "burst period")
    return settle_burst(Coerced(replace(registers, burst_period_s=period_s), errors))


def settle_burst(state: Coerced) -> Coerced:
    """Return a burst that its frequency can do and, with the internal trigger, one that fits the burst period."""
    registers = state.registers
    finite = math.isfinite(registers.cycles) and registers.burst_mode == "TRIG"
    if registers.burst and finite and registers.frequency_hz > FINITE_BURST_CEILING_HZ:
        state = state.changed("frequency reduced for burst mode", frequency_hz=FINITE_BURST_CEILING_HZ)
    if registers.trigger_source != "IMM" or not finite:
        return state
    needed_s = state.registers.burst_s + BURST_MARGIN_S
    if needed_s > registers.burst_period_s * (1 + ROUNDING):
        period_s = min(needed_s, BURST_PERIOD_LIMITS_S[1])
        state = state.changed("burst period increased to fit entire burst", burst_period_s=period_s)
    if needed_s > BURST_PERIOD_LIMITS_S[1]:
        most = math.floor((BURST_PERIOD_LIMITS_S[1] - BURST_MARGIN_S) * state.registers.frequency_hz)
        state = state.changed("burst count reduced to fit entire burst", cycles=float(max(1, most)))
    room_s = max(0.0, state.registers.burst_period_s - state.registers.burst_s - BURST_MARGIN_S)
    if registers.delay_s > room_s + ROUNDING:
        state = state.changed("trigger delay reduced to fit entire burst", delay_s=room_s)
    return state
