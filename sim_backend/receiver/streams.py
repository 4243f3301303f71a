"""Random numbers of a capture's records, independent of the division into blocks."""

from __future__ import annotations

import numpy as np

from sim_backend.wiring import Capture

_VALUES_PER_CHUNK = 1 << 20


class RecordStream:
    """Standard normal numbers for each record, which depend only on seed, ``key`` and capture.

    A record has the same numbers as if the whole capture were drawn at once. A block that follows the previous one
    continues the stream; any other block first draws and discards the numbers before it.
    """

    def __init__(self, seed: int, key: int) -> None:
        """Start the stream of random numbers; ``key`` distinguishes the streams of one ``seed``."""
        self._seed, self._key = seed, key
        self._next: tuple[int, int] | None = None
        self._rng = np.random.default_rng(0)

    def generator_for(self, capture: Capture, numbers: int) -> np.random.Generator:
        """Return the random generator at the position of the first record of ``capture``.

        The caller draws ``numbers`` for each record, so that a record has the same numbers in any division into
        captures.
        """
        if self._next != (capture.index, capture.first_record):
            sequence = np.random.SeedSequence(self._seed, spawn_key=(self._key, capture.index))
            self._rng = np.random.default_rng(sequence)
            skipped = capture.first_record * numbers
            for first in range(0, skipped, _VALUES_PER_CHUNK):
                self._rng.standard_normal(min(_VALUES_PER_CHUNK, skipped - first))
        self._next = capture.index, capture.first_record + len(capture.first_sample_ps)
        return self._rng
