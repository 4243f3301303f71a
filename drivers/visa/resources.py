"""VISA resources of pyvisa, by a vendor's VISA library or by pyvisa-py.

Two facts of pyvisa-py 0.7 to 0.8 are relied upon, which its documentation does not promise. A missing bus package is
a ``ValueError`` with the text 'Please install'. A failed transport raises any exception (``OSError``,
``RuntimeError``, ``EOFError``, bare ``Exception``), not ``VisaIOError`` alone.
"""

from __future__ import annotations

import functools
import os
import re
import socket
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Final, final

from drivers.visa.bounded import within
from drivers.visa.failures import MUTE, NO_DEVICE, UNREACHABLE, Failure, OpenError, failure_of
from drivers.visa.rs232 import FACTORY_SETTINGS, SerialSettings
from drivers.visa.sockets import tcp_endpoint

if TYPE_CHECKING:
    from pyvisa import ResourceManager
    from pyvisa.resources import MessageBasedResource

# The default of pyvisa, 0, is 0.1 s for VXI-11 in pyvisa-py before 0.9 (its issue 578).
OPEN_TIMEOUT_MS: Final = 2500
# Closing a VXI-11 link to an instrument that hangs lasts 5 s in pyvisa-py.
CLOSE_TIMEOUT_S: Final = 0.5
PROBE_TIMEOUT_S: Final = 0.5
LAN_RESOURCE: Final = re.compile(
    r"TCPIP\d*::(?P<host>[^:,]+)(?:,(?P<port>\d+))?(?:::(?P<hislip>hislip\d+)?(?:,(?P<hislip_port>\d+))?.*)?",
    re.IGNORECASE,
)
HISLIP_PORT: Final = 4880
PORTMAPPER_PORT: Final = 111
LOCK_TIMEOUT_MS: Final = 200
BUS_PACKAGES: Final = {
    "GPIB": ", or linux-gpib and pip install gpib-ctypes",
    "USB": ", or pip install pyusb and a libusb",
}
"""Remedies without a vendor's VISA, by kind of address."""


_manager_lock = threading.Lock()


@final
class NoVisaError(OpenError):
    """This computer has no driver for this kind of address; ``remedy`` says which one to install."""

    def __init__(self, address: str) -> None:
        bus = next((name for name in BUS_PACKAGES if address.upper().startswith(name)), "")
        what = f"no VISA driver for {bus or 'this kind of address'} is installed"
        why = "this computer has no driver for such an address, which may be right"
        remedy = f"install NI-VISA or Keysight IO Libraries{BUS_PACKAGES.get(bus, '')}"
        super().__init__(address, Failure(what, why, remedy))


@final
class VisaLine:
    """Line of text over a VISA resource that carries messages.

    ``backend`` is pyvisa's library choice: "" is the vendor's if there is one, else "@py". With ``lock`` the resource
    is locked against other programs, if library and transport can do that. Raises ``NoVisaError`` or any exception of
    the library when the resource cannot be opened.
    """

    def __init__(
        self, address: str, timeout_s: float, backend: str, lock: bool, serial: SerialSettings = FACTORY_SETTINGS
    ) -> None:
        import pyvisa

        self._resource = _message_resource(address, backend)
        try:
            self.timeout_s = timeout_s
            self._resource.read_termination = "\n"
            self._has_device_clear = _has_device_clear(self._resource)
            self._is_reply_missing = False
            self.is_rs232 = isinstance(self._resource, pyvisa.resources.SerialInstrument)
            if isinstance(self._resource, pyvisa.resources.SerialInstrument):
                # 8 data bits, no parity and 1 stop bit are VISA's own default.
                self._resource.baud_rate = serial.baud
                self._resource.flow_control = pyvisa.constants.ControlFlow[serial.handshake]
                self._resource.read_termination = serial.line_end[-1]
            if lock:
                self._lock()
        except Exception:
            self.close()
            raise

    @property
    def timeout_s(self) -> float:
        """The time that ``read`` waits for a reply."""
        return float(self._resource.timeout) / 1e3

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._resource.timeout = timeout_s * 1e3

    def write(self, message: bytes) -> None:
        """Send ``message``, after a missing reply with the interface cleared: it may still be waiting to send that."""
        if self._is_reply_missing and self._has_device_clear:
            # A failure shows at the message.
            with suppress(Exception):
                self._resource.clear()
        self._is_reply_missing = False
        self._resource.write_raw(message)

    def read(self) -> bytes:
        """Return one reply with its line end; raise ``TimeoutError`` if there is none."""
        import pyvisa

        try:
            reply = bytes(self._resource.read_raw())
        except pyvisa.VisaIOError as error:
            if error.error_code == pyvisa.constants.StatusCode.error_timeout:
                self._is_reply_missing = True
                raise TimeoutError from error
            raise
        self._is_reply_missing = False
        if not reply:
            # Over HiSLIP pyvisa-py returns at once if no query followed the last reply.
            raise TimeoutError
        return reply

    def discard_replies(self) -> None:
        """Drop what has arrived and was not read."""
        import pyvisa

        self._resource.flush(pyvisa.constants.BufferOperation.discard_read_buffer)

    def close(self) -> None:
        """Close the resource; a lost or closed one is no error."""
        with suppress(Exception):
            within(CLOSE_TIMEOUT_S, self._resource.close)

    def _lock(self) -> None:
        """Lock the resource exclusively; raise ``OSError`` if another program holds the lock."""
        import pyvisa

        try:
            self._resource.lock_excl(LOCK_TIMEOUT_MS)
        except pyvisa.VisaIOError as error:
            if error.error_code == pyvisa.constants.StatusCode.error_resource_locked:
                raise OSError("another program holds its lock") from error
            # pyvisa-py reports that it has no locks on most transports.


def _message_resource(address: str, backend: str) -> MessageBasedResource:
    """Return the open resource; raise ``NoVisaError``, or ``ValueError`` if it carries no messages."""
    import pyvisa

    try:
        resource = _resource_manager(backend).open_resource(address, open_timeout=OPEN_TIMEOUT_MS)
    except ValueError as error:
        if "Please install" in str(error):
            raise NoVisaError(address) from error
        raise
    if isinstance(resource, pyvisa.resources.MessageBasedResource):
        return resource
    resource.close()
    raise ValueError(f"{type(resource).__name__} carries no text messages")


def _has_device_clear(resource: MessageBasedResource) -> bool:
    """Return whether VISA's clear reaches the instrument's own interface: on GPIB, USB and VXI-11 gateways to GPIB.

    A reply that is not read blocks these interfaces; RS-232 has none, and HiSLIP numbers its replies.
    """
    import pyvisa

    kinds = pyvisa.resources
    if isinstance(resource, kinds.TCPIPInstrument):
        return "::hislip" not in resource.resource_name.lower()
    return isinstance(resource, (kinds.GPIBInstrument, kinds.USBInstrument))


def open_failure(address: str, error: BaseException) -> Failure:
    """Return why ``address`` cannot be opened; a LAN host is asked whether it accepts connections.

    pyvisa's error does not distinguish a host that is off from one that refuses, or accepts and then is silent.
    """
    failure = failure_of(error)
    match = None if tcp_endpoint(address) else LAN_RESOURCE.fullmatch(address)
    if match is None:
        return failure
    port = match["port"] or match["hislip_port"] or (HISLIP_PORT if match["hislip"] else PORTMAPPER_PORT)
    try:
        within(PROBE_TIMEOUT_S, lambda: _connect_once(match["host"], int(port)))
    except OSError as refusal:
        return failure_of(refusal)
    return MUTE if failure in (UNREACHABLE, NO_DEVICE) else failure


def _connect_once(host: str, port: int) -> None:
    socket.create_connection((host, port), PROBE_TIMEOUT_S).close()


def _resource_manager(backend: str) -> ResourceManager:
    import pyvisa

    # Several lines are opened at the same time, and pyvisa creates one manager a library.
    with _manager_lock:
        return pyvisa.ResourceManager(_library(backend or os.environ.get("PYVISA_LIBRARY", "")))


@functools.cache
def _library(backend: str) -> str:
    """Return the pyvisa library specification for ``backend``: the vendor's library if there is one, else "@py".

    Cached: pyvisa asks the linker and the compiler for the library, which takes a third of a second an instrument.
    """
    import pyvisa

    try:
        library_path = pyvisa.ResourceManager(backend).visalib.library_path
    except (ValueError, OSError):
        return "@py"
    return backend or ("@py" if library_path == "py" else f"{library_path}@ivi")
