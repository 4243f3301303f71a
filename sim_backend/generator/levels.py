"""Levels of a 33250A and its declared load, in open-circuit volts: functions from registers to registers."""

from __future__ import annotations

import math
from dataclasses import replace

from sim_backend.generator.registers import (
    LEVEL_GAP_V,
    LOAD_LIMITS_OHM,
    PEAK_V,
    ROUNDING,
    SMALLEST_VPP,
    Coerced,
    Error,
    Registers,
    clipped,
    rounded,
)
from sim_backend.generator.scpi_text import ScpiError

MAX_DBM = 1e3


def load_divider(registers: Registers) -> float:
    """Return the ratio of displayed and open-circuit voltage for the declared load."""
    return 1.0 if math.isinf(registers.load_ohm) else registers.load_ohm / (registers.load_ohm + 50.0)


def _resolved(
    registers: Registers, level_v: float, low_v: float, high_v: float, quantity: str
) -> tuple[float, tuple[Error, ...]]:
    """Return an open-circuit level, clipped to its limits and rounded to the displayed resolution, and its errors."""
    level_v, errors = clipped(level_v, low_v, high_v, quantity)
    divider, model = load_divider(registers), registers.model
    resolved_v = rounded(level_v * divider, model.amplitude_digits, model.amplitude_decimals) / divider
    return min(max(resolved_v, low_v), high_v), errors


def set_amplitude(registers: Registers, amplitude_v: float) -> Coerced:
    """Return the registers with another open-circuit amplitude; a conflicting offset is reduced."""
    amplitude_v, errors = clipped(amplitude_v, SMALLEST_VPP, 2 * PEAK_V, "amplitude")
    divider, model = load_divider(registers), registers.model
    # Rounded in the displayed unit.
    displayed = rounded(in_unit(registers, amplitude_v * divider), model.amplitude_digits, model.amplitude_decimals)
    amplitude_v = min(max(to_vpp(registers, displayed, "") / divider, SMALLEST_VPP), 2 * PEAK_V)
    # The peak voltage limits the sum of half the amplitude and the offset.
    offset_v, limit_v = registers.offset_v, PEAK_V - amplitude_v / 2
    state = Coerced(registers, errors)
    if abs(offset_v) > limit_v + ROUNDING:
        offset_v = math.copysign(limit_v, offset_v)
        state = state.changed("offset changed due to amplitude")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_offset(registers: Registers, offset_v: float) -> Coerced:
    """Return the registers with another open-circuit offset; a conflicting amplitude is reduced."""
    limit_v = PEAK_V - SMALLEST_VPP / 2
    offset_v, errors = _resolved(registers, offset_v, -limit_v, limit_v, "offset")
    amplitude_v, max_amplitude_v = registers.amplitude_v, 2 * (PEAK_V - abs(offset_v))
    state = Coerced(registers, errors)
    if amplitude_v > max_amplitude_v + ROUNDING:
        amplitude_v = max_amplitude_v
        state = state.changed("amplitude changed due to offset")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_high(registers: Registers, high_v: float) -> Coerced:
    """Return the registers with another open-circuit high level; a conflicting low level is lowered."""
    gap_v = LEVEL_GAP_V / load_divider(registers)
    high_v, errors = _resolved(registers, high_v, -PEAK_V + gap_v, PEAK_V, "high level")
    state = Coerced(replace(registers, high_v=high_v), errors)
    if high_v - registers.low_v < gap_v * (1 - 1e-9):
        state = state.changed("low level changed due to high level", low_v=high_v - gap_v)
    return state


def set_low(registers: Registers, low_v: float) -> Coerced:
    """Return the registers with another open-circuit low level; a conflicting high level is raised."""
    gap_v = LEVEL_GAP_V / load_divider(registers)
    low_v, errors = _resolved(registers, low_v, -PEAK_V, PEAK_V - gap_v, "low level")
    state = Coerced(replace(registers, low_v=low_v), errors)
    if registers.high_v - low_v < gap_v * (1 - 1e-9):
        state = state.changed("high level changed due to low level", high_v=low_v + gap_v)
    return state


def set_load(registers: Registers, load_ohm: float) -> Coerced:
    """Return the registers with another declared load, which changes displayed values only, not the output."""
    errors: tuple[Error, ...] = ()
    if load_ohm != math.inf:
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


def _rms_per_vpp(state: Registers) -> float:
    """Return the rms voltage over the peak-to-peak voltage of the present function: half over its crest factor."""
    crest_factors = {"SIN": math.sqrt(2), "RAMP": math.sqrt(3), "TRI": math.sqrt(3), "NOIS": 5.0}
    return 0.5 / crest_factors.get(state.function, 1.0)


def to_vpp(state: Registers, value: float, unit: str) -> float:
    """Return an amplitude as volts peak to peak at the load.

    ``unit`` of ``value``: VPP, VRMS or DBM; empty or V: the unit that is set. Raises ``ScpiError`` for DBM at high-Z.
    """
    unit = state.unit if unit in ("", "V") else unit
    if unit == "DBM":
        if math.isinf(state.load_ohm):
            raise ScpiError(-221, "Settings conflict; amplitude units cannot be dBm at high-Z load")
        # Clipped before the power of ten, which would overflow.
        watts = 1e-3 * 10 ** (min(max(value, -MAX_DBM), MAX_DBM) / 10)
        return math.sqrt(state.load_ohm * watts) / _rms_per_vpp(state)
    return value / _rms_per_vpp(state) if unit == "VRMS" else value


def in_unit(state: Registers, vpp: float) -> float:
    """Return an amplitude at the load, volts peak to peak, in the set unit."""
    if state.unit == "DBM":
        return 10 * math.log10((vpp * _rms_per_vpp(state)) ** 2 / (state.load_ohm * 1e-3))
    return vpp * _rms_per_vpp(state) if state.unit == "VRMS" else vpp


def amplitude_limits(state: Registers) -> tuple[float, float]:
    """Return the smallest and largest amplitude at the load, peak to peak."""
    divider = load_divider(state)
    return SMALLEST_VPP * divider, 2 * (PEAK_V - abs(state.offset_v)) * divider
