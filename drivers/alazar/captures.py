"""Single-port and dual-port captures: two procedures to get records out of a board.

Single port: the board stores all records, then each is read. Dual port (AutoDMA, traditional or NPT): records leave the
board during the capture, through a ring of two to four buffers. Each buffer is posted to the board, filled, waited for
in the order of posting, copied, and posted again. If the ring and the board's memory are full, the board reports an
overflow.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from drivers.alazar import api
from drivers.alazar.api import Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.limits import BUFFER_TARGET_BYTES, pre_trigger_samples, records_per_buffer
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.return_codes import RECORD_TOO_HIGH, SUCCESS, WAIT_TIMEOUT
from drivers.alazar.samples import RawRecords, Words, buffer_bytes, native, unpacked, word_dtype
from drivers.interfaces import Capture, Clock, DeadlineError, InstrumentError

POLL_S: Final = 0.01
# The board may write this many samples more than asked for.
READ_MARGIN_SAMPLES: Final = 16
MIN_BUFFERS: Final = 2
MAX_BUFFERS: Final = 4
# Ctrl-C is noticed between two calls of the library, so none lasts longer.
WAIT_SLICE_MS: Final = 100
# Pause after a record before the next software trigger; the board's time to re-arm is not documented.
FORCED_PAUSE_S: Final = 100e-6
MAX_FORCED_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class CaptureJob:
    """Arguments of a capture; ``allocate`` makes the memory that the board writes into."""

    board: AlazarBoard
    clock: Clock
    settings: Capture
    channels: tuple[Channel, ...]
    allocate: Callable[[int], PageBuffer]


@final
class SinglePortCapture:
    """One capture with a board that cannot be read while it records."""

    name = "single_port"

    def __init__(self, job: CaptureJob) -> None:
        self._job = job
        self._board, self._settings = job.board, job.settings
        self.armed = False
        record_bytes = job.board.model.sample_bytes * job.settings.record_samples
        self.records_per_block = min(job.settings.record_count, max(1, BUFFER_TARGET_BYTES // record_bytes))

    def prepare(self) -> None:
        """Program record size and count; raise ``InstrumentError`` if the memory does not hold them."""
        board, settings = self._board, self._settings
        count, samples = settings.record_count, settings.record_samples
        limit = board.max_records(samples)
        if count > limit:
            raise InstrumentError(
                board.role,
                f"record_count = {count} of {samples} samples, the memory holds {limit}",
                "without dual-port memory the whole capture must fit on the board",
                f"capture at most {limit} records at a time, or shorter ones",
            )
        _set_record_size(board, settings)
        board.call(board.library.AlazarSetRecordCount, count)

    def arm(self) -> None:
        """Start the capture, which waits for triggers; time stamps start at zero."""
        board = self._board
        # Set first, so that an interrupt during arming still leads to an abort.
        self.armed = True
        board.call(board.library.AlazarResetTimeStamp, api.TIMESTAMP_RESET_ALWAYS)
        board.call(board.library.AlazarStartCapture)

    def records(self, deadline_s: float) -> Iterator[RawRecords]:
        """Yield all records once the capture is complete.

        At the deadline, yield the records that have arrived, then raise ``DeadlineError``.
        """
        arrived = self._wait(deadline_s)
        self.abort()
        yield from self._read(arrived)
        if arrived < self._settings.record_count:
            raise missing_records_error(self._board.role, arrived, self._settings.record_count, deadline_s)

    def abort(self) -> None:
        """End the capture if one is running."""
        if self.armed and self._board.busy():
            self._board.call(self._board.library.AlazarAbortCapture)
        self.armed = False

    def buffers_posted(self) -> int:
        """Return 0: the board holds no buffer of this process."""
        return 0

    def _wait(self, deadline_s: float) -> int:
        """Return how many records arrived by the deadline."""
        while self._board.busy():
            remaining_s = deadline_s - self._job.clock.now_s()
            if remaining_s <= 0:
                # Read before the abort, after which some SDK versions report 0. A record may arrive in between.
                return self._board.parameter(Parameter.RECORDS_CAPTURED) or 0
            self._job.clock.sleep(min(POLL_S, remaining_s))
        return self._settings.record_count

    def _read(self, arrived: int) -> Iterator[RawRecords]:
        samples = self._settings.record_samples
        buffer = self._job.allocate(self._board.model.sample_bytes * (samples + READ_MARGIN_SAMPLES))
        try:
            for first in range(0, arrived, self.records_per_block):
                indices = range(first, min(first + self.records_per_block, arrived))
                words = [[self._words(buffer, channel, index) for index in indices] for channel in self._job.channels]
                times = np.array([self._trigger_samples(index) for index in indices])
                yield RawRecords(first, native(np.array(words)), times)
        finally:
            buffer.free()

    def _words(self, buffer: PageBuffer, channel: Channel, index: int) -> Words:
        board, samples = self._board, self._settings.record_samples
        offset = -pre_trigger_samples(self._settings)
        # The vendor counts records from 1.
        size = board.model.sample_bytes
        board.call(board.library.AlazarRead, int(channel), buffer.address, size, index + 1, offset, samples)
        return native(buffer.copy(word_dtype(board.model), samples))

    def _trigger_samples(self, index: int) -> float:
        """Return the trigger time of record ``index`` in periods of the sample clock.

        NaN if the library does not state it, as for records above 1000; the record itself is valid.
        """
        board, value = self._board, ctypes.c_uint64()
        stamp = board.library.AlazarGetTriggerTimestamp
        code = board.invoke(stamp, board.handle, index + 1, ctypes.byref(value))
        if code == RECORD_TOO_HIGH and index >= board.model.stamped_records:
            return math.nan
        board.check(code, "AlazarGetTriggerTimestamp")
        return float(value.value)


@final
class DualPortCapture:
    """One capture through a ring of page-aligned buffers.

    The buffers live from ``arm`` until ``abort``, which must always follow, also after the last record. If the abort
    fails, they are kept for the life of the process, because the board might still write into them. NPT records have
    no trigger time.
    """

    def __init__(self, job: CaptureJob, npt: bool) -> None:
        self._job, self._npt = job, npt
        self._board, self._settings = job.board, job.settings
        self.name = "npt" if npt else "traditional"
        self.records_per_block = records_per_buffer(job.settings, len(job.channels), job.board.model)
        self._buffer_count = job.settings.record_count // self.records_per_block
        self.armed = False
        self._buffers: list[PageBuffer] = []

    def prepare(self) -> None:
        """Program the record size."""
        _set_record_size(self._board, self._settings)

    def arm(self) -> None:
        """Post the ring of buffers and start the capture, which waits for triggers; time stamps start at zero."""
        board = self._board
        # Set first, so that an interrupt during arming still leads to an abort.
        self.armed = True
        try:
            board.call(board.library.AlazarResetTimeStamp, api.TIMESTAMP_RESET_ALWAYS)
            self._begin_transfer()
            samples, channels = self._settings.record_samples, len(self._job.channels)
            size = buffer_bytes(samples, self.records_per_block * channels, not self._npt, board.model)
            for _ in range(min(MAX_BUFFERS, max(MIN_BUFFERS, self._buffer_count))):
                self._buffers.append(self._job.allocate(size))
                self._post(self._buffers[-1])
            board.call(board.library.AlazarStartCapture)
        except BaseException:
            self.abort()
            raise

    def records(self, deadline_s: float) -> Iterator[RawRecords]:
        """Yield the records of each buffer once it is full.

        At the deadline, yield the records in the part-filled buffer, then raise ``DeadlineError``.
        """
        # A copy of the ring: ``abort`` may empty ``_buffers`` while this iterator is suspended.
        ring, model = tuple(self._buffers), self._board.model
        channels, record_samples = len(self._job.channels), self._settings.record_samples
        samples_per_count = 1 if self._npt else self._board.samples_per_timestamp()
        for index in range(self._buffer_count):
            buffer = ring[index % len(ring)]
            first, arrived = index * self.records_per_block, self.records_per_block
            complete = self._wait(buffer, deadline_s)
            captured = None
            if not complete:
                captured = self._board.parameter(Parameter.RECORDS_CAPTURED)
                # A board that reports no more records than were read has nothing in the buffer.
                arrived = self._fill_by_force(buffer) if captured is None or captured > first else 0
            if arrived:
                data = buffer.copy(np.dtype(np.uint8), buffer.size_bytes)
                # Posted again before the data are processed, so that slow processing loses no records. The last
                # buffers of a capture are not posted: no records are left to fill them.
                if complete and index + len(ring) < self._buffer_count:
                    self._post(buffer)
                words, counts = unpacked(data, channels, record_samples, self._npt, model)
                yield RawRecords(first, words[:, :arrived], counts[:arrived] * samples_per_count)
            if not complete:
                expected = self._settings.record_count
                raise missing_records_error(self._board.role, first + arrived, expected, deadline_s, captured)

    def abort(self) -> None:
        """End the transfer if one was begun, then free the buffers."""
        if self.armed:
            try:
                self._board.call(self._board.library.AlazarAbortAsyncRead)
            except BaseException:
                # The board may still write into the pages, so they must not be reused.
                for buffer in self._buffers:
                    buffer.make_permanent()
                raise
        self.armed = False
        while self._buffers:
            self._buffers.pop().free()

    def buffers_posted(self) -> int:
        """Return how many buffers the board holds right after arming."""
        return len(self._buffers)

    def _begin_transfer(self) -> None:
        board, settings = self._board, self._settings
        mode = api.ADMA_NPT if self._npt else api.ADMA_RECORD_HEADERS
        board.call(
            board.library.AlazarBeforeAsyncRead,
            sum(self._job.channels),
            -pre_trigger_samples(settings),
            settings.record_samples,
            self.records_per_block,
            settings.record_count,
            api.ADMA_EXTERNAL_STARTCAPTURE | mode,
        )

    def _post(self, buffer: PageBuffer) -> None:
        self._board.call(self._board.library.AlazarPostAsyncBuffer, buffer.address, buffer.size_bytes)

    def _wait(self, buffer: PageBuffer, deadline_s: float) -> bool:
        """Return whether ``buffer`` is full by the deadline; a full buffer is accepted even after it."""
        while True:
            # In slices, so that Ctrl-C and an abort by another thread are noticed.
            remaining_ms = max(0, math.ceil((deadline_s - self._job.clock.now_s()) * 1e3))
            if self._is_full(buffer, min(WAIT_SLICE_MS, remaining_ms)):
                return True
            if remaining_ms == 0:
                return False

    def _is_full(self, buffer: PageBuffer, timeout_ms: int) -> bool:
        """Return whether ``buffer`` is full, or becomes so within the time-out."""
        board = self._board
        if buffer.freed:
            why = "the bench was made safe in the meantime"
            raise InstrumentError(board.role, "the capture was aborted", why, "start the shot again")
        wait = board.library.AlazarWaitAsyncBufferComplete
        code = board.invoke(wait, board.handle, buffer.address, timeout_ms)
        if code != WAIT_TIMEOUT:
            board.check(code, "AlazarWaitAsyncBufferComplete")
        return bool(code != WAIT_TIMEOUT)

    def _fill_by_force(self, buffer: PageBuffer) -> int:
        """Complete the part-filled ``buffer`` by software triggers; return how many of its records came before them.

        The library hands over whole buffers only, and an abort leaves the content of a part-filled one undefined.
        Returns 0 if the board does not complete the buffer.
        """
        board, settings = self._board, self._settings
        record_s = (abs(settings.trigger_delay_samples) + settings.record_samples) / settings.sample_rate_hz
        end_s = self._job.clock.now_s() + MAX_FORCED_S
        for forced in range(1, self.records_per_block + 1):
            if board.invoke(board.library.AlazarForceTrigger, board.handle) != SUCCESS:
                break
            # The record must be complete before the next trigger, or that one is ignored and the count wrong.
            self._job.clock.sleep(2 * record_s + FORCED_PAUSE_S)
            if self._is_full(buffer, 0):
                return self.records_per_block - forced
            if self._job.clock.now_s() > end_s:
                break
        return 0


def _set_record_size(board: AlazarBoard, settings: Capture) -> None:
    pre = pre_trigger_samples(settings)
    board.call(board.library.AlazarSetRecordSize, pre, settings.record_samples - pre)


def missing_records_error(
    role: str, arrived: int, expected: int, deadline_s: float, captured: int | None = None
) -> DeadlineError:
    """Return the error for missing records; ``captured`` of them reached the board's memory."""
    unread = "" if captured is None or captured <= arrived else f" ({captured} captured, some in a part-filled buffer)"
    return DeadlineError(
        role,
        f"{arrived} of {expected} records delivered by the deadline at {deadline_s:.6g} s{unread}",
        "triggers are missing (a generator is off or untriggered, a cable is open, the level is too high) or came "
        "while the record before was still running",
        "check the trigger chain master, tracking_train, digitizer, trigger_level_v, and that delay and record fit "
        "the pulse period",
    )
