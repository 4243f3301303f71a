"""ATSApi function table over a simulated ATS460: named, called and answering as the vendor's library.

Out-parameters are ``ctypes.byref`` objects or pointers, buffers addresses, arrays or ``c_void_p``, scalars ints or
ctypes scalars. Every function answers a return code or the value its C form returns (docs/theory/instruments.md, 2.3
and 2.5 to 2.9).
"""

from __future__ import annotations

import ctypes
from typing import Any

from sim_backend.digitizer import codes, settings as alazar_settings
from sim_backend.digitizer.auto_dma import Transfer
from sim_backend.digitizer.codes import Code
from sim_backend.digitizer.settings import Changes
from sim_backend.digitizer.state import AlazarState, Recorder
from sim_backend.settings import Instruments

HANDLE = 0x460


class AlazarLibrary:
    """The vendor's library, with one board; loading it resets the board."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        self._state = AlazarState(recorder, instruments)

    # Systems and boards

    def AlazarGetBoardBySystemID(self, system: Any, board: Any) -> int | None:
        return HANDLE if (_number_of(system), _number_of(board)) == (1, 1) else None

    def AlazarGetBoardKind(self, handle: Any) -> int:
        return codes.BOARD_KIND if _number_of(handle) == HANDLE else 0

    def AlazarGetChannelInfo(self, handle: Any, samples: Any, bits: Any) -> int:
        return self._answer(
            handle, (samples, self._state.instruments.samples_per_channel), (bits, codes.RESOLUTION_BITS)
        )

    def AlazarGetSDKVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.SDK_VERSION, strict=True))

    def AlazarGetDriverVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return self._answer(HANDLE, *zip((major, minor, revision), codes.DRIVER_VERSION, strict=True))

    def AlazarQueryCapability(self, handle: Any, capability: Any, reserved: Any, value: Any) -> int:
        return self._answer_known(handle, self._state.capabilities(), capability, value)

    def AlazarGetParameter(self, handle: Any, channel: Any, parameter: Any, value: Any) -> int:
        return self._answer_known(handle, self._state.parameters(), parameter, value)

    # Settings

    def AlazarSetParameter(self, handle: Any, channel: Any, parameter: Any, value: Any) -> int:
        if _number_of(handle) == HANDLE and _number_of(parameter) != codes.PARAMETER_SET_FORMAT:
            return Code.UNSUPPORTED_FUNCTION
        return self._set(handle, {"signed": bool(_number_of(value))} if _number_of(value) in (0, 1) else None)

    def AlazarSetCaptureClock(self, handle: Any, source: Any, rate: Any, edge: Any, decimation: Any) -> int:
        return self._set(handle, alazar_settings.capture_clock(*map(_number_of, (source, rate, edge, decimation))))

    def AlazarInputControl(self, handle: Any, channel: Any, coupling: Any, range_id: Any, impedance: Any) -> int:
        if _number_of(handle) == HANDLE and _number_of(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        values = map(_number_of, (channel, coupling, range_id, impedance))
        return self._set(handle, alazar_settings.input_control(self._state.settings, *values))

    def AlazarSetBWLimit(self, handle: Any, channel: Any, on: Any) -> int:
        return self._set(handle, {} if _number_of(channel) in (1, 2) and _number_of(on) in (0, 1) else None)

    def AlazarSetTriggerOperation(self, handle: Any, operation: Any, *engines: Any) -> int:
        values = [_number_of(value) for value in engines]
        return self._set(handle, alazar_settings.trigger_operation(_number_of(operation), values))

    def AlazarSetExternalTrigger(self, handle: Any, coupling: Any, range_id: Any) -> int:
        return self._set(handle, alazar_settings.external_trigger(_number_of(coupling), _number_of(range_id)))

    def AlazarSetTriggerDelay(self, handle: Any, samples: Any) -> int:
        delay = alazar_settings.within("delay_samples", _number_of(samples), 0, codes.MOST_DELAY_SAMPLES)
        return self._set(handle, delay)

    def AlazarSetTriggerTimeOut(self, handle: Any, ticks: Any) -> int:
        return self._set(handle, alazar_settings.within("timeout_ticks", _number_of(ticks), 0, 0xFFFFFFFF))

    def AlazarConfigureAuxIO(self, handle: Any, mode: Any, parameter: Any) -> int:
        return self._set(handle, {"aux_mode": _number_of(mode)} if _number_of(mode) in codes.AUX_MODES else None)

    def AlazarResetTimeStamp(self, handle: Any, option: Any) -> int:
        valid = _number_of(option) in (codes.TIMESTAMP_FIRST_TIME_ONLY, codes.TIMESTAMP_ALWAYS)
        answer = self._set(handle, {} if valid else None)
        if answer == Code.SUCCESS:
            self._state.reset_timestamp(_number_of(option))
        return answer

    def AlazarSetRecordSize(self, handle: Any, pre: Any, post: Any) -> int:
        most = self._state.instruments.samples_per_channel
        return self._set(
            handle, alazar_settings.record_size(_number_of(pre), _number_of(post), most), Code.INVALID_SIZE
        )

    def AlazarSetRecordCount(self, handle: Any, count: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        refusal = self._state.refuse_count(_number_of(count))
        return self._set(handle, {"record_count": _number_of(count)} if refusal is Code.SUCCESS else None, refusal)

    def AlazarGetMaxRecordsCapable(self, handle: Any, samples: Any, most: Any) -> int:
        if _number_of(handle) == HANDLE and _number_of(samples) < 1:
            return Code.INVALID_SIZE
        return self._answer(handle, (most, self._state.most_records(_number_of(samples))))

    # Capture

    def AlazarStartCapture(self, handle: Any) -> int:
        return self._state.start() if _number_of(handle) == HANDLE else Code.INVALID_HANDLE

    def AlazarAbortCapture(self, handle: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        self._state.stop()
        return Code.SUCCESS

    def AlazarBusy(self, handle: Any) -> int:
        return int(self._state.busy() and _number_of(handle) == HANDLE)

    def AlazarGetStatus(self, handle: Any) -> int:
        return self._state.status() if _number_of(handle) == HANDLE else 0xFFFFFFFF

    def AlazarRead(
        self, handle: Any, channel: Any, buffer: Any, element_bytes: Any, record: Any, offset: Any, count: Any
    ) -> int:
        refusal = self._refuse_record(handle, record)
        address = _address_of(buffer)
        if refusal is not Code.SUCCESS:
            return refusal
        if not address:
            return Code.NULL_PARAM
        if _number_of(channel) not in (1, 2):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        if _number_of(element_bytes) != 2 or _number_of(count) < 1:
            return Code.INVALID_SIZE
        data = self._state.samples(*map(_number_of, (channel, record, offset, count)))
        if data is None:
            return Code.INVALID_OFFSET
        ctypes.memmove(address, data, len(data))
        return Code.SUCCESS

    def AlazarGetTriggerAddress(self, handle: Any, record: Any, address: Any, high: Any, low: Any) -> int:
        refusal = self._refuse_record(handle, record)
        if refusal is not Code.SUCCESS:
            return refusal
        count, start = self._state.timestamp(_number_of(record)), self._state.trigger_address(_number_of(record))
        return self._answer(handle, (address, start), (high, count >> 8), (low, count & 0xFF))

    def AlazarGetTriggerTimestamp(self, handle: Any, record: Any, timestamp: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        refusal = self._state.refuse_timestamp(_number_of(record))
        if refusal is not Code.SUCCESS:
            return refusal
        return self._answer(handle, (timestamp, self._state.timestamp(_number_of(record))))

    # Dual port

    def AlazarBeforeAsyncRead(
        self, handle: Any, channels: Any, offset: Any, samples: Any, per_buffer: Any, per_acquisition: Any, flags: Any
    ) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        mask = {1: (0,), 2: (1,), 3: (0, 1)}.get(_number_of(channels), ())
        transfer = Transfer(mask, *map(_number_of, (samples, per_buffer, per_acquisition, flags)))
        return self._state.begin_transfer(transfer, _number_of(offset))

    def AlazarPostAsyncBuffer(self, handle: Any, buffer: Any, size: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        return self._state.post_buffer(_address_of(buffer), _number_of(size))

    def AlazarWaitAsyncBufferComplete(self, handle: Any, buffer: Any, timeout_ms: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        return self._state.wait_for_buffer(_address_of(buffer), _number_of(timeout_ms))

    def AlazarAbortAsyncRead(self, handle: Any) -> int:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        self._state.end_transfer()
        return Code.SUCCESS

    # What the functions above share

    def _refuse_record(self, handle: Any, record: Any) -> Code:
        return self._state.refuse_record(_number_of(record)) if _number_of(handle) == HANDLE else Code.INVALID_HANDLE

    def _set(self, handle: Any, changes: Changes | None, refusal: Code = Code.FAILED) -> Code:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if changes is None:
            return refusal
        self._state.change(changes)
        return Code.SUCCESS

    def _answer(self, handle: Any, *values: tuple[Any, int]) -> Code:
        if _number_of(handle) != HANDLE:
            return Code.INVALID_HANDLE
        if any(target is None for target, _ in values):
            return Code.NULL_PARAM
        for target, value in values:
            _pointee_of(target).value = value
        return Code.SUCCESS

    def _answer_known(self, handle: Any, known: dict[int, int], key: Any, target: Any) -> Code:
        if _number_of(handle) == HANDLE and _number_of(key) not in known:
            return Code.UNSUPPORTED_FUNCTION
        return self._answer(handle, (target, known.get(_number_of(key), 0)))


def _number_of(value: Any) -> int:
    """Return an int or ctypes scalar as an int; none is 0."""
    return int(getattr(value, "value", value) or 0)


def _address_of(buffer: Any) -> int:
    """Return where a buffer begins."""
    if isinstance(buffer, ctypes.Array):
        return ctypes.addressof(buffer)
    return _number_of(buffer)


def _pointee_of(target: Any) -> Any:
    """Return what an out-parameter points to."""
    return target._obj if hasattr(target, "_obj") else target.contents
