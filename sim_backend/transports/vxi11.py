"""VXI-11 gateway: the core channel over ONC RPC (RFC 5531), one link a GPIB address."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

from sim_backend.transports.loopback import LOOPBACK, Listener, Port, receive_exactly

CORE_PROGRAM: Final = 0x0607AF
CREATE_LINK, DEVICE_WRITE, DEVICE_READ, DEVICE_READ_STB, DEVICE_TRIGGER, DEVICE_CLEAR = 10, 11, 12, 13, 14, 15
DEVICE_REMOTE, DEVICE_LOCAL, DEVICE_LOCK, DEVICE_UNLOCK, DESTROY_LINK = 16, 17, 18, 19, 23
NO_ERROR, NOT_ACCESSIBLE, INVALID_LINK, NOT_SUPPORTED, IO_TIMEOUT = 0, 3, 4, 8, 15
END_FLAG, END_REASON, COUNT_REASON = 8, 4, 1
LAST_FRAGMENT: Final = 1 << 31
MAXIMUM_BYTES: Final = 1 << 16
PROGRAM_UNAVAILABLE: Final = 1


@dataclass
class Link:
    """One open link: its instrument, the message that is coming in, the reply that is going out."""

    port: Port
    incoming: bytes = b""
    outgoing: bytes = b""


@final
class Vxi11Gateway:
    """A LAN/GPIB gateway with the instruments of ``ports`` by GPIB address.

    Programs name it as ``host,port``, which needs no portmapper.
    """

    def __init__(self, ports: Mapping[int, Port]) -> None:
        self._ports = ports
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._listener = Listener(self._converse)
        self.close = self._listener.close

    def address(self, gpib_address: int) -> str:
        """Return the VISA resource name of the instrument at ``gpib_address``."""
        return f"TCPIP0::{LOOPBACK},{self._listener.port}::gpib0,{gpib_address}::INSTR"

    def _converse(self, peer: socket.socket) -> None:
        links: dict[int, Link] = {}
        while True:
            transaction, program, procedure, arguments = _call(_record(peer))
            if program != CORE_PROGRAM:
                _send_record(peer, struct.pack("!6I", transaction, 1, 0, 0, 0, PROGRAM_UNAVAILABLE))
                continue
            create = procedure == CREATE_LINK
            result = self._create(links, arguments) if create else _on_link(links, procedure, arguments)
            _send_record(peer, struct.pack("!6I", transaction, 1, 0, 0, 0, 0) + result)

    def _create(self, links: dict[int, Link], arguments: bytes) -> bytes:
        # Before the device's name stand client id, lock flag and lock time-out, four bytes each.
        name, _ = _opaque(arguments, 12)
        prefix, _, gpib_address = name.decode("latin-1").partition(",")
        if prefix.lower() != "gpib0" or not gpib_address.isdigit() or int(gpib_address) not in self._ports:
            return struct.pack("!iiII", NOT_ACCESSIBLE, 0, 0, 0)
        with self._lock:
            number = next(self._numbers)
        links[number] = Link(self._ports[int(gpib_address)])
        return struct.pack("!iiII", NO_ERROR, number, 0, MAXIMUM_BYTES)


def _on_link(links: dict[int, Link], procedure: int, arguments: bytes) -> bytes:
    """Return the result of a core procedure, XDR-encoded."""
    (number,) = struct.unpack_from("!i", arguments)
    link = links.get(number)
    if link is None:
        return _failed(procedure, INVALID_LINK)
    if procedure == DEVICE_WRITE:
        return _write(link, arguments)
    if procedure == DEVICE_READ:
        return _read(link, arguments)
    if procedure == DEVICE_READ_STB:
        return struct.pack("!iI", NO_ERROR, link.port.status_byte())
    if procedure == DEVICE_TRIGGER:
        link.port.take(b"*TRG")
    elif procedure == DEVICE_CLEAR:
        link.port.reply()
        link.incoming = link.outgoing = b""
    elif procedure == DESTROY_LINK:
        del links[number]
    elif procedure not in (DEVICE_REMOTE, DEVICE_LOCAL, DEVICE_LOCK, DEVICE_UNLOCK):
        return _failed(procedure, NOT_SUPPORTED)
    return struct.pack("!i", NO_ERROR)


def _write(link: Link, arguments: bytes) -> bytes:
    # Link, time-out and lock time-out come first.
    (flags,) = struct.unpack_from("!i", arguments, 12)
    data, _ = _opaque(arguments, 16)
    link.incoming += data
    if flags & END_FLAG:
        # What was asked before and never fetched is gone, as on the instrument's own bus.
        link.outgoing = b""
        link.port.take(link.incoming)
        link.incoming = b""
    return struct.pack("!iI", NO_ERROR, len(data))


def _read(link: Link, arguments: bytes) -> bytes:
    request_bytes, timeout_ms = struct.unpack_from("!II", arguments, 4)
    link.outgoing = link.outgoing or link.port.reply()
    if not link.outgoing:
        time.sleep(timeout_ms / 1e3)
        return _failed(DEVICE_READ, IO_TIMEOUT)
    data, link.outgoing = link.outgoing[:request_bytes], link.outgoing[request_bytes:]
    header = struct.pack("!iiI", NO_ERROR, COUNT_REASON if link.outgoing else END_REASON, len(data))
    return header + data + bytes(-len(data) % 4)


def _failed(procedure: int, error: int) -> bytes:
    """Return the result of ``procedure`` that carries nothing but ``error``."""
    rest = {DEVICE_WRITE: 1, DEVICE_READ: 2, DEVICE_READ_STB: 1}.get(procedure, 0)
    return struct.pack(f"!i{rest}I", error, *[0] * rest)


def _call(record: bytes) -> tuple[int, int, int, bytes]:
    """Return transaction, program, procedure and arguments of an RPC call; raise ``EOFError`` for anything else."""
    transaction, kind, rpc_version, program, _, procedure = struct.unpack_from("!6I", record)
    if (kind, rpc_version) != (0, 2):
        raise EOFError("not an RPC call")
    # Two authenticators follow, a flavour and an opaque body each, which nobody here looks at.
    _, behind_credential = _opaque(record, 28)
    _, behind_verifier = _opaque(record, behind_credential + 4)
    return transaction, program, procedure, record[behind_verifier:]


def _opaque(data: bytes, start: int) -> tuple[bytes, int]:
    """Return the XDR variable-length field at ``start``, and where the next one begins."""
    (size,) = struct.unpack_from("!I", data, start)
    return data[start + 4 : start + 4 + size], start + 4 + -(-size // 4) * 4


def _record(peer: socket.socket) -> bytes:
    # A record comes in fragments; the top bit of a fragment's length marks the last.
    record, last = b"", False
    while not last:
        (mark,) = struct.unpack("!I", receive_exactly(peer, 4))
        last = bool(mark & LAST_FRAGMENT)
        record += receive_exactly(peer, mark & ~LAST_FRAGMENT)
    return record


def _send_record(peer: socket.socket, record: bytes) -> None:
    peer.sendall(struct.pack("!I", LAST_FRAGMENT | len(record)) + record)
