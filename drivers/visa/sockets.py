"""Raw TCP sockets that carry lines of text.

The standard library is used instead of pyvisa-py 0.8 for three reasons:

- pyvisa-py reports a refused connection only at the first message;
- it reports a closed connection as a time-out, or blocks for ever (Prologix);
- it cannot switch off the delay of small messages, which costs 40 ms a query.

Its pull request 637 mends the first one for VXI-11 alone.
"""

from __future__ import annotations

import re
import socket
import time
from contextlib import suppress
from typing import Final, Protocol, final

# Twice the time that a 33250A takes for its slowest settings, those of a pulse. A silent instrument delays the others.
TIMEOUT_S: Final = 1.5
OPEN_TIMEOUT_S: Final = 3.0
RECEIVE_BYTES: Final = 4096
TCP_RESOURCES: Final = (
    r"(?:PRLGX-)?TCPIP\d*::(?P<host>[^:,]+)::(?P<port>\d+)::(?:SOCKET|INTFC)",
    # An RS-232 line behind a TCP server, in pyserial's notation.
    r"ASRLsocket://(?P<host>[^:]+):(?P<port>\d+)::INSTR",
)


class TextLine(Protocol):
    """Carries lines of bytes to and from one instrument or adapter.

    ``write`` and ``read`` raise ``TimeoutError`` after ``timeout_s``; any other exception means a lost connection.
    """

    timeout_s: float
    is_rs232: bool

    def write(self, message: bytes) -> None:
        """Send ``message``, which carries its line end."""
        ...

    def read(self) -> bytes:
        """Return one reply, with or without its line end."""
        ...

    def discard_replies(self) -> None:
        """Drop what has arrived and was not read."""
        ...

    def close(self) -> None: ...


def tcp_endpoint(address: str) -> tuple[str, int] | None:
    """Return host and port if the VISA resource name ``address`` is a raw TCP socket, else None."""
    for pattern in TCP_RESOURCES:
        if match := re.fullmatch(pattern, address, re.IGNORECASE):
            return match["host"], int(match["port"])
    return None


@final
class TcpLine:
    """Line of text over a TCP connection; raises ``OSError`` when it cannot be opened within ``OPEN_TIMEOUT_S``."""

    def __init__(self, endpoint: tuple[str, int], timeout_s: float, is_rs232: bool = False) -> None:
        self.timeout_s = timeout_s
        self.is_rs232 = is_rs232
        self._received = b""
        self._socket = socket.create_connection(endpoint, OPEN_TIMEOUT_S)
        # Otherwise a query that follows a command waits 40 ms for an acknowledgement.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def write(self, message: bytes) -> None:
        """Send ``message``; raise ``ConnectionError`` if the other end closed the connection."""
        self._require_open()
        self._socket.settimeout(self.timeout_s)
        self._socket.sendall(message)

    def read(self) -> bytes:
        """Return the next line without its line feed; an incomplete line is dropped at the time-out."""
        deadline_s = time.monotonic() + self.timeout_s
        while b"\n" not in self._received:
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0.0:
                self._received = b""
                raise TimeoutError
            self._socket.settimeout(remaining_s)
            try:
                chunk = self._socket.recv(RECEIVE_BYTES)
            except TimeoutError:
                continue
            if not chunk:
                raise ConnectionError("the instrument closed the connection")
            self._received += chunk
        line, _, self._received = self._received.partition(b"\n")
        return line

    def discard_replies(self) -> None:
        """Drop what has arrived and was not read."""
        self._received = b""
        self._socket.settimeout(0.0)
        with suppress(BlockingIOError):
            while self._socket.recv(RECEIVE_BYTES):
                pass

    def close(self) -> None:
        """Close the socket; closing it twice is no error."""
        self._socket.close()

    def _require_open(self) -> None:
        """Raise ``ConnectionError`` if the other end closed the connection: TCP accepts one more message after that."""
        self._socket.settimeout(0.0)
        try:
            is_open = self._socket.recv(1, socket.MSG_PEEK) != b""
        except BlockingIOError:
            is_open = True
        except OSError:
            is_open = False
        if not is_open:
            raise ConnectionError("the instrument closed the connection")
