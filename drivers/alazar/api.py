"""ATSApi, the digitizer vendor's library: functions used, C signatures, constants (docs/theory/instruments.md, 2)."""

from __future__ import annotations

import ctypes
import sys
from enum import IntEnum, IntFlag
from typing import Any, Final, Protocol, cast

from drivers.interfaces import InstrumentError

# An out-parameter is ``ctypes.byref(value)``, a buffer an address.
Out = Any
Handle = int
Address = int

STATUS_FAILED: Final = 0xFFFF_FFFF


class Channel(IntEnum):
    """Channel numbers, which are mask bits as well."""

    A = 1
    B = 2


class ClockSource(IntEnum):
    """Where the sample clock comes from."""

    INTERNAL = 1


class Coupling(IntEnum):
    """Input and external trigger coupling."""

    AC = 1
    DC = 2


class Impedance(IntEnum):
    """Input impedance."""

    OHM_1M = 1
    OHM_50 = 2


class TriggerEngine(IntEnum):
    """The two trigger comparators."""

    J = 0
    K = 1


class TriggerOperation(IntEnum):
    """How the comparators combine."""

    J = 0


class TriggerSource(IntEnum):
    """What a comparator watches."""

    EXTERNAL = 2
    DISABLE = 3


class TriggerSlope(IntEnum):
    """The edge that triggers."""

    POSITIVE = 1
    NEGATIVE = 2


class ExternalTriggerRange(IntEnum):
    """Full scale of the external trigger input."""

    PLUS_MINUS_5V = 0
    PLUS_MINUS_1V = 1


class AuxMode(IntEnum):
    """What the AUX connector does."""

    OUT_TRIGGER = 0


class TimestampReset(IntEnum):
    """When the record time stamps start from zero."""

    FIRST_TIME_ONLY = 0
    ALWAYS = 1


class Adma(IntFlag):
    """Flags of ``AlazarBeforeAsyncRead``; traditional mode is their absence of others."""

    TRADITIONAL = 0x000
    EXTERNAL_STARTCAPTURE = 0x001
    ENABLE_RECORD_HEADERS = 0x008
    NPT = 0x200


class Parameter(IntEnum):
    """Arguments of ``AlazarGetParameter``."""

    DATA_FORMAT = 0x10000042
    SAMPLES_PER_TIMESTAMP_CLOCK = 0x10000044
    RECORDS_CAPTURED = 0x10000045
    ASYNC_BUFFERS_PENDING = 0x10000050


class Capability(IntEnum):
    """Arguments of ``AlazarQueryCapability``."""

    SERIAL_NUMBER = 0x10000024
    FPGA_VERSION = 0x1000002C
    BOARD_OPTIONS_LOW = 0x10000037


class BoardOption(IntFlag):
    """Bits of ``Capability.BOARD_OPTIONS_LOW``."""

    EXTERNAL_CLOCK = 1 << 1
    DUAL_PORT_MEMORY = 1 << 2


class StatusBit(IntFlag):
    """Bits of ``AlazarGetStatus``."""

    TRIGGER_TIMEOUT = 1 << 0
    CHANNEL_A_CLIPPED = 1 << 1
    CHANNEL_B_CLIPPED = 1 << 2


class AlazarLibrary(Protocol):
    """The vendor's functions this bench uses; names and order of arguments are the vendor's."""

    def AlazarGetBoardBySystemID(self, system_id: int, board_id: int, /) -> Handle | None: ...
    def AlazarGetBoardKind(self, handle: Handle, /) -> int: ...
    def AlazarGetChannelInfo(self, handle: Handle, samples: Out, bits: Out, /) -> int: ...
    def AlazarGetSDKVersion(self, major: Out, minor: Out, revision: Out, /) -> int: ...
    def AlazarGetDriverVersion(self, major: Out, minor: Out, revision: Out, /) -> int: ...
    def AlazarQueryCapability(self, handle: Handle, capability: int, reserved: int, value: Out, /) -> int: ...
    def AlazarGetParameter(self, handle: Handle, channel: int, parameter: int, value: Out, /) -> int: ...
    def AlazarSetCaptureClock(
        self, handle: Handle, source: int, rate_id: int, edge: int, decimation: int, /
    ) -> int: ...
    def AlazarInputControl(
        self, handle: Handle, channel: int, coupling: int, range_id: int, impedance: int, /
    ) -> int: ...
    def AlazarSetBWLimit(self, handle: Handle, channel: int, on: int, /) -> int: ...
    def AlazarSetTriggerOperation(
        self,
        handle: Handle,
        operation: int,
        engine_1: int,
        source_1: int,
        slope_1: int,
        level_1: int,
        engine_2: int,
        source_2: int,
        slope_2: int,
        level_2: int,
        /,
    ) -> int: ...
    def AlazarSetExternalTrigger(self, handle: Handle, coupling: int, trigger_range: int, /) -> int: ...
    def AlazarSetTriggerDelay(self, handle: Handle, samples: int, /) -> int: ...
    def AlazarSetTriggerTimeOut(self, handle: Handle, ticks: int, /) -> int: ...
    def AlazarConfigureAuxIO(self, handle: Handle, mode: int, parameter: int, /) -> int: ...
    def AlazarResetTimeStamp(self, handle: Handle, option: int, /) -> int: ...
    def AlazarSetRecordSize(self, handle: Handle, pre_samples: int, post_samples: int, /) -> int: ...
    def AlazarSetRecordCount(self, handle: Handle, count: int, /) -> int: ...
    def AlazarGetMaxRecordsCapable(self, handle: Handle, record_samples: int, records: Out, /) -> int: ...
    def AlazarStartCapture(self, handle: Handle, /) -> int: ...
    def AlazarAbortCapture(self, handle: Handle, /) -> int: ...
    def AlazarBusy(self, handle: Handle, /) -> int: ...
    def AlazarGetStatus(self, handle: Handle, /) -> int: ...
    def AlazarRead(
        self,
        handle: Handle,
        channel: int,
        buffer: Address,
        element_bytes: int,
        record: int,
        offset: int,
        samples: int,
        /,
    ) -> int: ...
    def AlazarGetTriggerTimestamp(self, handle: Handle, record: int, count: Out, /) -> int: ...
    def AlazarBeforeAsyncRead(
        self,
        handle: Handle,
        channels: int,
        offset: int,
        record_samples: int,
        records_per_buffer: int,
        records_per_acquisition: int,
        flags: int,
        /,
    ) -> int: ...
    def AlazarPostAsyncBuffer(self, handle: Handle, buffer: Address, size_bytes: int, /) -> int: ...
    def AlazarWaitAsyncBufferComplete(self, handle: Handle, buffer: Address, timeout_ms: int, /) -> int: ...
    def AlazarAbortAsyncRead(self, handle: Handle, /) -> int: ...


U8, U32, LONG, HANDLE, RC = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_long, ctypes.c_void_p, ctypes.c_int
U8_OUT, U32_OUT, LONG_OUT = ctypes.POINTER(U8), ctypes.POINTER(U32), ctypes.POINTER(LONG)
U64_OUT = ctypes.POINTER(ctypes.c_uint64)

# name: (result, arguments). The vendor's U32 is 32 bit everywhere; its ``long`` follows the platform.
SIGNATURES: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "AlazarGetBoardBySystemID": (HANDLE, (U32, U32)),
    "AlazarGetBoardKind": (U32, (HANDLE,)),
    "AlazarGetChannelInfo": (RC, (HANDLE, U32_OUT, U8_OUT)),
    "AlazarGetSDKVersion": (RC, (U8_OUT, U8_OUT, U8_OUT)),
    "AlazarGetDriverVersion": (RC, (U8_OUT, U8_OUT, U8_OUT)),
    "AlazarQueryCapability": (RC, (HANDLE, U32, U32, U32_OUT)),
    "AlazarGetParameter": (RC, (HANDLE, U8, U32, LONG_OUT)),
    "AlazarSetCaptureClock": (RC, (HANDLE, U32, U32, U32, U32)),
    "AlazarInputControl": (RC, (HANDLE, U8, U32, U32, U32)),
    "AlazarSetBWLimit": (RC, (HANDLE, U32, U32)),
    "AlazarSetTriggerOperation": (RC, (HANDLE, *(U32,) * 9)),
    "AlazarSetExternalTrigger": (RC, (HANDLE, U32, U32)),
    "AlazarSetTriggerDelay": (RC, (HANDLE, U32)),
    "AlazarSetTriggerTimeOut": (RC, (HANDLE, U32)),
    "AlazarConfigureAuxIO": (RC, (HANDLE, U32, U32)),
    "AlazarResetTimeStamp": (RC, (HANDLE, U32)),
    "AlazarSetRecordSize": (RC, (HANDLE, U32, U32)),
    "AlazarSetRecordCount": (RC, (HANDLE, U32)),
    "AlazarGetMaxRecordsCapable": (RC, (HANDLE, U32, U32_OUT)),
    "AlazarStartCapture": (RC, (HANDLE,)),
    "AlazarAbortCapture": (RC, (HANDLE,)),
    "AlazarBusy": (U32, (HANDLE,)),
    "AlazarGetStatus": (U32, (HANDLE,)),
    "AlazarRead": (U32, (HANDLE, U32, HANDLE, ctypes.c_int, LONG, LONG, U32)),
    "AlazarGetTriggerTimestamp": (RC, (HANDLE, U32, U64_OUT)),
    "AlazarBeforeAsyncRead": (RC, (HANDLE, U32, LONG, U32, U32, U32, U32)),
    "AlazarPostAsyncBuffer": (RC, (HANDLE, HANDLE, U32)),
    "AlazarWaitAsyncBufferComplete": (RC, (HANDLE, HANDLE, U32)),
    "AlazarAbortAsyncRead": (RC, (HANDLE,)),
}


def bind(library: Any, role: str) -> AlazarLibrary:
    """Return ``library`` (a ``ctypes.CDLL``) with all signatures set; ``InstrumentError`` names absent functions."""
    absent = [name for name in SIGNATURES if not hasattr(library, name)]
    if absent:
        why = "the installed ATSApi is older than the functions this bench needs"
        raise InstrumentError(role, f"no {', '.join(absent)} in the library", why, "install ATS-SDK 5.8 or newer")
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return cast(AlazarLibrary, library)


def load_library(role: str = "digitizer", name: str | None = None) -> AlazarLibrary:
    """Return the vendor's library; loading it resets every board in the machine."""
    wanted = name or ("ATSApi.dll" if sys.platform == "win32" else "libATSApi.so")
    try:
        library = ctypes.CDLL(wanted)
    except OSError as error:
        bits = 8 * ctypes.sizeof(ctypes.c_void_p)
        raise InstrumentError(
            role,
            f"cannot load {wanted}",
            f"the board's driver and SDK are not installed, or not for {bits} bit: {error}",
            "install the AlazarTech driver and ATS-SDK for the ATS460, or run on the simulated bench",
        ) from error
    return bind(library, role)
