"""Loopback: a port through which one message at a time reaches an instrument, and a listener on this machine alone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, final

LOOPBACK = "127.0.0.1"
"""Simulated instruments are never offered to a network."""
RECEIVE_BYTES = 65536


class Instrument(Protocol):
    """A SCPI instrument, one message in, one reply out."""

    def write(self, message: str) -> None: ...

    def read(self) -> str:
        """Return the reply to the last message; raise ``TimeoutError`` where there is none."""
        ...

    def serial_poll(self) -> int:
        """Return the status byte as the bus reads it, without a message."""
        ...


@final
class Port:
    """An instrument behind the lock of the world it belongs to, in bytes as they go over a connection."""

    def __init__(self, instrument: Instrument, lock: threading.RLock) -> None:
        self._instrument = instrument
        self._lock = lock

    def take(self, message: bytes) -> None:
        """Hand one message to the instrument; its line end is optional."""
        with self._lock:
            self._instrument.write(message.decode("latin-1").rstrip("\r\n"))

    def reply(self) -> bytes:
        """Return the reply with its line feed, nothing where there is none."""
        with self._lock, suppress(TimeoutError):
            return self._instrument.read().encode("latin-1") + b"\n"
        return b""

    def answer(self, message: bytes) -> bytes:
        """Return the reply to ``message``, undisturbed by what arrives on another connection."""
        with self._lock:
            self.take(message)
            return self.reply()

    def status_byte(self) -> int:
        """Return the status byte as the bus reads it, without a message."""
        with self._lock:
            return self._instrument.serial_poll()


@final
class Listener:
    """Accepts connections on a loopback port, each served by ``converse`` in a thread of its own, until closed.

    ``port`` 0 takes a free one. Raises ``OSError`` where the port is taken.
    """

    def __init__(self, converse: Callable[[socket.socket], None], port: int = 0) -> None:
        self._converse = converse
        self._listener = socket.create_server((LOOPBACK, port))
        self.port: int = self._listener.getsockname()[1]
        self._closing = False
        self._peers: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def close(self) -> None:
        """Hang up on every peer and wait until its thread has ended."""
        self._closing = True
        # A blocked accept() only wakes for a connection on every platform.
        with suppress(OSError), socket.create_connection((LOOPBACK, self.port), timeout=1.0):
            pass
        self._threads[0].join(timeout=5.0)
        self._listener.close()
        for peer in self._peers:
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
        for thread in self._threads[1:]:
            thread.join(timeout=5.0)

    def _accept(self) -> None:
        while not self._closing:
            peer, _ = self._listener.accept()
            if self._closing:
                peer.close()
                return
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._serve, args=(peer,), daemon=True)
            self._peers.append(peer)
            self._threads.append(thread)
            thread.start()

    def _serve(self, peer: socket.socket) -> None:
        # A peer that hangs up in the middle of a message ends its own conversation and nothing else.
        with peer, suppress(OSError, EOFError):
            self._converse(peer)


def receive_exactly(peer: socket.socket, size: int) -> bytes:
    """Return ``size`` bytes; raise ``EOFError`` where the peer hangs up before."""
    received = bytearray()
    while len(received) < size:
        chunk = peer.recv(min(RECEIVE_BYTES, size - len(received)))
        if not chunk:
            raise EOFError("the peer hung up")
        received += chunk
    return bytes(received)
