"""Timing of a 33250A: function, frequency, pulse shape and burst, coerced so that they fit each other."""

from __future__ import annotations

import math
from dataclasses import replace

from sim_backend.generator.registers import (
    BURST_MARGIN_S,
    EDGE_FRACTION_OF_WIDTH,
    EDGES_IN_PERIOD,
    ROUNDING,
    Coerced,
    Error,
    Registers,
    clipped,
)
from sim_backend.generator.scpi_text import not_simulated

NOT_SIMULATED = {
    "USER": "arbitrary waveforms",
    "ARB": "arbitrary waveforms",
    "PRBS": "pseudo-random bit sequences",
}


def width_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the narrowest and the widest pulse that fit into the present period, s."""
    model, period_s = registers.model, 1 / registers.frequency_hz
    shortest_width_s, longest_width_s = model.width_limits_s
    # Long periods have a larger minimum: that of the first table row with a period below the present one.
    min_width_s = next(
        (width_s for above_s, width_s in model.min_width_by_period_s if period_s > above_s), shortest_width_s
    )
    # The widest pulse leaves space for both edges in the period.
    max_width_s = min(longest_width_s, period_s - EDGES_IN_PERIOD * registers.edge_s)
    return min_width_s, max(min_width_s, max_width_s)


def edge_limits_s(registers: Registers) -> tuple[float, float]:
    """Return the shortest and the longest edge time for the present pulse width and period, s."""
    max_edge_s = (1 / registers.frequency_hz - registers.width_s) / EDGES_IN_PERIOD
    fastest_s, slowest_s = registers.model.edge_limits_s
    return fastest_s, max(fastest_s, min(slowest_s, EDGE_FRACTION_OF_WIDTH * registers.width_s, max_edge_s))


def duty_limits_percent(registers: Registers) -> tuple[float, float]:
    """Return the limits of the square wave's duty cycle at its frequency."""
    model, frequency_hz = registers.model, registers.frequency_hz
    if not model.duty_steps:
        # Limited by the narrowest pulse alone.
        lowest = min(50.0, max(0.01, 100 * model.width_limits_s[0] * frequency_hz))
        return lowest, 100.0 - lowest
    return next((low, high) for above_hz, low, high in model.duty_steps if frequency_hz > above_hz)


def frequency_limits_hz(registers: Registers) -> tuple[float, float]:
    """Return the frequency limits of the present function."""
    return registers.model.frequency_limits_hz[registers.function]


def set_function(registers: Registers, function: str) -> Coerced:
    """Return the registers with another function; conflicting frequencies and dependent settings are changed."""
    if function in NOT_SIMULATED:
        raise not_simulated(NOT_SIMULATED[function])
    state = Coerced(registers).changed(function=function)
    # The new function may have a smaller frequency range.
    low, high = registers.model.frequency_limits_hz[function]
    frequency_hz = min(max(registers.frequency_hz, low), high)
    if frequency_hz != registers.frequency_hz:
        verb = "reduced" if frequency_hz < registers.frequency_hz else "increased"
        state = state.changed(f"frequency {verb} for {function} function", frequency_hz=frequency_hz)
    if registers.burst and function in ("DC", "NOIS"):
        state = state.changed("burst turned off, not able to burst this function", burst=False)
    return settle_frequency(state)


def settle_frequency(state: Coerced) -> Coerced:
    """Return ``state`` with pulse, duty cycle and burst adapted to its frequency."""
    registers = state.registers
    if registers.function == "PULS":
        state = settle_pulse(state)
    low, high = duty_limits_percent(registers)
    if registers.function == "SQU" and not low <= registers.duty_percent <= high:
        duty = min(max(registers.duty_percent, low), high)
        state = state.changed("duty cycle changed due to frequency", duty_percent=duty)
    return settle_burst(state) if registers.burst else state


def at_frequency(registers: Registers, frequency_hz: float) -> Registers:
    """Return the registers at another frequency, with the same pulse width or, by ``pulse_hold``, duty cycle."""
    width_s = registers.width_s
    if registers.pulse_hold == "DCYC":
        width_s *= registers.frequency_hz / frequency_hz
    return replace(registers, frequency_hz=frequency_hz, width_s=width_s)


def settle_pulse(state: Coerced, number: int = -221) -> Coerced:
    """Return ``state`` with the pulse fitted into its period: first the edge is shortened, then the width.

    ``number`` is that of the queued errors.
    """
    registers = state.registers
    _, edge_s = edge_limits_s(registers)
    if registers.edge_s > edge_s * (1 + ROUNDING):
        state = _changed_with_error(state, number, "pulse edge time decreased due to period", edge_s=edge_s)
    lowest, width_s = width_limits_s(state.registers)
    if registers.width_s > width_s * (1 + ROUNDING):
        state = _changed_with_error(state, number, "pulse width decreased due to period", width_s=max(width_s, lowest))
    elif registers.width_s < lowest:
        state = state.changed("pulse width increased due to period", width_s=lowest)
    return state


def _changed_with_error(state: Coerced, number: int, what: str, **settings: float) -> Coerced:
    """Return ``state`` with other ``settings``, and the error ``number`` with a text that states ``what`` changed."""
    kind = "Settings conflict" if number == -221 else "Data out of range"
    registers = replace(state.registers, **settings)  # type: ignore[arg-type]
    return Coerced(registers, (*state.errors, (number, f"{kind}; {what}")))


def set_width(registers: Registers, width_s: float) -> Coerced:
    """Return the registers with another pulse width; a conflicting edge time is shortened."""
    width_s, errors = clipped(width_s, *width_limits_s(registers), "pulse width")
    state = Coerced(replace(registers, width_s=width_s), errors)
    edge_s = max(registers.model.edge_limits_s[0], EDGE_FRACTION_OF_WIDTH * width_s)
    if registers.edge_s > edge_s * (1 + ROUNDING):
        state = state.changed("pulse edge time decreased due to pulse width", edge_s=edge_s)
    return state


def set_burst(registers: Registers, on: bool) -> Coerced:
    """Return the registers with bursts on or off; DC and triggered noise cannot burst."""
    if not on:
        return Coerced(replace(registers, burst=False))
    state = Coerced(registers)
    if registers.function == "DC" or (registers.function == "NOIS" and registers.burst_mode == "TRIG"):
        return state.changed("not able to burst this function")
    return settle_burst(state.changed(burst=True))


def set_cycles(registers: Registers, cycles: float) -> Coerced:
    """Return the registers with another burst count; an infinite one excludes internal triggers."""
    errors: tuple[Error, ...] = ()
    if cycles != math.inf:
        cycles, errors = clipped(round(max(cycles, 0.0)), 1, registers.model.max_cycles, "burst count")
    state = Coerced(replace(registers, cycles=cycles), errors)
    if math.isinf(cycles) and registers.trigger_source == "IMM":
        state = state.changed("trigger source changed to BUS due to infinite burst", trigger_source="BUS")
    return settle_burst(state)


def set_source(registers: Registers, source: str) -> Coerced:
    """Return the registers with another trigger source, and the errors to queue for settings that change with it.

    An external source turns Trig Out off, as it uses the same connector. An internal one ends an endless burst: its
    count becomes the largest.
    """
    state = Coerced(replace(registers, trigger_source=source))
    if source == "EXT" and registers.trigger_output:
        state = state.changed("trigger output turned off by external trigger", trigger_output=False)
    if source == "IMM" and math.isinf(registers.cycles):
        state = state.changed("burst count changed due to immediate trigger", cycles=float(registers.model.max_cycles))
    return settle_burst(state)


def set_trigger_output(registers: Registers, on: bool) -> Coerced:
    """Return the registers with Trig Out on or off; it stays off while its connector is an input."""
    if on and (registers.trigger_source == "EXT" or (registers.burst and registers.burst_mode == "GAT")):
        return Coerced(registers).changed("trigger output not possible with external trigger")
    return Coerced(replace(registers, trigger_output=on))


def set_burst_mode(registers: Registers, mode: str) -> Coerced:
    """Return the registers with triggered or gated bursts; gated ones use the trigger connector as an input."""
    state = Coerced(replace(registers, burst_mode=mode))
    if mode == "GAT" and registers.trigger_output:
        state = state.changed("trigger output turned off by gated burst", trigger_output=False)
    return settle_burst(state)


def set_burst_period(registers: Registers, period_s: float) -> Coerced:
    """Return the registers with another period of the internal burst trigger, at least as long as a burst."""
    lowest, highest = registers.model.burst_period_limits_s
    if registers.trigger_source == "IMM" and math.isfinite(registers.cycles):
        lowest = min(highest, max(lowest, registers.burst_s + BURST_MARGIN_S))
    period_s, errors = clipped(period_s, lowest, highest, "burst period")
    return settle_burst(Coerced(replace(registers, burst_period_s=period_s), errors))


def settle_burst(state: Coerced) -> Coerced:
    """Return ``state`` with the burst fitted to its frequency limit and to the period of the internal trigger."""
    registers = state.registers
    # Counted bursts have a lower frequency limit than endless or gated ones.
    finite = math.isfinite(registers.cycles) and registers.burst_mode == "TRIG"
    too_fast = registers.function in ("SIN", "SQU") and registers.frequency_hz > registers.model.finite_burst_ceiling_hz
    if registers.burst and finite and too_fast:
        state = state.changed("frequency reduced for burst mode", frequency_hz=registers.model.finite_burst_ceiling_hz)
    if registers.trigger_source != "IMM" or not finite:
        return state
    # The internal trigger must come after the burst: lengthen its period, then reduce the count.
    burst_s, longest_s = state.registers.burst_s + BURST_MARGIN_S, registers.model.burst_period_limits_s[1]
    if min(burst_s, longest_s) > registers.burst_period_s * (1 + ROUNDING):
        period_s = min(burst_s, longest_s)
        state = state.changed("burst period increased to fit entire burst", burst_period_s=period_s)
    max_count = math.floor(longest_s * state.registers.frequency_hz * (1 + ROUNDING))
    if registers.cycles > max_count:
        state = state.changed("burst count reduced to fit entire burst", cycles=float(max(1, max_count)))
    if max_count < 1:
        # Not even one cycle fits: for a 33250A this happens below 2 mHz.
        state = state.changed("frequency increased for burst mode", frequency_hz=1 / longest_s)
    # The delay must fit into the remaining part of the period.
    max_delay_s = max(0.0, state.registers.burst_period_s - state.registers.burst_s - BURST_MARGIN_S)
    if registers.delay_s > max_delay_s + ROUNDING:
        state = state.changed("trigger delay reduced to fit entire burst", delay_s=max_delay_s)
    return state
