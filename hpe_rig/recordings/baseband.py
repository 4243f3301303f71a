"""I and Q back to samples around the carrier: interpolated, mixed up, the real part taken.

    r(t) = Re[ (I(t) + j Q(t)) exp(2 pi j f_d t) ],    f_d the demodulation frequency

A constant phase of the mixer turns every pulse alike and tells nothing of motion, so that its zero does not matter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import SingleArray

LEAST_RATE = 4.0
"""Samples a period of the highest frequency in the band, after interpolation."""
BAND_END = 1.5
"""Upper end of the band that the estimators look at, in units of the carrier."""


def to_radio_frequency(
    values: NDArray[np.complexfloating[Any, Any]], rate_hz: float, demodulation_hz: float, carrier_hz: float
) -> tuple[SingleArray, float]:
    """Return real samples (..., sample) of complex ``values`` (..., sample), and their rate.

    The rate is the smallest whole multiple of ``rate_hz`` that holds the band of the carrier twice over.
    """
    from scipy.signal import resample_poly

    highest_hz = max(BAND_END * carrier_hz, demodulation_hz + rate_hz / 2)
    factor = max(1, math.ceil(LEAST_RATE * highest_hz / rate_hz / 2))
    finer = values if factor == 1 else resample_poly(values, factor, 1, axis=-1)
    out_hz = rate_hz * factor
    carrier = np.exp(2j * np.pi * demodulation_hz / out_hz * np.arange(finer.shape[-1]))
    return np.asarray((finer * carrier).real, np.float32), out_hz
