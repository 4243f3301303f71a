"""White noise of a capture's records; if its blocks are requested in order, a thread draws the next one in advance.

    noise of block k --echoes added, codes, file-->  noise of block k + 1 --...
                     thread: block k + 1             thread: block k + 2

Random numbers then use a second core. The numbers are the same without the thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.receiver.front_end import noise_v
from sim_backend.receiver.streams import RecordStream
from sim_backend.settings import Receiver
from sim_backend.wiring import Capture

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

NoiseSource = Callable[[], FloatArray]
"""Returns the noise, waiting for it if necessary; the same array at every call."""

MIN_THREAD_SAMPLES = 1 << 18
"""Blocks of so many samples, about 2 ms of work, are drawn in a thread."""


class RecordNoise:
    """Noise of ``receiver``, from the random numbers of ``stream``."""

    def __init__(self, receiver: Receiver, stream: RecordStream) -> None:
        """Prepare the noise of ``receiver``; blocks of records may be drawn in advance in a thread."""
        self._receiver, self._stream = receiver, stream
        # One thread, so that blocks are drawn in order.
        self._thread: ThreadPoolExecutor | None = None
        self._next_block: tuple[Capture, Future[FloatArray]] | None = None
        # Capture, first record and number of records of the block requested last.
        self._latest_block: tuple[int, int, int] | None = None

    def source_for(self, capture: Capture) -> NoiseSource:
        """Return a function that waits for and returns the noise of the records of ``capture``, (record, sample), V.

        When blocks are requested in sequence, the next one is drawn ahead in a thread.
        """
        records, shape = len(capture.first_sample_ps), (len(capture.first_sample_ps), capture.samples)
        if self._receiver.snr_db is None:
            zeros = np.zeros(shape)
            return lambda: zeros
        future = self._next_block_for(capture)
        if future is None and records * capture.samples < MIN_THREAD_SAMPLES:
            noise = self._draw(capture)
            return lambda: noise
        future = future or self._submit(capture)
        # The block continues the latest one. A shorter block is the capture's last, so no block follows it.
        if self._latest_block == (capture.index, capture.first_record - records, records):
            following = replace(capture, first_record=capture.first_record + records)
            self._next_block = following, self._submit(following)
        self._latest_block = capture.index, capture.first_record, records
        # The block drawn ahead can be longer than the capture.
        return lambda: future.result()[:records]

    def _next_block_for(self, capture: Capture) -> Future[FloatArray] | None:
        """Return the block of noise drawn in advance if it begins with the records of ``capture``, else None.

        A block of other records is awaited and discarded.
        """
        if self._next_block is None:
            return None
        (block, future), self._next_block = self._next_block, None
        start = (capture.index, capture.first_record, capture.samples)
        same_start = start == (block.index, block.first_record, block.samples)
        if same_start and len(capture.first_sample_ps) <= len(block.first_sample_ps):
            return future
        # Only wait: a failure of a discarded block does not matter.
        future.exception()
        return None

    def _draw(self, capture: Capture) -> FloatArray:
        """Return the noise of the records of ``capture``, (record, sample), V."""
        rng = self._stream.generator_for(capture, capture.samples)
        return noise_v(self._receiver, len(capture.first_sample_ps), capture.samples, rng)

    def _submit(self, capture: Capture) -> Future[FloatArray]:
        """Start drawing the noise of ``capture`` in the thread, which is created at the first call."""
        if self._thread is None:
            from concurrent.futures import ThreadPoolExecutor

            self._thread = ThreadPoolExecutor(1)
        return self._thread.submit(self._draw, capture)
