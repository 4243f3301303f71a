"""Levels of a 33250A and its declared load: functions from registers to registers, in open-circuit volts."""

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

LARGEST_DBM = 1e3


def load_share(registers: Registers) -> float:
    """Return displayed over open-circuit voltage for the declared load."""
    return 1.0 if math.isinf(registers.load_ohm) else registers.load_ohm / (registers.load_ohm + 50.0)


def _held(
    registers: Registers, level_v: float, low_v: float, high_v: float, quantity: str
) -> tuple[float, tuple[Error, ...]]:
    """Return an open-circuit level within its limits as the instrument resolves it, as displayed, and its errors."""
    level_v, errors = clipped(level_v, low_v, high_v, quantity)
    share, model = load_share(registers), registers.model
    resolved_v = rounded(level_v * share, model.amplitude_digits, model.amplitude_decimals) / share
    return min(max(resolved_v, low_v), high_v), errors


def set_amplitude(registers: Registers, amplitude_v: float) -> Coerced:
    """Return the registers with another open-circuit amplitude; the offset may give way."""
    amplitude_v, errors = clipped(amplitude_v, SMALLEST_VPP, 2 * PEAK_V, "amplitude")
    share, model = load_share(registers), registers.model
    # Resolved in the unit that is displayed.
    shown = rounded(in_unit(registers, amplitude_v * share), model.amplitude_digits, model.amplitude_decimals)
    amplitude_v = min(max(to_vpp(registers, shown, "") / share, SMALLEST_VPP), 2 * PEAK_V)
    offset_v, room_v = registers.offset_v, PEAK_V - amplitude_v / 2
    state = Coerced(registers, errors)
    if abs(offset_v) > room_v + ROUNDING:
        offset_v = math.copysign(room_v, offset_v)
        state = state.changed("offset changed due to amplitude")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_offset(registers: Registers, offset_v: float) -> Coerced:
    """Return the registers with another open-circuit offset; the amplitude may give way."""
    most_v = PEAK_V - SMALLEST_VPP / 2
    offset_v, errors = _held(registers, offset_v, -most_v, most_v, "offset")
    amplitude_v, room_v = registers.amplitude_v, 2 * (PEAK_V - abs(offset_v))
    state = Coerced(registers, errors)
    if amplitude_v > room_v + ROUNDING:
        amplitude_v = room_v
        state = state.changed("amplitude changed due to offset")
    return state.changed(high_v=offset_v + amplitude_v / 2, low_v=offset_v - amplitude_v / 2)


def set_high(registers: Registers, high_v: float) -> Coerced:
    """Return the registers with another open-circuit high level; the low level may give way."""
    gap_v = LEVEL_GAP_V / load_share(registers)
    high_v, errors = _held(registers, high_v, -PEAK_V + gap_v, PEAK_V, "high level")
    state = Coerced(replace(registers, high_v=high_v), errors)
    if high_v - registers.low_v < gap_v * (1 - 1e-9):
        state = state.changed("low level changed due to high level", low_v=high_v - gap_v)
    return state


def set_low(registers: Registers, low_v: float) -> Coerced:
    """Return the registers with another open-circuit low level; the high level may give way."""
    gap_v = LEVEL_GAP_V / load_share(registers)
    low_v, errors = _held(registers, low_v, -PEAK_V, PEAK_V - gap_v, "low level")
    state = Coerced(replace(registers, low_v=low_v), errors)
    if registers.high_v - low_v < gap_v * (1 - 1e-9):
        state = state.changed("high level changed due to low level", high_v=low_v + gap_v)
    return state


def set_load(registers: Registers, load_ohm: float) -> Coerced:
    """Return the registers with another declared load; it is a declaration, the output itself does not change."""
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
    shares = {"SIN": math.sqrt(2), "RAMP": math.sqrt(3), "TRI": math.sqrt(3), "NOIS": 5.0}
    return 0.5 / shares.get(state.function, 1.0)


def to_vpp(state: Registers, value: float, unit: str) -> float:
    """Return an amplitude in ``unit``, or in the unit that is set where that is empty, as peak to peak at the load."""
    unit = state.unit if unit in ("", "V") else unit
    if unit == "DBM":
        if math.isinf(state.load_ohm):
            raise ScpiError(-221, "Settings conflict; amplitude units cannot be dBm at high-Z load")
        # Far beyond what any instrument can do a power of ten would overflow: it is clipped anyway.
        watts = 1e-3 * 10 ** (min(max(value, -LARGEST_DBM), LARGEST_DBM) / 10)
        return math.sqrt(state.load_ohm * watts) / _rms_per_vpp(state)
    return value / _rms_per_vpp(state) if unit == "VRMS" else value


def in_unit(state: Registers, vpp: float) -> float:
    """Return an amplitude at the load in the unit that is set."""
    if state.unit == "DBM":
        return 10 * math.log10((vpp * _rms_per_vpp(state)) ** 2 / (state.load_ohm * 1e-3))
    return vpp * _rms_per_vpp(state) if state.unit == "VRMS" else vpp


def amplitude_limits(state: Registers) -> tuple[float, float]:
    """Return the least and largest amplitude at the load, peak to peak."""
    share = load_share(state)
    return SMALLEST_VPP * share, 2 * (PEAK_V - abs(state.offset_v)) * share
