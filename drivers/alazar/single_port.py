"""Single-port capture: all records into the board's memory first, then read one by one."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from drivers.alazar import api
from drivers.alazar.api import Channel, Parameter
from drivers.alazar.board import AlazarBoard
from drivers.alazar.limits import BUFFER_WANTED_BYTES, pre_trigger_samples
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.samples import RawRecords
from drivers.interfaces import Capture, Clock, DeadlineError, InstrumentError

POLL_S: Final = 0.01
WORD_BYTES: Final = 2
# The board may write this many samples more than asked for.
READ_MARGIN_SAMPLES: Final = 16


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
        self.records_per_block = min(
            capture.record_count, max(1, BUFFER_WANTED_BYTES // (WORD_BYTES * capture.record_samples))
        )

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
        buffer = self._allocate(WORD_BYTES * (samples + READ_MARGIN_SAMPLES))
        try:
            for first in range(0, arrived, self.records_per_block):
                indices = range(first, min(first + self.records_per_block, arrived))
                words = np.stack(
                    [[self._words(buffer, channel, index) for index in indices] for channel in self._channels]
                )
                yield RawRecords(first, words, np.array([self._count(index) for index in indices], np.int64))
        finally:
            buffer.free()

    def _words(self, buffer: PageBuffer, channel: Channel, index: int) -> NDArray[np.uint16]:
        board, samples = self._board, self._capture.record_samples
        offset = -pre_trigger_samples(self._capture)
        # The vendor counts records from 1.
        board.call(board.library.AlazarRead, int(channel), buffer.address, WORD_BYTES, index + 1, offset, samples)
        return buffer.copy(np.dtype("<u2"), samples).astype(np.uint16, copy=False)

    def _count(self, index: int) -> int:
        count = ctypes.c_uint64()
        self._board.call(self._board.library.AlazarGetTriggerTimestamp, index + 1, ctypes.byref(count))
        return int(count.value)


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
