"""HiSLIP server (IVI-6.1): a synchronous and an asynchronous connection, messages with numbers."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
from enum import IntEnum
from typing import Final, NamedTuple, final

from sim_backend.transports.loopback import LOOPBACK, MAX_BYTES, Listener, Port, receive_exactly


class Kind(IntEnum):
    """Message types of IVI-6.1, table 4; only those in use."""

    INITIALIZE = 0
    INITIALIZE_RESPONSE = 1
    FATAL_ERROR = 2
    ERROR = 3
    ASYNC_LOCK = 4
    ASYNC_LOCK_RESPONSE = 5
    DATA = 6
    DATA_END = 7
    DEVICE_CLEAR_COMPLETE = 8
    DEVICE_CLEAR_ACKNOWLEDGE = 9
    ASYNC_REMOTE_LOCAL = 10
    ASYNC_REMOTE_LOCAL_RESPONSE = 11
    TRIGGER = 12
    ASYNC_MAXIMUM = 15
    ASYNC_MAXIMUM_RESPONSE = 16
    ASYNC_INITIALIZE = 17
    ASYNC_INITIALIZE_RESPONSE = 18
    ASYNC_CLEAR = 19
    ASYNC_STATUS = 21
    ASYNC_STATUS_RESPONSE = 22
    ASYNC_CLEAR_ACKNOWLEDGE = 23


UNIDENTIFIED, UNRECOGNIZED_TYPE, BAD_INITIALIZATION = 0, 1, 3
LOCK_REFUSED, LOCK_GRANTED, LOCK_ERROR = 0, 1, 3

HEADER: Final = struct.Struct("!2sBBIQ")
PROLOGUE: Final = b"HS"
VERSION_1_0: Final = 0x0100
MAXIMUM_BYTES: Final = MAX_BYTES
VENDOR_ID: Final = b"\0\0TW"
"""Two letters that identify the vendor of a server, in the last bytes of a parameter: TW is the twin."""


class Message(NamedTuple):
    """One HiSLIP message."""

    kind: int
    control: int = 0
    parameter: int = 0
    payload: bytes = b""


UNRECOGNIZED: Final = Message(Kind.ERROR, UNRECOGNIZED_TYPE, 0, b"unrecognized message type")


@final
class HislipServer:
    """A SCPI instrument at the sub-address ``hislip0``; a reply carries the number of its query."""

    def __init__(self, port: Port) -> None:
        """Listen on the loopback interface for clients of the instrument at ``port``."""
        self._port = port
        self._sessions = itertools.count(1)
        self._lock = threading.Lock()
        listener = Listener(self._converse)
        self.close = listener.close
        self.address = f"TCPIP0::{LOOPBACK}::hislip0,{listener.port}::INSTR"

    def _converse(self, peer: socket.socket) -> None:
        """Serve one connection, synchronous or asynchronous according to its first message, until it closes."""
        first = receive(peer)
        if first.kind == Kind.INITIALIZE:
            with self._lock:
                session = next(self._sessions) & 0xFFFF
            send(peer, Message(Kind.INITIALIZE_RESPONSE, 0, VERSION_1_0 << 16 | session, b""))
            self._answer_synchronous(peer, session)
        elif first.kind == Kind.ASYNC_INITIALIZE:
            # A client's second connection carries asynchronous messages; it names the session of the first.
            send(peer, Message(Kind.ASYNC_INITIALIZE_RESPONSE, 0, int.from_bytes(VENDOR_ID), b""))
            owner = f"session {first.parameter & 0xFFFF}"
            try:
                self._answer_asynchronous(peer, owner)
            finally:
                self._port.reservation.release(owner)
        else:
            send(peer, Message(Kind.FATAL_ERROR, BAD_INITIALIZATION, 0, b"Initialize comes first"))

    def _answer_synchronous(self, peer: socket.socket, session: int) -> None:
        """Answer data, clear and trigger messages until the connection closes or a message is too long."""
        incomplete = b""
        while True:
            message = receive(peer)
            # While another client holds the lock, messages wait.
            self._port.reservation.wait_until_unlocked(f"session {session}", float("inf"), peer)
            match message.kind:
                case Kind.DATA:
                    incomplete += message.payload
                    if len(incomplete) > MAX_BYTES:
                        send(peer, Message(Kind.FATAL_ERROR, UNIDENTIFIED, 0, b"message too long"))
                        return
                case Kind.DATA_END:
                    # The reply repeats the number of its query, so that a client recognises a late one.
                    reply = self._port.answer(incomplete + message.payload)
                    incomplete = b""
                    if reply:
                        send(peer, Message(Kind.DATA_END, 0, message.parameter, reply))
                case Kind.DEVICE_CLEAR_COMPLETE:
                    incomplete = b""
                    self._port.reply()
                    send(peer, Message(Kind.DEVICE_CLEAR_ACKNOWLEDGE))
                case Kind.TRIGGER:
                    self._port.send(b"*TRG")
                case _:
                    send(peer, UNRECOGNIZED)

    def _lock_answer(self, message: Message, owner: str, peer: socket.socket) -> int:
        """Acquire or release the exclusive lock for ``owner``, and return the protocol's answer.

        A shared lock is not granted.
        """
        reservation = self._port.reservation
        if not message.control & 1:
            return LOCK_GRANTED if reservation.release(owner) else LOCK_ERROR
        if reservation.held_by(owner):
            return LOCK_ERROR
        granted = not message.payload and reservation.acquire(owner, message.parameter / 1e3, peer)
        return LOCK_GRANTED if granted else LOCK_REFUSED

    def _answer_asynchronous(self, peer: socket.socket, owner: str) -> None:
        """Answer status, lock and clear messages until the connection closes; ``owner`` identifies its session."""
        while True:
            message = receive(peer)
            match message.kind:
                case Kind.ASYNC_MAXIMUM:
                    reply = Message(Kind.ASYNC_MAXIMUM_RESPONSE, 0, 0, struct.pack("!Q", MAXIMUM_BYTES))
                case Kind.ASYNC_CLEAR:
                    reply = Message(Kind.ASYNC_CLEAR_ACKNOWLEDGE)
                case Kind.ASYNC_STATUS:
                    reply = Message(Kind.ASYNC_STATUS_RESPONSE, self._port.status_byte())
                case Kind.ASYNC_LOCK:
                    reply = Message(Kind.ASYNC_LOCK_RESPONSE, self._lock_answer(message, owner, peer))
                case Kind.ASYNC_REMOTE_LOCAL:
                    reply = Message(Kind.ASYNC_REMOTE_LOCAL_RESPONSE)
                case _:
                    reply = UNRECOGNIZED
            send(peer, reply)


def send(peer: socket.socket, message: Message) -> None:
    """Send one message."""
    header = HEADER.pack(PROLOGUE, message.kind, message.control, message.parameter, len(message.payload))
    peer.sendall(header + message.payload)


def receive(peer: socket.socket) -> Message:
    """Return the next message; raise ``EOFError`` if the peer closes or does not speak HiSLIP."""
    prologue, kind, control, parameter, size = HEADER.unpack(receive_exactly(peer, HEADER.size))
    if prologue != PROLOGUE or size > MAXIMUM_BYTES:
        raise EOFError("not a HiSLIP message")
    return Message(kind, control, parameter, receive_exactly(peer, size))
