"""State of a simulated board as its library drives it: settings, captures, records, AutoDMA; plain numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.digitizer import codes
from sim_backend.digitizer.auto_dma import BufferQueue, Transfer, clipped_channels, timestamps
from sim_backend.digitizer.board import Arming, Board, BoardSettings, Taken, words
from sim_backend.digitizer.boards import BoardType
from sim_backend.digitizer.codes import Code
from sim_backend.digitizer.settings import Changes
from sim_backend.settings import Instruments
from sim_backend.wiring import SimulatedClock

REGISTER_READ_PS = 1_000_000
"""Time that a status query takes (assumed); without it a program that polls without sleeping would wait for ever."""
PS_PER_MS = 1_000_000_000


class Recorder(Protocol):
    """The world as the library needs it: time, the board, and the records of its last arming."""

    clock: SimulatedClock
    board: Board

    def arm(self, settings: BoardSettings) -> None: ...

    def taken(self, until_ps: int) -> Taken: ...

    def volts(self, until_ps: int, records: slice) -> FloatArray: ...

    def highest_v(self, until_ps: int, count: int) -> float: ...


class AlazarState:
    """One board that has just been reset."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        self.instruments = instruments
        self._recorder = recorder
        self._board = recorder.board
        self._clock = recorder.clock
        self._queue: BufferQueue | None = None
        self._reset_option = codes.TIMESTAMP_ALWAYS
        self._reset_ps = self._clock.now_ps
        self._board.stop(self._clock.now_ps)
        self._board.settings = BoardSettings(self._board.type)

    @property
    def type(self) -> BoardType:
        """Which board this is."""
        return self._board.type

    @property
    def dual_port(self) -> bool:
        """Whether records can leave the board while others come in."""
        return self.type.dual_port or self.instruments.dual_port_memory

    def has_channel(self, channel: int) -> bool:
        """Return whether ``channel``, a bit of a channel mask, is one of the board's inputs."""
        return channel in (1, 2, 4, 8)[: self.type.channels]

    @property
    def settings(self) -> BoardSettings:
        """What is programmed."""
        return self._board.settings

    def capabilities(self) -> dict[int, int]:
        """Return the fixed properties by their number."""
        dual_port = codes.OPTION_DUAL_PORT if self.dual_port else 0
        return {
            codes.CAPABILITY_SERIAL: codes.SERIAL_NUMBER,
            codes.CAPABILITY_CALIBRATION: 10110,
            codes.CAPABILITY_MEMORY: self.instruments.samples_per_channel,
            codes.CAPABILITY_BOARD: self.type.kind,
            codes.CAPABILITY_FPGA: self.instruments.fpga_version,
            codes.CAPABILITY_OPTIONS: codes.OPTION_EXTERNAL_CLOCK | dual_port,
        }

    def parameters(self) -> dict[int, int]:
        """Return what can be asked for, by its number."""
        complete, queue = self._complete(), self._queue
        posted, full = (len(queue.posted), queue.full(complete)) if queue else (0, 0)
        return {
            codes.PARAMETER_DATA_WIDTH: self.type.bits,
            codes.PARAMETER_BUFFER_BYTES: queue.transfer.buffer_bytes if queue else 0,
            codes.PARAMETER_BUFFER_COUNT: posted,
            codes.PARAMETER_GET_FORMAT: int(self.settings.signed),
            codes.PARAMETER_SAMPLES_PER_TIMESTAMP: self.type.samples_per_count,
            codes.PARAMETER_RECORDS_CAPTURED: complete,
            codes.PARAMETER_MOST_PRETRIGGER: max(0, self.settings.record_samples - 64),
            codes.PARAMETER_BUFFERS_PENDING: posted,
            codes.PARAMETER_BUFFERS_FULL: full,
            codes.PARAMETER_BUFFERS_EMPTY: posted - full,
        }

    def change(self, changes: Changes) -> None:
        """Program the board."""
        self._board.settings = replace(self.settings, **changes)

    def reset_timestamp(self, option: int) -> None:
        """Let time stamps start now and, as ``option`` says, at every arming."""
        self._reset_option, self._reset_ps = option, self._clock.now_ps

    def most_records(self, samples: int) -> int:
        """Return how many records of this length fit the memory."""
        most = min(self.instruments.samples_per_channel // (samples + 16), codes.MOST_RECORDS)
        return min(most, codes.MOST_RECORDS_OLD_FPGA) if self._old_fpga else most

    def refuse_count(self, count: int) -> Code:
        """Return whether a single-port capture can have ``count`` records."""
        if self._old_fpga and count > codes.MOST_RECORDS_OLD_FPGA:
            return Code.TOO_MANY_RECORDS
        return Code.SUCCESS if 1 <= count <= self.most_records(self.settings.record_samples) else Code.INVALID_SIZE

    def start(self) -> Code:
        """Wait for triggers from now on."""
        if self._board.running and self._queue is not None:
            return Code.SUCCESS
        if not self.settings.record_samples:
            return Code.NOT_INITIALIZED
        refusal = Code.SUCCESS if self._queue is not None else self.refuse_count(self.settings.record_count)
        if refusal is Code.SUCCESS:
            self._arm()
        return refusal

    def stop(self) -> None:
        """End the capture."""
        self._board.stop(self._clock.now_ps)

    def busy(self) -> bool:
        """Return, after the time that asking takes, whether a capture is running."""
        self._clock.now_ps += REGISTER_READ_PS
        return self._is_busy()

    def status(self) -> int:
        """Return the status bits of the last capture."""
        complete = self._complete()
        if not complete:
            return 0
        timed_out = self._arming.settings.timeout_ticks and np.any(
            self._recorder.taken(self._clock.now_ps).by[:complete] == codes.TRIGGERED_BY_TIMEOUT
        )
        highest_v = self._recorder.highest_v(self._clock.now_ps, complete)
        return int(timed_out) | clipped_channels(self._arming, highest_v)

    def refuse_record(self, record: int) -> Code:
        """Return whether ``record``, counted from 1, can be read from the memory."""
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        if not self._board.armings or self._is_busy():
            return Code.FAILED
        return Code.SUCCESS if 1 <= record <= self._complete() else Code.INVALID_INDEX

    def refuse_timestamp(self, record: int) -> Code:
        """Return whether ``record`` has a time stamp that can be read."""
        if record > codes.MOST_STAMPED_RECORDS:
            return Code.RECORD_TOO_HIGH
        return self.refuse_record(record)

    def samples(self, channel: int, record: int, offset: int, count: int) -> bytes | None:
        """Return ``count`` samples of a record of one channel as it lies in memory; None where it has none."""
        settings = self._arming.settings
        start = settings.pre_samples + offset
        if start < 0 or start + count > settings.record_samples:
            return None
        volts = self._recorder.volts(self._clock.now_ps, slice(record - 1, record))[0, start : start + count]
        at_input = volts if channel == 1 else np.zeros_like(volts)
        return words(at_input, settings.inputs[channel.bit_length() - 1], settings).tobytes()

    def timestamp(self, record: int) -> int:
        """Return when a record was triggered, in sample clock periods, as finely as the counter behind it counts."""
        taken = self._recorder.taken(self._clock.now_ps)
        count = int(timestamps(self._arming, taken.tick_ps[record - 1 : record], self._reset_ps)[0])
        return count * self.type.samples_per_count

    def begin_transfer(self, transfer: Transfer, offset: int) -> Code:
        """Prepare AutoDMA, and start it at once where the program does not do so itself."""
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        refusal = transfer.refusal(self.settings, offset) if self.dual_port else Code.UNSUPPORTED_FUNCTION
        if refusal is not Code.SUCCESS:
            return refusal
        self._queue = BufferQueue(
            transfer,
            self.instruments.samples_per_channel // (transfer.record_samples + 16),
            self.type.most_buffer_bytes,
        )
        if not transfer.flags & codes.ADMA_EXTERNAL_STARTCAPTURE:
            self._arm()
        return Code.SUCCESS

    def post_buffer(self, address: int, size: int) -> Code:
        """Take a buffer to write into."""
        if self._queue is None:
            return Code.NOT_INITIALIZED
        if self._board.running:
            self._queue.notice_overflow(self._complete())
        return self._queue.post(address, size)

    def wait_for_buffer(self, address: int, timeout_ms: int) -> Code:
        """Fill the buffer and let time pass until it is full, or until the time-out."""
        if self._queue is None:
            return Code.BUFFER_NOT_READY
        refusal = self._queue.turn_of(address)
        if refusal is not Code.SUCCESS:
            return refusal
        deadline_ps = self._clock.now_ps + timeout_ms * PS_PER_MS
        if not self._board.running:
            self._clock.advance_to(deadline_ps)
            return Code.WAIT_TIMEOUT
        self._queue.notice_overflow(self._complete())
        if self._queue.overflowed:
            return Code.BUFFER_OVERFLOW
        taken = self._recorder.taken(deadline_ps)
        filled_ps = self._queue.filled_ps(taken)
        if filled_ps is None or filled_ps > deadline_ps:
            self._clock.advance_to(deadline_ps)
            return Code.WAIT_TIMEOUT
        volts = self._recorder.volts(deadline_ps, self._queue.next_records)
        self._clock.advance_to(filled_ps)
        self._queue.deliver(self._arming, taken, volts, self._reset_ps)
        return Code.SUCCESS

    def end_transfer(self) -> None:
        """End the capture and let go of every buffer."""
        self.stop()
        self._queue = None

    @property
    def _arming(self) -> Arming:
        return self._board.armings[-1]

    @property
    def _old_fpga(self) -> bool:
        return self.instruments.fpga_version <= self.type.old_fpga

    def _arm(self) -> None:
        settings = self.settings
        if self._queue is not None:
            settings = replace(settings, record_count=self._queue.transfer.record_count)
        self._recorder.arm(settings)
        if self._reset_option == codes.TIMESTAMP_ALWAYS:
            self._reset_ps = self._clock.now_ps

    def _complete(self) -> int:
        if not self._board.armings:
            return 0
        return self._recorder.taken(self._clock.now_ps).complete(min(self._clock.now_ps, self._arming.stop_ps))

    def _is_busy(self) -> bool:
        return self._board.running and self._complete() < self._arming.settings.record_count
