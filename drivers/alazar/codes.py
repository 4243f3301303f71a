"""The return codes of the vendor's ATSApi, and the one place where a code becomes an error (reference 2.8)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from drivers.alazar.meanings import MEANINGS
from drivers.interfaces import InstrumentError

SUCCESS: Final = 512
FAILED: Final = 513
UNSUPPORTED_FUNCTION: Final = 533
WAIT_TIMEOUT: Final = 579
OLD_SDK: Final = 5
"""Last major version whose 604 and 607 are those of the old guide."""

# Their meaning changed between SDK versions, so that they have a name only where the version is known.
AMBIGUOUS: Final = frozenset({603, 604, 607})
_OLD_NAMES: Final[Mapping[int, tuple[str, str]]] = MappingProxyType(
    {
        604: ("ApiRecordTooHigh", "a record above 1000 has no time stamp with FPGA version 18 and below"),
        607: ("ApiTooManyRecords", "the record count exceeds 1000 with FPGA version 18 and below"),
    }
)
_NEW_NAMES: Final[Mapping[int, tuple[str, str]]] = MappingProxyType(
    {
        603: ("ApiError1", "too many single-port records"),
        604: ("ApiError2", "too many single-port records"),
        607: ("ApiNetworkError", "the connection to the board's server failed"),
    }
)
RETURN_CODES: Final[Mapping[int, str]] = MappingProxyType({code: name for code, (name, _) in MEANINGS.items()})

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
_UNSUSPECTED: Final = (
    "no cause is known for this code",
    "run again, restart the machine if it stays, and see the error list of your SDK version",
)


def check(code: int, call: str, role: str, sdk_major: int | None = None) -> None:
    """Return if ``code`` is success; else raise ``InstrumentError`` with call, number, name, meaning and remedy."""
    if code == SUCCESS:
        return
    name, meaning = _entry(code, sdk_major)
    why, remedy = _BY_CALL.get(call) or _BY_CODE.get(code) or _UNSUSPECTED
    raise InstrumentError(role, f"{call} returned {code} ({name}), {meaning}", why, remedy)


def code_name(code: int, sdk_major: int | None = None) -> str:
    """Return the vendor's name of ``code``."""
    return _entry(code, sdk_major)[0]


def _entry(code: int, sdk_major: int | None) -> tuple[str, str]:
    unnamed = "its name depends on the SDK version", "which is not known"
    if code in AMBIGUOUS and sdk_major is None:
        return unnamed
    if code in AMBIGUOUS:
        return (_OLD_NAMES if sdk_major is not None and sdk_major <= OLD_SDK else _NEW_NAMES).get(code, unnamed)
    return MEANINGS.get(code, ("unknown code", "no SDK version known here has this code"))
