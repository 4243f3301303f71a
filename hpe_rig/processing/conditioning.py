"""Conditioning of records before their motion is estimated: volts, offset, window, and pulses unlike the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.echoes import BoolArray, EchoGate, FloatArray

FOREIGN_LIMIT = 8.0
"""Robust standard deviations beyond which a pulse's logarithmic energy is foreign; and at least a factor of two."""


def codes_to_volts(codes: NDArray[np.int16], volts_per_code: float, volts_offset: float) -> FloatArray:
    """Return the records in volts, float64, with the shape of ``codes``."""
    return codes * np.float64(volts_per_code) + volts_offset


def centred_volts(
    codes: NDArray[np.int16], volts_per_code: float, sound: NDArray[np.bool_], gate: slice = slice(None)
) -> NDArray[np.float32]:
    """Return the records (pulse, sample) in volts without their offset, float32: 1/1000 of a code step is lost.

    The offset is the mean of the ``sound`` records (pulse,) in the ``gate``, those that are there and within full scale
    there: one number for all, since a mean of each record would add its noise to that record, and a mean over pulses at
    each sample would remove the resting echo, which is what carries the phase. Without any sound record nothing is
    taken off.
    """
    volts = codes.astype(np.float32)
    if sound.any():
        gated = volts[:, gate]
        volts -= (gated @ np.full(gated.shape[-1], 1 / gated.shape[-1], np.float32))[sound].mean()
    volts *= np.float32(volts_per_code)
    return volts


def hann(count: int) -> FloatArray:
    """Return a Hann window (count,) sampled at the middle of its intervals: symmetric, with a mean of exactly 1/2."""
    return np.asarray(np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2)


def unlike_pulses(echoes: EchoGate) -> BoolArray:
    """Return which valid pulses (pulse,) hold an energy unlike the others' in any realisation.

    They hold leaked tonebursts, spikes, or are dropped or clipped. The energy is that of the whole gate, so that what
    leaks outside the tracked band is seen as well; one echo's energy changes little with its motion. Half of the pulses
    must be sound.
    """
    level = np.log(np.maximum(echoes.energy[..., echoes.valid], np.finfo(np.float64).tiny))
    middle = np.median(level, axis=-1, keepdims=True)
    spread = np.median(np.abs(level - middle), axis=-1, keepdims=True) / 0.6745
    foreign = np.abs(level - middle) > np.maximum(FOREIGN_LIMIT * spread, np.log(2))
    flagged = np.zeros(echoes.valid.shape, dtype=bool)
    flagged[echoes.valid] = foreign.any(axis=tuple(range(foreign.ndim - 1)))
    return flagged


def clipped_pulses(codes: NDArray[np.int16], limits: tuple[int, int]) -> BoolArray:
    """Return which records (..., pulse) of ``codes`` (..., pulse, sample) reach the digitizer's full scale."""
    return np.asarray((codes.min(axis=-1) <= limits[0]) | (codes.max(axis=-1) >= limits[1]))
