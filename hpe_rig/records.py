"""One shot's codes with their axes; what did not arrive is marked as missing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import RecordBlock
from hpe_rig.plan import Shot

MISSING = np.int16(-32768)
"""Code of a sample that was never recorded; no 14-bit code reaches it."""


@dataclass(frozen=True, slots=True)
class ShotRecords:
    """The records of one shot on the plan's axes.

    ``codes`` int16 (pulse, sample), ``MISSING`` where nothing arrived; ``trigger_time_s`` float64 (pulse,), NaN there
    and where the way to capture states no time.
    """

    codes: NDArray[np.int16]
    trigger_time_s: NDArray[np.float64]
    volts_per_code: float
    volts_offset: float

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which pulses have a record, shape (pulse,)."""
        valid: NDArray[np.bool_] = self.codes[:, 0] != MISSING
        return valid


def pulse_index(block: RecordBlock, first_trigger_s: float, shot: Shot) -> NDArray[np.int64]:
    """Return the tracking pulse that each record of ``block`` belongs to, shape (record,); -1 where none fits.

    The board's trigger times decide, so that a lost trigger shifts no later record; where the way to capture states
    none, records count from the first.
    """
    if np.isnan(block.trigger_time_s).any():
        index = block.first_record + np.arange(block.codes.shape[0], dtype=np.int64)
        return np.where(index < shot.capture.record_count, index, -1)
    period = 1 / shot.tracking_train.rate_hz
    place = (block.trigger_time_s - first_trigger_s) / period
    index = np.round(place).astype(np.int64)
    stray = (np.abs(place - index) > 0.01) | (index < 0) | (index >= shot.capture.record_count)
    return np.where(stray, -1, index)


def assemble(blocks: Iterable[RecordBlock], shot: Shot) -> ShotRecords:
    """Return the records of ``blocks`` in the places of ``shot``'s pulses."""
    codes = np.full((shot.capture.record_count, shot.capture.record_samples), MISSING)
    trigger_time_s = np.full(shot.capture.record_count, np.nan)
    scale, offset, first_s = np.nan, np.nan, np.nan
    for block in blocks:
        if np.isnan(first_s) and block.trigger_time_s.size:
            first_s = float(block.trigger_time_s[0])
        scale, offset = block.volts_per_code, block.volts_offset
        index = pulse_index(block, first_s, shot)
        codes[index[index >= 0]] = block.codes[index >= 0]
        trigger_time_s[index[index >= 0]] = block.trigger_time_s[index >= 0]
    return ShotRecords(codes, trigger_time_s, scale, offset)
