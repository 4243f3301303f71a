"""Models of the simulated 33250A family: identity, limits, channels.

Provenance: 33250A from docs/explanation/instruments.md, 1.4; a sibling's burst ceiling, cycles, burst period and pulse
widths from its manual's burst and pulse pages, its frequency ranges, edge times and resolution from its data sheet as
remembered (assumed).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Model:
    """One instrument type; ``min_width_by_period_s``: (period above which it applies, smallest width)."""

    name: str
    identity: str
    frequency_limits_hz: Mapping[str, Range]
    finite_burst_ceiling_hz: float
    max_cycles: int
    width_limits_s: Range
    edge_limits_s: Range
    burst_period_limits_s: Range
    delay_limits_s: Range
    min_width_by_period_s: tuple[Range, ...] = ()
    channels: int = 0
    """Channels that a header may number; 0 if headers carry no number."""
    functions: str = "SINusoid SQUare RAMP PULSe NOISe DC USER"
    duty_steps: tuple[tuple[float, float, float], ...] = ()
    """(frequency above which it applies, smallest duty cycle, largest), from the highest frequency down."""
    frequency_digits: int = 15
    frequency_decimals: int = 6
    amplitude_digits: int = 4
    amplitude_decimals: int = 6
    """Resolution of displayed values: significant digits, and decimal places at most."""
    short_period_error: int = -221
    """Error of a period too short for the pulse."""


def _frequencies(sine_hz: float, ramp_hz: float, pulse: Range, arbitrary_hz: float) -> Mapping[str, Range]:
    """Return the frequency range of every function of a model, Hz.

    Functions share the upper limit of the sine or of the ramp; pulse and arbitrary waveforms have their own.
    """
    lowest = 1e-6
    ranges = dict.fromkeys(("SIN", "SQU", "NOIS", "DC"), (lowest, sine_hz))
    ramps = dict.fromkeys(("RAMP", "TRI"), (lowest, ramp_hz))
    return {**ranges, **ramps, "PULS": pulse, "USER": (lowest, arbitrary_hz)}


SERIES_FUNCTIONS = "SINusoid SQUare TRIangle RAMP PULSe PRBS NOISe ARBitrary DC"

# fmt: off
AGILENT_33250A = Model(
    name="33250A", identity="Agilent Technologies,33250A,0,2.01-1.01-2.00-03-2",
    frequency_limits_hz=_frequencies(80e6, 1e6, (500e-6, 50e6), 25e6),
    finite_burst_ceiling_hz=25e6, max_cycles=1_000_000, burst_period_limits_s=(1e-6, 500.0),
    width_limits_s=(8e-9, 2000.0), edge_limits_s=(5e-9, 1e-3), delay_limits_s=(0.0, 85.0),
    # Known: the narrowest pulse grows with the period. Assumed: the numbers.
    min_width_by_period_s=((200.0, 2e-6), (20.0, 200e-9)),
    duty_steps=((50e6, 50.0, 50.0), (25e6, 40.0, 60.0), (0.0, 20.0, 80.0)), short_period_error=-222,
    # 1 uHz or 9 digits, 0.1 mV or 4 digits (manual).
    frequency_digits=9, amplitude_decimals=4,
)
AGILENT_33220A = Model(
    name="33220A", identity="Agilent Technologies,33220A,MY44000001,2.02-2.02-22-2",
    frequency_limits_hz=_frequencies(20e6, 200e3, (500e-6, 5e6), 6e6),
    finite_burst_ceiling_hz=6e6, max_cycles=50_000, burst_period_limits_s=(1e-6, 500.0),
    width_limits_s=(20e-9, 2000.0), edge_limits_s=(5e-9, 100e-9), delay_limits_s=(0.0, 85.0),
    min_width_by_period_s=((100.0, 2e-6), (10.0, 200e-9)), duty_steps=((10e6, 40.0, 60.0), (0.0, 20.0, 80.0)),
)
AGILENT_33500B = Model(
    name="33522B", identity="Agilent Technologies,33522B,MY52000001,3.03-1.19-2.00-52-00",
    channels=2, functions=SERIES_FUNCTIONS,
    frequency_limits_hz=_frequencies(30e6, 200e3, (1e-6, 30e6), 30e6),
    finite_burst_ceiling_hz=6e6, max_cycles=100_000_000, burst_period_limits_s=(1e-6, 8000.0),
    width_limits_s=(16e-9, 1e6), edge_limits_s=(8.4e-9, 1e-6), delay_limits_s=(0.0, 1000.0),
)
KEYSIGHT_33600A = Model(
    name="33622A", identity="Keysight Technologies,33622A,MY53000001,A.02.03-3.15-03-64-02",
    channels=2, functions=SERIES_FUNCTIONS,
    frequency_limits_hz=_frequencies(120e6, 800e3, (1e-6, 100e6), 120e6),
    finite_burst_ceiling_hz=6e6, max_cycles=100_000_000, burst_period_limits_s=(1e-6, 8000.0),
    width_limits_s=(5e-9, 1e6), edge_limits_s=(2.9e-9, 1e-6), delay_limits_s=(0.0, 1000.0),
)
MODELS: Mapping[str, Model] = {
    "33250A": AGILENT_33250A, "33220A": AGILENT_33220A, "33500B": AGILENT_33500B, "33600A": KEYSIGHT_33600A,
}
# fmt: on
"""By the name of model or series in the bench file."""


def with_serial(model: Model, serial: str) -> Model:
    """Return ``model`` with another serial number; the 33250A's stays 0, as it reports none."""
    vendor, name, own_serial, firmware = model.identity.split(",")
    return replace(model, identity=",".join((vendor, name, serial if own_serial != "0" else "0", firmware)))
