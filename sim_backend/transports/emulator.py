"""Emulator: the generators of one simulated world behind real transports, on loopback alone."""

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
"""Factory setting of the 33250A; further instruments have the following addresses."""


Server = TypeVar("Server", SocketServer | SerialServer | HislipServer, Vxi11Gateway, PrologixAdapter)
SERVERS: Mapping[Transport, Callable[[Port], SocketServer | SerialServer | HislipServer]] = {
    "serial": serial_server,
    "hislip": HislipServer,
}
"""Servers of transports with one instrument a connection."""


@dataclass(frozen=True, slots=True)
class Served:
    """VISA address of an instrument, and of the adapter in front of it if there is one."""

    address: str
    interface: str | None = None


@final
class Emulator:
    """Servers for the instruments of ``roles``, listening until closed.

    ``instrument(role, over_serial)`` returns the instrument of a role, at its RS-232 connector if ``over_serial``. One
    message at a time reaches the shared world.
    """

    def __init__(
        self,
        transport: Transport,
        instrument: Callable[[str, bool], Instrument],
        roles: tuple[str, ...],
        tcp_ports: Mapping[str, int] | None = None,
    ) -> None:
        """Open servers for the instruments of ``roles`` over ``transport``.

        ``instrument`` returns the instrument of a role, given whether it is on a serial line. ``tcp_ports`` holds the
        ports of raw sockets by role; default: free ones.
        """
        self._stack = ExitStack()
        lock = threading.RLock()
        ports = {role: Port(instrument(role, transport == "serial"), lock) for role in roles}
        # If a server does not open, those already open are closed; after success they stay open.
        with ExitStack() as opening:
            opening.callback(self._stack.close)
            self.served = self._serve(transport, ports, tcp_ports or {})
            opening.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections; the instruments keep their state."""
        self._stack.close()

    def _serve(
        self, transport: Transport, ports: Mapping[str, Port], tcp_ports: Mapping[str, int]
    ) -> dict[str, Served]:
        """Open the servers of ``transport`` and return the address of each instrument, by role.

        Socket, serial and HiSLIP need one server for each instrument; VXI-11 and Prologix one for all.
        """
        if transport == "socket":
            servers = {
                role: self._open(SocketServer(port, tcp_port=tcp_ports.get(role, 0))) for role, port in ports.items()
            }
            return {role: Served(server.address) for role, server in servers.items()}
        if transport in SERVERS:
            return {role: Served(self._open(SERVERS[transport](port)).address) for role, port in ports.items()}
        by_gpib_address = dict(enumerate(ports.values(), FIRST_GPIB_ADDRESS))
        addresses = zip(ports, by_gpib_address, strict=True)
        if transport == "vxi11":
            gateway = self._open(Vxi11Gateway(by_gpib_address))
            return {role: Served(gateway.address(number)) for role, number in addresses}
        adapter = self._open(PrologixAdapter(by_gpib_address))
        return {role: Served(adapter.address(number), adapter.interface_address) for role, number in addresses}

    def _open(self, server: Server) -> Server:
        """Return ``server``, to be closed with the emulator."""
        self._stack.callback(server.close)
        return server
