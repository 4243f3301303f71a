"""Codes to volts, offset, gate and window: what happens to a record before its motion is estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def codes_to_volts(codes: NDArray[np.int16], volts_per_code: float, volts_offset: float) -> FloatArray:
    """Return the records in volts, float64, with the shape of ``codes``."""
    return codes * np.float64(volts_per_code) + volts_offset


def gate_slice(
    record_start_s: float,
    record_samples: int,
    sample_rate_hz: float,
    gate_depth_m: float,
    gate_length_m: float,
    sound_speed_m_per_s: float,
) -> slice:
    """Return the samples of a record that lie in the gate.

    ``record_start_s`` is the time of sample 0 after the tracking pulse was fired. Raises ``ValueError`` when the
    record does not hold the whole gate.
    """
    start_s = 2 * (gate_depth_m - gate_length_m / 2) / sound_speed_m_per_s
    start = round((start_s - record_start_s) * sample_rate_hz)
    samples = round(2 * gate_length_m / sound_speed_m_per_s * sample_rate_hz)
    if samples < 1 or start < 0 or start + samples > record_samples:
        raise ValueError(
            f"the gate covers samples {start} to {start + samples} of a record of {record_samples} samples: "
            "the record is misplaced or too short; try a longer record, a shorter gate or another trigger delay"
        )
    return slice(start, start + samples)


def remove_offset(volts: FloatArray) -> FloatArray:
    """Return the records (..., pulse, sample) without the mean over their pulses and samples.

    One number for all pulses: a mean of each record would add its noise to that record, and a mean over pulses at
    each sample would remove the resting echo, which is what carries the phase.
    """
    return np.asarray(volts - volts.mean(axis=(-2, -1), keepdims=True))


def hann(count: int) -> FloatArray:
    """Return a Hann window (count,) sampled at the middle of its intervals: symmetric, with a mean of exactly 1/2."""
    return np.asarray(np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2)
