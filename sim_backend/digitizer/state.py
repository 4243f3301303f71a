"""State of a simulated board between the library's calls: settings, captures, records, AutoDMA; plain numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.digitizer import codes
from sim_backend.digitizer.auto_dma import BufferQueue, Transfer, clipped_status, timestamps
from sim_backend.digitizer.board import AcceptedTriggers, Arming, Board, BoardSettings, words
from sim_backend.digitizer.boards import BoardType
from sim_backend.digitizer.codes import Code
from sim_backend.digitizer.settings import MIN_POST_TRIGGER_SAMPLES, RECORD_OVERHEAD_SAMPLES, Changes
from sim_backend.settings import Instruments
from sim_backend.wiring import SimulatedClock

REGISTER_READ_PS = 1_000_000
"""Duration of a status query (assumed); without it a program that polls without sleeping would never end."""
PS_PER_MS = 1_000_000_000


class Recorder(Protocol):
    """Interface of the world for the library: time, the board, and the records of its last arming."""

    clock: SimulatedClock
    board: Board

    def arm(self, settings: BoardSettings) -> None: ...

    def triggers(self, until_ps: int) -> AcceptedTriggers: ...

    def volts(self, until_ps: int, records: slice, channel: int) -> FloatArray: ...

    def peak_v(self, until_ps: int, count: int) -> float: ...


class AlazarState:
    """One board, initially just reset."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        """Open the board: stop it and give it the settings after power-on."""
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
        """The type of board."""
        return self._board.type

    @property
    def dual_port(self) -> bool:
        """Whether records can be read during a capture."""
        return self.type.dual_port or self.instruments.dual_port_memory

    def has_channel(self, channel: int) -> bool:
        """Return whether ``channel``, a bit of a channel mask, is one of the board's inputs."""
        return channel in (1, 2, 4, 8)[: self.type.channels]

    @property
    def settings(self) -> BoardSettings:
        """The programmed settings."""
        return self._board.settings

    def capabilities(self) -> dict[int, int]:
        """Return the fixed properties of the board, by the numbers of the vendor's library."""
        dual_port = codes.OPTION_DUAL_PORT if self.dual_port else 0
        return {
            codes.CAPABILITY_SERIAL: self._board.serial_number or codes.SERIAL_NUMBER,
            codes.CAPABILITY_CALIBRATION: 10110,
            codes.CAPABILITY_MEMORY: self.instruments.samples_per_channel,
            codes.CAPABILITY_BOARD: self.type.kind,
            codes.CAPABILITY_FPGA: self.instruments.fpga_version,
            codes.CAPABILITY_OPTIONS: codes.OPTION_EXTERNAL_CLOCK | dual_port,
        }

    def parameters(self) -> dict[int, int]:
        """Return the states of board and transfer that can be queried, by the numbers of the vendor's library."""
        complete, queue = self._complete(), self._queue
        posted, full = (len(queue.posted), queue.full(complete)) if queue else (0, 0)
        return {
            codes.PARAMETER_DATA_WIDTH: self.type.bits,
            codes.PARAMETER_BUFFER_BYTES: queue.transfer.buffer_bytes if queue else 0,
            codes.PARAMETER_BUFFER_COUNT: posted,
            codes.PARAMETER_GET_FORMAT: int(self.settings.signed),
            codes.PARAMETER_SAMPLES_PER_TIMESTAMP: self.type.samples_per_count,
            codes.PARAMETER_RECORDS_CAPTURED: complete,
            codes.PARAMETER_MAX_PRETRIGGER: max(0, self.settings.record_samples - MIN_POST_TRIGGER_SAMPLES),
            codes.PARAMETER_BUFFERS_PENDING: posted,
            codes.PARAMETER_BUFFERS_FULL: full,
            codes.PARAMETER_BUFFERS_EMPTY: posted - full,
        }

    def change(self, changes: Changes) -> None:
        """Program the board."""
        self._board.settings = replace(self.settings, **changes)

    def reset_timestamp(self, option: int) -> None:
        """Start time stamps now and, depending on ``option``, at every arming."""
        self._reset_option, self._reset_ps = option, self._clock.now_ps

    def max_records(self, samples: int) -> int:
        """Return how many records of this length fit into the memory."""
        count = min(self.instruments.samples_per_channel // (samples + RECORD_OVERHEAD_SAMPLES), codes.MAX_RECORDS)
        return min(count, codes.MAX_RECORDS_OLD_FPGA) if self._old_fpga else count

    def count_refusal(self, count: int) -> Code:
        """Return success if a capture into the board's memory can have ``count`` records, else the error code."""
        if self._old_fpga and count > codes.MAX_RECORDS_OLD_FPGA:
            return Code.TOO_MANY_RECORDS
        return Code.SUCCESS if 1 <= count <= self.max_records(self.settings.record_samples) else Code.INVALID_SIZE

    def start(self) -> Code:
        """Start the capture, which waits for triggers."""
        if self._board.running and self._queue is not None:
            return Code.SUCCESS
        if not self.settings.record_samples:
            return Code.NOT_INITIALIZED
        refusal = Code.SUCCESS if self._queue is not None else self.count_refusal(self.settings.record_count)
        if refusal is Code.SUCCESS:
            self._arm()
        return refusal

    def stop(self) -> None:
        """End the capture."""
        self._board.stop(self._clock.now_ps)

    def force_trigger(self) -> None:
        """Trigger the running capture by software; the call takes time."""
        self._board.force_trigger(self._clock.now_ps)
        self._clock.now_ps += REGISTER_READ_PS

    def busy(self) -> bool:
        """Return whether a capture is running; the query takes time."""
        self._clock.now_ps += REGISTER_READ_PS
        return self._is_busy()

    def status(self) -> int:
        """Return the status bits of the last capture: clipped channels; 0 without complete records."""
        complete = self._complete()
        if not complete:
            return 0
        return clipped_status(self._arming, self._recorder.peak_v(self._clock.now_ps, complete))

    def record_refusal(self, record: int) -> Code:
        """Return success if ``record``, counted from 1, can be read from the board's memory, else the error code."""
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        if not self._board.armings or self._is_busy():
            return Code.FAILED
        return Code.SUCCESS if 1 <= record <= self._complete() else Code.INVALID_INDEX

    def timestamp_refusal(self, record: int) -> Code:
        """Return success if the time stamp of ``record`` can be read, else the error code."""
        if record > codes.MAX_STAMPED_RECORDS:
            return Code.RECORD_TOO_HIGH
        return self.record_refusal(record)

    def samples(self, channel: int, record: int, offset: int, count: int) -> bytes | None:
        """Return the bytes of ``count`` samples of a record of one channel; None if they are not all in the record.

        ``channel``: its bit in the vendor's library. ``offset``: first sample relative to the trigger.
        """
        settings = self._arming.settings
        start = settings.pre_samples + offset
        if start < 0 or start + count > settings.record_samples:
            return None
        number = channel.bit_length() - 1
        volts = self._recorder.volts(self._clock.now_ps, slice(record - 1, record), number)
        return words(volts[0, start : start + count], settings.inputs[number], settings).tobytes()

    def timestamp(self, record: int) -> int:
        """Return the trigger time of a record in sample clock periods, in whole steps of the board's counter."""
        triggers = self._recorder.triggers(self._clock.now_ps)
        return int(self._stamps(triggers, slice(record - 1, record))[0]) * self.type.samples_per_count

    def begin_transfer(self, transfer: Transfer, offset: int) -> Code:
        """Prepare AutoDMA, the transfer of records into buffers of the program; return success or refusal.

        The capture starts at once, unless the program asks to start it by AlazarStartCapture.
        """
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        refusal = transfer.refusal(self.settings, offset) if self.dual_port else Code.UNSUPPORTED_FUNCTION
        if refusal is not Code.SUCCESS:
            return refusal
        self._queue = BufferQueue(
            transfer,
            self.instruments.samples_per_channel // (transfer.record_samples + RECORD_OVERHEAD_SAMPLES),
            self.type.max_buffer_bytes,
        )
        if not transfer.flags & codes.ADMA_EXTERNAL_STARTCAPTURE:
            self._arm()
        return Code.SUCCESS

    def post_buffer(self, address: int, size: int) -> Code:
        """Append a buffer of the program to the queue of the transfer; return success or the error code."""
        if self._queue is None:
            return Code.NOT_INITIALIZED
        if self._board.running:
            self._queue.update_overflow(self._complete())
        return self._queue.post(address, size)

    def wait_for_buffer(self, address: int, timeout_ms: int) -> Code:
        """Advance the clock until the buffer at ``address`` is full and fill it, or until the time-out.

        Return success or the error code.
        """
        if self._queue is None:
            return Code.BUFFER_NOT_READY
        refusal = self._queue.wait_refusal(address)
        if refusal is not Code.SUCCESS:
            return refusal
        # Nothing can fill a buffer while no capture runs.
        deadline_ps = self._clock.now_ps + timeout_ms * PS_PER_MS
        if not self._board.running:
            self._clock.advance_to(deadline_ps)
            return Code.WAIT_TIMEOUT
        self._queue.update_overflow(self._complete())
        if self._queue.overflowed:
            return Code.BUFFER_OVERFLOW
        triggers = self._recorder.triggers(deadline_ps)
        full_ps = self._queue.head_full_ps(triggers)
        if full_ps is None or full_ps > deadline_ps:
            self._clock.advance_to(deadline_ps)
            return Code.WAIT_TIMEOUT
        # The volts are computed before the clock advances, with the settings of now.
        records = self._queue.next_records
        volts = [self._recorder.volts(deadline_ps, records, channel) for channel in self._queue.transfer.channels]
        self._clock.advance_to(full_ps)
        self._queue.deliver(self._arming, triggers, volts, self._stamps(triggers, records))
        return Code.SUCCESS

    def end_transfer(self) -> None:
        """End the capture and forget every buffer."""
        self.stop()
        self._queue = None

    @property
    def _arming(self) -> Arming:
        return self._board.armings[-1]

    @property
    def _old_fpga(self) -> bool:
        return self.instruments.fpga_version <= self.type.old_fpga

    def _stamps(self, triggers: AcceptedTriggers, records: slice) -> Int64Array:
        return timestamps(self._arming, triggers, records, self._reset_ps, self.instruments.trigger_faults)

    def _arm(self) -> None:
        """Arm the board with the present settings, and reset the time stamp if it is set to do so."""
        settings = self.settings
        if self._queue is not None:
            settings = replace(settings, record_count=self._queue.transfer.record_count)
        self._recorder.arm(settings)
        if self._reset_option == codes.TIMESTAMP_ALWAYS:
            self._reset_ps = self._clock.now_ps

    def _complete(self) -> int:
        """Return the number of complete records of the last capture."""
        if not self._board.armings:
            return 0
        return self._recorder.triggers(self._clock.now_ps).complete(min(self._clock.now_ps, self._arming.stop_ps))

    def _is_busy(self) -> bool:
        return self._board.running and self._complete() < self._arming.settings.record_count
