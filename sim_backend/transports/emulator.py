"""Emulator of the generators behind real transports, on loopback alone; they share one world and one clock."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal, Self, TypeVar, final, get_args

from sim_backend.transports.hislip import HislipServer
from sim_backend.transports.lines import SerialServer, SocketServer, serial_server
from sim_backend.transports.loopback import Instrument, Port
from sim_backend.transports.prologix import PrologixAdapter
from sim_backend.transports.vxi11 import Vxi11Gateway

Transport = Literal["socket", "serial", "hislip", "vxi11", "prologix"]
TRANSPORTS: tuple[Transport, ...] = get_args(Transport)
FIRST_GPIB_ADDRESS = 10
"""Factory setting of the 33250A; each further instrument takes the next one."""


Opened = TypeVar("Opened", SocketServer | SerialServer | HislipServer, Vxi11Gateway, PrologixAdapter)
ALONE: Mapping[Transport, Callable[[Port], SocketServer | SerialServer | HislipServer]] = {
    "socket": SocketServer,
    "serial": serial_server,
    "hislip": HislipServer,
}
"""Servers of a single instrument each."""


@dataclass(frozen=True, slots=True)
class Served:
    """Where a program finds an instrument: its VISA address, and the interface to open first where there is one."""

    address: str
    interface: str | None = None


@final
class Emulator:
    """Servers for the instruments of ``roles``, listening until closed.

    ``instrument`` gives the instrument of a role, as its RS-232 connector sees it where the second argument is true.
    One message at a time reaches the world that they share.
    """

    def __init__(
        self, transport: Transport, instrument: Callable[[str, bool], Instrument], roles: tuple[str, ...]
    ) -> None:
        self._stack = ExitStack()
        lock = threading.RLock()
        ports = {role: Port(instrument(role, transport == "serial"), lock) for role in roles}
        with ExitStack() as opening:
            opening.callback(self._stack.close)
            self.served = self._serve(transport, ports)
            opening.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up on everyone; the instruments keep their state."""
        self._stack.close()

    def _serve(self, transport: Transport, ports: Mapping[str, Port]) -> dict[str, Served]:
        if transport in ALONE:
            return {role: Served(self._open(ALONE[transport](port)).address) for role, port in ports.items()}
        on_bus = dict(enumerate(ports.values(), FIRST_GPIB_ADDRESS))
        numbered = zip(ports, on_bus, strict=True)
        if transport == "vxi11":
            gateway = self._open(Vxi11Gateway(on_bus))
            return {role: Served(gateway.address(number)) for role, number in numbered}
        adapter = self._open(PrologixAdapter(on_bus))
        return {role: Served(adapter.address(number), adapter.interface_address) for role, number in numbered}

    def _open(self, server: Opened) -> Opened:
        self._stack.callback(server.close)
        return server
