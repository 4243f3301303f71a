"""Connection to one instrument over GPIB, USB, RS-232, raw TCP socket, HiSLIP, VXI-11 or a Prologix adapter."""

from __future__ import annotations

from contextlib import suppress
from typing import final

from drivers.visa.bounded import open_within
from drivers.visa.failures import OpenError, failure_of
from drivers.visa.prologix import PrologixAdapter, PrologixInstrument
from drivers.visa.resources import VisaLine, open_failure
from drivers.visa.rs232 import FACTORY_SETTINGS, PacedLine, SerialSettings
from drivers.visa.sockets import OPEN_TIMEOUT_S, TIMEOUT_S, TcpLine, TextLine, tcp_endpoint


@final
class VisaConnection:
    """One text connection; replies come without line end.

    ``address`` is a VISA resource name. ``adapter`` is the Prologix adapter in front of the instrument. ``backend``
    and ``lock`` are described at ``VisaLine``; raw sockets and Prologix adapters have no lock. ``serial`` applies to
    RS-232 lines, which are also paced to the instrument's input buffer.

    Raises ``OpenError`` when the connection cannot be opened within ``OPEN_TIMEOUT_S``, ``ConnectionError`` when it is
    lost, and ``TimeoutError`` from ``read`` when no reply comes within ``timeout_s``.
    """

    def __init__(
        self,
        address: str,
        timeout_s: float = TIMEOUT_S,
        backend: str = "",
        adapter: PrologixAdapter | None = None,
        lock: bool = False,
        serial: SerialSettings = FACTORY_SETTINGS,
    ) -> None:
        self.address = address
        self._serial = serial
        self._line_end = "\n"
        self._backend, self._adapter, self._lock = backend, adapter, lock
        self._open(timeout_s)

    @property
    def bus(self) -> str:
        """The address of the adapter in front of the instrument, else the instrument's."""
        return self._adapter.address if self._adapter else self.address

    @property
    def timeout_s(self) -> float:
        """The time that ``read`` waits for a reply."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        # A lost connection shows at the next message.
        with suppress(Exception):
            self._line.timeout_s = timeout_s

    def reopen(self) -> None:
        """Open the connection again, and its adapter; raise ``ConnectionError`` if there is no answer."""
        self.close()
        if self._adapter is not None:
            self._adapter.reopen()
        self._open(self._timeout_s)

    def write(self, message: str) -> None:
        """Send ``message`` and a line end."""
        try:
            self._line.write((message + self._line_end).encode("latin-1"))
        except Exception as error:
            raise ConnectionError(f"cannot write to {self.address!r}: {failure_of(error).what}") from error

    def read(self) -> str:
        """Return one reply; bytes beyond ASCII are decoded as Latin-1, so the caller must check the text."""
        try:
            return self._line.read().decode("latin-1").rstrip("\r\n")
        except TimeoutError as error:
            raise TimeoutError(f"no reply from {self.address!r} within {self.timeout_s:g} s") from error
        except Exception as error:
            raise ConnectionError(f"cannot read from {self.address!r}: {failure_of(error).what}") from error

    def close(self) -> None:
        """Close the connection; a lost or closed one is no error."""
        self._line.close()

    def _open(self, timeout_s: float) -> None:
        try:
            self._line: TextLine = open_within(OPEN_TIMEOUT_S, lambda: self._open_line(timeout_s))
            if self._line.is_rs232:
                self._line_end = self._serial.line_end
                self._line = PacedLine(self._line, self._line_end)
                # Over RS-232 the 33250A refuses commands until this one ends its local mode.
                self._line.write(f"SYST:REM{self._line_end}".encode())
        except OpenError:
            raise
        except Exception as error:
            raise OpenError(self.address, open_failure(self.address, error)) from error
        self.timeout_s = timeout_s

    def _open_line(self, timeout_s: float) -> TextLine:
        if self._adapter is not None:
            return PrologixInstrument(self._adapter, self.address)
        if endpoint := tcp_endpoint(self.address):
            return TcpLine(endpoint, timeout_s, is_rs232=self.address.upper().startswith("ASRL"))
        return VisaLine(self.address, timeout_s, self._backend, self._lock, self._serial)
