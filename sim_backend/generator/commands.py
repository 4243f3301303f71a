"""Command table of a 33250A: header -> what it sets and what it answers, as functions of the registers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from sim_backend.generator import levels, registers, timing
from sim_backend.generator.levels import load_share
from sim_backend.generator.models import Model
from sim_backend.generator.registers import Coerced, Registers
from sim_backend.generator.scpi_text import ScpiError, boolean, keyword, number, quoted, real_reply

Write = Callable[[Registers, tuple[str, ...]], Coerced]
Read = Callable[[Registers, tuple[str, ...]], str]
LimitsOf = Callable[[Registers], tuple[float, float]]
# What is shown of the registers: a field by its name, or what a function makes of them.
Shown = str | Callable[[Registers], Any]


@dataclass(frozen=True, slots=True)
class SettingCommand:
    """What one header does; None where the form without or with ``?`` does not exist."""

    write: Write | None
    read: Read | None


def _one(arguments: tuple[str, ...]) -> str:
    if not arguments:
        raise ScpiError(-109, "Missing parameter")
    if len(arguments) > 1:
        raise ScpiError(-108, "Parameter not allowed")
    return arguments[0]


def _extreme(text: str, limits: tuple[float, float]) -> float | None:
    low, high = limits
    return {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}.get(text.upper())


def _getter(shown: Shown) -> Callable[[Registers], Any]:
    return attrgetter(shown) if isinstance(shown, str) else shown


def _number(
    units: str,
    limits: LimitsOf,
    shown: Shown,
    put: Callable[[Registers, float], Coerced],
    infinite: bool = False,
    convert: Callable[[Registers, float, str], float] = lambda state, value, unit: value,
) -> SettingCommand:
    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        text = _one(arguments)
        value = _extreme(text, limits(state))
        if infinite and text.upper() in ("INF", "INFINITY"):
            value = math.inf
        return put(state, convert(state, *number(text, units)) if value is None else value)

    def read(state: Registers, arguments: tuple[str, ...]) -> str:
        if not arguments:
            return real_reply(_getter(shown)(state))
        value = _extreme(_one(arguments), limits(state))
        if value is None:
            raise ScpiError(-224, "Illegal parameter value")
        return real_reply(value)

    return SettingCommand(write, read)


def _clipped(
    units: str,
    limits: LimitsOf,
    field: str,
    quantity: str,
    settle: Callable[[Coerced], Coerced] = lambda coerced: coerced,
) -> SettingCommand:
    """Return a number that is clipped to its limits; ``settle`` fits the other settings to it."""

    def put(state: Registers, value: float) -> Coerced:
        value, errors = registers.clipped(value, *limits(state), quantity)
        return settle(Coerced(replace(state, **{field: value}), errors))  # type: ignore[arg-type]

    return _number(units, limits, field, put)


def _setter(shown: Shown) -> Callable[[Registers, Any], Coerced]:
    return lambda state, value: Coerced(replace(state, **{str(shown): value}))


def _choice(words: str, shown: Shown, put: Callable[[Registers, str], Coerced] | None = None) -> SettingCommand:
    return SettingCommand(
        lambda state, arguments: (put or _setter(shown))(state, keyword(_one(arguments), words.split())),
        lambda state, arguments: str(_getter(shown)(state)),
    )


def _switch(shown: Shown, put: Callable[[Registers, bool], Coerced] | None = None) -> SettingCommand:
    return SettingCommand(
        lambda state, arguments: (put or _setter(shown))(state, boolean(_one(arguments))),
        lambda state, arguments: str(int(_getter(shown)(state))),
    )


def _mode(name: str) -> SettingCommand:
    return _switch(lambda state: state.modulation == name, lambda state, on: timing.set_modulation(state, name, on))


def _amplitude() -> SettingCommand:
    def limits(state: Registers) -> tuple[float, float]:
        low, high = levels.amplitude_limits(state)
        return levels.in_unit(state, low), levels.in_unit(state, high)

    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        text = _one(arguments)
        vpp = _extreme(text, levels.amplitude_limits(state))
        if vpp is None:
            vpp = levels.to_vpp(state, *number(text, "VPP VRMS DBM V"))
        return levels.set_amplitude(state, vpp / load_share(state))

    shown = _number(
        "", limits, lambda state: levels.in_unit(state, state.amplitude_v * load_share(state)), levels.set_amplitude
    )
    return SettingCommand(write, shown.read)


def _level(open_limits: LimitsOf, field: str, put: Callable[[Registers, float], Coerced]) -> SettingCommand:
    def limits(state: Registers) -> tuple[float, float]:
        low, high = open_limits(state)
        return low * load_share(state), high * load_share(state)

    return _number(
        "V",
        limits,
        lambda state: getattr(state, field) * load_share(state),
        lambda state, value: put(state, value / load_share(state)),
    )


def _offset_limits(state: Registers) -> tuple[float, float]:
    room = registers.PEAK_V - state.amplitude_v / 2
    return -room, room


def _gap_v(state: Registers) -> float:
    return registers.LEVEL_GAP_V / load_share(state)


def _period_limits_s(state: Registers) -> tuple[float, float]:
    low_hz, high_hz = state.model.frequency_limits_hz["PULS"]
    return 1 / high_hz, 1 / low_hz


def _put_period(state: Registers, period_s: float) -> Coerced:
    period_s, errors = registers.clipped(period_s, *_period_limits_s(state), "pulse period")
    return timing.settle_frequency(timing.settle_pulse(Coerced(replace(state, frequency_hz=1 / period_s), errors)))


def _phase() -> SettingCommand:
    def limits(state: Registers) -> tuple[float, float]:
        return (-360.0, 360.0) if state.angle_unit == "DEG" else (-2 * math.pi, 2 * math.pi)

    def put(state: Registers, angle: float) -> Coerced:
        angle, errors = registers.clipped(angle, *limits(state), "burst phase")
        degrees = angle if state.angle_unit == "DEG" else math.degrees(angle)
        return Coerced(replace(state, burst_phase_deg=degrees), errors)

    def get(state: Registers) -> float:
        return state.burst_phase_deg if state.angle_unit == "DEG" else math.radians(state.burst_phase_deg)

    def convert(state: Registers, angle: float, unit: str) -> float:
        if unit in ("", state.angle_unit):
            return angle
        return math.degrees(angle) if unit == "RAD" else math.radians(angle)

    return _number("DEG RAD", limits, get, put, convert=convert)


def _text() -> SettingCommand:
    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        return Coerced(replace(state, display_text=quoted(_one(arguments))))

    return SettingCommand(write, lambda state, arguments: f'"{state.display_text}"')


def _range() -> SettingCommand:
    def write(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        once = _one(arguments).upper() == "ONCE"
        return Coerced(replace(state, range_auto="0" if once else str(int(boolean(arguments[0])))))

    return SettingCommand(write, lambda state, arguments: state.range_auto)


def _clear_text(state: Registers, arguments: tuple[str, ...]) -> Coerced:
    return Coerced(replace(state, display_text=""))


SETTINGS = {
    "[SOURce:]FUNCtion[:SHAPe]": _choice("SINusoid SQUare RAMP PULSe NOISe DC USER", "function", timing.set_function),
    "[SOURce:]FUNCtion:SQUare:DCYCle": _clipped("", timing.duty_limits_percent, "duty_percent", "duty cycle"),
    "[SOURce:]FUNCtion:RAMP:SYMMetry": _clipped("", lambda state: (0.0, 100.0), "symmetry_percent", "symmetry"),
    "[SOURce:]FREQuency[:CW]": _clipped(
        "HZ", timing.frequency_limits_hz, "frequency_hz", "frequency", timing.set_frequency
    ),
    "[SOURce:]VOLTage[:LEVel][:IMMediate][:AMPLitude]": _amplitude(),
    "[SOURce:]VOLTage[:LEVel][:IMMediate]:OFFSet": _level(_offset_limits, "offset_v", levels.set_offset),
    "[SOURce:]VOLTage[:LEVel][:IMMediate]:HIGH": _level(
        lambda state: (state.low_v + _gap_v(state), registers.PEAK_V), "high_v", levels.set_high
    ),
    "[SOURce:]VOLTage[:LEVel][:IMMediate]:LOW": _level(
        lambda state: (-registers.PEAK_V, state.high_v - _gap_v(state)), "low_v", levels.set_low
    ),
    "[SOURce:]VOLTage:RANGe:AUTO": _range(),
    "[SOURce:]VOLTage:UNIT": _choice("VPP VRMS DBM", "unit", levels.set_unit),
    "[SOURce:]PULSe:PERiod": _number("S", _period_limits_s, lambda state: 1 / state.frequency_hz, _put_period),
    "[SOURce:]PULSe:WIDTh": _number("S", timing.width_limits_s, "width_s", timing.set_width),
    "[SOURce:]PULSe:TRANsition": _clipped("S", timing.edge_limits_s, "edge_s", "pulse edge time"),
    "[SOURce:]BURSt:STATe": _switch("burst", timing.set_burst),
    "[SOURce:]BURSt:MODE": _choice("TRIGgered GATed", "burst_mode", timing.set_burst_mode),
    "[SOURce:]BURSt:NCYCles": _number(
        "", lambda state: (1.0, float(state.model.most_cycles)), "cycles", timing.set_cycles, infinite=True
    ),
    "[SOURce:]BURSt:INTernal:PERiod": _number(
        "S", attrgetter("model.burst_period_limits_s"), "burst_period_s", timing.set_burst_period
    ),
    "[SOURce:]BURSt:PHASe": _phase(),
    "[SOURce:]BURSt:GATE:POLarity": _choice("NORMal INVerted", "gate_polarity"),
    "[SOURce:]AM:STATe": _mode("AM"),
    "[SOURce:]FM:STATe": _mode("FM"),
    "[SOURce:]FSKey:STATe": _mode("FSK"),
    "[SOURce:]SWEep:STATe": _mode("SWE"),
    "OUTPut[:STATe]": _switch("output"),
    "OUTPut:LOAD": _number("OHM", lambda state: registers.LOAD_LIMITS_OHM, "load_ohm", levels.set_load, infinite=True),
    "OUTPut:POLarity": _choice("NORMal INVerted", "polarity"),
    "OUTPut:SYNC[:STATe]": _switch("sync"),
    "OUTPut:TRIGger[:STATe]": _switch("trigger_output", timing.set_trigger_output),
    "OUTPut:TRIGger:SLOPe": _choice("POSitive NEGative", "trigger_output_slope"),
    "TRIGger:SOURce": _choice("IMMediate EXTernal BUS", "trigger_source", timing.set_source),
    "TRIGger:SLOPe": _choice("POSitive NEGative", "trigger_slope"),
    "TRIGger:DELay": _clipped("S", attrgetter("model.delay_limits_s"), "delay_s", "trigger delay", timing.settle_burst),
    "UNIT:ANGLe": _choice("DEGree RADian", "angle_unit"),
    "DISPlay[:WINDow][:STATe]": _switch("display"),
    "DISPlay[:WINDow]:TEXT[:DATA]": _text(),
    "DISPlay[:WINDow]:TEXT:CLEar": SettingCommand(_clear_text, None),
    "SYSTem:BEEPer:STATe": _switch("beeper"),
}
"""Every setting of the twin's 33250A by header (docs/theory/instruments.md, 1.4)."""


def settings_of(model: Model) -> Mapping[str, SettingCommand]:
    """Return the settings of ``model`` by header; the series spell those of the pulse differently."""
    pulse = "[SOURce:]PULSe:"

    def spelled(header: str) -> str:
        if not header.startswith(pulse):
            return header
        node = model.period_node if header.endswith("PERiod") else model.pulse_node
        own = header.replace(pulse, f"[SOURce:]{node}:")
        return own + model.both_edges_node if own.endswith("TRANsition") else own

    return {spelled(header): setting for header, setting in SETTINGS.items()}
