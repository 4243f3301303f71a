"""Prologix GPIB-Ethernet adapter: one TCP connection, ``++`` commands, escaped data."""

from __future__ import annotations

import re
import socket
from collections.abc import Mapping
from typing import final

from sim_backend.transports.loopback import LOOPBACK, MAX_BYTES, RECEIVE_BYTES, Listener, Port

ESCAPE = 0x1B
ADAPTER_VERSION = b"Prologix GPIB-ETHERNET Controller version 1.6.6.0\r\n"
UNRECOGNIZED = b"Unrecognized command\r\n"
# A primary address, and an optional secondary one, which is ignored.
_ADDRESS = re.compile(rb"\+\+addr +([0-9]|[12][0-9]|30)( +[0-9]{1,3})? *")
_ESCAPED = re.compile(rb"\x1b(.)", re.DOTALL)
_MARK = re.compile(rb"\x1b.|[\r\n]", re.DOTALL)


@final
class PrologixAdapter:
    """The adapter with the instruments of ``ports`` by GPIB address; ``++addr`` selects one."""

    def __init__(self, ports: Mapping[int, Port]) -> None:
        """Accept TCP connections of programs to the adapter, on the loopback interface.

        ``ports``: connections to the instruments, by GPIB address. The system chooses the adapter's TCP port.
        """
        self._ports = ports
        listener = Listener(self._converse)
        self.close = listener.close
        # Programs open the adapter before its instruments.
        self.interface_address = f"PRLGX-TCPIP0::{LOOPBACK}::{listener.port}::INTFC"

    def address(self, gpib_address: int) -> str:
        """Return the VISA resource name of the instrument at ``gpib_address``."""
        return f"GPIB0::{gpib_address}::INSTR"

    def _converse(self, peer: socket.socket) -> None:
        """Serve one connection until it closes or sends a line that is too long."""
        incomplete, addressed = b"", next(iter(self._ports))
        while received := peer.recv(RECEIVE_BYTES):
            lines, incomplete = unescaped_lines(incomplete + received)
            if len(incomplete) > MAX_BYTES:
                return
            for line in lines:
                if not line.startswith(b"++"):
                    # Data for the addressed instrument; without an instrument at that address they are lost.
                    if addressed in self._ports:
                        self._ports[addressed].send(_ESCAPED.sub(rb"\1", line))
                elif line.startswith(b"++addr "):
                    match = _ADDRESS.fullmatch(line)
                    if match:
                        addressed = int(match[1])
                    else:
                        peer.sendall(UNRECOGNIZED)
                else:
                    peer.sendall(self._adapter(addressed, line))

    def _adapter(self, addressed: int, line: bytes) -> bytes:
        """Return the adapter's reply to a ``++`` command ``line``; settings have none.

        ``addressed``: GPIB address of the instrument that it acts on.
        """
        if line.startswith(b"++ver"):
            return ADAPTER_VERSION
        port = self._ports.get(addressed)
        if port is not None:
            if line.startswith(b"++read"):
                return port.reply()
            if line.startswith(b"++spoll"):
                return f"{port.status_byte()}\r\n".encode()
            if line.startswith(b"++trg"):
                port.send(b"*TRG")
            elif line.startswith(b"++clr"):
                port.reply()
        return b""


def unescaped_lines(data: bytes) -> tuple[list[bytes], bytes]:
    """Split ``data`` at line ends that are not escaped; return the complete lines and the incomplete last one.

    The lines keep their escape characters.
    """
    lines, start = [], 0
    # ESC escapes any following byte, including a line feed.
    for mark in _MARK.finditer(data):
        if mark[0][0] != ESCAPE:
            if mark.start() > start:
                lines.append(data[start : mark.start()])
            start = mark.end()
    return lines, data[start:]
