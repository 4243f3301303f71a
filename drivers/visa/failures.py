"""Reasons why a connection cannot be opened or is lost, in words, with the likely cause and a remedy.

Errors of the operating system, of pyvisa (status codes) and of pyvisa-py (exceptions of any type) become the same
words here, and nowhere else. pyvisa-py hides the error of the system behind its own ones, so that the chain of causes
is searched.
"""

from __future__ import annotations

import errno
import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Failure:
    """What happened, the likely cause (``why``) and what to try (``remedy``)."""

    what: str
    why: str
    remedy: str


UNREACHABLE: Final = Failure(
    "nothing answers there",
    "the instrument is off, unplugged or at another address, or a firewall is between",
    "check power, cable and address; ping the host",
)
REFUSED: Final = Failure(
    "the host refuses the connection",
    "the port is wrong, its remote interface is disabled, or another program holds its only connection",
    "check the port, enable the interface at the front panel, end other programs",
)
UNKNOWN_HOST: Final = Failure(
    "the host name is unknown",
    "it is misspelt, or the name server does not know it",
    "the IP address that the instrument displays, in place of the name",
)
MUTE: Final = Failure(
    "the host accepts the connection but does not answer",
    "the instrument or its interface hangs, or the port belongs to something else",
    "power it off and on, check the port",
)
NO_DEVICE: Final = Failure(
    "there is no such device",
    "it is off or unplugged, or has another address",
    "check power, cable and address, or see what hpe-rig bench finds",
)
NO_SERIAL_LINE: Final = Failure(
    "this device is no serial line",
    "the path belongs to a device of another kind, such as /dev/null",
    "the device of the serial line, such as ASRL/dev/ttyUSB0::INSTR",
)
NO_LINK: Final = Failure(
    "the host has no such device",
    "the device name or GPIB address is wrong, or the instrument behind the gateway is off",
    "check the address and the instrument's power",
)
NO_PERMISSION: Final = Failure(
    "this user may not use the device",
    "the device belongs to another group, or another program has opened it",
    "on Linux add the user to the device's group (dialout), else end the other program",
)
BUSY: Final = Failure(
    "another program uses it", "another program holds its lock or its connection", "end the other program"
)
CLOSED: Final = Failure(
    "the instrument closed the connection",
    "it was switched off, restarted, or ends idle connections",
    "check its power, open the bench again",
)
NO_ADDRESS: Final = Failure(
    "this is no VISA address",
    "it is misspelt or incomplete",
    "an address from the list of hpe-rig bench, such as TCPIP0::192.168.1.20::5025::SOCKET",
)
UNEXPLAINED: Final = Failure(
    "", "the address, the cable or the power is wrong", "check these, or see what hpe-rig bench finds"
)

SYSTEM_ERRORS: Final = {
    errno.ECONNREFUSED: REFUSED,
    errno.EHOSTUNREACH: UNREACHABLE,
    errno.ENETUNREACH: UNREACHABLE,
    errno.ETIMEDOUT: UNREACHABLE,
    errno.ENOENT: NO_DEVICE,
    errno.ENODEV: NO_DEVICE,
    errno.ENXIO: NO_DEVICE,
    errno.ENOTTY: NO_SERIAL_LINE,
    errno.EACCES: NO_PERMISSION,
    errno.EPERM: NO_PERMISSION,
    errno.EBUSY: BUSY,
    errno.ECONNRESET: CLOSED,
    errno.EPIPE: CLOSED,
    errno.ECONNABORTED: CLOSED,
}
"""Failures by the operating system's error number."""
STATUS_CODES: Final = {
    "error_timeout": UNREACHABLE,
    "error_resource_not_found": NO_DEVICE,
    "error_resource_busy": BUSY,
    "error_resource_locked": BUSY,
    "error_connection_lost": CLOSED,
    "error_no_permission": NO_PERMISSION,
    "error_invalid_resource_name": NO_ADDRESS,
}
"""Failures by the name of pyvisa's status code; other codes have pyvisa's own description."""
EXCEPTION_TEXTS: Final = (
    ("can't connect to server", UNREACHABLE),
    ("Connection was dropped", CLOSED),
    ("error creating link: 3", NO_LINK),
    ("error creating link: 11", BUSY),
    ("could not open port", NO_DEVICE),
    ("Could not configure port", NO_SERIAL_LINE),
)
"""Failures by a part of the text of pyvisa-py's and pyserial's exceptions."""
STATUS_NUMBER: Final = re.compile(r"-10738\d{5}")


class OpenError(ConnectionError):
    """A connection cannot be opened; ``why`` is the likely cause, ``remedy`` what to try."""

    def __init__(self, address: str, failure: Failure) -> None:
        super().__init__(f"cannot open {address!r}: {failure.what}")
        self.why = failure.why
        self.remedy = failure.remedy


def failure_of(error: BaseException) -> Failure:
    """Return the failure that ``error`` reports; its own text, with status codes in words, if it is none of these."""
    causes = list(_causes(error))
    # The innermost cause is the most precise one.
    for cause in reversed(causes):
        if failure := _known_failure(cause):
            return failure
    text = next((text for text in map(_text, causes) if text), type(error).__name__)
    return Failure(text, UNEXPLAINED.why, UNEXPLAINED.remedy)


def _text(error: BaseException) -> str:
    """Return the text of ``error``, status codes of VISA described."""
    code = getattr(error, "error_code", None)
    text = str(error) if code is None else str(int(code))
    return STATUS_NUMBER.sub(lambda match: _status_words(int(match[0])), text).strip().rstrip(".")


def _known_failure(error: BaseException) -> Failure | None:
    if isinstance(error, socket.gaierror):
        return UNKNOWN_HOST
    if isinstance(error, TimeoutError):
        return UNREACHABLE
    if isinstance(error, OSError) and error.errno in SYSTEM_ERRORS:
        return SYSTEM_ERRORS[error.errno]
    code = getattr(error, "error_code", None)
    if code is not None and (failure := STATUS_CODES.get(_status_name(code))):
        return failure
    return next((failure for text, failure in EXCEPTION_TEXTS if text in str(error)), None)


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield ``error``, its cause, the cause of that, and so on."""
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__


def _status_name(code: int) -> str:
    from pyvisa.constants import StatusCode

    try:
        return StatusCode(code).name
    except ValueError:
        return ""


def _status_words(code: int) -> str:
    """Return pyvisa's description of a status code."""
    from pyvisa.errors import completion_and_error_messages

    name, description = completion_and_error_messages.get(code, ("", f"unknown VISA status {code}"))
    return f"{description.rstrip('.')} ({name})" if name else description
