"""Random numbers of a capture's records, drawn in the order of the records, whatever blocks these are asked for in."""

from __future__ import annotations

import numpy as np

from sim_backend.wiring import Capture

_VALUES_AT_ONCE = 1 << 20


class RecordStream:
    """Standard normal numbers, as many a record, that seed, ``key`` and capture alone decide.

    Each record has the numbers that it would have if the whole capture were drawn at once. A block that follows the
    one before goes on where that ended; any other costs what is drawn to get there.
    """

    def __init__(self, seed: int, key: int) -> None:
        self._seed, self._key = seed, key
        self._next: tuple[int, int] | None = None
        self._rng = np.random.default_rng(0)

    def begin(self, capture: Capture, numbers: int) -> np.random.Generator:
        """Return a generator that stands at the first record of ``capture``; draw ``numbers`` for each of them."""
        if self._next != (capture.index, capture.first_record):
            sequence = np.random.SeedSequence(self._seed, spawn_key=(self._key, capture.index))
            self._rng = np.random.default_rng(sequence)
            passed = capture.first_record * numbers
            for first in range(0, passed, _VALUES_AT_ONCE):
                self._rng.standard_normal(min(_VALUES_AT_ONCE, passed - first))
        self._next = capture.index, capture.first_record + len(capture.first_sample_ps)
        return self._rng
