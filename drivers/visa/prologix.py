"""Prologix GPIB adapters: several GPIB instruments behind one TCP or serial line.

Lines that start with ``++`` are for the adapter, all others go to the instrument last named by ``++addr``
(Prologix GPIB-ETHERNET user manual, version 1.6.6). pyvisa-py has Prologix sessions from version 0.8 on. They block
for ever when the adapter closes the connection, and give the instrument 50 ms to reply.
"""

from __future__ import annotations

import re
from typing import Final, final

from drivers.visa.bounded import open_within
from drivers.visa.failures import OpenError
from drivers.visa.resources import VisaLine, open_failure
from drivers.visa.sockets import OPEN_TIMEOUT_S, TIMEOUT_S, TcpLine, TextLine, tcp_endpoint

MAX_READ_TIMEOUT_MS: Final = 3000
# The adapter must give up before the program does; otherwise a late reply could answer the next instrument's query.
READ_TIMEOUT_FRACTION: Final = 0.8
# Controller mode; a reply is sent on request only; no line end appended, EOI asserted and not marked in replies.
SETTINGS: Final = ("++mode 1", "++auto 0", "++eos 3", "++eoi 1", "++eot_enable 0")
SERIAL_ADAPTER: Final = re.compile(r"PRLGX-ASRL\d*::(?P<device>.+)::INTFC", re.IGNORECASE)
GPIB_ADDRESS: Final = re.compile(r"GPIB\d*::(?P<address>\d+(?:::\d+)?)(?:::INSTR)?", re.IGNORECASE)
SPECIAL_BYTES: Final = re.compile(rb"([\x1b\n\r+])")


@final
class PrologixAdapter:
    """One adapter, which the connections of its instruments share.

    ``address`` is ``PRLGX-TCPIP0::host::1234::INTFC`` or ``PRLGX-ASRL::device::INTFC``. Raises ``OpenError`` if
    the adapter cannot be opened within ``OPEN_TIMEOUT_S``.
    """

    def __init__(self, address: str, timeout_s: float = TIMEOUT_S, backend: str = "") -> None:
        self.address = address
        self._backend = backend
        self._open(timeout_s)

    @property
    def timeout_s(self) -> float:
        """The time that a read waits, in this program and in the adapter."""
        return self._line.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._line.timeout_s = timeout_s
        self._line.write(_read_timeout(timeout_s))

    def reopen(self) -> None:
        """Open the adapter again; raise ``ConnectionError`` if it does not answer."""
        timeout_s = self.timeout_s
        self.close()
        self._open(timeout_s)

    def write(self, gpib_address: str, message: bytes) -> None:
        """Send ``message`` to an instrument; a late reply, of whichever instrument, is dropped."""
        self._line.discard_replies()
        text = message.removesuffix(b"\n")
        # An instrument may still be waiting to send a missing reply.
        clear = b"++clr\n" if gpib_address in self._silent_addresses else b""
        self._silent_addresses.discard(gpib_address)
        self._line.write(self._selection(gpib_address) + clear + SPECIAL_BYTES.sub(b"\x1b\\1", text) + b"\n")
        self._is_reply_requested = False

    def read(self, gpib_address: str) -> bytes:
        """Return a reply of an instrument, which the adapter is asked for once a message."""
        request = b"" if self._is_reply_requested else b"++read eoi\n"
        if commands := self._selection(gpib_address) + request:
            self._line.write(commands)
        self._is_reply_requested = True
        try:
            return self._line.read()
        except TimeoutError:
            self._silent_addresses.add(gpib_address)
            raise

    def close(self) -> None:
        """Close the adapter; a lost or closed one is no error."""
        self._line.close()

    def _open(self, timeout_s: float) -> None:
        try:
            self._line = open_within(OPEN_TIMEOUT_S, lambda: self._open_line(timeout_s))
            self._line.write(b"".join(f"{setting}\n".encode() for setting in SETTINGS) + _read_timeout(timeout_s))
        except OpenError:
            raise
        except Exception as error:
            raise OpenError(self.address, open_failure(self.address, error)) from error
        self._selected = ""
        self._silent_addresses: set[str] = set()
        self._is_reply_requested = False

    def _open_line(self, timeout_s: float) -> TextLine:
        if endpoint := tcp_endpoint(self.address):
            return TcpLine(endpoint, timeout_s)
        if match := SERIAL_ADAPTER.fullmatch(self.address):
            return VisaLine(f"ASRL{match['device']}::INSTR", timeout_s, self._backend, lock=False)
        raise ValueError("it is no Prologix adapter, such as PRLGX-TCPIP0::192.168.1.20::1234::INTFC")

    def _selection(self, gpib_address: str) -> bytes:
        """Return the command that selects an instrument, nothing if it is selected."""
        if gpib_address == self._selected:
            return b""
        self._selected = gpib_address
        return f"++addr {gpib_address}\n".encode()


@final
class PrologixInstrument:
    """Line of text to the instrument ``address`` (``GPIB0::10::INSTR``) behind ``adapter``, which stays open."""

    is_rs232 = False

    def __init__(self, adapter: PrologixAdapter, address: str) -> None:
        match = GPIB_ADDRESS.fullmatch(address)
        if match is None:
            raise ValueError("an instrument behind a Prologix adapter needs an address such as GPIB0::10::INSTR")
        self._adapter = adapter
        self._gpib_address = match["address"].replace("::", " ")

    @property
    def timeout_s(self) -> float:
        """The time that ``read`` waits for a reply."""
        return self._adapter.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        if timeout_s != self._adapter.timeout_s:
            self._adapter.timeout_s = timeout_s

    def write(self, message: bytes) -> None:
        """Send ``message``."""
        self._adapter.write(self._gpib_address, message)

    def read(self) -> bytes:
        """Return one reply; raise ``TimeoutError`` if there is none."""
        return self._adapter.read(self._gpib_address)

    def discard_replies(self) -> None:
        """Do nothing: each message drops them."""

    def close(self) -> None:
        """Do nothing: other instruments use the adapter."""


def _read_timeout(timeout_s: float) -> bytes:
    """Return the command that limits the adapter's wait for an instrument's reply."""
    limit_ms = round(READ_TIMEOUT_FRACTION * timeout_s * 1e3)
    return f"++read_tmo_ms {max(1, min(limit_ms, MAX_READ_TIMEOUT_MS))}\n".encode()
