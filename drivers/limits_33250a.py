"""What a 33250A cannot do, found before anything is sent (limits: Agilent 33250A specifications and command table)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from drivers.interfaces import InstrumentError, PulseTrain, Toneburst, TriggerPulse

EDGE_S: Final = 5e-9
PULSE_RATE_HZ: Final = (500e-6, 50e6)
# Above 25 MHz the instrument does infinite bursts only, and those are never wanted here.
BURST_CARRIER_HZ: Final = (1e-6, 25e6)
CYCLES: Final = (1, 1_000_000)
DELAY_S: Final = (0.0, 85.0)
WIDTH_S: Final = (8e-9, 2000.0)
LOAD_OHM: Final = (1.0, 10_000.0)
SOURCE_OHM: Final = 50.0
OPEN_CIRCUIT_PEAK_V: Final = 10.0
OPEN_CIRCUIT_LEAST_VPP: Final = 2e-3
# A pulse's edges take 1.6 edge times off the period (reference 1.4).
EDGE_SHARE: Final = 1.6
# The narrowest pulse grows with the period: (period above which it holds, narrowest width).
NARROWEST_S: Final = ((200.0, 2e-6), (20.0, 200e-9))


def refuse(role: str, mistakes: Sequence[str]) -> None:
    """Raise one ``InstrumentError`` with all of ``mistakes``; nothing when there are none."""
    if mistakes:
        why = "the 33250A cannot do this, and nothing was sent to it"
        raise InstrumentError(role, "; ".join(mistakes), why, "change the value in the scene or bench file")


def trigger_pulse_mistakes(pulse: TriggerPulse) -> list[str]:
    """Return what a 33250A cannot do of ``pulse``."""
    return [*_outside("width_s", pulse.width_s, WIDTH_S[0], WIDTH_S[1] / 2), *_level(pulse.high_v, pulse.load_ohm)]


def pulse_train_mistakes(train: PulseTrain) -> list[str]:
    """Return what a 33250A cannot do of ``train``."""
    rate = _outside("rate_hz", train.rate_hz, *PULSE_RATE_HZ)
    return [
        *rate,
        *([] if rate else _width(train.width_s, 1.0 / train.rate_hz)),
        *_outside("count", train.count, *CYCLES),
        *_outside("delay_s", train.delay_s, *DELAY_S),
        *_level(train.high_v, train.load_ohm),
    ]


def toneburst_mistakes(burst: Toneburst) -> list[str]:
    """Return what a 33250A cannot do of ``burst``."""
    load = _load(burst.load_ohm)
    lowest, highest = OPEN_CIRCUIT_LEAST_VPP, 2 * OPEN_CIRCUIT_PEAK_V
    share = 1.0 if load else share_at_load(burst.load_ohm)
    return [
        *_outside("carrier_hz", burst.carrier_hz, *BURST_CARRIER_HZ),
        *_outside("cycles", burst.cycles, *CYCLES),
        *_outside("delay_s", burst.delay_s, *DELAY_S),
        *load,
        *([] if load else _outside("amplitude_vpp", burst.amplitude_vpp, lowest * share, highest * share)),
    ]


def share_at_load(load_ohm: float) -> float:
    """Return the part of the open-circuit voltage that a load sees behind the 50 ohm source."""
    return 1.0 / (1.0 + SOURCE_OHM / load_ohm)


def _width(width_s: float, period_s: float) -> list[str]:
    narrowest = next((width for above_s, width in NARROWEST_S if period_s > above_s), WIDTH_S[0])
    widest = min(WIDTH_S[1], period_s - EDGE_SHARE * EDGE_S)
    return _outside("width_s", width_s, narrowest, widest, f" at a period of {period_s:.6g} s")


def _level(high_v: float, load_ohm: float) -> list[str]:
    load = _load(load_ohm)
    if load:
        return load
    share = share_at_load(load_ohm)
    where = f" into {load_ohm:g} ohm"
    return _outside("high_v", high_v, OPEN_CIRCUIT_LEAST_VPP * share, OPEN_CIRCUIT_PEAK_V * share, where)


def _load(load_ohm: float) -> list[str]:
    return [] if load_ohm == float("inf") else _outside("load_ohm", load_ohm, *LOAD_OHM, " (or inf)")


def _outside(name: str, value: float, lowest: float, highest: float, where: str = "") -> list[str]:
    # Written so that a nan is outside as well.
    if lowest <= value <= highest:
        return []
    return [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}{where}"]
