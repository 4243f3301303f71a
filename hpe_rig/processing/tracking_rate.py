"""Rate of the tracking train by the digitizer's clock, from the trigger times of a shot.

    t_k = offset + k / (r (1 + e))

    t_k  trigger time of pulse k
    r    nominal pulse rate
    e    relative error of the rate, fitted by least squares

Both clocks contribute: e is the rate error of the train minus that of the digitizer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from hpe_rig.arrays import FloatArray

if TYPE_CHECKING:
    from hpe_rig.store import Placement

MIN_TIMES: Final = 10
"""Number of trigger times below which no rate is measured."""
MAX_STEP_SAMPLES: Final = 16
"""Largest step of the counter of trigger times, in samples (assumed: boards count 1 to 16)."""


@dataclass(frozen=True, slots=True)
class TrackingRate:
    """Relative error of the tracking train's rate by the digitizer's clock, and its standard uncertainty."""

    error: float
    uncertainty: float


def measured_rate(
    trigger_time_s: FloatArray, placement: Placement, rate_hz: float, sample_rate_hz: float
) -> TrackingRate | None:
    """Return the error of the pulse rate from the trigger times of the records, (record,), NaN if unknown.

    ``placement``: pulse of each record. None with too few times, and where the counter of trigger times or the number
    of pulses between two records is not certain.
    """
    timed = (placement.pulse >= 0) & np.isfinite(trigger_time_s)
    if timed.sum() < MIN_TIMES or placement.remarks or placement.loose[timed].any():
        return None
    time_s, pulse = trigger_time_s[timed], placement.pulse[timed]
    time_s = time_s - time_s[0]
    # Least squares of time against pulse number.
    centred_s, centred_pulse = time_s - time_s.mean(), pulse - pulse.mean()
    energy = float(centred_pulse @ centred_pulse)
    period_s = float(centred_pulse @ centred_s) / energy
    residual_s = centred_s - period_s * centred_pulse
    noise_s = math.sqrt(float(residual_s @ residual_s) / (time_s.size - 2) / energy)
    # Rounding to the counter's step q may drift through a train of length T: at most 1.5 q/T of the slope, uniform.
    counts = np.rint(time_s * sample_rate_hz).astype(np.int64)
    step = min(int(np.gcd.reduce(counts)), MAX_STEP_SAMPLES)
    rounding = 1.5 / math.sqrt(3) * step / sample_rate_hz / float(time_s[-1])
    return TrackingRate(1 / (period_s * rate_hz) - 1, math.hypot(noise_s / period_s, rounding))
