"""Registers of a 33250A, and how a setting that does not fit is bent: pure functions from registers to registers.

The instrument clips or substitutes and queues an error, it never refuses a number (docs/theory/instruments.md,
1.6). Levels are kept as open-circuit voltages, so that a change of the declared load rescales what is displayed and
nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from sim_backend.generator.models import AGILENT_33250A, Model

Error = tuple[int, str]

PEAK_V = 10.0
"""Largest open-circuit voltage: 5 V into 50 ohm (manual)."""
SMALLEST_VPP = 2e-3
"""Smallest open-circuit amplitude: 1 mVpp into 50 ohm (a driver's argument limits, taken from the manual)."""
LEVEL_GAP_V = 1e-3
"""Least distance of the high from the low level, as displayed."""
EDGE_S = 5e-9
LOAD_LIMITS_OHM = (1.0, 10_000.0)

# Assumed: no source was found for these.
EDGE_SHARE_OF_WIDTH = 0.625
EDGES_IN_PERIOD = 1.6
BURST_MARGIN_S = 200e-9

ROUNDING = 1e-12
"""A limit that is itself computed counts as kept within this relative error."""


@dataclass(frozen=True, slots=True)
class Registers:
    """Everything a program can set, and the model whose limits it meets; the defaults are the power-on state.

    Levels are open-circuit volts.
    """

    model: Model = AGILENT_33250A
    function: str = "SIN"
    frequency_hz: float = 1e3
    high_v: float = 0.1
    low_v: float = -0.1
    unit: str = "VPP"
    range_auto: str = "1"
    duty_percent: float = 50.0
    symmetry_percent: float = 100.0
    width_s: float = 100e-6
    edge_s: float = EDGE_S
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
    phase_deg: float = 0.0
    pulse_hold: str = "WIDT"
    trigger_source: str = "IMM"
    trigger_slope: str = "POS"
    delay_s: float = 0.0
    timer_s: float = 1.0
    angle_unit: str = "DEG"
    display: bool = True
    display_text: str = ""
    beeper: bool = True
    inactive: Mapping[str, float | str] = field(default_factory=dict)
    """Settings of functions that are off, as far as they were changed (`inactive`)."""

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


def power_on(model: Model, beeper: bool = True) -> Registers:
    """Return what ``model`` wakes up with; its edges are no faster than it can make them."""
    return Registers(model, edge_s=max(EDGE_S, model.edge_limits_s[0]), beeper=beeper)


@dataclass(frozen=True, slots=True)
class Coerced:
    """Registers after a setting, with what the error queue was told."""

    registers: Registers
    errors: tuple[Error, ...] = ()

    def then(self, put: Callable[[Registers], Coerced]) -> Coerced:
        """Return what ``put`` makes of these, and the errors of both."""
        after = put(self.registers)
        return Coerced(after.registers, self.errors + after.errors)

    def changed(self, conflict: str = "", **settings: object) -> Coerced:
        """Return these with ``settings``, and the settings conflict that forced them if there was one."""
        told = ((-221, f"Settings conflict; {conflict}"),) if conflict else ()
        return Coerced(replace(self.registers, **settings), self.errors + told)  # type: ignore[arg-type]


def rounded(value: float, digits: int, decimals: int) -> float:
    """Return ``value`` as an instrument of limited resolution holds it: to the nearest (assumed) of its settings.

    These have ``digits`` significant digits, and ``decimals`` decimal places at most.
    """
    if not value or not math.isfinite(value):
        return value
    return round(value, min(decimals, digits - 1 - math.floor(math.log10(abs(value)))))


def clipped(value: float, low: float, high: float, quantity: str) -> tuple[float, tuple[Error, ...]]:
    """Return ``value`` within the limits, and the error that says which of them it hit."""
    if value > high + ROUNDING * abs(high):
        return high, ((-222, f"Data out of range; {quantity}; value clipped to upper limit"),)
    if value < low - ROUNDING * abs(low):
        return low, ((-222, f"Data out of range; {quantity}; value clipped to lower limit"),)
    return min(max(value, low), high), ()
