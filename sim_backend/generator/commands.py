"""Commands that set a waveform, by header: effect and reply as functions of the registers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import attrgetter

from sim_backend.generator import levels, registers, timing
from sim_backend.generator.kinds import (
    LimitsOf,
    SettingCommand,
    choice,
    choice_of_model,
    clipping,
    min_or_max_keyword,
    numeric,
    switch,
)
from sim_backend.generator.levels import load_divider
from sim_backend.generator.models import Model
from sim_backend.generator.registers import Coerced, Registers
from sim_backend.generator.scpi_text import (
    boolean,
    not_simulated,
    number_with_unit,
    only_argument,
    refuse_arguments,
    unquoted,
)


def _amplitude() -> SettingCommand:
    """Return the amplitude setting in Vpp, Vrms or dBm at the load."""

    def limits(state: Registers) -> tuple[float, float]:
        """Return the smallest and the largest amplitude, in the set unit."""
        low, high = levels.amplitude_limits(state)
        return levels.in_unit(state, low), levels.in_unit(state, high)

    def write_amplitude(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        """Return the registers after the command VOLTage with these arguments, and its errors."""
        text = only_argument(arguments)
        # Limits and default are in Vpp at the load, whatever the set unit.
        vpp = min_or_max_keyword(text, levels.amplitude_limits(state))
        if text.upper() in ("DEF", "DEFAULT"):
            vpp = DEFAULT_VPP
        if vpp is None:
            vpp = levels.to_vpp(state, *number_with_unit(text, "VPP VRMS DBM V"))
        # The registers hold the open-circuit amplitude; the command states it at the load.
        return levels.set_amplitude(state, vpp / load_divider(state))

    with_limits_in_set_unit = numeric(
        "VPP VRMS DBM",
        limits,
        lambda state: levels.in_unit(state, state.amplitude_v * load_divider(state)),
        levels.set_amplitude,
    )
    return replace(with_limits_in_set_unit, command=write_amplitude)


DEFAULT_VPP = 0.1


def _level(open_limits: LimitsOf, field: str, put: Callable[[Registers, float], Coerced]) -> SettingCommand:
    """Return a voltage setting, commanded and displayed in volts at the load.

    ``open_limits``, the stored ``field`` and the argument of ``put`` are open-circuit volts.
    """

    def limits(state: Registers) -> tuple[float, float]:
        """Return the limits in volts at the load."""
        low, high = open_limits(state)
        return low * load_divider(state), high * load_divider(state)

    return numeric(
        "V",
        limits,
        lambda state: getattr(state, field) * load_divider(state),
        lambda state, value: put(state, value / load_divider(state)),
    )


def _offset_limits(state: Registers) -> tuple[float, float]:
    """Return the limits of the open-circuit offset: offset and half the amplitude share the peak voltage."""
    limit_v = registers.PEAK_V - state.amplitude_v / 2
    return -limit_v, limit_v


def _gap_v(state: Registers) -> float:
    return registers.LEVEL_GAP_V / load_divider(state)


def _period_limits_s(state: Registers) -> tuple[float, float]:
    """Return the limits of the pulse period, s, also while another function is selected.

    The period is that of the present function too, so it must be within the frequency limits of both.
    """
    pulse_low_hz, pulse_high_hz = state.model.frequency_limits_hz["PULS"]
    present_low_hz, present_high_hz = timing.frequency_limits_hz(state)
    return 1 / min(pulse_high_hz, present_high_hz), 1 / max(pulse_low_hz, present_low_hz)


def _put_period(state: Registers, period_s: float) -> Coerced:
    """Set the pulse period, clipped to its limits, and adapt the settings that depend on it."""
    period_s, errors = registers.clipped(period_s, *_period_limits_s(state), "pulse period")
    changed = timing.at_frequency(state, 1 / period_s)
    return timing.settle_frequency(timing.settle_pulse(Coerced(changed, errors), state.model.short_period_error))


def _put_frequency(state: Registers, frequency_hz: float) -> Coerced:
    """Set the frequency, clipped to its limits and rounded to the displayed digits, and adapt dependent settings."""
    low_hz, high_hz = timing.frequency_limits_hz(state)
    frequency_hz, errors = registers.clipped(frequency_hz, low_hz, high_hz, "frequency")
    frequency_hz = registers.rounded(frequency_hz, state.model.frequency_digits, state.model.frequency_decimals)
    # Rounding may exceed a limit, so it is clipped again.
    frequency_hz = min(max(frequency_hz, low_hz), high_hz)
    return timing.settle_frequency(Coerced(timing.at_frequency(state, frequency_hz), errors))


def _pulse_duty_limits(state: Registers) -> tuple[float, float]:
    """Return the limits of the pulse's duty cycle, percent, from those of its width."""
    low_s, high_s = timing.width_limits_s(state)
    return 100 * low_s * state.frequency_hz, 100 * high_s * state.frequency_hz


def _put_pulse_duty(state: Registers, percent: float) -> Coerced:
    """Set the pulse's duty cycle, percent, clipped to its limits; it is stored as a width."""
    percent, errors = registers.clipped(percent, *_pulse_duty_limits(state), "pulse duty cycle")
    after = timing.set_width(state, percent / 100 / state.frequency_hz)
    return Coerced(after.registers, errors + after.errors)


def _phase(field: str, quantity: str) -> SettingCommand:
    """Return the setting of an angle, stored in degrees in ``field`` of the registers; ``quantity`` names it in errors.

    It is commanded and displayed in the set angle unit.
    """

    def limits(state: Registers) -> tuple[float, float]:
        """Return plus and minus one turn in the set angle unit."""
        return (-360.0, 360.0) if state.angle_unit == "DEG" else (-2 * math.pi, 2 * math.pi)

    def put(state: Registers, angle: float) -> Coerced:
        """Return the registers with this angle, given in the set angle unit, clipped to its limits and in degrees."""
        angle, errors = registers.clipped(angle, *limits(state), quantity)
        degrees = angle if state.angle_unit == "DEG" else math.degrees(angle)
        return Coerced(replace(state, **{field: degrees}), errors)  # type: ignore[arg-type]

    def get(state: Registers) -> float:
        """Return the stored angle in the set angle unit."""
        degrees: float = getattr(state, field)
        return degrees if state.angle_unit == "DEG" else math.radians(degrees)

    def convert(state: Registers, angle: float, unit: str) -> float:
        """Return an angle given in ``unit`` in the set angle unit."""
        if unit in ("", state.angle_unit):
            return angle
        return math.degrees(angle) if unit == "RAD" else math.radians(angle)

    return numeric("DEG RAD", limits, get, put, convert=convert)


def _text() -> SettingCommand:
    """Return the setting of the text on the display."""

    def write_text(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        return Coerced(replace(state, display_text=unquoted(only_argument(arguments))[:MAX_TEXT]))

    return SettingCommand(write_text, lambda state, arguments: f'"{state.display_text}"', "quoted text")


MAX_TEXT = 40


def _auto_range_setting() -> SettingCommand:
    """Return the setting of automatic ranging: on, off, or once, which counts as off."""

    def write_auto(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        once = only_argument(arguments).upper() == "ONCE"
        return Coerced(replace(state, range_auto="0" if once else str(int(boolean(arguments[0])))))

    return SettingCommand(write_auto, lambda state, arguments: state.range_auto, "ON, OFF, ONCE")


def _without_argument(**settings: object) -> SettingCommand:
    """Return a command without argument that stores ``settings``, such as the display's CLEar."""

    def store_settings(state: Registers, arguments: tuple[str, ...]) -> Coerced:
        refuse_arguments(arguments)
        return Coerced(replace(state, **settings))  # type: ignore[arg-type]

    return SettingCommand(store_settings, None)


def _always_off(header: str) -> SettingCommand:
    """Return the switch of a function that is not simulated: off is accepted, on is refused with -241."""

    def write_state(state: Registers, on: bool) -> Coerced:
        if on:
            raise not_simulated(header)
        return Coerced(state)

    return replace(switch(lambda state: False, write_state), accepts="OFF")


FREQUENCY = numeric("HZ", timing.frequency_limits_hz, "frequency_hz", _put_frequency)
AMPLITUDE = _amplitude()
OFFSET = _level(_offset_limits, "offset_v", levels.set_offset)
PERIOD = numeric("S", _period_limits_s, lambda state: 1 / state.frequency_hz, _put_period)
WIDTH = numeric("S", timing.width_limits_s, "width_s", timing.set_width)
EDGES = clipping("S", timing.edge_limits_s, "edge_s", "pulse edge time")

SETTINGS: Mapping[str, SettingCommand] = {
    "[SOURce<n>:]FUNCtion[:SHAPe]": choice_of_model(
        "SINusoid, SQUare, RAMP, PULSe, NOISe, DC, and USER, TRIangle, PRBS, ARBitrary if the model has them",
        lambda state: state.model.functions.split(),
        "function",
        timing.set_function,
    ),
    "[SOURce<n>:]FUNCtion[:SHAPe]:SQUare:DCYCle": clipping(
        "", timing.duty_limits_percent, "duty_percent", "duty cycle"
    ),
    "[SOURce<n>:]FUNCtion[:SHAPe]:RAMP:SYMMetry": clipping(
        "", lambda state: (0.0, 100.0), "symmetry_percent", "symmetry"
    ),
    "[SOURce<n>:]FREQuency[:CW]": FREQUENCY,
    "[SOURce<n>:]VOLTage[:LEVel][:IMMediate][:AMPLitude]": AMPLITUDE,
    "[SOURce<n>:]VOLTage[:LEVel][:IMMediate]:OFFSet": OFFSET,
    "[SOURce<n>:]VOLTage[:LEVel][:IMMediate]:HIGH": _level(
        lambda state: (state.low_v + _gap_v(state), registers.PEAK_V), "high_v", levels.set_high
    ),
    "[SOURce<n>:]VOLTage[:LEVel][:IMMediate]:LOW": _level(
        lambda state: (-registers.PEAK_V, state.high_v - _gap_v(state)), "low_v", levels.set_low
    ),
    "[SOURce<n>:]VOLTage:RANGe:AUTO": _auto_range_setting(),
    "[SOURce<n>:]VOLTage[:LEVel][:IMMediate]:UNIT[:VOLTage]": choice("VPP VRMS DBM", "unit", levels.set_unit),
    "[SOURce<n>:]BURSt:STATe": switch("burst", timing.set_burst),
    "[SOURce<n>:]BURSt:MODE": choice("TRIGgered GATed", "burst_mode", timing.set_burst_mode),
    "[SOURce<n>:]BURSt:NCYCles": numeric(
        "", lambda state: (1.0, float(state.model.max_cycles)), "cycles", timing.set_cycles, infinite=True
    ),
    "[SOURce<n>:]BURSt:INTernal:PERiod": numeric(
        "S", attrgetter("model.burst_period_limits_s"), "burst_period_s", timing.set_burst_period
    ),
    "[SOURce<n>:]BURSt:PHASe": _phase("burst_phase_deg", "burst phase"),
    "[SOURce<n>:]PHASe[:ADJust]": _phase("phase_deg", "phase"),
    "[SOURce<n>:]PHASe:REFerence": _without_argument(phase_deg=0.0),
    "OUTPut<n>[:STATe]": switch("output"),
    "OUTPut<n>:LOAD": numeric(
        "OHM", lambda state: registers.LOAD_LIMITS_OHM, "load_ohm", levels.set_load, infinite=True
    ),
    "OUTPut<n>:POLarity": choice("NORMal INVerted", "polarity"),
    "OUTPut:SYNC[:STATe]": switch("sync"),
    "OUTPut:TRIGger[:STATe]": switch("trigger_output", timing.set_trigger_output),
    "OUTPut:TRIGger:SLOPe": choice("POSitive NEGative", "trigger_output_slope"),
    "TRIGger<n>[:SEQuence]:SOURce": choice("IMMediate EXTernal BUS", "trigger_source", timing.set_source),
    "TRIGger<n>[:SEQuence]:SLOPe": choice("POSitive NEGative", "trigger_slope"),
    "TRIGger<n>[:SEQuence]:DELay": clipping(
        "S", attrgetter("model.delay_limits_s"), "delay_s", "trigger delay", timing.settle_burst
    ),
    "UNIT:ANGLe": choice("DEGree RADian", "angle_unit"),
    **{f"[SOURce<n>:]{name}:STATe": _always_off(f"{name}:STAT") for name in ("AM", "FM", "FSKey", "SWEep")},
    "[SOURce<n>:]MARKer[:STATe]": _always_off("MARK"),
    "DISPlay[:WINDow][:STATe]": switch("display"),
    "DISPlay[:WINDow]:TEXT[:DATA]": _text(),
    "DISPlay[:WINDow]:TEXT:CLEar": _without_argument(display_text=""),
    "SYSTem:BEEPer:STATe": switch("beeper"),
}
"""Settings of every model, by header (docs/explanation/instruments.md, 1.4)."""

OF_33250A: Mapping[str, SettingCommand] = {
    "[SOURce:]PULSe:PERiod": PERIOD,
    "[SOURce:]PULSe:WIDTh": WIDTH,
    "[SOURce:]PULSe:TRANsition": EDGES,
}
PULSE: Mapping[str, SettingCommand] = {
    "[SOURce<n>:]FUNCtion:PULSe:WIDTh": WIDTH,
    "[SOURce<n>:]FUNCtion:PULSe:DCYCle": numeric(
        "", _pulse_duty_limits, lambda state: 100 * state.width_s * state.frequency_hz, _put_pulse_duty
    ),
    "[SOURce<n>:]FUNCtion:PULSe:HOLD": choice("WIDTh DCYCle", "pulse_hold"),
}
OF_33220A: Mapping[str, SettingCommand] = {
    **PULSE,
    "[SOURce:]PULSe:PERiod": PERIOD,
    "[SOURce:]FUNCtion:PULSe:TRANsition": EDGES,
}
OF_SERIES: Mapping[str, SettingCommand] = {
    **PULSE,
    "[SOURce<n>:]FUNCtion:PULSe:PERiod": PERIOD,
    "[SOURce<n>:]FUNCtion:PULSe:TRANsition[:BOTH]": EDGES,
}


def settings_of(model: Model) -> Mapping[str, SettingCommand]:
    """Return the settings of ``model`` by header; the models differ in the headers of the pulse."""
    return {**SETTINGS, **{"33250A": OF_33250A, "33220A": OF_33220A}.get(model.name, OF_SERIES)}
