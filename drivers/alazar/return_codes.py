"""Return codes of the vendor's ATSApi: names, meanings, and their conversion to errors.

Source: docs/explanation/instruments.md, 2.8.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from drivers.interfaces import InstrumentError

SUCCESS: Final = 512
FAILED: Final = 513
UNSUPPORTED_FUNCTION: Final = 533
WAIT_TIMEOUT: Final = 579
RECORD_TOO_HIGH: Final = 604
"""Of ``AlazarGetTriggerTimestamp``, in every SDK version: the record's trigger time is not available."""
OLD_SDK: Final = 5
"""Last major version that uses the old guide's meanings of 604 and 607."""

# One line a code, in the vendor's order: the first block from 512 without a gap, the second from 608.
_FROM_512: Final = """
Success: done
Failed: the call failed without saying why
AccessDenied: access to the board was denied
DmaChannelUnavailable: the DMA channel is in use
DmaChannelInvalid: there is no such DMA channel
DmaChannelTypeError: the DMA channel is of another type
DmaInProgress: a DMA transfer is in progress
DmaDone: the DMA transfer is over
DmaPaused: the DMA transfer is paused
DmaNotPaused: the DMA transfer is not paused
DmaCommandInvalid: the DMA engine has no such command
DmaManReady: the DMA engine is ready
DmaManNotReady: the DMA engine is not ready
DmaInvalidChannelPriority: there is no such DMA priority
DmaManCorrupted: the DMA engine's state is corrupt
DmaInvalidElementIndex: there is no such DMA element
DmaNoMoreElements: the DMA engine has no element left
DmaSglInvalid: the DMA scatter list is invalid
DmaSglQueueFull: the DMA scatter queue is full
NullParam: a pointer is null
InvalidBusIndex: there is no such bus
UnsupportedFunction: the function is not supported
InvalidPciSpace: there is no such PCI space
InvalidIopSpace: there is no such I/O space
InvalidSize: a size is invalid
InvalidAddress: an address is invalid
InvalidAccessType: the kind of access is invalid
InvalidIndex: an index is out of range
MuNotReady: the messaging unit is not ready
MuFifoEmpty: the messaging queue is empty
MuFifoFull: the messaging queue is full
InvalidRegister: there is no such register
DoorbellClearFailed: the doorbell could not be cleared
InvalidUserPin: there is no such user pin
InvalidUserState: there is no such user pin state
EepromNotPresent: the board has no EEPROM
EepromTypeNotSupported: the EEPROM is of an unknown type
EepromBlank: the EEPROM is blank
ConfigAccessFailed: the PCI configuration could not be accessed
InvalidDeviceInfo: the device information is invalid
NoActiveDriver: no kernel driver is active
InsufficientResources: the system lacks resources
ObjectAlreadyAllocated: the object is allocated already
AlreadyInitialized: it is initialised already
NotInitialized: it is not initialised
BadConfigRegEndianMode: the byte order of the configuration register is wrong
InvalidPowerState: the power state is invalid
PowerDown: the board is powered down
FlybyNotSupported: fly-by transfers are not supported
NotSupportThisChannel: this channel is not supported
NoAction: nothing was done
HSNotSupported: hot swap is not supported
VPDNotSupported: vital product data are not supported
VpdNotEnabled: vital product data are not enabled
NoMoreCap: there is no further capability
InvalidOffset: an offset is invalid
BadPinDirection: the pin's direction is wrong
PciTimeout: the PCI bus timed out
DmaChannelClosed: the DMA channel is closed
DmaChannelError: the DMA channel reports an error
InvalidHandle: the board's handle is invalid
BufferNotReady: the buffer is not ready
InvalidData: the data are invalid
DoNothing: there is nothing to do
DmaSglBuildFailed: the DMA scatter list could not be built
PMNotSupported: power management is not supported
InvalidDriverVersion: the driver is of another version
WaitTimeout: the wait timed out
WaitCanceled: the wait was cancelled
BufferTooSmall: the buffer is too small
BufferOverflow: the board's memory overflowed
InvalidBuffer: the buffer is invalid or posted already
InvalidRecordsPerBuffer: the number of records per buffer is invalid
DmaPending: a DMA transfer is pending
LockAndProbePagesFailed: the buffer's pages could not be locked
WaitAbandoned: the wait was abandoned
WaitFailed: the wait failed
TransferComplete: this was the last buffer
PllNotLocked: the clock loop is not locked
NotSupportedInDualChannelMode: not supported with two channels
NotSupportedInQuadChannelMode: not supported with four channels
FileIoError: a file could not be read or written
InvalidClockFrequency: the clock frequency is invalid
InvalidSkipTable: the skip table is invalid
InvalidDspModule: there is no such DSP module
DESOnlySupportedInSingleChannelMode: dual-edge sampling takes a single channel
InconsistentChannel: the channels contradict each other
DspFiniteRecordsPerAcquisition: the DSP takes a finite record count
NotEnoughNptFooters: there is no room for the record footers
InvalidNptFooter: a record footer is invalid
OCTIgnoreBadClockNotSupported: ignoring a bad clock is not supported
"""
_FROM_608: Final = """
FftSizeTooLarge: the transform is too long
GPUError: the graphics processor reports an error
AcquisitionModeOnlySupportedInFifoStreaming: this mode takes FIFO streaming
InterleaveNotSupportedInTraditionalMode: samples cannot be interleaved in traditional mode
RecordHeadersNotSupported: record headers are not supported
RecordFootersNotSupported: record footers are not supported
"""


def _entries(lines: str, first: int) -> Iterator[tuple[int, tuple[str, str]]]:
    for code, line in enumerate(lines.strip().splitlines(), first):
        name, _, meaning = line.partition(": ")
        yield code, (f"Api{name}", meaning)


MEANINGS: Final[Mapping[int, tuple[str, str]]] = {
    **dict(_entries(_FROM_512, 512)),
    605: ("ApiOCT605", "a function for optical coherence tomography failed"),
    606: ("ApiOCT606", "a function for optical coherence tomography failed"),
    **dict(_entries(_FROM_608, 608)),
}

# The meaning of these depends on the SDK version; they are named only if it is known.
AMBIGUOUS: Final = frozenset({603, 604, 607})
_OLD_NAMES: Final[Mapping[int, tuple[str, str]]] = {
    604: ("ApiRecordTooHigh", "a record above 1000 has no time stamp"),
    607: ("ApiTooManyRecords", "the record count exceeds 1000 with FPGA version 18 and below"),
}
_NEW_NAMES: Final[Mapping[int, tuple[str, str]]] = {
    603: ("ApiError1", "too many single-port records"),
    604: ("ApiError2", "too many single-port records"),
    607: ("ApiNetworkError", "the connection to the board's server failed"),
}

# The likely cause and its remedy.
_BY_CODE: Final[Mapping[int, tuple[str, str]]] = {
    513: ("the board refused an argument or combination", "compare the setting with the board's data sheet"),
    514: ("another program holds the board", "end the other program"),
    518: ("a transfer is still running, or buffers were asked for out of order", "abort and arm again"),
    533: ("this board or SDK version has no such function", "install another ATS-SDK version"),
    536: ("a size is not one the board accepts", "change the record length"),
    552: ("the kernel driver is not loaded", "reinstall the driver, restart the machine"),
    553: ("the machine has not enough memory for the buffers", "use shorter or fewer records"),
    572: ("the board's handle is not valid any more", "open the bench again"),
    573: ("the buffer was not posted", "abort and arm again"),
    578: ("driver and SDK are of different versions", "install driver and SDK of one release"),
    579: ("no trigger arrived in time", "check the trigger cable, level and the generators' outputs"),
    581: ("the buffer is smaller than the records", "change the record length or count"),
    582: ("records came faster than they were read, and the board's memory is full", "lower the pulse rate"),
    584: ("the records per buffer do not divide the record count", "change the record count"),
    586: ("the system could not pin the buffers", "use shorter or fewer records, close other programs"),
    590: ("the sample clock is not locked", "check the clock source"),
}
_BY_CALL: Final[Mapping[str, tuple[str, str]]] = {
    "AlazarSetRecordCount": (
        "the record count exceeds what the board holds; with FPGA version 18 and below that is 1000",
        "record fewer pulses per capture",
    ),
    "AlazarInputControl": ("the board has no such input range at 50 ohm", "choose another input_range_v"),
}
_UNKNOWN_CAUSE: Final = (
    "no cause is known for this code",
    "run again, restart the machine if it stays, and see the error list of your SDK version",
)


def check(code: int, call: str, role: str, sdk_major: int | None = None) -> None:
    """Return if ``code`` is success; else raise ``InstrumentError`` with call, number, name, meaning and remedy."""
    if code == SUCCESS:
        return
    name, meaning = _entry(code, sdk_major)
    why, remedy = _BY_CALL.get(call) or _BY_CODE.get(code) or _UNKNOWN_CAUSE
    raise InstrumentError(role, f"{call} returned {code} ({name}), {meaning}", why, remedy)


def _entry(code: int, sdk_major: int | None) -> tuple[str, str]:
    unnamed = "its name depends on the SDK version", "which is not known"
    if code in AMBIGUOUS:
        names = {} if sdk_major is None else _OLD_NAMES if sdk_major <= OLD_SDK else _NEW_NAMES
        return names.get(code, unnamed)
    return MEANINGS.get(code, ("unknown code", "no SDK version known here has this code"))
