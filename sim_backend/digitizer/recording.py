"""Recording: the volts of one capture, computed block by block on demand.

A block is a few megabytes, so the memory does not grow with the capture. The latest blocks are cached; an older one is
computed again, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

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


class Recording:
    """Volts at channel A of the records of one capture."""

    def __init__(self, record_volts: RecordVolts) -> None:
        """Start without records; ``record_volts`` computes the voltages of records from bursts and times."""
        self._record_volts = record_volts
        # Each snapshot with its first record: later programming does not change complete records.
        self._segments: list[tuple[int, CaptureSnapshot]] = []
        self._complete = 0
        # Cached blocks, by number and by the first record of their snapshot.
        self._blocks: dict[tuple[int, int], FloatArray] = {}
        # Running maximum of the voltage over the records, one array a block.
        self._running_peak_v: list[FloatArray] = []

    def update(self, captured: CaptureSnapshot, now_ps: int) -> None:
        """Take over the latest snapshot of the bench for the records that are not complete yet at ``now_ps``."""
        if not self._segments or not same_inputs(self._segments[-1][1], captured):
            first = self._complete
            self._segments = [segment for segment in self._segments if segment[0] < first] + [(first, captured)]
            self._blocks = {key: volts for key, volts in self._blocks.items() if key[1] < first}
            self._running_peak_v = self._running_peak_v[: first // _records_per_block(captured.capture)]
        self._complete = captured.triggers.complete(now_ps)

    def volts(self, records: slice) -> FloatArray:
        """Return the volts of consecutive ``records``, (record, sample)."""
        size = _records_per_block(self._segments[-1][1].capture)
        blocks = []
        for number in range(records.start // size, -(-records.stop // size)):
            first = number * size
            blocks.append(self._block(number)[max(0, records.start - first) : records.stop - first])
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

    def peak_v(self, count: int) -> float:
        """Return the largest absolute voltage of the first ``count`` records; 0 without records."""
        if not count:
            return 0.0
        number, index = divmod(count - 1, _records_per_block(self._segments[-1][1].capture))
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
        size = _records_per_block(self._segments[-1][1].capture)
        first = number * size
        # A segment is the first record of a snapshot and the snapshot, which holds until the next one starts.
        ends = [start for start, _ in self._segments[1:]] + [first + size]
        for (start, captured), end in zip(self._segments, ends, strict=True):
            low, high = max(0, start - first), min(size, end - first)
            if low < high:
                yield self._computed(number, start, captured)[low:high]

    def _computed(self, number: int, start: int, captured: CaptureSnapshot) -> FloatArray:
        """Return the volts of a block for the snapshot that starts at record ``start``; cached."""
        if (number, start) not in self._blocks:
            block = _block_of(captured.capture, number)
            volts = self._record_volts(captured.tonebursts, near(captured.pulses, block), block)
            self._blocks[number, start] = volts
            while len(self._blocks) > CACHED_BLOCKS:
                del self._blocks[next(iter(self._blocks))]
        return self._blocks[number, start]


def _records_per_block(capture: Capture) -> int:
    return max(1, BLOCK_VALUES // capture.samples)


def _block_of(capture: Capture, number: int) -> Capture:
    """Return the capture that consists of the records of block ``number``."""
    size = _records_per_block(capture)
    first = number * size
    return replace(capture, first_sample_ps=capture.first_sample_ps[first : first + size], first_record=first)
