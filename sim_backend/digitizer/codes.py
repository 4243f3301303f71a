"""Codes of the ATSApi as the simulated ATS460 knows them (docs/theory/instruments.md, 2.4 and 2.8).

Which code answers which misuse is documented for few cases only (513 for an input combination, 518/573 for a buffer out
of turn, 579, 582); the others are the nearest code by name, assumed, and all stand in ``Code``.
"""

from __future__ import annotations

from enum import IntEnum


class Code(IntEnum):
    """Return codes that the simulated library gives."""

    SUCCESS = 512
    FAILED = 513
    DMA_IN_PROGRESS = 518
    NULL_PARAM = 531
    UNSUPPORTED_FUNCTION = 533
    INVALID_SIZE = 536
    INVALID_ADDRESS = 537
    INVALID_INDEX = 539
    NOT_INITIALIZED = 556
    NOT_SUPPORT_THIS_CHANNEL = 561
    INVALID_OFFSET = 567
    INVALID_HANDLE = 572
    BUFFER_NOT_READY = 573
    WAIT_TIMEOUT = 579
    BUFFER_TOO_SMALL = 581
    BUFFER_OVERFLOW = 582
    INVALID_BUFFER = 583
    INVALID_RECORDS_PER_BUFFER = 584
    TOO_MANY_RECORDS = 607
    """SDK 5.8.2 for more records than FPGA 18 and below can hold; newer SDKs give this number another meaning."""
    RECORD_TOO_HIGH = 604
    """SDK 5.8.2, time stamp of a record above 1000 on FPGA 18 and below."""


_NAMES_BY_NUMBER = """
Success Failed AccessDenied DmaChannelUnavailable DmaChannelInvalid DmaChannelTypeError DmaInProgress DmaDone DmaPaused
DmaNotPaused DmaCommandInvalid DmaManReady DmaManNotReady DmaInvalidChannelPriority DmaManCorrupted
DmaInvalidElementIndex DmaNoMoreElements DmaSglInvalid DmaSglQueueFull NullParam InvalidBusIndex UnsupportedFunction
InvalidPciSpace InvalidIopSpace InvalidSize InvalidAddress InvalidAccessType InvalidIndex MuNotReady MuFifoEmpty
MuFifoFull InvalidRegister DoorbellClearFailed InvalidUserPin InvalidUserState EepromNotPresent EepromTypeNotSupported
EepromBlank ConfigAccessFailed InvalidDeviceInfo NoActiveDriver InsufficientResources ObjectAlreadyAllocated
AlreadyInitialized NotInitialized BadConfigRegEndianMode InvalidPowerState PowerDown FlybyNotSupported
NotSupportThisChannel NoAction HSNotSupported VPDNotSupported VpdNotEnabled NoMoreCap InvalidOffset BadPinDirection
PciTimeout DmaChannelClosed DmaChannelError InvalidHandle BufferNotReady InvalidData DoNothing DmaSglBuildFailed
PMNotSupported InvalidDriverVersion WaitTimeout WaitCanceled BufferTooSmall BufferOverflow InvalidBuffer
InvalidRecordsPerBuffer DmaPending LockAndProbePagesFailed WaitAbandoned WaitFailed TransferComplete PllNotLocked
NotSupportedInDualChannelMode
"""
_NAMES = _NAMES_BY_NUMBER.split()


def text_of(code: int) -> str:
    """Return the library's name of a return code."""
    index = code - Code.SUCCESS
    return f"Api{_NAMES[index]}" if 0 <= index < len(_NAMES) else "ApiUnknown"


BOARD_KIND = 7
SERIAL_NUMBER = 460_001
SDK_VERSION = (5, 8, 2)
DRIVER_VERSION = (5, 8, 2)
RESOLUTION_BITS = 14
MOST_RECORDS = 256_000
MOST_RECORDS_OLD_FPGA = 1000
OLD_FPGA = 18
MOST_DELAY_SAMPLES = 9_999_999
MOST_BUFFER_BYTES = 4 * 1024 * 1024
HEADER_BYTES = 16
ENDLESS_RECORDS = 0x7FFFFFFF
SAMPLES_PER_TIMESTAMP = 2

SAMPLE_RATES_HZ = {
    0x01: 1_000,
    0x02: 2_000,
    0x04: 5_000,
    0x08: 10_000,
    0x0A: 20_000,
    0x0C: 50_000,
    0x0E: 100_000,
    0x10: 200_000,
    0x12: 500_000,
    0x14: 1_000_000,
    0x18: 2_000_000,
    0x1A: 5_000_000,
    0x1C: 10_000_000,
    0x1E: 20_000_000,
    0x22: 50_000_000,
    0x24: 100_000_000,
    0x25: 125_000_000,
}
"""Sample rate by id, internal clock."""

INPUT_RANGES_V = {
    1: 0.02,
    2: 0.04,
    3: 0.05,
    4: 0.08,
    5: 0.1,
    6: 0.2,
    7: 0.4,
    8: 0.5,
    9: 0.8,
    10: 1.0,
    11: 2.0,
    12: 4.0,
    13: 5.0,
    14: 8.0,
    15: 10.0,
}
"""Full scale by id; that the board takes exactly these is assumed (no primary source)."""
HIGHEST_50_OHM_RANGE = 12
"""Range id up to which 50 ohm may be chosen (assumed)."""

IMPEDANCE_1_MOHM, IMPEDANCE_50_OHM = 1, 2
SOURCE_EXTERNAL, SOURCE_DISABLE = 2, 3
SLOPE_POSITIVE, SLOPE_NEGATIVE = 1, 2
EXTERNAL_RANGES_V = {0: 5.0, 1: 1.0}
AUX_OUT_TRIGGER = 0
AUX_MODES = (0, 1, 2, 4, 5, 6, 14, 20)
TRIGGERED_BY_EXTERNAL, TRIGGERED_BY_TIMEOUT = 3, 7
TIMESTAMP_FIRST_TIME_ONLY, TIMESTAMP_ALWAYS = 0, 1

ADMA_EXTERNAL_STARTCAPTURE, ADMA_RECORD_HEADERS, ADMA_NPT = 0x1, 0x8, 0x200

CAPABILITY_SERIAL, CAPABILITY_CALIBRATION = 0x10000024, 0x10000026
CAPABILITY_MEMORY, CAPABILITY_BOARD, CAPABILITY_FPGA, CAPABILITY_OPTIONS = (
    0x1000002A,
    0x1000002B,
    0x1000002C,
    0x10000037,
)
OPTION_EXTERNAL_CLOCK, OPTION_DUAL_PORT = 1 << 1, 1 << 2

PARAMETER_DATA_WIDTH, PARAMETER_BUFFER_BYTES, PARAMETER_BUFFER_COUNT = 0x10000009, 0x10000039, 0x10000040
PARAMETER_SET_FORMAT, PARAMETER_GET_FORMAT, PARAMETER_SAMPLES_PER_TIMESTAMP = 0x10000041, 0x10000042, 0x10000044
PARAMETER_RECORDS_CAPTURED, PARAMETER_MOST_PRETRIGGER = 0x10000045, 0x10000046
PARAMETER_BUFFERS_PENDING, PARAMETER_BUFFERS_FULL, PARAMETER_BUFFERS_EMPTY = 0x10000050, 0x10000051, 0x10000052
