"""Conditioning of records before their motion is estimated: volts, offset, window, and pulses unlike the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, SingleArray
from hpe_rig.processing.echo.echoes import BLOCK_SAMPLES, EchoGate

if TYPE_CHECKING:
    from hpe_rig.store import GatedRecords

FOREIGN_LIMIT = 8.0
"""Robust standard deviations beyond which a pulse's logarithmic energy is foreign; and at least a factor of two."""


def codes_to_volts(codes: Int16Array, volts_per_code: float, volts_offset: float) -> FloatArray:
    """Return the records in volts, float64, with the shape of ``codes``."""
    return codes * np.float64(volts_per_code) + volts_offset


def centred_volts(codes: Int16Array, volts_per_code: float, sound: BoolArray, gate: slice = slice(None)) -> SingleArray:
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


@dataclass(frozen=True, slots=True)
class GateStatistics:
    """What each record holds in the gate, in codes: ``lowest``, ``highest``, ``mean`` and ``square``, its mean square.

    All (pulse,), of a missing record anything.
    """

    lowest: Int16Array
    highest: Int16Array
    mean: FloatArray
    square: FloatArray

    def at_full_scale(self, limits: tuple[int, int]) -> BoolArray:
        """Return which records (pulse,) reach the digitizer's full scale."""
        return np.asarray((self.lowest <= limits[0]) | (self.highest >= limits[1]))


def gate_statistics(records: GatedRecords) -> GateStatistics:
    """Return the statistics of every record of a shot, a block of pulses at a time."""
    pulses, samples = records.shape
    gate, step = slice(records.margin[0], samples - records.margin[1]), max(1, BLOCK_SAMPLES // samples)
    blocks = (records.block(slice(first, first + step))[:, gate] for first in range(0, pulses, step))
    return joined_statistics([statistics_of(codes) for codes in blocks])


def statistics_of(codes: Int16Array) -> GateStatistics:
    """Return the statistics of records in the gate, (pulse, sample)."""
    single = codes.astype(np.float32)
    # sums of integers below 2^24 are exact in single precision, those of squares are good to 1e-6
    mean = (single @ np.ones(single.shape[1], np.float32)).astype(np.float64) / single.shape[1]
    square = np.einsum("ij,ij->i", single, single).astype(np.float64) / single.shape[1]
    return GateStatistics(codes.min(axis=1), codes.max(axis=1), mean, square)


def joined_statistics(parts: Sequence[GateStatistics]) -> GateStatistics:
    """Return the statistics of all pulses from those of some after the other."""
    names = ("lowest", "highest", "mean", "square")
    return GateStatistics(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@final
class CodedVolts:
    """Volts of a shot's ``records`` without their offset, made from the codes when asked for: see `VoltsInBlocks`.

    ``pulses`` are those of the window, ``sound`` (pulse,) those in it that fix the offset, as in `centred_volts`.
    """

    def __init__(self, records: GatedRecords, pulses: slice, sound: BoolArray, found: GateStatistics) -> None:
        self._records, self._first = records, pulses.start
        self.shape = (sound.size, records.shape[1])
        self.ndim, self.dtype = 2, np.dtype(np.float32)
        mean = found.mean[pulses]
        self._offset = float(mean[sound].mean()) if sound.any() else 0.0
        count = records.shape[1] - sum(records.margin)
        square = found.square[pulses] + self._offset * (self._offset - 2 * mean)
        self.energy = np.asarray(count * records.volts_per_code**2 * np.maximum(square, 0.0))

    def block(self, pulses: slice) -> SingleArray:
        """Return the volts of some of the window's pulses, (pulse, sample)."""
        start, stop, _ = pulses.indices(self.shape[0])
        volts = self._records.block(slice(self._first + start, self._first + stop)).astype(np.float32)
        volts -= np.float32(self._offset)
        volts *= np.float32(self._records.volts_per_code)
        return volts

    def __getitem__(self, index: Any) -> SingleArray:
        """Return what an array of all volts would."""
        return np.asarray(self.block(slice(None))[index])


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
    middle = _median(level)
    spread = _median(np.abs(level - middle)) / 0.6745
    foreign = np.abs(level - middle) > np.maximum(FOREIGN_LIMIT * spread, np.log(2))
    flagged = np.zeros(echoes.valid.shape, dtype=bool)
    flagged[echoes.valid] = foreign.any(axis=tuple(range(foreign.ndim - 1)))
    return flagged


def _median(values: FloatArray) -> FloatArray:
    """Return the median along the last axis, of length 1 then; np.median would load NumPy's masked arrays."""
    lower, upper = (values.shape[-1] - 1) // 2, values.shape[-1] // 2
    parted = np.partition(values, [lower, upper], axis=-1)
    return np.asarray(parted[..., lower : upper + 1].mean(axis=-1, keepdims=True))
