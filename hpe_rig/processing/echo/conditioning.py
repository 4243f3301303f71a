"""Conditioning of records before motion is estimated: volts, offset, window, and pulses with deviating energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, SingleArray
from hpe_rig.processing.echo.gate import BLOCK_SAMPLES, EchoGate

if TYPE_CHECKING:
    from hpe_rig.store import GatedRecords

MAX_ENERGY_DEVIATION = 8.0
"""Robust standard deviations of the logarithmic energy beyond which a pulse deviates; always at least a factor of 2."""


@dataclass(frozen=True, slots=True)
class GateStatistics:
    """Statistics of each record's codes in the gate, (pulse,); undefined for a missing record."""

    lowest: Int16Array
    highest: Int16Array
    mean: FloatArray
    mean_square: FloatArray

    def at_full_scale(self, limits: tuple[int, int]) -> BoolArray:
        """Return which records (pulse,) reach the digitizer's full scale."""
        return np.asarray((self.lowest <= limits[0]) | (self.highest >= limits[1]))


def gate_statistics(records: GatedRecords) -> GateStatistics:
    """Return lowest, highest, mean and mean square code in the gate of every record of a shot, block by block."""
    pulses, samples = records.shape
    gate, step = slice(records.margin[0], samples - records.margin[1]), max(1, BLOCK_SAMPLES // samples)
    blocks = (records.block(slice(first, first + step))[:, gate] for first in range(0, pulses, step))
    return concatenate_statistics([code_statistics(codes) for codes in blocks])


def code_statistics(codes: Int16Array) -> GateStatistics:
    """Return lowest, highest, mean and mean square of each record's ``codes`` (pulse, sample)."""
    single = codes.astype(np.float32)
    # Sums of integers below 2^24 are exact in single precision; sums of squares are accurate to 1e-6.
    mean = (single @ np.ones(single.shape[1], np.float32)).astype(np.float64) / single.shape[1]
    mean_square = np.einsum("ij,ij->i", single, single).astype(np.float64) / single.shape[1]
    return GateStatistics(lowest=codes.min(axis=1), highest=codes.max(axis=1), mean=mean, mean_square=mean_square)


def concatenate_statistics(blocks: Sequence[GateStatistics]) -> GateStatistics:
    """Return the statistics of all pulses from those of consecutive blocks."""
    names = ("lowest", "highest", "mean", "mean_square")
    return GateStatistics(*(np.concatenate([getattr(block, name) for block in blocks]) for name in names))


@final
class CodedVolts:
    """Volts of a shot's ``records`` without their offset, converted from codes on demand: see `gate.BlockedVolts`.

    ``pulses`` are the pulses of the window. The offset is the mean in the gate over the ``usable`` records (pulse,),
    those present and within full scale. It is one number for all: the mean of a record would add its noise to that
    record, and a mean over pulses at each sample would remove the resting echo, which carries the phase. Without a
    usable record no offset is removed.
    """

    def __init__(self, records: GatedRecords, pulses: slice, usable: BoolArray, statistics: GateStatistics) -> None:
        """Prepare the conversion of codes to volts: offset and energy, from the ``statistics`` of the gate's codes."""
        self._records, self._first = records, pulses.start
        self.shape = (usable.size, records.shape[1])
        self.ndim, self.dtype = 2, np.dtype(np.float32)
        mean = statistics.mean[pulses]
        self._offset = float(mean[usable].mean()) if usable.any() else 0.0
        gate_samples = records.shape[1] - sum(records.margin)
        # mean of (code - offset)²
        square = statistics.mean_square[pulses] + self._offset * (self._offset - 2 * mean)
        self.energy = np.asarray(gate_samples * records.volts_per_code**2 * np.maximum(square, 0.0))

    def block(self, pulses: slice) -> SingleArray:
        """Return the volts (pulse, sample) of a block of the window's ``pulses``, without offset."""
        start, stop, _ = pulses.indices(self.shape[0])
        volts = self._records.block(slice(self._first + start, self._first + stop)).astype(np.float32)
        volts -= np.float32(self._offset)
        volts *= np.float32(self._records.volts_per_code)
        return volts

    def __getitem__(self, index: Any) -> SingleArray:
        """Return volts at an index of the whole array (pulse, sample)."""
        return np.asarray(self.block(slice(None))[index])


def hann(count: int) -> FloatArray:
    """Return a Hann window (count,) sampled at the middle of its intervals: symmetric, with a mean of exactly 1/2."""
    return np.asarray(np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2)


def deviating_levels(log_energy: FloatArray) -> BoolArray:
    """Return which of the logarithmic energies (..., pulse) are unlike the others of their realisation.

    Unlike: farther from the median than ``MAX_ENERGY_DEVIATION`` standard deviations, and than a factor of two.
    """
    deviation = np.abs(log_energy - np.median(log_energy, axis=-1, keepdims=True))
    # For a normal distribution the median absolute deviation is 0.6745 standard deviations.
    standard_deviation = np.median(deviation, axis=-1, keepdims=True) / 0.6745
    return np.asarray(deviation > np.maximum(MAX_ENERGY_DEVIATION * standard_deviation, np.log(2)))


def deviating_pulses(echoes: EchoGate) -> BoolArray:
    """Return which valid pulses (pulse,) have an energy unlike the others', in at least one realisation.

    Causes are leaked tonebursts, spikes, and dropped or clipped records. The energy is that of the whole gate, so that
    leakage outside the tracked band counts too; motion hardly changes it. At least half of the pulses must be intact.
    """
    deviates = deviating_levels(np.log(np.maximum(echoes.energy[..., echoes.valid], np.finfo(np.float64).tiny)))
    pulses = np.zeros(echoes.valid.shape, dtype=bool)
    pulses[echoes.valid] = deviates.any(axis=tuple(range(deviates.ndim - 1)))
    return pulses
