"""Dual-port capture: AutoDMA, traditional or NPT; records leave the board while it captures.

A ring of two to four buffers goes round: posted (the board's), filled by the board, waited for in the order of posting,
copied, posted again. A record has nowhere to go when the ring is full and the board's own memory is too: the board
then answers with an overflow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final, final

import numpy as np

from drivers.alazar import api
from drivers.alazar.api import Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.limits import pre_trigger_samples, records_per_buffer
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.return_codes import WAIT_TIMEOUT
from drivers.alazar.samples import RawRecords, buffer_bytes, unpacked
from drivers.alazar.single_port import late
from drivers.interfaces import Capture, Clock, InstrumentError

LEAST_BUFFERS: Final = 2
MOST_BUFFERS: Final = 4
# One foreign call holds back Ctrl-C for this long at most.
WAIT_SLICE_MS: Final = 100


@final
class DualPortCapture:
    """One capture at a time through a ring of page-aligned buffers.

    The buffers live from ``arm`` until ``abort``, which must follow on every way out, also after the last record.
    If the abort itself fails they are kept for the life of the process: the board might still write into them. NPT
    records carry no trigger time.
    """

    def __init__(
        self,
        board: AlazarBoard,
        clock: Clock,
        capture: Capture,
        allocate: Callable[[int], PageBuffer],
        channels: tuple[Channel, ...] = (Channel.A,),
        npt: bool = False,
    ) -> None:
        self._board, self._clock, self._capture, self._allocate = board, clock, capture, allocate
        self._channels, self._npt = channels, npt
        self.name = "npt" if npt else "traditional"
        self.records_per_block = records_per_buffer(capture, len(channels))
        self._buffer_count = capture.record_count // self.records_per_block
        self.armed = False
        self._buffers: list[PageBuffer] = []

    def prepare(self) -> None:
        """Program the record size."""
        pre = pre_trigger_samples(self._capture)
        self._board.call(self._board.library.AlazarSetRecordSize, pre, self._capture.record_samples - pre)

    def arm(self) -> None:
        """Post the ring of buffers and wait for triggers from now on; time stamps start at zero."""
        board = self._board
        # Set first: an interrupt during arming must find something to abort.
        self.armed = True
        try:
            board.call(board.library.AlazarResetTimeStamp, api.TIMESTAMP_RESET_ALWAYS)
            self._announce()
            size = buffer_bytes(
                self._capture.record_samples, self.records_per_block, len(self._channels), not self._npt
            )
            for _ in range(min(MOST_BUFFERS, max(LEAST_BUFFERS, self._buffer_count))):
                self._buffers.append(self._allocate(size))
                self._post(self._buffers[-1])
            board.call(board.library.AlazarStartCapture)
        except BaseException:
            self.abort()
            raise

    def records(self, deadline_s: float) -> Iterator[RawRecords]:
        """Yield each buffer's records as it fills; raise ``DeadlineError`` when one is not full by the deadline."""
        # The ring as it was armed: ``abort`` may empty ``_buffers`` while a reader stands between two blocks.
        ring, samples = tuple(self._buffers), self._capture.record_samples
        for index in range(self._buffer_count):
            buffer = ring[index % len(ring)]
            self._wait(buffer, index, deadline_s)
            # A copy, since the next lines give the memory back to the board.
            filled = buffer.copy(np.dtype(np.uint8), buffer.size_bytes)
            # Posted before anyone works on the copy, so that slow work costs no records; the last buffers of a capture
            # are not, since nothing would ever fill them.
            if index + len(ring) < self._buffer_count:
                self._post(buffer)
            yield unpacked(filled, index * self.records_per_block, len(self._channels), samples, self._npt)

    def abort(self) -> None:
        """End the transfer if one was begun, then free the buffers."""
        if self.armed:
            try:
                self._board.call(self._board.library.AlazarAbortAsyncRead)
            except BaseException:
                # Not aborted, the board may write into the pages at any time: better lost than someone else's.
                for buffer in self._buffers:
                    buffer.keep()
                raise
        self.armed = False
        while self._buffers:
            self._buffers.pop().free()

    def buffers_posted(self) -> int:
        """Return how many buffers the board holds right after arming."""
        return len(self._buffers)

    def _announce(self) -> None:
        board, capture = self._board, self._capture
        mode = api.ADMA_NPT if self._npt else api.ADMA_RECORD_HEADERS
        board.call(
            board.library.AlazarBeforeAsyncRead,
            sum(self._channels),
            -pre_trigger_samples(capture),
            capture.record_samples,
            self.records_per_block,
            capture.record_count,
            api.ADMA_EXTERNAL_STARTCAPTURE | mode,
        )

    def _post(self, buffer: PageBuffer) -> None:
        self._board.call(self._board.library.AlazarPostAsyncBuffer, buffer.address, buffer.size_bytes)

    def _wait(self, buffer: PageBuffer, index: int, deadline_s: float) -> None:
        """Return when ``buffer`` is full; one that is full already is taken even after the deadline."""
        board = self._board
        while True:
            if buffer.freed:
                why = "the bench was made safe in the meantime"
                raise InstrumentError(board.role, "the capture was aborted", why, "start the shot again")
            # In slices, so that Ctrl-C and a bench that is made safe meanwhile are noticed.
            remaining_ms = max(0, math.ceil((deadline_s - self._clock.now_s()) * 1e3))
            timeout_ms = min(WAIT_SLICE_MS, remaining_ms)
            wait = board.library.AlazarWaitAsyncBufferComplete
            code = board.ask(wait, board.handle, buffer.address, timeout_ms)
            if code != WAIT_TIMEOUT:
                board.check(code, "AlazarWaitAsyncBufferComplete")
                return
            if remaining_ms == 0:
                captured = board.parameter(Parameter.RECORDS_CAPTURED)
                raise late(board.role, index * self.records_per_block, self._capture.record_count, deadline_s, captured)
