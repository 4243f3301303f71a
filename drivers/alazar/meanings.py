"""Every return code of the vendor's ATSApi: its name, and what it says in words (reference 2.8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final

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


MEANINGS: Final[Mapping[int, tuple[str, str]]] = MappingProxyType(
    {
        **dict(_entries(_FROM_512, 512)),
        605: ("ApiOCT605", "a function for optical coherence tomography failed"),
        606: ("ApiOCT606", "a function for optical coherence tomography failed"),
        **dict(_entries(_FROM_608, 608)),
    }
)
