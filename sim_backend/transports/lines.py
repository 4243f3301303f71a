"""Line servers, where a line feed ends a message: raw TCP socket and RS-232."""

from __future__ import annotations

import os
import socket
import threading
from contextlib import suppress
from typing import final

from sim_backend.transports.loopback import LOOPBACK, RECEIVE_BYTES, Listener, Port


class Lines:
    """Bytes in, whole lines out."""

    def __init__(self) -> None:
        self._rest = b""

    def completed_by(self, received: bytes) -> list[bytes]:
        """Return the lines that ``received`` completes, without their line feed; what is left over is kept."""
        *lines, self._rest = (self._rest + received).split(b"\n")
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
        self._wake, self._woken = os.pipe()
        self.address = f"ASRL{os.ttyname(self._theirs)}::INSTR"
        self._thread = threading.Thread(target=self._converse, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and take the terminal away."""
        os.write(self._woken, b".")
        self._thread.join(timeout=5.0)
        for descriptor in (self._ours, self._theirs, self._wake, self._woken):
            os.close(descriptor)

    def _converse(self) -> None:
        import select

        lines = Lines()
        # A read of the terminal cannot be interrupted from another thread: the pipe wakes the wait instead.
        while True:
            ready, _, _ = select.select([self._ours, self._wake], [], [])
            if self._wake in ready:
                return
            for line in lines.completed_by(os.read(self._ours, RECEIVE_BYTES)):
                reply = self._port.answer(line)
                with suppress(OSError):
                    os.write(self._ours, reply)


def serial_server(port: Port) -> SerialServer | SocketServer:
    """Return a serial line to the instrument: a pseudo terminal, or TCP where there are none (Windows)."""
    if hasattr(os, "openpty"):
        return SerialServer(port)
    # As pyvisa-py takes it, through pyserial; other VISA libraries know serial lines of this machine only.
    return SocketServer(port, "ASRLsocket://{host}:{port}::INSTR")
