"""Records of one shot: blocks as they arrive -> codes on the plan's axes, missing records marked."""

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
    """Records of one shot, in memory (`ShotRecords`) or in the file: codes come a block of pulses at a time.

    ``shape``: (pulse, sample); ``valid`` (pulse,): which have a record; the rest as in `ShotRecords`.
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
        """Return the codes of some ``pulses``, (pulse, sample), ``MISSING`` where nothing arrived."""
        ...


@dataclass(frozen=True, slots=True)
class ShotRecords:
    """The records of one shot on the plan's axes.

    ``codes`` int16 (pulse, sample), ``MISSING`` where nothing arrived; ``trigger_time_s`` float64 (pulse,), NaN there
    and where the way to capture states no time. ``code_limits`` are the digitizer's lowest and highest code, at which a
    sample is clipped. ``margin``: how many of the samples come before and behind the gate, where it is a gate's.
    ``damaged`` (pulse,): which of the missing records failed their checksums; None where all others never came.
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
        """Return the codes of some ``pulses``, (pulse, sample)."""
        return self.codes[pulses]

    def cut(self, gate: slice, margin: int = 0) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` on either side, as far as there are."""
        around, margins = with_margin(gate, margin, self.codes.shape[1])
        return replace(self, codes=self.codes[:, around], margin=margins)

    @property
    def valid(self) -> BoolArray:
        """Which pulses have a record, shape (pulse,)."""
        valid: BoolArray = self.codes[:, 0] != MISSING
        return valid


def with_margin(gate: slice, margin: int, samples: int) -> tuple[slice, tuple[int, int]]:
    """Return a gate with up to ``margin`` samples of a record of ``samples`` on either side, and how many these are."""
    around = slice(max(0, gate.start - margin), min(samples, gate.stop + margin))
    return around, (gate.start - around.start, around.stop - gate.stop)


@dataclass(frozen=True, slots=True)
class Placed:
    """The latest record of a shot that has its place: its pulse, its trigger's time by the board, its number."""

    pulse: int
    trigger_time_s: float
    record: int


def place(block: RecordBlock, before: Placed | None, shot: Shot) -> tuple[Int64Array, Placed | None]:
    """Return the tracking pulse of each record of ``block``, (record,), -1 where none fits, and the latest placed.

    The board's trigger times decide, counted from the record placed last, so that a lost trigger shifts no later record
    and a board whose clock is off by up to 100 ppm loses none in blocks of up to 2000. The first record that comes is
    taken for the first pulse's: no time tells whether triggers before it were lost. Records without a time count on
    from the one placed last, and from the first where the way to capture states no times at all.
    """
    record = np.arange(block.codes.shape[0], dtype=np.int64) + block.first_record
    timed = np.isfinite(block.trigger_time_s)
    index, latest = np.empty_like(record), before
    if timed.any():
        index[timed], latest = _placed_by_time(record[timed], block.trigger_time_s[timed], before, shot)
    counted = record[~timed] + (0 if latest is None else latest.pulse - latest.record)
    index[~timed] = np.where(counted < shot.capture.record_count, counted, -1)
    return index, latest


def _placed_by_time(
    record: Int64Array, trigger_time_s: FloatArray, before: Placed | None, shot: Shot
) -> tuple[Int64Array, Placed | None]:
    anchor = before or Placed(0, float(trigger_time_s[0]), int(record[0]))
    pulses = anchor.pulse + (trigger_time_s - anchor.trigger_time_s) * shot.tracking_train.rate_hz
    index = np.round(pulses).astype(np.int64)
    stray = (np.abs(pulses - index) > 0.25) | (index < 0) | (index >= shot.capture.record_count)
    index[stray] = -1
    if stray.all():
        return index, before
    last = int(np.flatnonzero(~stray)[-1])
    return index, Placed(int(index[last]), float(trigger_time_s[last]), int(record[last]))


def assemble(blocks: Iterable[RecordBlock], shot: Shot) -> ShotRecords:
    """Return the records of ``blocks`` in the places of ``shot``'s pulses."""
    codes = np.full((shot.capture.record_count, shot.capture.record_samples), MISSING)
    trigger_time_s = np.full(shot.capture.record_count, np.nan)
    scale, offset, limits, latest = np.nan, np.nan, (0, 0), None
    for block in blocks:
        scale, offset, limits = block.volts_per_code, block.volts_offset, block.code_limits
        index, latest = place(block, latest, shot)
        codes[index[index >= 0]] = block.codes[index >= 0]
        trigger_time_s[index[index >= 0]] = block.trigger_time_s[index >= 0]
    return ShotRecords(codes, trigger_time_s, scale, offset, limits)
