"""ATSApi, the digitizer vendor's library: functions, C signatures, constants (docs/explanation/instruments.md, 2)."""

from __future__ import annotations

import ctypes
import sys
from enum import IntEnum
from typing import Any, Final

from drivers.interfaces import InstrumentError

AlazarLibrary = Any
"""The vendor's library with the functions of ``SIGNATURES``; buffers are addresses, outputs ``ctypes.byref``."""

CLOCK_INTERNAL: Final = 1
COUPLING_DC: Final = 2
IMPEDANCE_50_OHM: Final = 2
TRIGGER_OPERATION_J: Final = 0
ENGINE_J, ENGINE_K = 0, 1
SOURCE_EXTERNAL, SOURCE_DISABLE = 2, 3
SLOPE_POSITIVE: Final = 1
AUX_OUT_TRIGGER: Final = 0
TIMESTAMP_RESET_ALWAYS: Final = 1
# Flags of ``AlazarBeforeAsyncRead``; without ADMA_NPT the mode is traditional.
ADMA_EXTERNAL_STARTCAPTURE, ADMA_RECORD_HEADERS, ADMA_NPT = 0x001, 0x008, 0x200
# A bit of ``Capability.BOARD_OPTIONS_LOW``.
OPTION_DUAL_PORT_MEMORY: Final = 1 << 2
# Bits of ``AlazarGetStatus``: channel A or B clipped.
STATUS_CLIPPED: Final = 1 << 1 | 1 << 2
STATUS_FAILED: Final = 0xFFFF_FFFF


class Channel(IntEnum):
    """Channel numbers, which are mask bits as well."""

    A = 1
    B = 2


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
    "AlazarForceTrigger": (RC, (HANDLE,)),
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
    """Set all signatures of ``library`` (a ``ctypes.CDLL``); raise ``InstrumentError`` with every missing function."""
    missing = [name for name in SIGNATURES if not hasattr(library, name)]
    if missing:
        why = "the installed ATSApi is older than the functions this bench needs"
        raise InstrumentError(role, f"no {', '.join(missing)} in the library", why, "install ATS-SDK 5.8 or newer")
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def load_library(role: str = "digitizer", name: str | None = None) -> AlazarLibrary:
    """Load the vendor's library and return it; this resets every board in the machine."""
    file_name = name or ("ATSApi.dll" if sys.platform == "win32" else "libATSApi.so")
    try:
        library = ctypes.CDLL(file_name)
    except OSError as error:
        bits = 8 * ctypes.sizeof(ctypes.c_void_p)
        raise InstrumentError(
            role,
            f"cannot load {file_name}",
            f"the board's driver and SDK are missing, or not for {bits} bit: {error}",
            "install the AlazarTech driver and ATS-SDK for the board, or run on the simulated bench",
        ) from error
    return bind(library, role)
