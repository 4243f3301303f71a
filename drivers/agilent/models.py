"""Models of the 33250A family, identified by ``*IDN?``: limits, channel number, headers of the pulse.

Sources. 33250A: docs/explanation/instruments.md, 1.4; its resolution: the manual (amplitude 0.1 mV or 4 digits,
frequency 1 uHz or 9 digits). 33500 series: its manual's burst and pulse pages (count, 6 MHz limit of counted sine
bursts, smallest width). Assumed: the 33600A has the same limit; offset and levels have the amplitude's resolution; from
memory of the data sheets, the siblings' sine and pulse rates, edges, delays and resolution, the 33220A's row, and the
accuracy of every clock (one year after adjustment, near 23 degrees Celsius). A series with several frequency options is
listed with the lowest one.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

Range = tuple[float, float]
LEVELS: Final = frozenset({"VOLT", "VOLT:OFFS", "VOLT:HIGH", "VOLT:LOW"})
CHANNEL_HEADERS: Final = {"OUTP:TRIG": "OUTP:TRIG", "OUTP:SYNC": "OUTP:SYNC", "OUTP": "OUTP1", "TRIG": "TRIG1"}


@dataclass(frozen=True, slots=True)
class Resolution:
    """Resolution of a setting: ``digits`` significant digits, but no finer than ``step``."""

    step: float
    digits: int

    def at(self, value: float) -> float:
        """Return the difference of neighbouring settings at ``value``."""
        decade = math.floor(math.log10(abs(value))) if value else -math.inf
        return max(self.step, 10.0 ** (decade - self.digits + 1))


# The digits of a double: only the step limits the number.
ALL_DIGITS: Final = 15
LEVEL_RESOLUTION: Final = Resolution(1e-4, 4)


@dataclass(frozen=True, slots=True)
class GeneratorModel:
    """One instrument type.

    ``sine_hz`` limits a continuous sine, ``burst_carrier_hz`` counted sine bursts; ``narrowest_s`` lists (period above
    which it applies, smallest width); ``edge_s`` is the fastest pulse edge; ``pattern`` matches the name in ``*IDN?``.
    ``clock_accuracy`` is the largest relative error of the internal time base.
    """

    name: str
    pattern: str
    sine_hz: Range
    pulse_rate_hz: Range
    burst_carrier_hz: Range
    cycles: tuple[int, int]
    delay_s: Range
    width_s: Range
    edge_s: float
    narrowest_s: tuple[Range, ...] = ()
    channel_number: bool = False
    pulse_node: str = "PULS"
    period_node: str = "PULS"
    frequency_resolution: Resolution = Resolution(1e-6, ALL_DIGITS)
    clock_accuracy: float = 2e-6

    def header(self, header: str) -> str:
        """Return this model's header for a header of the 33250A."""
        node = self.period_node if header == "PULS:PER" else self.pulse_node
        spelled = header.replace("PULS:", f"{node}:", 1)
        if not self.channel_number:
            return spelled
        for start, numbered in CHANNEL_HEADERS.items():
            if spelled == start or spelled.startswith(f"{start}:"):
                return numbered + spelled[len(start) :]
        return f"SOUR1:{spelled}"

    def resolution(self, header: str, value: float) -> float:
        """Return the resolution of a number under a header of the 33250A; 0 if it is not rounded."""
        if header == "FREQ":
            return self.frequency_resolution.at(value)
        return LEVEL_RESOLUTION.at(value) if header in LEVELS else 0.0

    def shortest_period_s(self, rate_hz: float) -> float:
        """Return the shortest period of a rate: that of the rate rounded up to the resolution."""
        step_hz = self.resolution("FREQ", rate_hz)
        return 1 / max(rate_hz, step_hz * math.ceil(rate_hz / step_hz * (1 - 1e-12)))

    def min_width_s(self, period_s: float) -> float:
        """Return the narrowest pulse at a period."""
        return next((width for above_s, width in self.narrowest_s if period_s > above_s), self.width_s[0])


# fmt: off
AGILENT_33250A: Final = GeneratorModel(
    name="33250A", pattern=r"33250A",
    # Above 25 MHz the instrument has infinite bursts alone, which the bench does not use.
    sine_hz=(1e-6, 80e6), pulse_rate_hz=(500e-6, 50e6), burst_carrier_hz=(1e-6, 25e6),
    cycles=(1, 1_000_000), delay_s=(0.0, 85.0), width_s=(8e-9, 2000.0), edge_s=5e-9,
    # Known: the smallest width grows with the period. Assumed: the numbers.
    narrowest_s=((200.0, 2e-6), (20.0, 200e-9)), frequency_resolution=Resolution(1e-6, 9),
)
MODELS: Final = (
    AGILENT_33250A,
    GeneratorModel(
        name="33220A", pattern=r"33220A", pulse_node="FUNC:PULS",
        sine_hz=(1e-6, 20e6), pulse_rate_hz=(500e-6, 5e6), burst_carrier_hz=(1e-6, 6e6),
        cycles=(1, 50_000), delay_s=(0.0, 85.0), width_s=(20e-9, 2000.0), edge_s=5e-9,
        narrowest_s=((100.0, 2e-6), (10.0, 200e-9)), clock_accuracy=20e-6,
    ),
    GeneratorModel(
        name="33500B", pattern=r"335\d\d[AB]", pulse_node="FUNC:PULS", period_node="FUNC:PULS", channel_number=True,
        sine_hz=(1e-6, 20e6), pulse_rate_hz=(1e-6, 20e6), burst_carrier_hz=(1e-6, 6e6),
        cycles=(1, 100_000_000), delay_s=(0.0, 1000.0), width_s=(16e-9, 1e6), edge_s=8.4e-9, clock_accuracy=1e-6,
    ),
    GeneratorModel(
        name="33600A", pattern=r"336\d\dA", pulse_node="FUNC:PULS", period_node="FUNC:PULS", channel_number=True,
        sine_hz=(1e-6, 80e6), pulse_rate_hz=(1e-6, 80e6), burst_carrier_hz=(1e-6, 6e6),
        cycles=(1, 100_000_000), delay_s=(0.0, 1000.0), width_s=(5e-9, 1e6), edge_s=2.9e-9, clock_accuracy=1e-6,
    ),
)
# fmt: on
MODEL_NAMES: Final = tuple(model.name for model in MODELS)


def model_named(name: str) -> GeneratorModel | None:
    """Return the model of ``name``, the second field of ``*IDN?``; None for an unknown instrument."""
    return next((model for model in MODELS if re.fullmatch(model.pattern, name.strip().upper())), None)
