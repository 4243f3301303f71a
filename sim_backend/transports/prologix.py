"""Prologix GPIB-Ethernet adapter: one TCP connection, ``++`` commands, escaped data."""

from __future__ import annotations

import re
import socket
from collections.abc import Mapping
from typing import final

from sim_backend.transports.loopback import LOOPBACK, RECEIVE_BYTES, Listener, Port

ESCAPE = 0x1B
ADAPTER_VERSION = b"Prologix GPIB-ETHERNET Controller version 1.6.6.0\r\n"
_ESCAPED = re.compile(rb"\x1b(.)", re.DOTALL)


@final
class PrologixAdapter:
    """The adapter with the instruments of ``ports`` by GPIB address; it speaks to the one last named by ``++addr``."""

    def __init__(self, ports: Mapping[int, Port]) -> None:
        self._ports = ports
        listener = Listener(self._converse)
        self.close = listener.close
        # To be opened before its instruments.
        self.interface_address = f"PRLGX-TCPIP0::{LOOPBACK}::{listener.port}::INTFC"

    def address(self, gpib_address: int) -> str:
        """Return the VISA resource name of the instrument at ``gpib_address``."""
        return f"GPIB0::{gpib_address}::INSTR"

    def _converse(self, peer: socket.socket) -> None:
        rest, addressed = b"", next(iter(self._ports))
        while received := peer.recv(RECEIVE_BYTES):
            lines, rest = unescaped_lines(rest + received)
            for line in lines:
                if not line.startswith(b"++"):
                    # Nobody listens at an address without an instrument; GPIB data sent there is lost.
                    if addressed in self._ports:
                        self._ports[addressed].take(_ESCAPED.sub(rb"\1", line))
                elif line.startswith(b"++addr "):
                    addressed = int(line.split()[1])
                else:
                    peer.sendall(self._adapter(addressed, line))

    def _adapter(self, addressed: int, line: bytes) -> bytes:
        """Return the adapter's answer to one of its own commands; settings have none."""
        if line.startswith(b"++ver"):
            return ADAPTER_VERSION
        port = self._ports.get(addressed)
        if port is not None:
            if line.startswith(b"++read"):
                return port.reply()
            if line.startswith(b"++spoll"):
                return f"{port.status_byte()}\r\n".encode()
            if line.startswith(b"++trg"):
                port.take(b"*TRG")
            elif line.startswith(b"++clr"):
                port.reply()
        return b""


def unescaped_lines(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the lines of ``data`` that an unescaped line feed or carriage return ends, and what is left over."""
    # Byte by byte, since ESC takes its meaning from whatever follows, a line feed in the data of a message included.
    lines, start, index = [], 0, 0
    while index < len(data):
        if data[index] == ESCAPE:
            index += 2
            continue
        if data[index] in b"\r\n":
            if index > start:
                lines.append(data[start:index])
            start = index + 1
        index += 1
    return lines, data[start:]
