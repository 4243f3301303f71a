"""Line servers for raw TCP sockets and RS-232; a line feed ends a message."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import final

from sim_backend.transports.loopback import CLOSING_S, LOOPBACK, MAX_BYTES, RECEIVE_BYTES, Listener, Port


class LineBuffer:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self._incomplete = b""

    def feed(self, received: bytes) -> Iterator[bytes]:
        """Yield the lines that ``received`` completes, without their line feed.

        Raises ``EOFError`` after these lines if the next one gets too long, and drops it.
        """
        *lines, self._incomplete = (self._incomplete + received).split(b"\n")
        yield from lines
        if len(self._incomplete) > MAX_BYTES:
            self._incomplete = b""
            raise EOFError("the message is too long")


@final
class SocketServer:
    """A SCPI instrument on a raw TCP socket at the VISA resource name ``address``."""

    def __init__(self, port: Port, address: str = "TCPIP0::{host}::{port}::SOCKET", tcp_port: int = 0) -> None:
        """Listen on the loopback interface for clients of the instrument at ``port``; ``tcp_port`` 0: any free one."""
        self._port = port
        listener = Listener(self._converse, tcp_port)
        self.close = listener.close
        self.address = address.format(host=LOOPBACK, port=listener.port)

    def _converse(self, peer: socket.socket) -> None:
        """Answer the lines of one connection until it closes."""
        lines = LineBuffer()
        while received := peer.recv(RECEIVE_BYTES):
            for line in lines.feed(received):
                reply = self._port.answer(line)
                if reply:
                    peer.sendall(reply)


@final
class SerialServer:
    """A SCPI instrument on a pseudo terminal, which programs open like an RS-232 port.

    It has no handshake: bytes beyond ``buffer_bytes`` that arrive while the instrument carries out a line, which takes
    ``busy_s``, are lost.
    """

    def __init__(self, port: Port, buffer_bytes: int = MAX_BYTES, busy_s: float = 0.0) -> None:
        """Open a pseudo terminal, and serve the instrument at ``port`` over it in a thread."""
        import tty

        self._port = port
        self._buffer_bytes, self._busy_s = buffer_bytes, busy_s
        self.lost_bytes = 0
        self._server_end, self._client_end = os.openpty()
        # Without raw mode the terminal would echo commands back as replies.
        tty.setraw(self._client_end)
        os.set_blocking(self._server_end, False)
        self._wake, self._wake_writer = os.pipe()
        self.address = f"ASRL{os.ttyname(self._client_end)}::INSTR"
        self._thread = threading.Thread(target=self._converse, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the server, which closes the terminal; an answer in progress delays both."""
        os.write(self._wake_writer, b".")
        self._thread.join(timeout=CLOSING_S)

    def _converse(self) -> None:
        """Answer the lines on the terminal until ``close`` is called, and close the terminal."""
        try:
            self._answer_lines()
        finally:
            for descriptor in (self._server_end, self._client_end, self._wake, self._wake_writer):
                os.close(descriptor)

    def _answer_lines(self) -> None:
        import select

        buffer = b""
        # Another thread cannot interrupt a read or write of the terminal; the pipe wakes this one.
        while True:
            ready, _, _ = select.select([self._server_end, self._wake], [], [], 0.0 if b"\n" in buffer else None)
            if self._wake in ready:
                return
            # A client that discards its output empties the terminal between the two calls.
            with suppress(BlockingIOError):
                if ready:
                    buffer = self._buffered(buffer + os.read(self._server_end, RECEIVE_BYTES))
            line, end, following = buffer.partition(b"\n")
            if end:
                buffer = following
                time.sleep(self._busy_s)
                if not self._send(self._port.answer(line)):
                    return

    def _buffered(self, received: bytes) -> bytes:
        """Return the bytes that fit into the buffer; a line that does not fit at all is lost."""
        buffer = received[: self._buffer_bytes]
        if len(buffer) == self._buffer_bytes and b"\n" not in buffer:
            buffer = b""
        self.lost_bytes += len(received) - len(buffer)
        return buffer

    def _send(self, reply: bytes) -> bool:
        """Send a reply and return True, or False if the server is closed meanwhile."""
        import select

        while reply:
            wake, _, _ = select.select([self._wake], [self._server_end], [])
            if wake:
                return False
            with suppress(BlockingIOError):
                reply = reply[os.write(self._server_end, reply) :]
        return True


def serial_server(port: Port) -> SerialServer | SocketServer:
    """Return a serial line to the instrument: a pseudo terminal, or TCP on systems without one (Windows)."""
    if hasattr(os, "openpty"):
        return SerialServer(port)
    # The notation of pyserial; other VISA libraries open only serial lines of this machine.
    return SocketServer(port, "ASRLsocket://{host}:{port}::INSTR")
