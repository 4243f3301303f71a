"""Connection over VISA: GPIB, RS-232, raw TCP socket, HiSLIP, VXI-11 and Prologix, by a vendor's VISA or pyvisa-py."""

from __future__ import annotations

import functools
import os
import socket
import traceback
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, final

if TYPE_CHECKING:
    from pyvisa import ResourceManager
    from pyvisa.resources import MessageBasedResource, Resource

# Factory setting of the 33250A's RS-232 interface; 8 data bits, no parity and 1 stop bit are VISA's own default.
SERIAL_BAUD: Final = 57600
LOCK_PATIENCE_S: Final = 0.2
# Twice what a 33250A takes for its slowest settings, of a pulse; a mute instrument shall not hold the others up longer.
TIMEOUT_S: Final = 1.5
PROLOGIX: Final = "PRLGX"
SERIAL_OVER_TCP: Final = "ASRLSOCKET://"
# Kinds of address that pyvisa-py does not open by itself, and what it needs for them.
DRIVERS: Final = {
    "GPIB": ", or linux-gpib and pip install gpib-ctypes",
    "USB": ", or pip install pyusb and a libusb",
}


class NoVisaError(ConnectionError):
    """There is no driver on this computer for an address of this kind; ``remedy`` says which one to install."""

    def __init__(self, address: str, error: Exception) -> None:
        kind, package = next(
            ((bus, need) for bus, need in DRIVERS.items() if address.upper().startswith(bus)), ("", "")
        )
        super().__init__(f"cannot open {address!r}: no VISA driver for {kind or 'this kind of address'} is installed")
        self.remedy = f"install NI-VISA or Keysight IO Libraries{package}"
        self.detail = str(error)


@final
class VisaInterface:
    """An adapter that instruments stand behind, such as ``PRLGX-TCPIP0::host::1234::INTFC``; open it before them.

    Raises ``ConnectionError`` when it cannot be opened.
    """

    def __init__(self, address: str, timeout_s: float = TIMEOUT_S, backend: str = "") -> None:
        self.address = address
        # Only pyvisa-py knows this kind of interface.
        self.backend = "@py" if address.upper().startswith(PROLOGIX) else backend
        self._open(timeout_s)

    def _open(self, timeout_s: float) -> None:
        try:
            self._resource = _opened(_resource_manager(self.backend), self.address)
            # The time-out of an instrument behind the adapter is not handed on to it.
            self._resource.timeout = timeout_s * 1e3
        except Exception as error:
            raise _not_open(self.address, error) from error
        self.link = _socket_of(self._resource)
        _send_at_once(self.link)

    @property
    def timeout_s(self) -> float:
        """How long a read through the adapter waits."""
        return float(self._resource.timeout) / 1e3

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._resource.timeout = timeout_s * 1e3

    def reopen(self, timeout_s: float) -> None:
        """Open the adapter again where it has hung up; raise ``ConnectionError`` where it is not there."""
        if self.link is None or _hung_up(self.link):
            self.close()
            self._open(timeout_s)

    def close(self) -> None:
        """Close the adapter; closing one that is gone already is no error."""
        with suppress(Exception):
            self._resource.close()


@final
class VisaConnection:
    """One text connection; replies without line end.

    Raises ``ConnectionError`` when the connection cannot be opened or is lost, ``TimeoutError`` from ``read`` when
    no reply comes within ``timeout_s``. With ``lock`` it is nobody else's where VISA can see to that. ``backend`` is
    pyvisa's library choice ("" is the vendor's, else "@py"). pyvisa-py lets exceptions of every kind through
    (``OSError``, ``RuntimeError``, ``EOFError``, bare ``Exception``); after any of them the connection is not to be
    trusted.
    """

    def __init__(
        self,
        address: str,
        timeout_s: float = TIMEOUT_S,
        backend: str = "",
        interface: VisaInterface | None = None,
        lock: bool = False,
    ) -> None:
        import pyvisa

        self.address = address
        self._timeout_code = pyvisa.constants.StatusCode.error_timeout
        self._backend, self._interface, self._lock = backend, interface, lock
        self._own_link: socket.socket | None = None
        self._open(timeout_s)

    def _open(self, timeout_s: float) -> None:
        interface = self._interface
        try:
            self._resource = _open(_resource_manager(interface.backend if interface else self._backend), self.address)
            self._own_link = _socket_of(self._resource)
            self._link = interface.link if interface else self._own_link
            self._prepare(timeout_s)
            _require_connected(self._link)
            if self._lock:
                self._exclude_others()
        except Exception as error:
            if hasattr(self, "_resource"):
                self.close()
            raise _not_open(self.address, error) from error

    @property
    def shared(self) -> str:
        """The adapter that the instrument stands behind, else its own address."""
        return self._interface.address if self._interface else self.address

    def reopen(self) -> None:
        """Open the connection again, with the adapter before it where that hung up too; raise ``ConnectionError``."""
        timeout_s = self._timeout_s
        self.close()
        if self._interface is not None:
            self._interface.reopen(timeout_s)
        self._open(timeout_s)

    def write(self, message: str) -> None:
        """Send ``message`` and a line feed."""
        # pyvisa-py waits for ever where a Prologix adapter has hung up, and takes one more message where a peer has.
        if self._hung_up():
            raise ConnectionError(f"{self.address!r} closed the connection")
        try:
            self._resource.write(message)
        except Exception as error:
            raise ConnectionError(f"cannot write to {self.address!r}: {error}") from error

    def read(self) -> str:
        """Return one reply line; bytes that are no ASCII come as they are, for the asker to judge."""
        try:
            reply = self._resource.read_raw().decode("latin-1")
        except Exception as error:
            if getattr(error, "error_code", None) != self._timeout_code:
                raise ConnectionError(f"cannot read from {self.address!r}: {error}") from error
            if self._hung_up():
                raise ConnectionError(f"{self.address!r} closed the connection") from error
            raise TimeoutError(f"no reply from {self.address!r} within {self.timeout_s:g} s") from error
        if not reply:
            # Over HiSLIP pyvisa-py does not wait where nothing was asked since the last reply.
            raise TimeoutError(f"no reply from {self.address!r}")
        return reply.rstrip("\r\n")

    @property
    def timeout_s(self) -> float:
        """How long ``read`` waits."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        with suppress(Exception):
            # One that is gone is found by what is sent to it.
            self._resource.timeout = timeout_s * 1e3
            if self._interface is not None:
                self._interface.timeout_s = timeout_s

    def close(self) -> None:
        """Close the connection; closing one that is gone already is no error."""
        with suppress(Exception):
            self._resource.close()
        # Where the peer was gone already, pyserial leaves it open.
        if self._own_link is not None:
            self._own_link.close()

    def _prepare(self, timeout_s: float) -> None:
        import pyvisa

        self.timeout_s = timeout_s
        self._resource.encoding = "latin-1"
        self._resource.write_termination = "\n"
        # A Prologix adapter has no read terminator to set; there the line end is cut in read().
        with suppress(pyvisa.VisaIOError):
            self._resource.read_termination = "\n"
        _send_at_once(self._own_link)
        if isinstance(self._resource, pyvisa.resources.SerialInstrument):
            self._resource.baud_rate = SERIAL_BAUD
            self._resource.flow_control = pyvisa.constants.ControlFlow.dtr_dsr
            # Over RS-232 the instrument refuses commands until it is told to leave local mode.
            self._resource.write("SYST:REM")

    def _exclude_others(self) -> None:
        """Take VISA's exclusive lock, where library and transport have one; a raw socket has none."""
        import pyvisa

        try:
            self._resource.lock_excl(LOCK_PATIENCE_S * 1e3)
        except pyvisa.VisaIOError as error:
            if error.error_code == pyvisa.constants.StatusCode.error_resource_locked:
                raise OSError("another program holds its lock") from error
        except (NotImplementedError, AttributeError):
            return

    def _hung_up(self) -> bool:
        """Return whether the peer has closed a raw socket, which pyvisa-py reports as a mere time-out."""
        return self._link is not None and _hung_up(self._link)


def _hung_up(link: socket.socket) -> bool:
    if link.fileno() < 0:
        return True
    timeout_s = link.gettimeout()
    try:
        link.setblocking(False)
        return link.recv(1, socket.MSG_PEEK) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
    finally:
        link.settimeout(timeout_s)


def _socket_of(resource: Resource) -> socket.socket | None:
    """Return the raw socket under a pyvisa-py session, None under any other library or transport."""
    with suppress(Exception):
        sessions: Any = getattr(resource.visalib, "sessions", None)
        link = sessions[resource.session].interface
        # Under a serial line that is a TCP socket, pyserial's.
        link = getattr(link, "_socket", link)
        return link if isinstance(link, socket.socket) else None
    return None


def _send_at_once(link: socket.socket | None) -> None:
    """Do without the delay that collects small messages: 40 ms each time a query follows a command."""
    if link is not None:
        with suppress(OSError):
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _require_connected(link: socket.socket | None) -> None:
    """Raise ``OSError`` where a raw socket was refused, which pyvisa-py tells nobody before the first message."""
    code = 0 if link is None else link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if code:
        raise OSError(code, os.strerror(code))


def _not_open(address: str, error: Exception) -> ConnectionError:
    # This is how pyvisa-py says that the package it needs for such an address is not there.
    if isinstance(error, ValueError) and "Please install" in str(error):
        return NoVisaError(address, error)
    return ConnectionError(f"cannot open {address!r}: {str(error).rstrip('.') or type(error).__name__}")


def _resource_manager(backend: str) -> ResourceManager:
    import pyvisa

    return pyvisa.ResourceManager(_library(backend or os.environ.get("PYVISA_LIBRARY", "")))


@functools.cache
def _library(backend: str) -> str:
    """Return which library ``backend`` stands for, "" for the vendor's, else pyvisa-py's.

    Looked for once: pyvisa asks the linker and the compiler each time, which takes a third of a second an instrument.
    """
    import pyvisa

    try:
        found = pyvisa.ResourceManager(backend).visalib.library_path
    except (ValueError, OSError):
        return "@py"
    return backend or ("@py" if found == "py" else f"{found}@ivi")


def _open(manager: ResourceManager, address: str) -> MessageBasedResource:
    import pyvisa

    resource = _opened(manager, address)
    if isinstance(resource, pyvisa.resources.MessageBasedResource):
        return resource
    resource.close()
    raise ValueError(f"{type(resource).__name__} carries no text messages")


def _opened(manager: ResourceManager, address: str) -> Resource:
    """Return the open resource; where it cannot be opened, nothing stays open of it."""
    if address.upper().startswith(SERIAL_OVER_TCP):
        import serial

        # On Windows pyvisa-py asks pyserial for COMsocket://, which is among the modules here.
        if __package__ not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(__package__)
    try:
        return manager.open_resource(address)
    except Exception as error:
        _close_sockets(error)
        raise


def _close_sockets(error: BaseException | None) -> None:
    """Close what pyvisa-py had connected, or tried to, before it raised: only the traceback still leads there."""
    while error is not None:
        for frame, _ in traceback.walk_tb(error.__traceback__):
            if str(frame.f_globals.get("__name__")).startswith(("pyvisa_py.tcpip", "pyvisa_py.protocols")):
                for owner in frame.f_locals.values():
                    _close_sockets_of(owner)
        error = error.__context__


def _close_sockets_of(owner: object, depth: int = 2) -> None:
    """Close the sockets that ``owner``, or what it owns, has among its attributes."""
    for held in getattr(owner, "__dict__", {}).values():
        if isinstance(held, socket.socket):
            held.close()
        elif depth > 1:
            _close_sockets_of(held, depth - 1)
