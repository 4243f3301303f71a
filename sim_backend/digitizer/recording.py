"""Recording: the volts of one capture, made block by block as its records are asked for.

A block is a few megabytes, so that a capture of a million records takes no more memory than one of some thousand. The
blocks of the latest records stay, as many as the board's own memory holds; an older one is made anew, the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.digitizer.capture_snapshot import CaptureSnapshot, same_inputs
from sim_backend.wiring import Bursts, Capture, near

RecordVolts = Callable[[Bursts, Bursts, Capture], FloatArray]
"""Tonebursts, pulses and the records wanted -> volts (record, sample), which depend on these records alone."""

BLOCK_VALUES = 1 << 20
"""Samples of a block: 8 MB, which the allocator hands out again and again instead of asking for new pages."""
BLOCKS_KEPT = 9
"""More than a board of 8 million samples has in its memory."""


class Recording:
    """Volts at channel A of the records of one capture."""

    def __init__(self, record_volts: RecordVolts) -> None:
        self._record_volts = record_volts
        # From which record on a snapshot holds: what has been recorded stays, whatever is programmed later.
        self._parts: list[tuple[int, CaptureSnapshot]] = []
        self._complete = 0
        # What the physics made, by block and by the record from which on its snapshot holds.
        self._made: dict[tuple[int, int], FloatArray] = {}
        # The largest voltage so far, by record, one array a block.
        self._highest_v: list[FloatArray] = []

    def update(self, captured: CaptureSnapshot, now_ps: int) -> None:
        """Take what the instruments are programmed to from now on; records complete before are kept."""
        if not self._parts or not same_inputs(self._parts[-1][1], captured):
            first = self._complete
            self._parts = [part for part in self._parts if part[0] < first] + [(first, captured)]
            self._made = {key: volts for key, volts in self._made.items() if key[1] < first}
            self._highest_v = self._highest_v[: first // _records_a_block(captured.capture)]
        self._complete = captured.taken.complete(now_ps)

    def volts(self, records: slice) -> FloatArray:
        """Return the volts of consecutive ``records``, (record, sample)."""
        size = _records_a_block(self._parts[-1][1].capture)
        blocks = []
        for number in range(records.start // size, -(-records.stop // size)):
            first = number * size
            blocks.append(self._block(number)[max(0, records.start - first) : records.stop - first])
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

    def highest_v(self, count: int) -> float:
        """Return the largest voltage, of either sign, in the first ``count`` records; 0 in none."""
        if not count:
            return 0.0
        number, place = divmod(count - 1, _records_a_block(self._parts[-1][1].capture))
        while len(self._highest_v) <= number:
            self._block(len(self._highest_v))
        return float(self._highest_v[number][place])

    def _block(self, number: int) -> FloatArray:
        pieces = list(self._pieces(number))
        volts = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        if number == len(self._highest_v):
            before_v = self._highest_v[-1][-1] if number else 0.0
            own_v = np.maximum(volts.max(axis=1), -volts.min(axis=1))
            self._highest_v.append(np.maximum(np.maximum.accumulate(own_v), before_v))
        return volts

    def _pieces(self, number: int) -> Iterator[FloatArray]:
        """Yield the volts of a block's records, from every snapshot that holds for some of them."""
        size = _records_a_block(self._parts[-1][1].capture)
        first = number * size
        ends = [begin for begin, _ in self._parts[1:]] + [first + size]
        for (begin, captured), end in zip(self._parts, ends, strict=True):
            low, high = max(0, begin - first), min(size, end - first)
            if low < high:
                yield self._make(number, begin, captured)[low:high]

    def _make(self, number: int, begin: int, captured: CaptureSnapshot) -> FloatArray:
        if (number, begin) not in self._made:
            wanted = _block_of(captured.capture, number)
            volts = self._record_volts(captured.tonebursts, near(captured.pulses, wanted), wanted)
            self._made[number, begin] = volts
            while len(self._made) > BLOCKS_KEPT:
                del self._made[next(iter(self._made))]
        return self._made[number, begin]


def _records_a_block(capture: Capture) -> int:
    return max(1, BLOCK_VALUES // capture.samples)


def _block_of(capture: Capture, number: int) -> Capture:
    size = _records_a_block(capture)
    first = number * size
    return replace(capture, first_sample_ps=capture.first_sample_ps[first : first + size], first_record=first)
