"""Limits of the 33250A and its siblings, checked before anything is sent; the numbers of a model are in `models`."""

from __future__ import annotations

import math
from typing import Final

from drivers.agilent.models import AGILENT_33250A, GeneratorModel, Range
from drivers.interfaces import ContinuousSine, GeneratorTask, PulseTrain, Toneburst, TriggerPulse

LOAD_OHM: Final = (1.0, 10_000.0)
SOURCE_OHM: Final = 50.0
OPEN_CIRCUIT_PEAK_V: Final = 10.0
OPEN_CIRCUIT_MIN_VPP: Final = 2e-3
# The edges of a pulse take 1.6 edge times of the period (docs/explanation/instruments.md, 1.4).
EDGES_IN_PERIOD: Final = 1.6


def mistakes(task: GeneratorTask, model: GeneratorModel = AGILENT_33250A, max_vpp: float = math.inf) -> list[str]:
    """Return every value of ``task`` outside the limits of ``model``, as text with value and limits.

    ``max_vpp`` is the largest swing into the declared load that the connected device tolerates.
    """
    return _beyond_model(task, model) + _beyond_wiring(task, max_vpp)


def load_divider(load_ohm: float) -> float:
    """Return the voltage at a load over the open-circuit voltage of the 50 ohm source."""
    return 1.0 / (1.0 + SOURCE_OHM / load_ohm)


def _beyond_model(task: GeneratorTask, model: GeneratorModel) -> list[str]:
    match task:
        case TriggerPulse():
            widest_s = model.width_s[1] / 2
            return [*_outside("width_s", task.width_s, (model.width_s[0], widest_s)), *_level(task)]
        case PulseTrain():
            rate = _outside("rate_hz", task.rate_hz, model.pulse_rate_hz)
            width = [] if rate else _width(task.width_s, model.shortest_period_s(task.rate_hz), model)
            return [*rate, *width, *_burst(task.count, "count", task.delay_s, model), *_level(task)]
        case Toneburst():
            where = f" for counted bursts of a {model.name}"
            return [
                *_outside("carrier_hz", task.carrier_hz, model.burst_carrier_hz, where),
                *_burst(task.cycles, "cycles", task.delay_s, model),
                *_amplitude(task),
            ]
        case ContinuousSine():
            return [*_outside("frequency_hz", task.frequency_hz, model.sine_hz), *_amplitude(task)]


def _beyond_wiring(task: GeneratorTask, max_vpp: float) -> list[str]:
    if isinstance(task, TriggerPulse | PulseTrain):
        name, swing_v = "high_v", task.high_v
    else:
        name, swing_v = "amplitude_vpp", task.amplitude_vpp
    if swing_v <= max_vpp:
        return []
    return [f"{name} = {swing_v:.10g} is above max_vpp = {max_vpp:.10g}, the limit of the bench file at this output"]


def _width(width_s: float, period_s: float, model: GeneratorModel) -> list[str]:
    # The gap between two pulses holds both edges, and is at least as wide as the narrowest pulse.
    gap_s = max(EDGES_IN_PERIOD * model.edge_s, model.width_s[0])
    limits_s = model.min_width_s(period_s), min(model.width_s[1], period_s - gap_s)
    return _outside("width_s", width_s, limits_s, f" at a period of {period_s:.6g} s")


def _burst(count: int, name: str, delay_s: float, model: GeneratorModel) -> list[str]:
    return [*_outside(name, count, model.cycles), *_outside("delay_s", delay_s, model.delay_s)]


def _level(pulse: TriggerPulse | PulseTrain) -> list[str]:
    return _into_load("high_v", pulse.high_v, pulse.load_ohm, OPEN_CIRCUIT_PEAK_V, f" into {pulse.load_ohm:g} ohm")


def _amplitude(sine: Toneburst | ContinuousSine) -> list[str]:
    return _into_load("amplitude_vpp", sine.amplitude_vpp, sine.load_ohm, 2 * OPEN_CIRCUIT_PEAK_V)


def _into_load(name: str, volts: float, load_ohm: float, open_circuit_v: float, where: str = "") -> list[str]:
    load = [] if load_ohm == math.inf else _outside("load_ohm", load_ohm, LOAD_OHM, " (or inf)")
    if load:
        return load
    divider = load_divider(load_ohm)
    return _outside(name, volts, (OPEN_CIRCUIT_MIN_VPP * divider, open_circuit_v * divider), where)


def _outside(name: str, value: float, limits: Range, where: str = "") -> list[str]:
    lowest, highest = limits
    # Written so that NaN counts as outside.
    if lowest <= value <= highest:
        return []
    return [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}{where}"]
