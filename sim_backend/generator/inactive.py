"""Inactive settings: modulation, sweep and arbitrary waveforms, which have no output in the twin.

While these functions are off, their settings behave as on the instrument. Switching one on is refused with an error
that the twin does not simulate it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from sim_backend.generator.kinds import LimitsOf, SettingCommand, choice, numeric, switch
from sim_backend.generator.registers import Coerced, Registers, clipped
from sim_backend.generator.scpi_text import not_simulated
from sim_backend.generator.timing import frequency_limits_hz

SHAPES = "SINusoid SQUare RAMP NRAMp TRIangle NOISe USER"
SLOW_HZ = (2e-3, 20e3)


def with_inactive(state: Registers, **values: float | str) -> Registers:
    """Return the registers with changed inactive settings."""
    return replace(state, inactive={**state.inactive, **values})


def _number(key: str, default: float, limits: LimitsOf, units: str = "") -> SettingCommand:
    """Return a numeric setting that is stored under ``key`` and has no effect on the output."""

    def put(state: Registers, value: float) -> Coerced:
        """Store the value, clipped to its limits."""
        value, errors = clipped(value, *limits(state), key.replace("_", " "))
        return Coerced(with_inactive(state, **{key: value}), errors)

    return numeric(units, limits, lambda state: state.inactive.get(key, default), put)


def _fixed_limits(low: float, high: float) -> LimitsOf:
    return lambda state: (low, high)


def _word(key: str, default: str, words: str) -> SettingCommand:
    """Return a setting with one of ``words`` that is stored under ``key`` and has no effect on the output."""

    def put(state: Registers, word: str) -> Coerced:
        return Coerced(with_inactive(state, **{key: word}))

    return choice(words, lambda state: state.inactive.get(key, default), put)


def off(function: str) -> SettingCommand:
    """Return the switch of a function that is not simulated: it is off and cannot be switched on."""

    def put(state: Registers, on: bool) -> Coerced:
        """Accept off; raise ``ScpiError`` for on."""
        if on:
            raise not_simulated(function)
        return Coerced(state)

    return switch(lambda state: False, put)


def _sweep_ends_hz(state: Registers) -> tuple[float, float]:
    """Return start and stop frequency of the sweep."""
    return float(state.inactive.get("start_frequency", 100.0)), float(state.inactive.get("stop_frequency", 1e3))


def _centre_limits_hz(state: Registers) -> tuple[float, float]:
    """Return the limits of the sweep's centre frequency at the present span.

    Within them, start and stop stay within the frequency limits of the selected waveform.
    """
    low_hz, high_hz = frequency_limits_hz(state)
    start_hz, stop_hz = _sweep_ends_hz(state)
    half_span_hz = abs(stop_hz - start_hz) / 2
    return low_hz + half_span_hz, high_hz - half_span_hz


def _span_limits_hz(state: Registers) -> tuple[float, float]:
    """Return the limits of the sweep's span at the present centre frequency.

    Within them, start and stop stay within the frequency limits of the selected waveform.
    """
    low_hz, high_hz = frequency_limits_hz(state)
    start_hz, stop_hz = _sweep_ends_hz(state)
    centre_hz = (start_hz + stop_hz) / 2
    return 0.0, 2 * min(high_hz - centre_hz, centre_hz - low_hz)


def _sweep_setting(
    quantity: str,
    limits: LimitsOf,
    value_of_ends: Callable[[float, float], float],
    ends_of_value: Callable[[float, float, float], tuple[float, float]],
) -> SettingCommand:
    """Return the setting of ``quantity``, the centre or span of the sweep; only start and stop are stored.

    ``value_of_ends`` computes it from start and stop frequency, ``ends_of_value`` the new start and stop from its new
    value and the present ones.
    """

    def put(state: Registers, value: float) -> Coerced:
        """Return the registers with start and stop of the sweep for this centre or span, clipped to its limits."""
        value, errors = clipped(value, *limits(state), quantity)
        start_hz, stop_hz = ends_of_value(value, *_sweep_ends_hz(state))
        return Coerced(with_inactive(state, start_frequency=start_hz, stop_frequency=stop_hz), errors)

    return numeric("HZ", limits, lambda state: value_of_ends(*_sweep_ends_hz(state)), put)


def _modulation(name: str, function: str, rate_hz: float) -> dict[str, SettingCommand]:
    """Return the settings of one modulation by header; they are stored and have no effect on the output."""
    key = name.lower()
    return {
        f"[SOURce<n>:]{name}:STATe": off(function),
        f"[SOURce<n>:]{name}:SOURce": _word(f"{key}_source", "INT", "INTernal EXTernal"),
        f"[SOURce<n>:]{name}:INTernal:FREQuency": _number(f"{key}_frequency", rate_hz, _fixed_limits(*SLOW_HZ), "HZ"),
        f"[SOURce<n>:]{name}:INTernal:FUNCtion[:SHAPe]": _word(f"{key}_shape", "SIN", SHAPES),
    }


def _centred(value: float, start_hz: float, stop_hz: float) -> tuple[float, float]:
    """Return start and stop of a sweep with the same span around the centre ``value``."""
    half_hz = (stop_hz - start_hz) / 2
    return value - half_hz, value + half_hz


def _spanning(value: float, start_hz: float, stop_hz: float) -> tuple[float, float]:
    """Return start and stop of a sweep with the same centre and the span ``value``."""
    centre_hz = (start_hz + stop_hz) / 2
    return centre_hz - value / 2, centre_hz + value / 2


INACTIVE: Mapping[str, SettingCommand] = {
    **_modulation("AM", "amplitude modulation", 100.0),
    "[SOURce<n>:]AM:DEPTh": _number("am_depth", 100.0, _fixed_limits(0.0, 120.0)),
    **_modulation("FM", "frequency modulation", 10.0),
    "[SOURce<n>:]FM:DEViation": _number("fm_deviation", 100.0, _fixed_limits(5.0, 40.05e6), "HZ"),
    "[SOURce<n>:]FSKey:STATe": off("frequency shift keying"),
    "[SOURce<n>:]FSKey:SOURce": _word("fsk_source", "INT", "INTernal EXTernal"),
    "[SOURce<n>:]FSKey:FREQuency": _number("hop_frequency", 100.0, frequency_limits_hz, "HZ"),
    "[SOURce<n>:]FSKey:INTernal:RATE": _number("fsk_rate", 10.0, _fixed_limits(2e-3, 100e3), "HZ"),
    "[SOURce<n>:]SWEep:STATe": off("the sweep"),
    "[SOURce<n>:]SWEep:SPACing": _word("sweep_spacing", "LIN", "LINear LOGarithmic"),
    "[SOURce<n>:]SWEep:TIME": _number("sweep_time", 1.0, _fixed_limits(1e-3, 500.0), "S"),
    "[SOURce<n>:]FREQuency:STARt": _number("start_frequency", 100.0, frequency_limits_hz, "HZ"),
    "[SOURce<n>:]FREQuency:STOP": _number("stop_frequency", 1e3, frequency_limits_hz, "HZ"),
    "[SOURce<n>:]FREQuency:CENTer": _sweep_setting(
        "centre frequency", _centre_limits_hz, lambda start_hz, stop_hz: (start_hz + stop_hz) / 2, _centred
    ),
    "[SOURce<n>:]FREQuency:SPAN": _sweep_setting(
        "frequency span", _span_limits_hz, lambda start_hz, stop_hz: abs(stop_hz - start_hz), _spanning
    ),
    "[SOURce<n>:]MARKer[:STATe]": off("the frequency marker"),
    "[SOURce<n>:]MARKer:FREQuency": _number("marker_frequency", 500.0, frequency_limits_hz, "HZ"),
}
"""Settings of modulation, sweep and marker by header (manual; assumed for the siblings, which have more)."""

INACTIVE_OF_SERIES: Mapping[str, SettingCommand] = {
    "[SOURce<n>:]FUNCtion:ARBitrary:SRATe": _number("sample_rate", 40e3, _fixed_limits(1e-6, 250e6)),
    "[SOURce<n>:]FUNCtion:ARBitrary:FILTer": _word("arbitrary_filter", "NORM", "NORMal STEP OFF"),
    "[SOURce<n>:]FUNCtion:ARBitrary:ADVance": _word("arbitrary_advance", "SRAT", "TRIGger SRATe"),
    "TRIGger<n>:COUNt": _number("trigger_count", 1.0, _fixed_limits(1.0, 1e6)),
}
"""Settings of the 33500 and 33600 series; the trigger count has no effect, as triggering is continuously armed."""
