"""ATSApi function table over a simulated board: named, called and answering as the vendor's library.

Out-parameters are ``ctypes.byref`` objects or pointers, buffers addresses, arrays or ``c_void_p``, scalars ints or
ctypes scalars. Every function answers a return code or the value its C form returns (docs/theory/instruments.md, 2.3
and 2.5 to 2.9).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import wraps
from typing import Any

from sim_backend.digitizer import codes, settings
from sim_backend.digitizer.auto_dma import Transfer
from sim_backend.digitizer.codes import Code
from sim_backend.digitizer.settings import Changes
from sim_backend.digitizer.state import AlazarState, Recorder
from sim_backend.settings import Instruments

HANDLE = 0x460
Function = Callable[..., Any]


def _of_board(refused: int = Code.INVALID_HANDLE) -> Callable[[Function], Function]:
    """Have a function answer ``refused`` for a wrong handle, and see plain values (`_plain`) otherwise."""

    def checked(function: Function) -> Function:
        @wraps(function)
        def called(library: AlazarLibrary, handle: Any, *arguments: Any) -> Any:
            return function(library, handle, *map(_plain, arguments)) if _plain(handle) == HANDLE else refused

        return called

    return checked


class AlazarLibrary:
    """The vendor's library, with one board; loading it resets the board."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        self._state = AlazarState(recorder, instruments)

    # Systems and boards

    def AlazarGetBoardBySystemID(self, system: Any, board: Any) -> int | None:
        return HANDLE if (_plain(system), _plain(board)) == (1, 1) else None

    @_of_board(refused=0)
    def AlazarGetBoardKind(self, handle: Any) -> int:
        return self._state.type.kind

    @_of_board()
    def AlazarGetChannelInfo(self, handle: Any, samples: Any, bits: Any) -> int:
        return _answer((samples, self._state.instruments.samples_per_channel), (bits, self._state.type.bits))

    def AlazarGetSDKVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return _answer(*zip((major, minor, revision), codes.SDK_VERSION, strict=True))

    def AlazarGetDriverVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return _answer(*zip((major, minor, revision), codes.DRIVER_VERSION, strict=True))

    @_of_board()
    def AlazarQueryCapability(self, handle: Any, capability: int, reserved: Any, value: Any) -> int:
        return _answer_known(self._state.capabilities(), capability, value)

    @_of_board()
    def AlazarGetParameter(self, handle: Any, channel: int, parameter: int, value: Any) -> int:
        return _answer_known(self._state.parameters(), parameter, value)

    # Settings

    @_of_board()
    def AlazarSetParameter(self, handle: Any, channel: int, parameter: int, value: int) -> int:
        if parameter != codes.PARAMETER_SET_FORMAT:
            return Code.UNSUPPORTED_FUNCTION
        return self._set({"signed": bool(value)} if value in (0, 1) else None)

    @_of_board()
    def AlazarSetCaptureClock(self, handle: Any, source: int, rate: int, edge: int, decimation: int) -> int:
        return self._set(settings.capture_clock(self._state.type, source, rate, edge, decimation))

    @_of_board()
    def AlazarInputControl(self, handle: Any, channel: int, coupling: int, range_id: int, impedance: int) -> int:
        if not self._state.has_channel(channel):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        return self._set(settings.input_control(self._state.settings, channel, coupling, range_id, impedance))

    @_of_board()
    def AlazarSetBWLimit(self, handle: Any, channel: int, on: int) -> int:
        return self._set({} if self._state.has_channel(channel) and on in (0, 1) else None)

    @_of_board()
    def AlazarSetTriggerOperation(self, handle: Any, operation: int, *engines: int) -> int:
        return self._set(settings.trigger_operation(operation, engines))

    @_of_board()
    def AlazarSetExternalTrigger(self, handle: Any, coupling: int, range_id: int) -> int:
        return self._set(settings.external_trigger(coupling, range_id))

    @_of_board()
    def AlazarSetTriggerDelay(self, handle: Any, samples: int) -> int:
        return self._set(settings.trigger_delay(self._state.type, samples))

    @_of_board()
    def AlazarSetTriggerTimeOut(self, handle: Any, ticks: int) -> int:
        return self._set(settings.within("timeout_ticks", ticks, 0, 0xFFFFFFFF))

    @_of_board()
    def AlazarConfigureAuxIO(self, handle: Any, mode: int, parameter: int) -> int:
        return self._set({"aux_mode": mode} if mode in codes.AUX_MODES else None)

    @_of_board()
    def AlazarResetTimeStamp(self, handle: Any, option: int) -> int:
        if option not in (codes.TIMESTAMP_FIRST_TIME_ONLY, codes.TIMESTAMP_ALWAYS):
            return Code.FAILED
        self._state.reset_timestamp(option)
        return Code.SUCCESS

    @_of_board()
    def AlazarSetRecordSize(self, handle: Any, pre: int, post: int) -> int:
        size = settings.record_size(self._state.type, pre, post, self._state.instruments.samples_per_channel)
        return self._set(size, Code.INVALID_SIZE)

    @_of_board()
    def AlazarSetRecordCount(self, handle: Any, count: int) -> int:
        refusal = self._state.refuse_count(count)
        return self._set({"record_count": count} if refusal is Code.SUCCESS else None, refusal)

    @_of_board()
    def AlazarGetMaxRecordsCapable(self, handle: Any, samples: int, most: Any) -> int:
        return _answer((most, self._state.most_records(samples))) if samples >= 1 else Code.INVALID_SIZE

    # Capture

    @_of_board()
    def AlazarStartCapture(self, handle: Any) -> int:
        return self._state.start()

    @_of_board()
    def AlazarAbortCapture(self, handle: Any) -> int:
        self._state.stop()
        return Code.SUCCESS

    @_of_board(refused=0)
    def AlazarBusy(self, handle: Any) -> int:
        return int(self._state.busy())

    @_of_board(refused=0xFFFFFFFF)
    def AlazarGetStatus(self, handle: Any) -> int:
        return self._state.status()

    @_of_board()
    def AlazarRead(
        self, handle: Any, channel: int, buffer: int, element_bytes: int, record: int, offset: int, count: int
    ) -> int:
        refusal = self._state.refuse_record(record)
        if refusal is not Code.SUCCESS:
            return refusal
        if not buffer:
            return Code.NULL_PARAM
        if not self._state.has_channel(channel):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        if element_bytes != self._state.type.bytes_per_sample or count < 1:
            return Code.INVALID_SIZE
        data = self._state.samples(channel, record, offset, count)
        if data is None:
            return Code.INVALID_OFFSET
        ctypes.memmove(buffer, data, len(data))
        return Code.SUCCESS

    @_of_board()
    def AlazarGetTriggerTimestamp(self, handle: Any, record: int, timestamp: Any) -> int:
        refusal = self._state.refuse_timestamp(record)
        return _answer((timestamp, self._state.timestamp(record))) if refusal is Code.SUCCESS else refusal

    # Dual port

    @_of_board()
    def AlazarBeforeAsyncRead(
        self, handle: Any, channels: int, offset: int, samples: int, per_buffer: int, per_acquisition: int, flags: int
    ) -> int:
        chosen = tuple(index for index in range(channels.bit_length()) if channels >> index & 1)
        size = self._state.type.bytes_per_sample
        return self._state.begin_transfer(Transfer(chosen, samples, per_buffer, per_acquisition, flags, size), offset)

    @_of_board()
    def AlazarPostAsyncBuffer(self, handle: Any, buffer: int, size: int) -> int:
        return self._state.post_buffer(buffer, size)

    @_of_board()
    def AlazarWaitAsyncBufferComplete(self, handle: Any, buffer: int, timeout_ms: int) -> int:
        return self._state.wait_for_buffer(buffer, timeout_ms)

    @_of_board()
    def AlazarAbortAsyncRead(self, handle: Any) -> int:
        self._state.end_transfer()
        return Code.SUCCESS

    def _set(self, changes: Changes | None, refusal: Code = Code.FAILED) -> Code:
        if changes is None:
            return refusal
        self._state.change(changes)
        return Code.SUCCESS


def _plain(value: Any) -> Any:
    """Return an int or ctypes scalar as an int, none as 0, an array as its address, an out-parameter as it is."""
    if isinstance(value, ctypes.Array):
        return ctypes.addressof(value)
    if hasattr(value, "_obj") or hasattr(type(value), "contents"):
        return value
    return int(getattr(value, "value", value) or 0)


def _answer(*values: tuple[Any, int]) -> Code:
    """Put each value where its out-parameter points to."""
    if not all(target for target, _ in values):
        return Code.NULL_PARAM
    for target, value in values:
        (target._obj if hasattr(target, "_obj") else target.contents).value = value
    return Code.SUCCESS


def _answer_known(known: dict[int, int], key: int, target: Any) -> Code:
    return _answer((target, known[key])) if key in known else Code.UNSUPPORTED_FUNCTION
