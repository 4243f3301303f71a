"""White noise of a capture's records: where its blocks are asked for in turn, the next one is drawn meanwhile.

    noise of block k --echoes added, codes, file-->  noise of block k + 1 --...
                     drawn meanwhile: block k + 1    drawn meanwhile: block k + 2

Random numbers take a core of their own, and everything else another. What comes out is the same without.
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
"""Gives an array, waiting until it is made; the same at every call."""

DRAWN_MEANWHILE = 1 << 18
"""Samples of a block, from about 2 ms on, that are drawn in a thread."""


class RecordNoise:
    """Noise of ``receiver``, from the random numbers of ``stream``."""

    def __init__(self, receiver: Receiver, stream: RecordStream) -> None:
        self._receiver, self._stream = receiver, stream
        # One thread, so that blocks are drawn in the order in which they are begun.
        self._thread: ThreadPoolExecutor | None = None
        self._ahead: tuple[Capture, Future[FloatArray]] | None = None
        self._before: tuple[int, int, int] | None = None

    def begin(self, capture: Capture) -> NoiseSource:
        """Return what gives the noise of the records of ``capture``, (record, sample), V."""
        records, shape = len(capture.first_sample_ps), (len(capture.first_sample_ps), capture.samples)
        if self._receiver.snr_db is None:
            zeros = np.zeros(shape)
            return lambda: zeros
        future = self._taken(capture)
        if future is None and records * capture.samples < DRAWN_MEANWHILE:
            drawn = self._draw(capture)
            return lambda: drawn
        future = future or self._submit(capture)
        # A shorter block is the capture's last.
        if self._before == (capture.index, capture.first_record - records, records):
            after = replace(capture, first_record=capture.first_record + records)
            self._ahead = after, self._submit(after)
        self._before = capture.index, capture.first_record, records
        return lambda: future.result()[:records]

    def _taken(self, capture: Capture) -> Future[FloatArray] | None:
        """Return what was drawn ahead if ``capture`` is the beginning of it, and wait for it where it is not."""
        if self._ahead is None:
            return None
        (ahead, future), self._ahead = self._ahead, None
        begins = (ahead.index, ahead.first_record, ahead.samples)
        whole = len(capture.first_sample_ps) <= len(ahead.first_sample_ps)
        if whole and begins == (capture.index, capture.first_record, capture.samples):
            return future
        # Waits only: what nobody asks for may have failed.
        future.exception()
        return None

    def _draw(self, capture: Capture) -> FloatArray:
        rng = self._stream.begin(capture, capture.samples)
        return noise_v(self._receiver, len(capture.first_sample_ps), capture.samples, rng)

    def _submit(self, capture: Capture) -> Future[FloatArray]:
        if self._thread is None:
            from concurrent.futures import ThreadPoolExecutor

            self._thread = ThreadPoolExecutor(1)
        return self._thread.submit(self._draw, capture)
