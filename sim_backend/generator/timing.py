"""Timing of a 33250A: function, frequency, pulse shape and burst, bent so that they fit each other."""

from __future__ import annotations

import math
from dataclasses import replace

from sim_backend.generator.registers import (
    BURST_MARGIN_S,
    EDGE_SHARE_OF_WIDTH,
    EDGES_IN_PERIOD,
    ROUNDING,
    Coerced,
    Error,
    Registers,
    clipped,
    rounded,
)


def width_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the pulse widths that the period leaves room for."""
    narrowest_s, widest_s = registers.model.width_limits_s
    period_s = 1 / registers.frequency_hz
    lowest = next((width for longest, width in registers.model.narrowest_s if period_s > longest), narrowest_s)
    return lowest, min(widest_s, period_s - EDGES_IN_PERIOD * registers.edge_s)


def edge_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the edge times that pulse width and period leave room for."""
    room_s = (1 / registers.frequency_hz - registers.width_s) / EDGES_IN_PERIOD
    fastest_s, slowest_s = registers.model.edge_limits_s
    return fastest_s, max(fastest_s, min(slowest_s, EDGE_SHARE_OF_WIDTH * registers.width_s, room_s))


def duty_limits_percent(registers: Registers) -> tuple[float, float]:
    """Return the duty cycles of the square wave at its frequency."""
    if registers.frequency_hz > 50e6:
        return 50.0, 50.0
    return (40.0, 60.0) if registers.frequency_hz > 25e6 else (20.0, 80.0)


def frequency_limits_hz(registers: Registers) -> tuple[float, float]:
    """Return the frequencies of the present function."""
    return registers.model.frequency_limits_hz[registers.function]


def set_function(registers: Registers, function: str) -> Coerced:
    """Return the registers with another function; the frequency and what hangs on it may give way."""
    state = Coerced(registers).changed(function=function)
    low, high = registers.model.frequency_limits_hz[function]
    frequency_hz = min(max(registers.frequency_hz, low), high)
    if frequency_hz != registers.frequency_hz:
        verb = "reduced" if frequency_hz < registers.frequency_hz else "increased"
        state = state.changed(f"frequency {verb} for {function} function", frequency_hz=frequency_hz)
    if registers.burst and function in ("DC", "NOIS"):
        state = state.changed("burst turned off, not able to burst this function", burst=False)
    return settle_frequency(state)


def set_frequency(state: Coerced) -> Coerced:
    """Return a frequency that was just set as the instrument resolves it, and what it makes of the rest."""
    model = state.registers.model
    frequency_hz = rounded(state.registers.frequency_hz, model.frequency_digits, model.frequency_step_decimals)
    return settle_frequency(state.changed(frequency_hz=frequency_hz))


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
    edge_s = max(registers.model.edge_limits_s[0], EDGE_SHARE_OF_WIDTH * width_s)
    if registers.edge_s > edge_s * (1 + ROUNDING):
        state = state.changed("pulse edge time decreased due to pulse width", edge_s=edge_s)
    return state


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
        cycles, errors = clipped(round(cycles), 1, registers.model.most_cycles, "burst count")
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
        state = state.changed("burst count changed due to immediate trigger", cycles=float(registers.model.most_cycles))
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
    lowest, highest = registers.model.burst_period_limits_s
    if registers.trigger_source == "IMM" and math.isfinite(registers.cycles):
        lowest = min(highest, max(lowest, registers.burst_s + BURST_MARGIN_S))
    period_s, errors = clipped(period_s, lowest, highest, "burst period")
    return settle_burst(Coerced(replace(registers, burst_period_s=period_s), errors))


def settle_burst(state: Coerced) -> Coerced:
    """Return a burst that its frequency can do and, with the internal trigger, one that fits the burst period."""
    registers = state.registers
    finite = math.isfinite(registers.cycles) and registers.burst_mode == "TRIG"
    too_fast = registers.function in ("SIN", "SQU") and registers.frequency_hz > registers.model.finite_burst_ceiling_hz
    if registers.burst and finite and too_fast:
        state = state.changed("frequency reduced for burst mode", frequency_hz=registers.model.finite_burst_ceiling_hz)
    if registers.trigger_source != "IMM" or not finite:
        return state
    needed_s = state.registers.burst_s + BURST_MARGIN_S
    if needed_s > registers.burst_period_s * (1 + ROUNDING):
        period_s = min(needed_s, registers.model.burst_period_limits_s[1])
        state = state.changed("burst period increased to fit entire burst", burst_period_s=period_s)
    if needed_s > registers.model.burst_period_limits_s[1]:
        most = math.floor((registers.model.burst_period_limits_s[1] - BURST_MARGIN_S) * state.registers.frequency_hz)
        state = state.changed("burst count reduced to fit entire burst", cycles=float(max(1, most)))
    room_s = max(0.0, state.registers.burst_period_s - state.registers.burst_s - BURST_MARGIN_S)
    if registers.delay_s > room_s + ROUNDING:
        state = state.changed("trigger delay reduced to fit entire burst", delay_s=room_s)
    return state
