"""The ATSApi function table over a simulated ATS460: named, called and answering as the vendor's library.

Out-parameters are ``ctypes.byref`` objects, buffers addresses or ``c_void_p``, scalars ints or ctypes scalars.
Every function answers a return code or the value its C form returns (reference, 2.3 and 2.5 to 2.9).
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim_backend import alazar_codes as codes
from sim_backend import alazar_settings
from sim_backend.alazar_arguments import address_of, number_of, pointee_of
from sim_backend.alazar_codes import Code
from sim_backend.alazar_settings import Changes
from sim_backend.auto_dma import BufferQueue, Transfer, clipped_channels, timestamps
from sim_backend.board_ats460 import Arming, Board, BoardSettings, Taken, words
from sim_backend.clock import SimulatedClock
from sim_backend.settings import Instruments

HANDLE = 0x460
REGISTER_READ_PS = 1_000_000
"""Time that a status query takes (assumed); without it a program that polls without sleeping would wait for ever."""


class Recorder(Protocol):
    """The world as the library needs it: time, the board, and the records of its last arming."""

    clock: SimulatedClock
    board: Board

    def arm(self, settings: BoardSettings) -> None: ...

    def taken(self, until_ps: int) -> Taken: ...

    def volts(self, until_ps: int) -> NDArray[np.float64]: ...


class AlazarLibrary:
    """The vendor's library, with one board; loading it resets the board."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        self._instruments = instruments
        self._recorder = recorder
        self._board = recorder.board
        self._clock = recorder.clock
        self._queue: BufferQueue | None = None
        self._reset_option = codes.TIMESTAMP_ALWAYS
        self._reset_ps = self._clock.now_ps
        self._board.stop(self._clock.now_ps)
        self._board.settings = BoardSettings()

    # Systems and boards

    def AlazarNumOfSystems(self) -> int:
        return 1

    def AlazarBoardsInSystemBySystemID(self, system: Any) -> int:
        return 1 if number_of(system) == 1 else 0

    def AlazarGetBoardBySystemID(self, system: Any, board: Any) -> int | None:
        return HANDLE if (number_of(system), number_of(board)) == (1, 1) else None

    def AlazarGetBoardKind(self, handle: Any) -> int:
        return codes.BOARD_KIND if number_of(handle) == HANDLE else 0

    def AlazarGetChannelInfo(self, handle: Any, samples: Any, bits: Any) -> int:
        return self._answer(handle, (samples, self._instruments.samples_per_channel), (bits, codes.RESOLUTION_BITS))

    def AlazarGetSDKVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.SDK_VERSION, strict=True))

    def AlazarGetDriverVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.DRIVER_VERSION, strict=True))

    def AlazarErrorToText(self, code: Any) -> bytes:
        return codes.text_of(number_of(code)).encode("ascii")

    def AlazarQueryCapability(self, handle: Any, capability: Any, reserved: Any, value: Any) -> int:
        dual_port = codes.OPTION_DUAL_PORT if self._instruments.dual_port_memory else 0
        known = {
            codes.CAPABILITY_SERIAL: codes.SERIAL_NUMBER,
            codes.CAPABILITY_CALIBRATION: 10110,
            codes.CAPABILITY_MEMORY: self._instruments.samples_per_channel,
            codes.CAPABILITY_BOARD: codes.BOARD_KIND,
            codes.CAPABILITY_FPGA: self._instruments.fpga_version,
            codes.CAPABILITY_OPTIONS: codes.OPTION_EXTERNAL_CLOCK | dual_port,
        }
        return self._answer_known(handle, known, capability, value)

    def AlazarGetParameter(self, handle: Any, channel: Any, parameter: Any, value: Any) -> int:
        complete = self._complete() if self._board.armings else 0
        queue = self._queue
        posted, full = (len(queue.posted), queue.full(complete)) if queue else (0, 0)
        known = {
            codes.PARAMETER_DATA_WIDTH: codes.RESOLUTION_BITS,
            codes.PARAMETER_BUFFER_BYTES: queue.transfer.buffer_bytes if queue else 0,
            codes.PARAMETER_BUFFER_COUNT: posted,
            codes.PARAMETER_GET_FORMAT: int(self._board.settings.signed),
            codes.PARAMETER_SAMPLES_PER_TIMESTAMP: codes.SAMPLES_PER_TIMESTAMP,
            codes.PARAMETER_RECORDS_CAPTURED: complete,
            codes.PARAMETER_MOST_PRETRIGGER: max(0, self._board.settings.record_samples - 64),
            codes.PARAMETER_BUFFERS_PENDING: posted,
            codes.PARAMETER_BUFFERS_FULL: full,
            codes.PARAMETER_BUFFERS_EMPTY: posted - full,
        }
        return self._answer_known(handle, known, parameter, value)

    # Settings

    def AlazarSetParameter(self, handle: Any, channel: Any, parameter: Any, value: Any) -> int:
        if number_of(handle) == HANDLE and number_of(parameter) != codes.PARAMETER_SET_FORMAT:
            return Code.UNSUPPORTED_FUNCTION
        return self._set(handle, {"signed": bool(number_of(value))} if number_of(value) in (0, 1) else None)

    def AlazarSetCaptureClock(self, handle: Any, source: Any, rate: Any, edge: Any, decimation: Any) -> int:
        return self._set(handle, alazar_settings.capture_clock(*map(number_of, (source, rate, edge, decimation))))

    def AlazarInputControl(self, handle: Any, channel: Any, coupling: Any, range_id: Any, impedance: Any) -> int:
        if number_of(handle) == HANDLE and number_of(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        values = map(number_of, (channel, coupling, range_id, impedance))
        return self._set(handle, alazar_settings.input_control(self._board.settings, *values))

    def AlazarSetBWLimit(self, handle: Any, channel: Any, on: Any) -> int:
        return self._set(handle, {} if number_of(channel) in (1, 2) and number_of(on) in (0, 1) else None)

    def AlazarSetTriggerOperation(self, handle: Any, operation: Any, *engines: Any) -> int:
        values = [number_of(value) for value in engines]
        return self._set(handle, alazar_settings.trigger_operation(number_of(operation), values))

    def AlazarSetExternalTrigger(self, handle: Any, coupling: Any, range_id: Any) -> int:
        return self._set(handle, alazar_settings.external_trigger(number_of(coupling), number_of(range_id)))

    def AlazarSetTriggerDelay(self, handle: Any, samples: Any) -> int:
        delay = alazar_settings.within("delay_samples", number_of(samples), 0, codes.MOST_DELAY_SAMPLES)
        return self._set(handle, delay)

    def AlazarSetTriggerTimeOut(self, handle: Any, ticks: Any) -> int:
        return self._set(handle, alazar_settings.within("timeout_ticks", number_of(ticks), 0, 0xFFFFFFFF))

    def AlazarConfigureAuxIO(self, handle: Any, mode: Any, parameter: Any) -> int:
        return self._set(handle, {"aux_mode": number_of(mode)} if number_of(mode) in codes.AUX_MODES else None)

    def AlazarResetTimeStamp(self, handle: Any, option: Any) -> int:
        valid = number_of(option) in (codes.TIMESTAMP_FIRST_TIME_ONLY, codes.TIMESTAMP_ALWAYS)
        answer = self._set(handle, {} if valid else None)
        if answer == Code.SUCCESS:
            self._reset_option, self._reset_ps = number_of(option), self._clock.now_ps
        return answer

    def AlazarSetRecordSize(self, handle: Any, pre: Any, post: Any) -> int:
        most = self._instruments.samples_per_channel
        return self._set(handle, alazar_settings.record_size(number_of(pre), number_of(post), most), Code.INVALID_SIZE)

    def AlazarSetRecordCount(self, handle: Any, count: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        refusal = self._refuse_count(number_of(count))
        return self._set(handle, {"record_count": number_of(count)} if refusal is Code.SUCCESS else None, refusal)

    def AlazarGetMaxRecordsCapable(self, handle: Any, samples: Any, most: Any) -> int:
        if number_of(handle) == HANDLE and number_of(samples) < 1:
            return Code.INVALID_SIZE
        return self._answer(handle, (most, self._most_records(number_of(samples))))

    # Capture

    def AlazarStartCapture(self, handle: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._board.running and self._queue is not None:
            return Code.SUCCESS
        if not self._board.settings.record_samples:
            return Code.NOT_INITIALIZED
        if self._queue is None:
            refusal = self._refuse_count(self._board.settings.record_count)
            if refusal is not Code.SUCCESS:
                return refusal
        self._arm()
        return Code.SUCCESS

    def AlazarAbortCapture(self, handle: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        self._board.stop(self._clock.now_ps)
        return Code.SUCCESS

    def AlazarBusy(self, handle: Any) -> int:
        self._clock.now_ps += REGISTER_READ_PS
        return int(number_of(handle) == HANDLE and self._is_busy())

    def AlazarTriggered(self, handle: Any) -> int:
        self._clock.now_ps += REGISTER_READ_PS
        if number_of(handle) != HANDLE or not self._board.armings:
            return 0
        tick_ps = self._recorder.taken(self._clock.now_ps).tick_ps
        return int(tick_ps.size > 0 and tick_ps[0] <= self._clock.now_ps)

    def AlazarGetStatus(self, handle: Any) -> int:
        if number_of(handle) != HANDLE:
            return 0xFFFFFFFF
        complete = self._complete() if self._board.armings else 0
        if not complete:
            return 0
        timed_out = np.any(self._recorder.taken(self._clock.now_ps).by[:complete] == codes.TRIGGERED_BY_TIMEOUT)
        return int(timed_out) | clipped_channels(self._arming, self._recorder.volts(self._clock.now_ps)[:complete])

    def AlazarRead(
        self, handle: Any, channel: Any, buffer: Any, element_bytes: Any, record: Any, offset: Any, count: Any
    ) -> int:
        refusal = self._refuse_record(handle, record)
        address = address_of(buffer)
        if refusal is not Code.SUCCESS:
            return refusal
        if not address:
            return Code.NULL_PARAM
        if number_of(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        settings = self._arming.settings
        start, length = settings.pre_samples + number_of(offset), number_of(count)
        if number_of(element_bytes) != 2 or length < 1:
            return Code.INVALID_SIZE
        if start < 0 or start + length > settings.record_samples:
            return Code.INVALID_OFFSET
        volts = self._recorder.volts(self._clock.now_ps)[number_of(record) - 1, start : start + length]
        index = number_of(channel) - 1
        data = words(volts if index == 0 else np.zeros_like(volts), settings.inputs[index], settings.signed)
        ctypes.memmove(address, data.tobytes(), 2 * length)
        return Code.SUCCESS

    def AlazarGetTriggerAddress(self, handle: Any, record: Any, address: Any, high: Any, low: Any) -> int:
        refusal = self._refuse_record(handle, record)
        if refusal is not Code.SUCCESS:
            return refusal
        count, start = self._timestamp(record), (number_of(record) - 1) * (self._arming.settings.record_samples + 16)
        return self._answer(handle, (address, start), (high, count >> 8), (low, count & 0xFF))

    def AlazarGetTriggerTimestamp(self, handle: Any, record: Any, timestamp: Any) -> int:
        if self._instruments.fpga_version <= codes.OLD_FPGA and number_of(record) > codes.MOST_RECORDS_OLD_FPGA:
            return Code.RECORD_TOO_HIGH
        refusal = self._refuse_record(handle, record)
        return refusal if refusal is not Code.SUCCESS else self._answer(handle, (timestamp, self._timestamp(record)))

    def AlazarGetWhoTriggeredBySystemID(self, system: Any, board: Any, record: Any) -> int:
        if self._refuse_record(self.AlazarGetBoardBySystemID(system, board), record) is not Code.SUCCESS:
            return 0
        return int(self._recorder.taken(self._clock.now_ps).by[number_of(record) - 1])

    # Dual port

    def AlazarBeforeAsyncRead(
        self, handle: Any, channels: Any, offset: Any, samples: Any, per_buffer: Any, per_acquisition: Any, flags: Any
    ) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        mask = {1: (0,), 2: (1,), 3: (0, 1)}.get(number_of(channels), ())
        transfer = Transfer(mask, *map(number_of, (samples, per_buffer, per_acquisition, flags)))
        settings, dual_port = self._board.settings, self._instruments.dual_port_memory
        refusal = transfer.refusal(settings, number_of(offset)) if dual_port else Code.UNSUPPORTED_FUNCTION
        if refusal is not Code.SUCCESS:
            return refusal
        self._queue = BufferQueue(transfer, self._instruments.samples_per_channel // (transfer.record_samples + 16))
        if not transfer.flags & codes.ADMA_EXTERNAL_STARTCAPTURE:
            self._arm()
        return Code.SUCCESS

    def AlazarPostAsyncBuffer(self, handle: Any, buffer: Any, size: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is None:
            return Code.NOT_INITIALIZED
        if self._board.running:
            self._queue.notice_overflow(self._complete())
        return self._queue.post(address_of(buffer), number_of(size))

    def AlazarWaitAsyncBufferComplete(self, handle: Any, buffer: Any, timeout_ms: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is None:
            return Code.BUFFER_NOT_READY
        refusal = self._queue.turn_of(address_of(buffer))
        if refusal is not Code.SUCCESS:
            return refusal
        deadline_ps = self._clock.now_ps + number_of(timeout_ms) * 1_000_000_000
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
        volts = self._recorder.volts(deadline_ps)
        self._clock.advance_to(filled_ps)
        self._queue.deliver(self._arming, taken, volts, self._reset_ps)
        return Code.SUCCESS

    def AlazarAbortAsyncRead(self, handle: Any) -> int:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        self._board.stop(self._clock.now_ps)
        self._queue = None
        return Code.SUCCESS

    # What the functions above share

    @property
    def _arming(self) -> Arming:
        return self._board.armings[-1]

    def _arm(self) -> None:
        settings = self._board.settings
        if self._queue is not None:
            settings = replace(settings, record_count=self._queue.transfer.record_count)
        self._recorder.arm(settings)
        if self._reset_option == codes.TIMESTAMP_ALWAYS:
            self._reset_ps = self._clock.now_ps

    def _complete(self) -> int:
        return self._recorder.taken(self._clock.now_ps).complete(min(self._clock.now_ps, self._arming.stop_ps))

    def _is_busy(self) -> bool:
        return self._board.running and self._complete() < self._arming.settings.record_count

    def _timestamp(self, record: Any) -> int:
        taken = self._recorder.taken(self._clock.now_ps)
        return int(timestamps(self._arming, taken, self._reset_ps)[number_of(record) - 1])

    def _most_records(self, samples: int) -> int:
        most = min(self._instruments.samples_per_channel // (samples + 16), codes.MOST_RECORDS)
        return min(most, codes.MOST_RECORDS_OLD_FPGA) if self._instruments.fpga_version <= codes.OLD_FPGA else most

    def _refuse_count(self, count: int) -> Code:
        if self._instruments.fpga_version <= codes.OLD_FPGA and count > codes.MOST_RECORDS_OLD_FPGA:
            return Code.TOO_MANY_RECORDS
        return (
            Code.SUCCESS if 1 <= count <= self._most_records(self._board.settings.record_samples) else Code.INVALID_SIZE
        )

    def _refuse_record(self, handle: Any, record: Any) -> Code:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        if not self._board.armings or self._is_busy():
            return Code.FAILED
        return Code.SUCCESS if 1 <= number_of(record) <= self._complete() else Code.INVALID_INDEX

    def _set(self, handle: Any, changes: Changes | None, refusal: Code = Code.FAILED) -> Code:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if changes is None:
            return refusal
        self._board.settings = replace(self._board.settings, **changes)
        return Code.SUCCESS

    def _answer(self, handle: Any, *values: tuple[Any, int]) -> Code:
        if number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if any(target is None for target, _ in values):
            return Code.NULL_PARAM
        for target, value in values:
            pointee_of(target).value = value
        return Code.SUCCESS

    def _answer_known(self, handle: Any, known: dict[int, int], key: Any, target: Any) -> Code:
        if number_of(handle) == HANDLE and number_of(key) not in known:
            return Code.UNSUPPORTED_FUNCTION
        return self._answer(handle, (target, known.get(number_of(key), 0)))
