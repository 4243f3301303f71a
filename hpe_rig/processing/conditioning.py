"""Codes to volts, offset, gate and window: what happens to a record before its motion is estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def codes_to_volts(codes: NDArray[np.int16], volts_per_code: float, volts_offset: float) -> FloatArray:
    """Return the records in volts, float64, with the shape of ``codes``."""
    return codes * np.float64(volts_per_code) + volts_offset


def remove_offset(volts: FloatArray) -> FloatArray:
    """Return the records (..., pulse, sample) without the mean over their pulses and samples.

    One number for all pulses: a mean of each record would add its noise to that record, and a mean over pulses at
    each sample would remove the resting echo, which is what carries the phase.
    """
    return np.asarray(volts - volts.mean(axis=(-2, -1), keepdims=True))


def hann(count: int) -> FloatArray:
    """Return a Hann window (count,) sampled at the middle of its intervals: symmetric, with a mean of exactly 1/2."""
    return np.asarray(np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2)
