"""Records of one shot: arriving blocks -> codes on the plan's axes (pulse, sample), with missing records marked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, Int64Array
from hpe_rig.plan import Shot

MISSING = np.int16(-32768)
"""Code of a sample that was never recorded; below the code limits of every digitizer."""


class GatedRecords(Protocol):
    """Records of one shot, in memory (`ShotRecords`) or in the file (`StoredShot`), read in blocks of pulses.

    ``shape``: (pulse, sample); ``valid`` (pulse,): True for pulses with a record; the others as in `ShotRecords`.
    """

    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def valid(self) -> BoolArray: ...
    @property
    def volts_per_code(self) -> float: ...
    @property
    def code_limits(self) -> tuple[int, int]: ...
    @property
    def margin(self) -> tuple[int, int]: ...
    @property
    def damaged(self) -> BoolArray | None: ...

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample); ``MISSING`` for a missing record."""
        ...


@dataclass(frozen=True, slots=True)
class ShotRecords:
    """The records of one shot on the plan's axes.

    codes: int16 (pulse, sample), ``MISSING`` for missing records.
    trigger_time_s: float64 (pulse,), NaN for missing records and for capture modes without times.
    code_limits: the digitizer's lowest and highest code; a sample with one of them is clipped.
    margin: numbers of samples before and after the gate.
    damaged: (pulse,), True for missing records that fail their checksums; None for records not read from a file.
    """

    codes: Int16Array
    trigger_time_s: FloatArray
    volts_per_code: float
    volts_offset: float
    code_limits: tuple[int, int]
    margin: tuple[int, int] = (0, 0)
    damaged: BoolArray | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.codes.shape[0], self.codes.shape[1]

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample)."""
        return self.codes[pulses]

    def cut(self, gate: slice, margin: int = 0) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` existing samples on either side."""
        samples, margins = with_margin(gate, margin, self.codes.shape[1])
        return replace(self, codes=self.codes[:, samples], margin=margins)

    @property
    def valid(self) -> BoolArray:
        """True for pulses with a record, (pulse,)."""
        valid: BoolArray = self.codes[:, 0] != MISSING
        return valid


def with_margin(gate: slice, margin: int, samples: int) -> tuple[slice, tuple[int, int]]:
    """Return ``gate`` extended by up to ``margin`` samples within a record of ``samples``, and both extensions."""
    extended = slice(max(0, gate.start - margin), min(samples, gate.stop + margin))
    return extended, (gate.start - extended.start, extended.stop - gate.stop)


@dataclass(frozen=True, slots=True)
class LastRecord:
    """The latest record of a shot with a known pulse: pulse index, the board's trigger time, number of the record."""

    pulse: int
    trigger_time_s: float
    record: int


def pulse_indices(block: RecordBlock, previous: LastRecord | None, shot: Shot) -> tuple[Int64Array, LastRecord | None]:
    """Return the tracking pulse of each record of ``block`` (record,), -1 if none fits, and the last such record.

    The pulse follows from the board's trigger time relative to the last record of the ``previous`` block. So a lost
    trigger shifts no later record, and a board with a clock error of up to 100 ppm loses none in blocks of up to 2000.
    The first record is assumed to belong to the first pulse, because no time reveals triggers lost before it. Records
    without a time are counted from the latest record with a known pulse, or from the first record if there is none.
    """
    record = np.arange(block.codes.shape[0], dtype=np.int64) + block.first_record
    timed = np.isfinite(block.trigger_time_s)
    index, latest = np.empty_like(record), previous
    if timed.any():
        index[timed], latest = _indices_by_time(record[timed], block.trigger_time_s[timed], previous, shot)
    counted = record[~timed] + (0 if latest is None else latest.pulse - latest.record)
    index[~timed] = np.where(counted < shot.capture.record_count, counted, -1)
    return index, latest


def _indices_by_time(
    record: Int64Array, trigger_time_s: FloatArray, previous: LastRecord | None, shot: Shot
) -> tuple[Int64Array, LastRecord | None]:
    """Return the tracking pulse of each record by its trigger time, and the last record with a pulse.

    A stray trigger gets -1. ``record`` and ``trigger_time_s`` (record,): number within the shot, and time. Pulses are
    counted from ``previous``, the last record of the block before.
    """
    anchor = previous or LastRecord(0, float(trigger_time_s[0]), int(record[0]))
    pulses = anchor.pulse + (trigger_time_s - anchor.trigger_time_s) * shot.tracking_train.rate_hz
    index = np.round(pulses).astype(np.int64)
    # More than a quarter of the pulse interval from any pulse: a spurious trigger.
    stray = (np.abs(pulses - index) > 0.25) | (index < 0) | (index >= shot.capture.record_count)
    index[stray] = -1
    if stray.all():
        return index, previous
    last = int(np.flatnonzero(~stray)[-1])
    return index, LastRecord(int(index[last]), float(trigger_time_s[last]), int(record[last]))


def assemble(blocks: Iterable[RecordBlock], shot: Shot) -> ShotRecords:
    """Return all records of ``shot`` as one array (pulse, sample), from ``blocks`` of records as they arrived.

    Pulses without a record hold the code for missing records.
    """
    codes = np.full((shot.capture.record_count, shot.capture.record_samples), MISSING)
    trigger_time_s = np.full(shot.capture.record_count, np.nan)
    scale, offset, limits, latest = np.nan, np.nan, (0, 0), None
    for block in blocks:
        scale, offset, limits = block.volts_per_code, block.volts_offset, block.code_limits
        index, latest = pulse_indices(block, latest, shot)
        codes[index[index >= 0]] = block.codes[index >= 0]
        trigger_time_s[index[index >= 0]] = block.trigger_time_s[index >= 0]
    return ShotRecords(codes, trigger_time_s, scale, offset, limits)
