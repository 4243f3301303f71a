"""Codes to volts, offset, gate and window: what happens to a record before its motion is estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def codes_to_volts(codes: NDArray[np.int16], volts_per_code: float, volts_offset: float) -> FloatArray:
    """Return the records in volts, float64, with the shape of ``codes``."""
    return codes * np.float64(volts_per_code) + volts_offset


def centred_volts(codes: NDArray[np.int16], volts_per_code: float, sound: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the records (pulse, sample) in volts without their offset, float32: 1/1000 of a code step is lost.

    The offset is the mean of the ``sound`` records (pulse,), those that are there and within full scale: one number for
    all, since a mean of each record would add its noise to that record, and a mean over pulses at each sample would
    remove the resting echo, which is what carries the phase. Without any sound record nothing is taken off.
    """
    volts = codes.astype(np.float32)
    if sound.any():
        volts -= (volts @ np.full(codes.shape[-1], 1 / codes.shape[-1], np.float32))[sound].mean()
    volts *= np.float32(volts_per_code)
    return volts


def hann(count: int) -> FloatArray:
    """Return a Hann window (count,) sampled at the middle of its intervals: symmetric, with a mean of exactly 1/2."""
    return np.asarray(np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2)
