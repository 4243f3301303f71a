"""Captures, the two ways to get records out of a board.

Single port: all records into the board's memory first, then read one by one. Dual port: AutoDMA, traditional or NPT;
records leave the board while it captures. There a ring of two to four buffers goes round: posted (the board's), filled
by the board, waited for in the order of posting, copied, posted again. A record has nowhere to go when the ring is full
and the board's own memory is too: the board then answers with an overflow.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from typing import Final, final

import numpy as np

from drivers.alazar import api
from drivers.alazar.api import Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.limits import BUFFER_WANTED_BYTES, pre_trigger_samples, records_per_buffer
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.return_codes import RECORD_TOO_HIGH, WAIT_TIMEOUT
from drivers.alazar.samples import BufferLayout, RawRecords, Words, buffer_bytes, native, unpacked, word_dtype
from drivers.interfaces import Capture, Clock, DeadlineError, InstrumentError

POLL_S: Final = 0.01
# The board may write this many samples more than asked for.
READ_MARGIN_SAMPLES: Final = 16
LEAST_BUFFERS: Final = 2
MOST_BUFFERS: Final = 4
# One foreign call holds back Ctrl-C for this long at most.
WAIT_SLICE_MS: Final = 100


@final
class SinglePortCapture:
    """One capture at a time on a board whose memory cannot be read while it records."""

    name = "single_port"

    def __init__(
        self,
        board: AlazarBoard,
        clock: Clock,
        capture: Capture,
        allocate: Callable[[int], PageBuffer],
        channels: tuple[Channel, ...] = (Channel.A,),
    ) -> None:
        self._board, self._clock, self._capture, self._allocate = board, clock, capture, allocate
        self._channels = channels
        self.armed = False
        wanted = max(1, BUFFER_WANTED_BYTES // (board.model.sample_bytes * capture.record_samples))
        self.records_per_block = min(capture.record_count, wanted)

    def prepare(self) -> None:
        """Program record size and count; raise ``InstrumentError`` if the memory does not hold them."""
        board, capture = self._board, self._capture
        most = board.most_records(capture.record_samples)
        if capture.record_count > most:
            raise InstrumentError(
                board.role,
                f"record_count = {capture.record_count} of {capture.record_samples} samples, the memory holds {most}",
                "without dual-port memory the whole capture must fit on the board",
                f"capture at most {most} records at a time, or shorter ones",
            )
        pre = pre_trigger_samples(capture)
        board.call(board.library.AlazarSetRecordSize, pre, capture.record_samples - pre)
        board.call(board.library.AlazarSetRecordCount, capture.record_count)

    def arm(self) -> None:
        """Wait for triggers from now on; time stamps start at zero."""
        board = self._board
        # Set first: an interrupt during arming must find something to abort.
        self.armed = True
        board.call(board.library.AlazarResetTimeStamp, api.TIMESTAMP_RESET_ALWAYS)
        board.call(board.library.AlazarStartCapture)

    def records(self, deadline_s: float) -> Iterator[RawRecords]:
        """Yield all records after the last has come; at the deadline those that came, then raise ``DeadlineError``."""
        arrived = self._wait(deadline_s)
        self.abort()
        yield from self._read(arrived)
        if arrived < self._capture.record_count:
            raise late(self._board.role, arrived, self._capture.record_count, deadline_s)

    def abort(self) -> None:
        """End the capture if one is running."""
        if self.armed and self._board.busy():
            self._board.call(self._board.library.AlazarAbortCapture)
        self.armed = False

    def buffers_posted(self) -> int:
        """Return 0: no memory of ours is in the board's hands."""
        return 0

    def _wait(self, deadline_s: float) -> int:
        while self._board.busy():
            remaining_s = deadline_s - self._clock.now_s()
            if remaining_s <= 0:
                # Asked before the abort, after which some SDK versions forget it; one more may come in between.
                return self._board.parameter(Parameter.RECORDS_CAPTURED) or 0
            self._clock.sleep(min(POLL_S, remaining_s))
        return self._capture.record_count

    def _read(self, arrived: int) -> Iterator[RawRecords]:
        samples = self._capture.record_samples
        buffer = self._allocate(self._board.model.sample_bytes * (samples + READ_MARGIN_SAMPLES))
        try:
            for first in range(0, arrived, self.records_per_block):
                indices = range(first, min(first + self.records_per_block, arrived))
                words = [[self._words(buffer, channel, index) for index in indices] for channel in self._channels]
                times = np.array([self._trigger_samples(index) for index in indices])
                yield RawRecords(first, native(np.array(words)), times)
        finally:
            buffer.free()

    def _words(self, buffer: PageBuffer, channel: Channel, index: int) -> Words:
        board, samples = self._board, self._capture.record_samples
        offset = -pre_trigger_samples(self._capture)
        # The vendor counts records from 1.
        size = board.model.sample_bytes
        board.call(board.library.AlazarRead, int(channel), buffer.address, size, index + 1, offset, samples)
        return native(buffer.copy(word_dtype(board.model), samples))

    def _trigger_samples(self, index: int) -> float:
        """Return when record ``index`` was triggered in periods of the sample clock; NaN where the library refuses it.

        The library need not state the time of a record above 1000; the record itself is there, and not lost for that.
        """
        board, value = self._board, ctypes.c_uint64()
        stamp = board.library.AlazarGetTriggerTimestamp
        code = board.ask(stamp, board.handle, index + 1, ctypes.byref(value))
        if code == RECORD_TOO_HIGH and index >= board.model.stamped_records:
            return math.nan
        board.check(code, "AlazarGetTriggerTimestamp")
        return float(value.value)


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
        self.records_per_block = records_per_buffer(capture, len(channels), board.model)
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
            samples, channels = self._capture.record_samples, len(self._channels)
            size = buffer_bytes(samples, self.records_per_block * channels, not self._npt, board.model)
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
        ring, model = tuple(self._buffers), self._board.model
        layout = BufferLayout(len(self._channels), self._capture.record_samples, self._npt, model)
        samples_per_count = 1 if self._npt else self._board.samples_per_timestamp()
        for index in range(self._buffer_count):
            buffer = ring[index % len(ring)]
            self._wait(buffer, index, deadline_s)
            # A copy, since the next lines give the memory back to the board.
            filled = buffer.copy(np.dtype(np.uint8), buffer.size_bytes)
            # Posted before anyone works on the copy, so that slow work costs no records; the last buffers of a capture
            # are not, since nothing would ever fill them.
            if index + len(ring) < self._buffer_count:
                self._post(buffer)
            words, counts = unpacked(filled, layout)
            yield RawRecords(index * self.records_per_block, words, counts * samples_per_count)

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


def late(role: str, arrived: int, expected: int, deadline_s: float, captured: int | None = None) -> DeadlineError:
    """Return the error for records that did not come in time; ``captured`` of them reached the board's memory."""
    unread = "" if captured is None or captured <= arrived else f" ({captured} captured, some in a part-filled buffer)"
    return DeadlineError(
        role,
        f"{arrived} of {expected} records delivered by the deadline at {deadline_s:.6g} s{unread}",
        "triggers are missing (a generator is off or untriggered, a cable is open, the level is too high) or came "
        "while the record before was still running",
        "check the trigger chain master, tracking_train, digitizer, trigger_level_v, and that delay and record fit "
        "the pulse period",
    )
