"""Conversion of I and Q to real samples around the carrier: interpolate, mix up, take the real part.

    r(t) = Re[ (I(t) + j Q(t)) exp(2 pi j f_d t) ],    f_d the demodulation frequency

The phase of the mixer is unknown. It is constant, so it does not affect the estimated motion.

Interpolation leaves images of the band at multiples of the sampling rate. Mixed up, one of them can lie at the negative
carrier, and the real part adds it to the echoes. So the filter suppresses images by 100 dB.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import SingleArray

MIN_SAMPLES_PER_PERIOD = 4.0
"""Samples per period of the highest frequency in the band, after interpolation."""
BAND_END = 1.5
"""Upper end of the band that the estimators use, in units of the carrier."""
FILTER_SAMPLES = 32
"""Half the length of the interpolation filter in input samples: its band ends at 0.45 of their rate."""
IMAGE_DB = 100.0
"""Suppression of the images."""


def to_radio_frequency(
    values: NDArray[np.complexfloating[Any, Any]], rate_hz: float, demodulation_hz: float, carrier_hz: float
) -> tuple[SingleArray, float]:
    """Return real samples (..., sample) of complex ``values`` (..., sample), and their rate.

    The rate is the smallest integer multiple of ``rate_hz`` that samples the band twice as fast as needed.
    """
    from scipy.signal import firwin, kaiser_beta, resample_poly

    # The band of the carrier and that of I and Q around the demodulation frequency must both fit.
    highest_hz = max(BAND_END * carrier_hz, demodulation_hz + rate_hz / 2)
    factor = max(1, math.ceil(MIN_SAMPLES_PER_PERIOD * highest_hz / rate_hz / 2))
    interpolated = values
    if factor > 1:
        taps: Any = firwin(2 * FILTER_SAMPLES * factor + 1, 1 / factor, window=("kaiser", kaiser_beta(IMAGE_DB)))
        interpolated = resample_poly(values, factor, 1, axis=-1, window=taps)
    output_hz = rate_hz * factor
    # Mix up: multiply by exp(2 pi j f_d t).
    carrier = np.exp(2j * np.pi * demodulation_hz / output_hz * np.arange(interpolated.shape[-1]))
    return np.asarray((interpolated * carrier).real, np.float32), output_hz
