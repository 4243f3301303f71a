"""Recording: the volts of one capture, computed block by block on demand.

A block is a few megabytes, so the memory does not grow with the capture. The latest blocks are cached; an older one is
computed again, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.digitizer.capture_snapshot import CaptureSnapshot, same_inputs
from sim_backend.wiring import Bursts, Capture, near

RecordVolts = Callable[[Bursts, Bursts, Capture], FloatArray]
"""Tonebursts, pulses and a capture -> volts (record, sample), which depend on its records alone."""

BLOCK_VALUES = 1 << 20
"""Samples of a block: 8 MB, which the allocator reuses without asking the system for new pages."""
CACHED_BLOCKS = 9
"""More than the memory of a board with 8 million samples."""


class _Segment(NamedTuple):
    """Consecutive records with one snapshot of settings and signals, up to the next segment's first record."""

    first_record: int
    captured: CaptureSnapshot


class _BlockKey(NamedTuple):
    """Key of a cached block: its number, and the first record of the segment with its snapshot."""

    number: int
    first_record: int


class Recording:
    """Volts at channel A of the records of one capture."""

    def __init__(self, record_volts: RecordVolts) -> None:
        """Start without records; ``record_volts`` computes the voltages of records from bursts and times."""
        self._record_volts = record_volts
        # Each segment has the instrument settings at the acquisition of its records. A complete record stays in its
        # segment, so that its voltages do not change if an instrument is set differently before they are computed.
        self._segments: list[_Segment] = []
        self._complete_records = 0
        self._blocks: dict[_BlockKey, FloatArray] = {}
        # Largest absolute voltage from the first record to each record, (record,), one array a block. The digitizer's
        # status needs it to report clipping, also after a block's voltages have left the cache.
        self._running_peak_v: list[FloatArray] = []

    def update(self, captured: CaptureSnapshot, now_ps: int) -> None:
        """Use the snapshot ``captured`` for all records that were not complete at the last update.

        The bench holds the history of its signals, so a later snapshot is right for records that have become complete
        since then. How many are complete at ``now_ps`` is stored for the next update.
        """
        if not self._segments or not same_inputs(self._segments[-1].captured, captured):
            first = self._complete_records
            earlier = [segment for segment in self._segments if segment.first_record < first]
            self._segments = [*earlier, _Segment(first, captured)]
            self._blocks = {key: volts for key, volts in self._blocks.items() if key.first_record < first}
            self._running_peak_v = self._running_peak_v[: first // _records_per_block(captured.capture)]
        self._complete_records = captured.triggers.complete(now_ps)

    def volts(self, records: slice) -> FloatArray:
        """Return the volts of consecutive ``records``, (record, sample)."""
        size = self._block_size()
        blocks = []
        for number in range(records.start // size, -(-records.stop // size)):
            first = number * size
            blocks.append(self._block(number)[max(0, records.start - first) : records.stop - first])
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

    def peak_v(self, count: int) -> float:
        """Return the largest absolute voltage of the first ``count`` records; 0 without records."""
        if not count:
            return 0.0
        number, index = divmod(count - 1, self._block_size())
        while len(self._running_peak_v) <= number:
            self._block(len(self._running_peak_v))
        return float(self._running_peak_v[number][index])

    def _block(self, number: int) -> FloatArray:
        """Return the volts (record, sample) of block ``number``, consecutive records that are computed together.

        Extends the running peak voltage if the block is the next one.
        """
        pieces = list(self._pieces(number))
        volts = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        if number == len(self._running_peak_v):
            before_v = self._running_peak_v[-1][-1] if number else 0.0
            record_peak_v = np.maximum(volts.max(axis=1), -volts.min(axis=1))
            self._running_peak_v.append(np.maximum(np.maximum.accumulate(record_peak_v), before_v))
        return volts

    def _pieces(self, number: int) -> Iterator[FloatArray]:
        """Yield the volts of a block's records, one piece for each snapshot of the bench."""
        size = self._block_size()
        first = number * size
        # A segment ends where the next one starts; the last one lasts to the end of the block at least.
        ends = [segment.first_record for segment in self._segments[1:]] + [first + size]
        for segment, end in zip(self._segments, ends, strict=True):
            low, high = max(0, segment.first_record - first), min(size, end - first)
            if low < high:
                yield self._computed(number, segment)[low:high]

    def _computed(self, number: int, segment: _Segment) -> FloatArray:
        """Return the volts of block ``number`` for the snapshot of ``segment``; cached."""
        key, captured = _BlockKey(number, segment.first_record), segment.captured
        if key not in self._blocks:
            block = _block_of(captured.capture, number)
            self._blocks[key] = self._record_volts(captured.tonebursts, near(captured.pulses, block), block)
            while len(self._blocks) > CACHED_BLOCKS:
                del self._blocks[next(iter(self._blocks))]
        return self._blocks[key]

    def _block_size(self) -> int:
        """Return the number of records of a block."""
        return _records_per_block(self._segments[-1].captured.capture)


def _records_per_block(capture: Capture) -> int:
    return max(1, BLOCK_VALUES // capture.samples)


def _block_of(capture: Capture, number: int) -> Capture:
    """Return the capture that consists of the records of block ``number``."""
    size = _records_per_block(capture)
    first = number * size
    return replace(capture, first_sample_ps=capture.first_sample_ps[first : first + size], first_record=first)
