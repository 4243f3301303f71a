"""VXI-11 gateway: the core channel over ONC RPC (RFC 5531), one link a GPIB address."""

from __future__ import annotations

import itertools
import re
import socket
import struct
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

from sim_backend.transports.loopback import (
    LOOPBACK,
    MAX_BYTES,
    POLL_S,
    Listener,
    Port,
    raise_if_closed,
    receive_exactly,
)

CORE_PROGRAM: Final = 0x0607AF
CREATE_LINK, DEVICE_WRITE, DEVICE_READ, DEVICE_READ_STB, DEVICE_TRIGGER, DEVICE_CLEAR = 10, 11, 12, 13, 14, 15
DEVICE_REMOTE, DEVICE_LOCAL, DEVICE_LOCK, DEVICE_UNLOCK, DESTROY_LINK = 16, 17, 18, 19, 23
NO_ERROR, NOT_ACCESSIBLE, INVALID_LINK, NOT_SUPPORTED, OUT_OF_RESOURCES = 0, 3, 4, 8, 9
LOCKED_BY_ANOTHER, NOT_LOCKED, IO_TIMEOUT = 11, 12, 15
WAIT_FOR_LOCK: Final = 1
MAX_LINKS: Final = 64
"""Links of one connection."""
END_FLAG, END_REASON, COUNT_REASON = 8, 4, 1
LAST_FRAGMENT: Final = 1 << 31
MAXIMUM_BYTES: Final = 1 << 16
# Offsets of flags and lock time-out in the arguments (VXI-11, B.6).
_FLAG_OFFSETS: Final = {
    DEVICE_WRITE: (12, 8),
    DEVICE_READ: (16, 12),
    DEVICE_LOCK: (4, 8),
    **dict.fromkeys((DEVICE_READ_STB, DEVICE_TRIGGER, DEVICE_CLEAR, DEVICE_REMOTE, DEVICE_LOCAL), (4, 8)),
}
_NUMBER = re.compile(r"[0-9]{1,2}", re.ASCII)
CALL_SUCCEEDED, PROGRAM_UNAVAILABLE, GARBAGE_ARGUMENTS = 0, 1, 4


# Links are compared by identity.
@dataclass(eq=False)
class Link:
    """One open link: its instrument, the incomplete message, and the unread part of the reply."""

    port: Port
    incoming: bytes = b""
    outgoing: bytes = b""


@final
class Vxi11Gateway:
    """A LAN/GPIB gateway with the instruments of ``ports`` by GPIB address.

    Its address ``host,port`` needs no portmapper.
    """

    def __init__(self, ports: Mapping[int, Port]) -> None:
        """Listen on the loopback interface; ``ports``: instruments by GPIB address."""
        self._ports = ports
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._listener = Listener(self._converse)
        self.close = self._listener.close

    def address(self, gpib_address: int) -> str:
        """Return the VISA resource name of the instrument at ``gpib_address``."""
        return f"TCPIP0::{LOOPBACK},{self._listener.port}::gpib0,{gpib_address}::INSTR"

    def _converse(self, peer: socket.socket) -> None:
        """Answer the RPC calls of one connection until it closes."""
        links: dict[int, Link] = {}
        try:
            while True:
                transaction, program, procedure, arguments = _call(_record(peer))
                if program != CORE_PROGRAM:
                    _send_reply(peer, transaction, PROGRAM_UNAVAILABLE)
                    continue
                try:
                    create = procedure == CREATE_LINK
                    result = (
                        self._create(links, arguments, peer) if create else _on_link(links, procedure, arguments, peer)
                    )
                except struct.error:
                    _send_reply(peer, transaction, GARBAGE_ARGUMENTS)
                    continue
                _send_reply(peer, transaction, CALL_SUCCEEDED, result)
        finally:
            # The locks of a client end with its connection.
            for link in links.values():
                link.port.reservation.release(link)

    def _create(self, links: dict[int, Link], arguments: bytes, peer: socket.socket) -> bytes:
        """Return the result of create_link: error, link number, abort port (0: none), largest message in bytes."""
        # Arguments: client number, whether to lock the device, lock time-out, device name.
        _, exclusive, lock_timeout_ms = struct.unpack_from("!iII", arguments)
        name, _ = _opaque(arguments, 12)
        link = self._link_to(name)
        if link is None:
            return struct.pack("!iiII", NOT_ACCESSIBLE, 0, 0, 0)
        if len(links) >= MAX_LINKS:
            return struct.pack("!iiII", OUT_OF_RESOURCES, 0, 0, 0)
        if exclusive and not link.port.reservation.acquire(link, lock_timeout_ms / 1e3, peer):
            return struct.pack("!iiII", LOCKED_BY_ANOTHER, 0, 0, 0)
        with self._lock:
            number = next(self._numbers)
        links[number] = link
        return struct.pack("!iiII", NO_ERROR, number, 0, MAXIMUM_BYTES)

    def _link_to(self, name: bytes) -> Link | None:
        """Return a new link to the device ``name``, such as ``gpib0,10``; None if there is no such instrument."""
        prefix, _, gpib_address = name.decode("latin-1").partition(",")
        if prefix.lower() != "gpib0" or not _NUMBER.fullmatch(gpib_address):
            return None
        port = self._ports.get(int(gpib_address))
        return Link(port) if port else None


def _on_link(links: dict[int, Link], procedure: int, arguments: bytes, peer: socket.socket) -> bytes:
    """Return the result of a VXI-11 procedure on a link, XDR-encoded; raise ``struct.error`` if arguments are missing.

    A link is a client's connection to one instrument. ``arguments`` begin with its number.
    """
    (number,) = struct.unpack_from("!i", arguments)
    link = links.get(number)
    if link is None:
        return _failed(procedure, INVALID_LINK)
    reservation = link.port.reservation
    if procedure == DEVICE_UNLOCK:
        return struct.pack("!i", NO_ERROR if reservation.release(link) else NOT_LOCKED)
    if procedure == DESTROY_LINK:
        reservation.release(link)
        del links[number]
        return struct.pack("!i", NO_ERROR)
    if procedure not in _FLAG_OFFSETS:
        return _failed(procedure, NOT_SUPPORTED)
    flags, lock_timeout_ms = (struct.unpack_from("!I", arguments, offset)[0] for offset in _FLAG_OFFSETS[procedure])
    lock_timeout_s = lock_timeout_ms / 1e3 if flags & WAIT_FOR_LOCK else 0.0
    if procedure == DEVICE_LOCK:
        acquired = not reservation.held_by(link) and reservation.acquire(link, lock_timeout_s, peer)
        return struct.pack("!i", NO_ERROR if acquired else LOCKED_BY_ANOTHER)
    if not reservation.wait_until_unlocked(link, lock_timeout_s, peer):
        return _failed(procedure, LOCKED_BY_ANOTHER)
    return _execute(link, procedure, arguments, peer)


def _execute(link: Link, procedure: int, arguments: bytes, peer: socket.socket) -> bytes:
    """Return the result of a VXI-11 procedure that needs the instrument, which no other client has locked."""
    if procedure == DEVICE_WRITE:
        return _write(link, arguments)
    if procedure == DEVICE_READ:
        return _read(link, arguments, peer)
    if procedure == DEVICE_READ_STB:
        return struct.pack("!iI", NO_ERROR, link.port.status_byte())
    if procedure == DEVICE_TRIGGER:
        link.port.send(b"*TRG")
    elif procedure == DEVICE_CLEAR:
        link.port.reply()
        link.incoming = link.outgoing = b""
    return struct.pack("!i", NO_ERROR)


def _write(link: Link, arguments: bytes) -> bytes:
    """Return the result of device_write: error and number of bytes accepted.

    A message that ends with these bytes is sent to the instrument. Arguments of 4 bytes each: link, time-out, lock
    time-out, and at offset 12 the flags. The data follow at offset 16.
    """
    (flags,) = struct.unpack_from("!i", arguments, 12)
    data, _ = _opaque(arguments, 16)
    if len(link.incoming) + len(data) > MAX_BYTES:
        link.incoming = b""
        return _failed(DEVICE_WRITE, OUT_OF_RESOURCES)
    link.incoming += data
    if flags & END_FLAG:
        # An unread reply is lost, as on GPIB.
        link.outgoing = b""
        message, link.incoming = link.incoming, b""
        link.port.send(message)
    return struct.pack("!iI", NO_ERROR, len(data))


def _read(link: Link, arguments: bytes, peer: socket.socket) -> bytes:
    """Return the result of device_read: error, reason for the end and the next bytes of the reply.

    Arguments of 4 bytes: link, number of bytes requested, time-out, and others that are not used.
    """
    request_bytes, timeout_ms = struct.unpack_from("!II", arguments, 4)
    link.outgoing = link.outgoing or link.port.reply()
    if not link.outgoing:
        _wait(timeout_ms / 1e3, peer)
        return _failed(DEVICE_READ, IO_TIMEOUT)
    data, link.outgoing = link.outgoing[:request_bytes], link.outgoing[request_bytes:]
    # XDR pads data to a multiple of 4 bytes.
    header = struct.pack("!iiI", NO_ERROR, COUNT_REASON if link.outgoing else END_REASON, len(data))
    return header + data + bytes(-len(data) % 4)


def _wait(duration_s: float, peer: socket.socket) -> None:
    """Sleep; raise ``EOFError`` if the peer closes meanwhile, since a time-out may be 25 days."""
    deadline_s = time.monotonic() + duration_s
    while (remaining_s := deadline_s - time.monotonic()) > 0:
        time.sleep(min(remaining_s, POLL_S))
        raise_if_closed(peer)


def _failed(procedure: int, error: int) -> bytes:
    """Return the result of ``procedure`` with ``error`` and zeros."""
    zeros = {DEVICE_WRITE: 1, DEVICE_READ: 2, DEVICE_READ_STB: 1}.get(procedure, 0)
    return struct.pack(f"!i{zeros}I", error, *[0] * zeros)


def _call(record: bytes) -> tuple[int, int, int, bytes]:
    """Return transaction, program, procedure and arguments of an RPC call; raise ``EOFError`` for anything else."""
    try:
        transaction, kind, rpc_version, program, _, procedure = struct.unpack_from("!6I", record)
        # Two authenticators follow, a flavour and an opaque body each; they are ignored.
        _, credential_end = _opaque(record, 28)
        _, verifier_end = _opaque(record, credential_end + 4)
    except struct.error as error:
        raise EOFError("the RPC call is too short") from error
    if (kind, rpc_version) != (0, 2):
        raise EOFError("not an RPC call")
    return transaction, program, procedure, record[verifier_end:]


def _opaque(data: bytes, start: int) -> tuple[bytes, int]:
    """Return the XDR variable-length field at ``start``, and the start of the next one.

    Raises ``struct.error`` if the field is cut off.
    """
    (size,) = struct.unpack_from("!I", data, start)
    if start + 4 + size > len(data):
        raise struct.error("the field is cut off")
    return data[start + 4 : start + 4 + size], start + 4 + -(-size // 4) * 4


def _record(peer: socket.socket) -> bytes:
    """Return the next RPC record, its fragments joined; raise ``EOFError`` if it is too long or the peer closes."""
    # The top bit of a fragment's length marks the last fragment.
    record, last = b"", False
    while not last:
        (mark,) = struct.unpack("!I", receive_exactly(peer, 4))
        last = bool(mark & LAST_FRAGMENT)
        record += receive_exactly(peer, mark & ~LAST_FRAGMENT)
        if len(record) > MAX_BYTES:
            raise EOFError("the call is too long")
    return record


def _send_reply(peer: socket.socket, transaction: int, status: int, result: bytes = b"") -> None:
    """Send the reply to an RPC call as a record of one fragment."""
    # Transaction; a reply (1), accepted (0), with an empty verifier (flavour and length 0); status.
    record = struct.pack("!6I", transaction, 1, 0, 0, 0, status) + result
    peer.sendall(struct.pack("!I", LAST_FRAGMENT | len(record)) + record)
