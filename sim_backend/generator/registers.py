"""Registers of a 33250A, and the coercion of settings that do not fit.

The instrument clips or substitutes a number and queues an error; it never refuses one (docs/explanation/instruments.md,
1.6). Levels are stored as open-circuit voltages, so the declared load changes the displayed values alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from sim_backend.generator.models import AGILENT_33250A, Model

Error = tuple[int, str]

PEAK_V = 10.0
"""Largest open-circuit voltage: 5 V into 50 ohm (manual)."""
SMALLEST_VPP = 2e-3
"""Smallest open-circuit amplitude: 1 mVpp into 50 ohm (the limits of a driver, from the manual)."""
LEVEL_GAP_V = 1e-3
"""Smallest difference of high and low level, as displayed."""
EDGE_S = 5e-9
LOAD_LIMITS_OHM = (1.0, 10_000.0)

# Assumed: no source was found for these.
EDGE_FRACTION_OF_WIDTH = 0.625
EDGES_IN_PERIOD = 1.6
BURST_MARGIN_S = 200e-9

ROUNDING = 1e-12
"""Relative tolerance of a computed limit."""


@dataclass(frozen=True, slots=True)
class Registers:
    """All settings of one channel, with the model that limits them; the defaults are the power-on state.

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
    phase_deg: float = 0.0
    pulse_hold: str = "WIDT"
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
        """Duration of a burst; infinite for endless bursts."""
        return self.cycles / self.frequency_hz


def power_on(model: Model, beeper: bool = True) -> Registers:
    """Return the power-on state of ``model``; its edge time respects the model's limit."""
    return Registers(model, edge_s=max(EDGE_S, model.edge_limits_s[0]), beeper=beeper)


@dataclass(frozen=True, slots=True)
class Coerced:
    """Registers after a setting, which may have been clipped or have changed others, and the errors to queue."""

    registers: Registers
    errors: tuple[Error, ...] = ()

    def then(self, put: Callable[[Registers], Coerced]) -> Coerced:
        """Apply ``put`` to the registers, and append its errors."""
        after = put(self.registers)
        return Coerced(after.registers, self.errors + after.errors)

    def changed(self, conflict: str = "", **settings: object) -> Coerced:
        """Return the registers with ``settings``; ``conflict`` is the text of a settings conflict to queue."""
        errors = ((-221, f"Settings conflict; {conflict}"),) if conflict else ()
        return Coerced(replace(self.registers, **settings), self.errors + errors)  # type: ignore[arg-type]


def rounded(value: float, digits: int, decimals: int) -> float:
    """Return ``value`` rounded to the instrument's resolution (assumed: to the nearest).

    The resolution is ``digits`` significant digits, and at most ``decimals`` decimal places.
    """
    if not value or not math.isfinite(value):
        return value
    return round(value, min(decimals, digits - 1 - math.floor(math.log10(abs(value)))))


def clipped(value: float, low: float, high: float, quantity: str) -> tuple[float, tuple[Error, ...]]:
    """Return ``value`` clipped to the limits, and the error if it was outside."""
    if value > high + ROUNDING * abs(high):
        return high, ((-222, f"Data out of range; {quantity}; value clipped to upper limit"),)
    if value < low - ROUNDING * abs(low):
        return low, ((-222, f"Data out of range; {quantity}; value clipped to lower limit"),)
    return min(max(value, low), high), ()
