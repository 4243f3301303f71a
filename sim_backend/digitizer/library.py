"""ATSApi function table over a simulated board, with the names, arguments and results of the vendor's library.

Out-parameters are ``ctypes.byref`` objects or pointers, buffers addresses, arrays or ``c_void_p``, scalars ints or
ctypes scalars. Every function returns a return code or the value of its C form (docs/explanation/instruments.md, 2.3
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


def _with_handle(refused: int = Code.INVALID_HANDLE) -> Callable[[Function], Function]:
    """Return a decorator for functions of the vendor's library: a wrong handle returns ``refused``.

    Arguments arrive at the function as plain values.
    """

    def checked(function: Function) -> Function:
        """Return ``function`` with the check of its handle."""

        @wraps(function)
        def called(library: AlazarLibrary, handle: Any, *arguments: Any) -> Any:
            """Call the function if ``handle`` is that of the board."""
            return function(library, handle, *map(_plain, arguments)) if _plain(handle) == HANDLE else refused

        return called

    return checked


class AlazarLibrary:
    """The vendor's library with one board; loading it resets the board."""

    def __init__(self, recorder: Recorder, instruments: Instruments) -> None:
        self._state = AlazarState(recorder, instruments)

    # Systems and boards

    def AlazarGetBoardBySystemID(self, system: Any, board: Any) -> int | None:
        return HANDLE if (_plain(system), _plain(board)) == (1, 1) else None

    @_with_handle(refused=0)
    def AlazarGetBoardKind(self, handle: Any) -> int:
        return self._state.type.kind

    @_with_handle()
    def AlazarGetChannelInfo(self, handle: Any, samples: Any, bits: Any) -> int:
        return _answer((samples, self._state.instruments.samples_per_channel), (bits, self._state.type.bits))

    def AlazarGetSDKVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return _answer(*zip((major, minor, revision), codes.SDK_VERSION, strict=True))

    def AlazarGetDriverVersion(self, major: Any, minor: Any, revision: Any) -> int:
        return _answer(*zip((major, minor, revision), codes.DRIVER_VERSION, strict=True))

    @_with_handle()
    def AlazarQueryCapability(self, handle: Any, capability: int, reserved: Any, value: Any) -> int:
        return _answer_from(self._state.capabilities(), capability, value)

    @_with_handle()
    def AlazarGetParameter(self, handle: Any, channel: int, parameter: int, value: Any) -> int:
        return _answer_from(self._state.parameters(), parameter, value)

    # Settings

    @_with_handle()
    def AlazarSetParameter(self, handle: Any, channel: int, parameter: int, value: int) -> int:
        """Set the format of the codes, signed or unsigned, the only parameter that is simulated."""
        if parameter != codes.PARAMETER_SET_FORMAT:
            return Code.UNSUPPORTED_FUNCTION
        return self._set({"signed": bool(value)} if value in (0, 1) else None)

    @_with_handle()
    def AlazarSetCaptureClock(self, handle: Any, source: int, rate: int, edge: int, decimation: int) -> int:
        return self._set(settings.clock_changes(self._state.type, source, rate, edge, decimation))

    @_with_handle()
    def AlazarInputControl(self, handle: Any, channel: int, coupling: int, range_id: int, impedance: int) -> int:
        """Set coupling, range and impedance of an input."""
        if not self._state.has_channel(channel):
            return Code.NOT_SUPPORT_THIS_CHANNEL
        return self._set(settings.input_changes(self._state.settings, channel, coupling, range_id, impedance))

    @_with_handle()
    def AlazarSetBWLimit(self, handle: Any, channel: int, on: int) -> int:
        return self._set({} if self._state.has_channel(channel) and on in (0, 1) else None)

    @_with_handle()
    def AlazarSetTriggerOperation(self, handle: Any, operation: int, *engines: int) -> int:
        return self._set(settings.trigger_operation_changes(operation, engines))

    @_with_handle()
    def AlazarSetExternalTrigger(self, handle: Any, coupling: int, range_id: int) -> int:
        return self._set(settings.external_trigger_changes(self._state.type, coupling, range_id))

    @_with_handle()
    def AlazarSetTriggerDelay(self, handle: Any, samples: int) -> int:
        return self._set(settings.trigger_delay_changes(self._state.type, samples))

    @_with_handle()
    def AlazarSetTriggerTimeOut(self, handle: Any, ticks: int) -> int:
        """Accept 0, no time-out; a board that triggers itself is not simulated."""
        return Code.UNSUPPORTED_FUNCTION if ticks else Code.SUCCESS

    @_with_handle()
    def AlazarConfigureAuxIO(self, handle: Any, mode: int, parameter: int) -> int:
        return self._set({"aux_mode": mode} if mode in codes.AUX_MODES else None)

    @_with_handle()
    def AlazarResetTimeStamp(self, handle: Any, option: int) -> int:
        """Set whether the time stamp is reset at every capture or only once."""
        if option not in (codes.TIMESTAMP_FIRST_TIME_ONLY, codes.TIMESTAMP_ALWAYS):
            return Code.FAILED
        self._state.reset_timestamp(option)
        return Code.SUCCESS

    @_with_handle()
    def AlazarSetRecordSize(self, handle: Any, pre: int, post: int) -> int:
        """Set the samples of a record before and after the trigger."""
        size = settings.record_size_changes(self._state.type, pre, post, self._state.instruments.samples_per_channel)
        return self._set(size, Code.INVALID_SIZE)

    @_with_handle()
    def AlazarSetRecordCount(self, handle: Any, count: int) -> int:
        """Set the number of records of a capture."""
        refusal = self._state.count_refusal(count)
        return self._set({"record_count": count} if refusal is Code.SUCCESS else None, refusal)

    @_with_handle()
    def AlazarGetMaxRecordsCapable(self, handle: Any, samples: int, count: Any) -> int:
        return _answer((count, self._state.max_records(samples))) if samples >= 1 else Code.INVALID_SIZE

    # Capture

    @_with_handle()
    def AlazarStartCapture(self, handle: Any) -> int:
        return self._state.start()

    @_with_handle()
    def AlazarAbortCapture(self, handle: Any) -> int:
        """Stop the running capture."""
        self._state.stop()
        return Code.SUCCESS

    @_with_handle()
    def AlazarForceTrigger(self, handle: Any) -> int:
        self._state.force_trigger()
        return Code.SUCCESS

    @_with_handle(refused=0)
    def AlazarBusy(self, handle: Any) -> int:
        return int(self._state.busy())

    @_with_handle(refused=0xFFFFFFFF)
    def AlazarGetStatus(self, handle: Any) -> int:
        return self._state.status()

    @_with_handle()
    def AlazarRead(
        self, handle: Any, channel: int, buffer: int, element_bytes: int, record: int, offset: int, count: int
    ) -> int:
        """Copy samples of one record to ``buffer``, an address; return the code of success or refusal."""
        refusal = self._state.record_refusal(record)
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

    @_with_handle()
    def AlazarGetTriggerTimestamp(self, handle: Any, record: int, timestamp: Any) -> int:
        """Write the trigger time of ``record`` into ``timestamp``; return the code of success or refusal."""
        refusal = self._state.timestamp_refusal(record)
        return _answer((timestamp, self._state.timestamp(record))) if refusal is Code.SUCCESS else refusal

    # Dual port

    @_with_handle()
    def AlazarBeforeAsyncRead(
        self, handle: Any, channels: int, offset: int, samples: int, per_buffer: int, per_acquisition: int, flags: int
    ) -> int:
        """Prepare the transfer of records into the program's buffers (AutoDMA).

        ``channels``: a bit for each channel.
        """
        indices = tuple(index for index in range(channels.bit_length()) if channels >> index & 1)
        size = self._state.type.bytes_per_sample
        return self._state.begin_transfer(Transfer(indices, samples, per_buffer, per_acquisition, flags, size), offset)

    @_with_handle()
    def AlazarPostAsyncBuffer(self, handle: Any, buffer: int, size: int) -> int:
        return self._state.post_buffer(buffer, size)

    @_with_handle()
    def AlazarWaitAsyncBufferComplete(self, handle: Any, buffer: int, timeout_ms: int) -> int:
        return self._state.wait_for_buffer(buffer, timeout_ms)

    @_with_handle()
    def AlazarAbortAsyncRead(self, handle: Any) -> int:
        """End the transfer into the program's buffers."""
        self._state.end_transfer()
        return Code.SUCCESS

    def _set(self, changes: Changes | None, refusal: Code = Code.FAILED) -> Code:
        """Apply ``changes`` to the settings, or return ``refusal`` if there are none."""
        if changes is None:
            return refusal
        self._state.change(changes)
        return Code.SUCCESS


def _plain(value: Any) -> Any:
    """Return an argument of a C function as a Python value: numbers as int, None as 0, an array as its address.

    Pointers to results (out-parameters) stay as they are.
    """
    if isinstance(value, ctypes.Array):
        return ctypes.addressof(value)
    if hasattr(value, "_obj") or hasattr(type(value), "contents"):
        return value
    return int(getattr(value, "value", value) or 0)


def _answer(*values: tuple[Any, int]) -> Code:
    """Write each value to its out-parameter, a pointer given by the program; return the code of success or refusal."""
    if not all(target for target, _ in values):
        return Code.NULL_PARAM
    for target, value in values:
        (target._obj if hasattr(target, "_obj") else target.contents).value = value
    return Code.SUCCESS


def _answer_from(values: dict[int, int], key: int, target: Any) -> Code:
    return _answer((target, values[key])) if key in values else Code.UNSUPPORTED_FUNCTION
