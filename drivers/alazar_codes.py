"""The return codes of the vendor's ATSApi, and the one place where a code becomes an error (reference 2.8)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from drivers.interfaces import InstrumentError

SUCCESS: Final = 512
FAILED: Final = 513
UNSUPPORTED_FUNCTION: Final = 533
WAIT_TIMEOUT: Final = 579

# In the vendor's order, from 512 without a gap; 592 and above came with later SDKs.
_NAMES: Final = """
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
NotSupportedInDualChannelMode NotSupportedInQuadChannelMode FileIoError InvalidClockFrequency InvalidSkipTable
InvalidDspModule DESOnlySupportedInSingleChannelMode InconsistentChannel DspFiniteRecordsPerAcquisition
NotEnoughNptFooters InvalidNptFooter OCTIgnoreBadClockNotSupported
"""

# Their meaning changed between SDK versions, so no name is given for them.
AMBIGUOUS: Final = frozenset({603, 604, 607})

RETURN_CODES: Final[Mapping[int, str]] = MappingProxyType(
    {code: f"Api{name}" for code, name in enumerate(_NAMES.split(), SUCCESS)}
    | {
        605: "ApiOCT605",
        606: "ApiOCT606",
        608: "ApiFftSizeTooLarge",
        609: "ApiGPUError",
        610: "ApiAcquisitionModeOnlySupportedInFifoStreaming",
        611: "ApiInterleaveNotSupportedInTraditionalMode",
        612: "ApiRecordHeadersNotSupported",
        613: "ApiRecordFootersNotSupported",
    }
)

# What to suspect first: (cause, remedy).
_BY_CODE: Final[Mapping[int, tuple[str, str]]] = MappingProxyType(
    {
        513: ("the board refused an argument or combination", "compare the setting with the ATS460's data sheet"),
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
)
_BY_CALL: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "AlazarSetRecordCount": (
            "the record count exceeds what the board holds; with FPGA version 18 and below that is 1000",
            "record fewer pulses per capture",
        ),
        "AlazarInputControl": (
            "the board has no such input range at 50 ohm",
            "choose another input_range_v",
        ),
    }
)


def check(code: int, call: str, role: str) -> None:
    """Return if ``code`` is success; else raise ``InstrumentError`` with call, number, name and likely cause."""
    if code == SUCCESS:
        return
    meaning = f"see the error list of your SDK version, where {code} has its own meaning"
    unknown = ("no cause is known for this code", meaning)
    why, remedy = _BY_CALL.get(call) or _BY_CODE.get(code) or unknown
    raise InstrumentError(role, f"{call} returned {code} ({code_name(code)})", why, remedy)


def code_name(code: int) -> str:
    """Return the vendor's name of ``code``."""
    if code in AMBIGUOUS:
        return "its name depends on the SDK version"
    return RETURN_CODES.get(code, "unknown code")
