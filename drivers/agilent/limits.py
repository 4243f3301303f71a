"""What a 33250A or a sibling cannot do, found before a setting is sent (limits: ``generator_models``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from drivers.agilent.models import AGILENT_33250A, GeneratorModel
from drivers.interfaces import InstrumentError, PulseTrain, Toneburst, TriggerPulse

LOAD_OHM: Final = (1.0, 10_000.0)
SOURCE_OHM: Final = 50.0
OPEN_CIRCUIT_PEAK_V: Final = 10.0
OPEN_CIRCUIT_LEAST_VPP: Final = 2e-3
# A pulse's edges take 1.6 edge times off the period (reference 1.4).
EDGE_SHARE: Final = 1.6


def refuse(role: str, model: GeneratorModel, mistakes: Sequence[str]) -> None:
    """Raise one ``InstrumentError`` with all of ``mistakes``; nothing when there are none."""
    if mistakes:
        why = f"the {model.name} or what it is wired to cannot take this, and no setting was sent"
        raise InstrumentError(role, "; ".join(mistakes), why, "change the value in the scene or bench file")


def trigger_pulse_mistakes(pulse: TriggerPulse, model: GeneratorModel = AGILENT_33250A) -> list[str]:
    """Return what ``model`` cannot do of ``pulse``."""
    width = _outside("width_s", pulse.width_s, model.width_s[0], model.width_s[1] / 2)
    return [*width, *_level(pulse.high_v, pulse.load_ohm)]


def pulse_train_mistakes(train: PulseTrain, model: GeneratorModel = AGILENT_33250A) -> list[str]:
    """Return what ``model`` cannot do of ``train``."""
    rate = _outside("rate_hz", train.rate_hz, *model.pulse_rate_hz)
    return [
        *rate,
        *([] if rate else _width(train.width_s, 1.0 / train.rate_hz, model)),
        *_outside("count", train.count, *model.cycles),
        *_outside("delay_s", train.delay_s, *model.delay_s),
        *_level(train.high_v, train.load_ohm),
    ]


def toneburst_mistakes(burst: Toneburst, model: GeneratorModel = AGILENT_33250A) -> list[str]:
    """Return what ``model`` cannot do of ``burst``."""
    load = _load(burst.load_ohm)
    lowest, highest = OPEN_CIRCUIT_LEAST_VPP, 2 * OPEN_CIRCUIT_PEAK_V
    share = 1.0 if load else share_at_load(burst.load_ohm)
    return [
        *_outside("carrier_hz", burst.carrier_hz, *model.burst_carrier_hz, f" for counted bursts of a {model.name}"),
        *_outside("cycles", burst.cycles, *model.cycles),
        *_outside("delay_s", burst.delay_s, *model.delay_s),
        *load,
        *([] if load else _outside("amplitude_vpp", burst.amplitude_vpp, lowest * share, highest * share)),
    ]


def wiring_mistakes(name: str, swing_v: float, max_vpp: float) -> list[str]:
    """Return whether a swing is more than the bench file allows at this output."""
    if swing_v <= max_vpp:
        return []
    return [f"{name} = {swing_v:.10g} is above max_vpp = {max_vpp:.10g}, what the bench file allows at this output"]


def share_at_load(load_ohm: float) -> float:
    """Return the part of the open-circuit voltage that a load sees behind the 50 ohm source."""
    return 1.0 / (1.0 + SOURCE_OHM / load_ohm)


def _width(width_s: float, period_s: float, model: GeneratorModel) -> list[str]:
    # The gap between two pulses must hold both edges, and is itself no narrower than a pulse.
    gap_s = max(EDGE_SHARE * model.edge_s, model.width_s[0])
    widest = min(model.width_s[1], period_s - gap_s)
    return _outside("width_s", width_s, model.least_width_s(period_s), widest, f" at a period of {period_s:.6g} s")


def _level(high_v: float, load_ohm: float) -> list[str]:
    load = _load(load_ohm)
    if load:
        return load
    share = share_at_load(load_ohm)
    where = f" into {load_ohm:g} ohm"
    return _outside("high_v", high_v, OPEN_CIRCUIT_LEAST_VPP * share, OPEN_CIRCUIT_PEAK_V * share, where)


def _load(load_ohm: float) -> list[str]:
    return [] if load_ohm == math.inf else _outside("load_ohm", load_ohm, *LOAD_OHM, " (or inf)")


def _outside(name: str, value: float, lowest: float, highest: float, where: str = "") -> list[str]:
    # Written so that a nan is outside as well.
    if lowest <= value <= highest:
        return []
    return [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}{where}"]
