"""Loopback: access to an instrument by one message at a time, and a listener on this machine alone."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, final

LOOPBACK = "127.0.0.1"
"""Simulated instruments are never on a network."""
RECEIVE_BYTES = 65536
MAX_BYTES = 1 << 20
"""The longest message: an arbitrary waveform of 65 536 points with 16 characters each."""
MAX_PEERS = 64
"""Simultaneous connections of a listener; a further one is closed at once."""
CLOSING_S = 1.0
POLL_S = 0.05
"""Interval at which a waiting thread checks its connection."""


class Instrument(Protocol):
    """A SCPI instrument, one message in, one reply out."""

    def write(self, message: str) -> None: ...

    def read(self) -> str:
        """Return the reply to the last message; raise ``TimeoutError`` if there is none."""
        ...

    def serial_poll(self) -> int:
        """Return the status byte, as by a serial poll on the bus."""
        ...


@final
class Reservation:
    """Exclusive lock on an instrument; ``owner`` identifies a client.

    Waiting methods raise ``EOFError`` if the client's connection ``peer`` closes.
    """

    def __init__(self) -> None:
        """Start unlocked."""
        self._free = threading.Condition()
        self._owner: object = None

    def acquire(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        """Acquire the lock for ``owner`` within ``timeout_s``; return whether that succeeded.

        Raises ``EOFError`` if ``peer`` closes its connection meanwhile.
        """
        with self._free:
            if not self._wait_available(owner, timeout_s, peer):
                return False
            self._owner = owner
            return True

    def wait_until_unlocked(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        """Wait at most ``timeout_s`` until no client other than ``owner`` holds the lock; return whether that is so.

        Raises ``EOFError`` if ``peer``, the connection of ``owner``, closes meanwhile.
        """
        if self._owner in (None, owner):
            return True
        with self._free:
            return self._wait_available(owner, timeout_s, peer)

    def release(self, owner: object) -> bool:
        """Release the lock and return whether ``owner`` held it."""
        with self._free:
            if owner is None or self._owner != owner:
                return False
            self._owner = None
            self._free.notify_all()
            return True

    def held_by(self, owner: object) -> bool:
        """Return whether ``owner`` holds the lock."""
        return self._owner == owner

    def _wait_available(self, owner: object, timeout_s: float, peer: socket.socket) -> bool:
        """Wait until no other owner has the lock; return False after ``timeout_s``.

        Raises ``EOFError`` if ``peer`` closes its connection.
        """
        deadline_s = time.monotonic() + timeout_s
        while self._owner not in (None, owner):
            if time.monotonic() >= deadline_s:
                return False
            self._free.wait(POLL_S)
            raise_if_closed(peer)
        return True


@final
class Port:
    """An instrument behind the lock of its world, with messages and replies in bytes."""

    def __init__(self, instrument: Instrument, lock: threading.RLock) -> None:
        """Give ``instrument`` a lock, shared by all instruments, and a reservation for clients."""
        self._instrument = instrument
        self._lock = lock
        self.reservation = Reservation()

    def send(self, message: bytes) -> None:
        """Send one message to the instrument; its line end is optional."""
        with self._lock:
            self._instrument.write(message.decode("latin-1").rstrip("\r\n"))

    def reply(self) -> bytes:
        """Return the instrument's reply with a line feed, empty if there is none."""
        with self._lock, suppress(TimeoutError):
            return self._instrument.read().encode("latin-1") + b"\n"
        return b""

    def answer(self, message: bytes) -> bytes:
        """Send ``message`` to the instrument and return its reply; messages of other connections wait."""
        with self._lock:
            self.send(message)
            return self.reply()

    def status_byte(self) -> int:
        """Return the status byte, as by a serial poll on the bus."""
        with self._lock:
            return self._instrument.serial_poll()


@final
class Listener:
    """Accepts connections on a loopback port until closed; ``converse`` serves each in its thread.

    ``port`` 0 selects a free one. Raises ``OSError`` if the port is in use.
    """

    def __init__(self, converse: Callable[[socket.socket], None], port: int = 0) -> None:
        """Accept connections on the loopback interface, and run ``converse`` for each in a thread."""
        self._converse = converse
        self._listener = socket.create_server((LOOPBACK, port))
        self.port: int = self._listener.getsockname()[1]
        self._closing = False
        self._peers: dict[threading.Thread, socket.socket] = {}
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Close every connection and wait until its thread has ended."""
        self._closing = True
        deadline_s = time.monotonic() + CLOSING_S
        # On every platform a connection wakes a blocked accept().
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
        """Accept connections until the listener closes, and serve each in a thread."""
        while not self._closing:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                # No free descriptor, or the peer has left: later connections may succeed.
                time.sleep(POLL_S)
                continue
            self._peers = {thread: peer for thread, peer in self._peers.items() if thread.is_alive()}
            if self._closing or len(self._peers) >= MAX_PEERS:
                peer.close()
                continue
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._serve, args=(peer,), daemon=True)
            thread.start()
            self._peers[thread] = peer

    def _serve(self, peer: socket.socket) -> None:
        """Run the conversation of one connection until it ends or breaks."""
        # A connection that closes in the middle of a message affects no other one.
        with peer, suppress(OSError, EOFError):
            self._converse(peer)


def raise_if_closed(peer: socket.socket) -> None:
    """Raise ``EOFError`` if the peer closed the connection; pending data stay unread."""
    ready, _, _ = select.select([peer], [], [], 0.0)
    if ready and not peer.recv(1, socket.MSG_PEEK):
        raise EOFError("the peer closed the connection")


def receive_exactly(peer: socket.socket, size: int) -> bytes:
    """Return ``size`` bytes; raise ``EOFError`` if the peer closes before, or ``size`` is too large."""
    if size > MAX_BYTES:
        raise EOFError("the message is too long")
    received = bytearray()
    while len(received) < size:
        chunk = peer.recv(min(RECEIVE_BYTES, size - len(received)))
        if not chunk:
            raise EOFError("the peer closed the connection")
        received += chunk
    return bytes(received)
