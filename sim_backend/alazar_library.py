"""The ATSApi function table over a simulated ATS460: named, called and answering as the vendor's library.

Out-parameters are ``ctypes.byref`` objects, buffers addresses or ``c_void_p``, scalars ints or ctypes scalars.
Every function answers a return code or the value its C form returns (reference, 2.3 and 2.5 to 2.9).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim_backend import alazar_codes as codes
from sim_backend.alazar_codes import Code
from sim_backend.auto_dma import BufferQueue, Transfer, clipped_channels, timestamps
from sim_backend.board_ats460 import Arming, Board, BoardSettings, Engine, Input, Taken, words
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
        return 1 if _number(system) == 1 else 0

    def AlazarGetBoardBySystemID(self, system: Any, board: Any) -> int | None:
        return HANDLE if (_number(system), _number(board)) == (1, 1) else None

    def AlazarGetBoardKind(self, handle: Any) -> int:
        return codes.BOARD_KIND if _number(handle) == HANDLE else 0

    def AlazarGetChannelInfo(self, handle: Any, samples: Any, bits: Any) -> int:
        return self._answer(handle, (samples, self._instruments.samples_per_channel), (bits, codes.RESOLUTION_BITS))

    def AlazarGetSDKVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.SDK_VERSION, strict=True))

    def AlazarGetDriverVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.DRIVER_VERSION, strict=True))

    def AlazarErrorToText(self, code: Any) -> bytes:
        return codes.text_of(_number(code)).encode("ascii")

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

    def AlazarSetParameter(self, handle: Any, channel: Any, parameter: Any, value: Any) -> int:
        if _number(handle) == HANDLE and _number(parameter) != codes.PARAMETER_SET_FORMAT:
            return Code.UNSUPPORTED_FUNCTION
        return self._set(handle, _number(value) in (0, 1), lambda: {"signed": bool(_number(value))})

    # Settings

    def AlazarSetCaptureClock(self, handle: Any, source: Any, rate: Any, edge: Any, decimation: Any) -> int:
        valid = _number(source) == 1 and _number(edge) in (0, 1) and _number(decimation) == 0
        valid = valid and _number(rate) in codes.SAMPLE_RATES_HZ
        return self._set(handle, valid, lambda: {"sample_rate_hz": codes.SAMPLE_RATES_HZ[_number(rate)]})

    def AlazarInputControl(self, handle: Any, channel: Any, coupling: Any, range_id: Any, impedance: Any) -> int:
        if _number(handle) == HANDLE and _number(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        highest = {
            codes.IMPEDANCE_1_MOHM: max(codes.INPUT_RANGES_V),
            codes.IMPEDANCE_50_OHM: codes.HIGHEST_50_OHM_RANGE,
        }
        valid = _number(coupling) in (1, 2) and 1 <= _number(range_id) <= highest.get(_number(impedance), 0)

        def inputs() -> dict[str, object]:
            changed = list(self._board.settings.inputs)
            changed[_number(channel) - 1] = Input(codes.INPUT_RANGES_V[_number(range_id)], _number(impedance))
            return {"inputs": tuple(changed)}

        return self._set(handle, valid, inputs)

    def AlazarSetBWLimit(self, handle: Any, channel: Any, on: Any) -> int:
        return self._set(handle, _number(channel) in (1, 2) and _number(on) in (0, 1), dict)

    def AlazarSetTriggerOperation(self, handle: Any, operation: Any, *engines: Any) -> int:
        values = [_number(value) for value in engines]
        first, second = values[:4], values[4:]
        valid = len(values) == 8 and 0 <= _number(operation) <= 6 and {first[0], second[0]} == {0, 1}
        valid = valid and all(
            source in (0, 1, 2, 3) and slope in (1, 2) and 0 <= level <= 255
            for _, source, slope, level in (first, second)
        )

        def operation_and_engines() -> dict[str, object]:
            by_engine = {engine[0]: Engine(*engine[1:]) for engine in (first, second)}
            return {"operation": _number(operation), "engines": (by_engine[0], by_engine[1])}

        return self._set(handle, valid, operation_and_engines)

    def AlazarSetExternalTrigger(self, handle: Any, coupling: Any, range_id: Any) -> int:
        valid = _number(coupling) in (1, 2) and _number(range_id) in codes.EXTERNAL_RANGES_V
        return self._set(handle, valid, lambda: {"external_range_v": codes.EXTERNAL_RANGES_V[_number(range_id)]})

    def AlazarSetTriggerDelay(self, handle: Any, samples: Any) -> int:
        valid = 0 <= _number(samples) <= codes.MOST_DELAY_SAMPLES
        return self._set(handle, valid, lambda: {"delay_samples": _number(samples)})

    def AlazarSetTriggerTimeOut(self, handle: Any, ticks: Any) -> int:
        return self._set(handle, _number(ticks) >= 0, lambda: {"timeout_ticks": _number(ticks)})

    def AlazarConfigureAuxIO(self, handle: Any, mode: Any, parameter: Any) -> int:
        return self._set(handle, _number(mode) in codes.AUX_MODES, lambda: {"aux_mode": _number(mode)})

    def AlazarResetTimeStamp(self, handle: Any, option: Any) -> int:
        valid = _number(option) in (codes.TIMESTAMP_FIRST_TIME_ONLY, codes.TIMESTAMP_ALWAYS)
        answer = self._set(handle, valid, dict)
        if answer == Code.SUCCESS:
            self._reset_option, self._reset_ps = _number(option), self._clock.now_ps
        return answer

    def AlazarSetRecordSize(self, handle: Any, pre: Any, post: Any) -> int:
        samples = _number(pre) + _number(post)
        valid = samples >= 128 and samples % 16 == 0 and _number(pre) % 64 == 0 and 0 <= _number(pre) <= samples - 64
        valid = valid and samples + 16 <= self._instruments.samples_per_channel
        sizes = {"pre_samples": _number(pre), "post_samples": _number(post)}
        return self._set(handle, valid, lambda: sizes, Code.INVALID_SIZE)

    def AlazarSetRecordCount(self, handle: Any, count: Any) -> int:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        refusal = self._refuse_count(_number(count))
        return self._set(handle, refusal is Code.SUCCESS, lambda: {"record_count": _number(count)}, refusal)

    def AlazarGetMaxRecordsCapable(self, handle: Any, samples: Any, most: Any) -> int:
        if _number(handle) == HANDLE and _number(samples) < 1:
            return Code.INVALID_SIZE
        return self._answer(handle, (most, self._most_records(_number(samples))))

    # Capture

    def AlazarStartCapture(self, handle: Any) -> int:
        if _number(handle) != HANDLE:
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
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        self._board.stop(self._clock.now_ps)
        return Code.SUCCESS

    def AlazarBusy(self, handle: Any) -> int:
        self._clock.now_ps += REGISTER_READ_PS
        return int(_number(handle) == HANDLE and self._is_busy())

    def AlazarTriggered(self, handle: Any) -> int:
        self._clock.now_ps += REGISTER_READ_PS
        if _number(handle) != HANDLE or not self._board.armings:
            return 0
        tick_ps = self._recorder.taken(self._clock.now_ps).tick_ps
        return int(tick_ps.size > 0 and tick_ps[0] <= self._clock.now_ps)

    def AlazarGetStatus(self, handle: Any) -> int:
        if _number(handle) != HANDLE:
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
        address = _address(buffer)
        if refusal is not Code.SUCCESS:
            return refusal
        if not address:
            return Code.NULL_PARAM
        if _number(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        settings = self._arming.settings
        start, length = settings.pre_samples + _number(offset), _number(count)
        if _number(element_bytes) != 2 or length < 1:
            return Code.INVALID_SIZE
        if start < 0 or start + length > settings.record_samples:
            return Code.INVALID_OFFSET
        volts = self._recorder.volts(self._clock.now_ps)[_number(record) - 1, start : start + length]
        index = _number(channel) - 1
        data = words(volts if index == 0 else np.zeros_like(volts), settings.inputs[index], settings.signed)
        ctypes.memmove(address, data.tobytes(), 2 * length)
        return Code.SUCCESS

    def AlazarGetTriggerAddress(self, handle: Any, record: Any, address: Any, high: Any, low: Any) -> int:
        refusal = self._refuse_record(handle, record)
        if refusal is not Code.SUCCESS:
            return refusal
        count, start = self._timestamp(record), (_number(record) - 1) * (self._arming.settings.record_samples + 16)
        return self._answer(handle, (address, start), (high, count >> 8), (low, count & 0xFF))

    def AlazarGetTriggerTimestamp(self, handle: Any, record: Any, timestamp: Any) -> int:
        if self._instruments.fpga_version <= codes.OLD_FPGA and _number(record) > codes.MOST_RECORDS_OLD_FPGA:
            return Code.RECORD_TOO_HIGH
        refusal = self._refuse_record(handle, record)
        return refusal if refusal is not Code.SUCCESS else self._answer(handle, (timestamp, self._timestamp(record)))

    def AlazarGetWhoTriggeredBySystemID(self, system: Any, board: Any, record: Any) -> int:
        if self._refuse_record(self.AlazarGetBoardBySystemID(system, board), record) is not Code.SUCCESS:
            return 0
        return int(self._recorder.taken(self._clock.now_ps).by[_number(record) - 1])

    # Dual port

    def AlazarBeforeAsyncRead(
        self, handle: Any, channels: Any, offset: Any, samples: Any, per_buffer: Any, per_acquisition: Any, flags: Any
    ) -> int:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        mask = {1: (0,), 2: (1,), 3: (0, 1)}.get(_number(channels), ())
        transfer = Transfer(mask, _number(samples), _number(per_buffer), _number(per_acquisition), _number(flags))
        refusal = self._refuse_transfer(transfer, _number(offset))
        if refusal is not Code.SUCCESS:
            return refusal
        self._queue = BufferQueue(transfer, self._instruments.samples_per_channel // (transfer.record_samples + 16))
        if not transfer.flags & codes.ADMA_EXTERNAL_STARTCAPTURE:
            self._arm()
        return Code.SUCCESS

    def AlazarPostAsyncBuffer(self, handle: Any, buffer: Any, size: Any) -> int:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is None:
            return Code.NOT_INITIALIZED
        if self._board.running:
            self._queue.notice_overflow(self._complete())
        return self._queue.post(_address(buffer), _number(size))

    def AlazarWaitAsyncBufferComplete(self, handle: Any, buffer: Any, timeout_ms: Any) -> int:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is None:
            return Code.BUFFER_NOT_READY
        refusal = self._queue.turn_of(_address(buffer))
        if refusal is not Code.SUCCESS:
            return refusal
        deadline_ps = self._clock.now_ps + _number(timeout_ms) * 1_000_000_000
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
        if _number(handle) != HANDLE:
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
        return int(timestamps(self._arming, taken, self._reset_ps)[_number(record) - 1])

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
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if self._queue is not None:
            return Code.DMA_IN_PROGRESS
        if not self._board.armings or self._is_busy():
            return Code.FAILED
        return Code.SUCCESS if 1 <= _number(record) <= self._complete() else Code.INVALID_INDEX

    def _refuse_transfer(self, transfer: Transfer, offset: int) -> Code:
        settings = self._board.settings
        if not self._instruments.dual_port_memory or transfer.flags & ~0x209 or (transfer.npt and transfer.headers):
            return Code.UNSUPPORTED_FUNCTION
        if not transfer.channels:
            return Code.NOT_SUPPORT_THIS_CHANNEL
        multiple = 32 if transfer.npt else 16
        if transfer.record_samples != settings.record_samples or transfer.record_samples % multiple:
            return Code.INVALID_SIZE
        if offset != -settings.pre_samples or (transfer.npt and offset):
            return Code.INVALID_OFFSET
        per_buffer, count = transfer.records_per_buffer, transfer.record_count
        if per_buffer < 1 or count < 1 or (count != codes.ENDLESS_RECORDS and count % per_buffer):
            return Code.INVALID_RECORDS_PER_BUFFER
        return Code.SUCCESS if transfer.buffer_bytes < codes.MOST_BUFFER_BYTES else Code.INVALID_SIZE

    def _set(
        self, handle: Any, valid: bool, changes: Callable[[], dict[str, Any]], refusal: Code = Code.FAILED
    ) -> Code:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if not valid:
            return refusal
        self._board.settings = replace(self._board.settings, **changes())
        return Code.SUCCESS

    def _answer(self, handle: Any, *values: tuple[Any, int]) -> Code:
        if _number(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if any(target is None for target, _ in values):
            return Code.NULL_PARAM
        for target, value in values:
            _pointee(target).value = value
        return Code.SUCCESS

    def _answer_known(self, handle: Any, known: dict[int, int], key: Any, target: Any) -> Code:
        if _number(handle) == HANDLE and _number(key) not in known:
            return Code.UNSUPPORTED_FUNCTION
        return self._answer(handle, (target, known.get(_number(key), 0)))


def _number(value: Any) -> int:
    return int(getattr(value, "value", value) or 0)


def _address(buffer: Any) -> int:
    if isinstance(buffer, ctypes.Array):
        return ctypes.addressof(buffer)
    return _number(buffer)


def _pointee(target: Any) -> Any:
    return target._obj if hasattr(target, "_obj") else target.contents
