"""Loopback: a port through which one message at a time reaches an instrument, and a listener on this machine alone."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, final

LOOPBACK = "127.0.0.1"
"""Simulated instruments are never offered to a network."""
RECEIVE_BYTES = 65536
MOST_BYTES = 1 << 20
"""The longest message: an arbitrary waveform of 65 536 points with 16 characters each. Who sends more is cut off."""
MOST_PEERS = 64
"""How many connections a listener serves at a time; one more is closed at once."""
CLOSING_S = 1.0
LOOK_S = 0.05
"""How often a thread that waits looks whether its peer is still there."""


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
class Reservation:
    """The exclusive lock that one of several clients may hold on an instrument; clients are told apart by ``owner``."""

    def __init__(self) -> None:
        self._free = threading.Condition()
        self._owner: object = None

    def take(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        """Take the lock within ``timeout_s`` and return whether that went well; ``EOFError`` where ``peer`` leaves."""
        with self._free:
            if not self._available(owner, timeout_s, peer):
                return False
            self._owner = owner
            return True

    def respected(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        """Return whether nobody else holds the lock, waiting for that; ``EOFError`` where ``peer`` leaves."""
        if self._owner in (None, owner):
            return True
        with self._free:
            return self._available(owner, timeout_s, peer)

    def release(self, owner: object) -> bool:
        """Give the lock back and return whether ``owner`` had it."""
        with self._free:
            if owner is None or self._owner != owner:
                return False
            self._owner = None
            self._free.notify_all()
            return True

    def held_by(self, owner: object) -> bool:
        """Return whether ``owner`` holds the lock."""
        return self._owner == owner

    def _available(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        deadline_s = time.monotonic() + timeout_s
        while self._owner not in (None, owner):
            if time.monotonic() >= deadline_s:
                return False
            self._free.wait(LOOK_S)
            raise_if_gone(peer)
        return True


@final
class Port:
    """An instrument behind the lock of the world it belongs to, in bytes as they go over a connection."""

    def __init__(self, instrument: Instrument, lock: threading.RLock) -> None:
        self._instrument = instrument
        self._lock = lock
        self.reservation = Reservation()

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
        self._peers: dict[threading.Thread, socket.socket] = {}
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Hang up on every peer and wait until its thread has ended."""
        self._closing = True
        deadline_s = time.monotonic() + CLOSING_S
        # A blocked accept() only wakes for a connection on every platform.
        with suppress(OSError), socket.create_connection((LOOPBACK, self.port), timeout=CLOSING_S):
            pass
        self._accepting.join(timeout=CLOSING_S)
        self._listener.close()
        peers = dict(self._peers)
        for peer in peers.values():
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
        for thread in peers:
            thread.join(timeout=max(0.0, deadline_s - time.monotonic()))

    def _accept(self) -> None:
        while not self._closing:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                # No descriptor left, or the peer is gone again: others may come.
                time.sleep(LOOK_S)
                continue
            self._peers = {thread: of for thread, of in self._peers.items() if thread.is_alive()}
            if self._closing or len(self._peers) >= MOST_PEERS:
                peer.close()
                continue
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._serve, args=(peer,), daemon=True)
            thread.start()
            self._peers[thread] = peer

    def _serve(self, peer: socket.socket) -> None:
        # A peer that hangs up in the middle of a message ends its own conversation and nothing else.
        with peer, suppress(OSError, EOFError):
            self._converse(peer)


def raise_if_gone(peer: socket.socket) -> None:
    """Raise ``EOFError`` where the peer hung up; what it may have sent is left to be received."""
    ready, _, _ = select.select([peer], [], [], 0.0)
    if ready and not peer.recv(1, socket.MSG_PEEK):
        raise EOFError("the peer hung up")


def receive_exactly(peer: socket.socket, size: int) -> bytes:
    """Return ``size`` bytes; raise ``EOFError`` where the peer hangs up before, or announces more than is taken."""
    if size > MOST_BYTES:
        raise EOFError("a message that is too long")
    received = bytearray()
    while len(received) < size:
        chunk = peer.recv(min(RECEIVE_BYTES, size - len(received)))
        if not chunk:
            raise EOFError("the peer hung up")
        received += chunk
    return bytes(received)
