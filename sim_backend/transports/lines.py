"""Line servers, where a line feed ends a message: raw TCP socket and RS-232."""

from __future__ import annotations

import os
import socket
import threading
from contextlib import suppress
from typing import final

from sim_backend.transports.loopback import CLOSING_S, LOOPBACK, MOST_BYTES, RECEIVE_BYTES, Listener, Port


class Lines:
    """Bytes in, whole lines out."""

    def __init__(self) -> None:
        self._rest = b""

    def completed_by(self, received: bytes) -> list[bytes]:
        """Return the lines that ``received`` completes, without their line feed; what is left over is kept.

        Raises ``EOFError``, and forgets it, where a line gets too long.
        """
        *lines, self._rest = (self._rest + received).split(b"\n")
        if len(self._rest) > MOST_BYTES:
            self._rest = b""
            raise EOFError("a message that is too long")
        return lines


@final
class SocketServer:
    """A SCPI instrument on a raw TCP socket; ``address`` is its VISA resource name, with the port filled in."""

    def __init__(self, port: Port, address: str = "TCPIP0::{host}::{port}::SOCKET") -> None:
        self._port = port
        listener = Listener(self._converse)
        self.close = listener.close
        self.address = address.format(host=LOOPBACK, port=listener.port)

    def _converse(self, peer: socket.socket) -> None:
        lines = Lines()
        while received := peer.recv(RECEIVE_BYTES):
            for line in lines.completed_by(received):
                reply = self._port.answer(line)
                if reply:
                    peer.sendall(reply)


@final
class SerialServer:
    """A SCPI instrument on a pseudo terminal, which a program opens as it would open an RS-232 port."""

    def __init__(self, port: Port) -> None:
        import tty

        self._port = port
        self._ours, self._theirs = os.openpty()
        # Without raw mode the terminal would echo commands back as replies.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._wake, self._woken = os.pipe()
        self.address = f"ASRL{os.ttyname(self._theirs)}::INSTR"
        self._thread = threading.Thread(target=self._converse, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and take the terminal away."""
        os.write(self._woken, b".")
        self._thread.join(timeout=CLOSING_S)
        for descriptor in (self._ours, self._theirs, self._wake, self._woken):
            os.close(descriptor)

    def _converse(self) -> None:
        import select

        lines = Lines()
        # Neither a read nor a write of the terminal can be interrupted from another thread: the pipe wakes both.
        while True:
            ready, _, _ = select.select([self._ours, self._wake], [], [])
            if self._wake in ready:
                return
            # A line that cannot be hung up: what is too long is lost, as in a buffer that runs over.
            with suppress(EOFError):
                for line in lines.completed_by(os.read(self._ours, RECEIVE_BYTES)):
                    if not self._send(self._port.answer(line)):
                        return

    def _send(self, reply: bytes) -> bool:
        """Send a reply and return True, or False where the server closes while nobody reads."""
        import select

        while reply:
            wake, _, _ = select.select([self._wake], [self._ours], [])
            if wake:
                return False
            with suppress(BlockingIOError):
                reply = reply[os.write(self._ours, reply) :]
        return True


def serial_server(port: Port) -> SerialServer | SocketServer:
    """Return a serial line to the instrument: a pseudo terminal, or TCP where there are none (Windows)."""
    if hasattr(os, "openpty"):
        return SerialServer(port)
    # As pyvisa-py takes it, through pyserial; other VISA libraries know serial lines of this machine only.
    return SocketServer(port, "ASRLsocket://{host}:{port}::INSTR")
