"""One name for each physical instrument, whatever spelling of its VISA address a bench file has.

The spelling follows pyvisa's resource names: a board of 0 and the class INSTR may be omitted, upper and lower case are
equal. One instrument on a LAN also answers as ``inst0`` (VXI-11), as ``hislip0`` and on its raw socket. Instruments
behind one gateway or adapter, and ports of one host beyond those of the protocols, are different instruments.

Aliases that a vendor's VISA defines are unknown here. Two of them for one instrument are noticed by its serial number.
"""

from __future__ import annotations

import ipaddress
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Final

from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.scene import Mistake

RESOLUTION_TIMEOUT_S: Final = 2.0
"""Longest wait for the addresses of all host names; a name without an answer stays as it is written."""
SCPI_PORTS: Final = ("5024", "5025")
"""Raw sockets of Keysight instruments: a telnet prompt, and SCPI; also those of other vendors."""
HISLIP_PORT: Final = "4880"
PROLOGIX_PORT: Final = "1234"
CLASSES: Final = ("INSTR", "SOCKET", "INTFC", "RAW")
LOOPBACK: Final = "127.0.0.1"


def literal_host(host: str) -> str:
    """Return an IP address in its usual spelling and a host name in lower case, without asking any network."""
    name = host.strip("[]").lower().rstrip(".")
    if name == "localhost":
        return LOOPBACK
    with suppress(ValueError):
        address = ipaddress.ip_address(name)
        if isinstance(address, ipaddress.IPv6Address):
            address = address.ipv4_mapped or address
        # The target of a connection to no address, 0.0.0.0, is this computer.
        return LOOPBACK if str(address) == "::1" or address.is_unspecified else str(address)
    return name


def resolved_host(host: str) -> str:
    """Return the IP address of ``host``, the lowest IPv4 one of several; without an answer as `literal_host`.

    Takes as long as the resolver of the system does.
    """
    name = literal_host(host)
    with suppress(OSError, UnicodeError):
        addresses = {literal_host(str(entry[4][0])) for entry in socket.getaddrinfo(name, None)}
        return min(addresses, key=lambda address: (":" in address, address))
    return name


def posix_device(device: str) -> str:
    """Return the device file that a path of a serial line leads to, such as ``/dev/serial/by-id/...``."""
    return os.path.realpath(device) if device.startswith("/") else device


def windows_device(device: str) -> str:
    """Return the name of a serial port: 3 and com3 are COM3."""
    return f"COM{device}" if device.isdigit() else device.upper()


SYSTEM_DEVICE: Final = windows_device if sys.platform == "win32" else posix_device


def canonical_resource(
    address: str,
    interface: str | None = None,
    host: Callable[[str], str] = literal_host,
    device: Callable[[str], str] = SYSTEM_DEVICE,
) -> str:
    """Return the name of the instrument at ``address``, behind the adapter ``interface`` if there is one.

    ``host`` and ``device`` return one name for all spellings of a host and of a serial line. An address of unknown form
    is returned in upper case.
    """
    # IPv6 addresses, in brackets, contain the separator.
    head, *fields = re.split(r"::(?![^\[]*\])", address.strip())
    match = re.fullmatch(r"(PRLGX-TCPIP|PRLGX-ASRL|TCPIP|GPIB|ASRL|USB)(.*)", head, re.IGNORECASE)
    is_socket = bool(fields) and fields[-1].upper() == "SOCKET"
    if fields and fields[-1].upper() in CLASSES:
        fields.pop()
    # Fields that are missing or no numbers make an unknown form.
    with suppress(ValueError, IndexError, TypeError):
        match (match[1].upper() if match else "", match[2] if match else ""):
            case ("GPIB", board):
                bus = canonical_resource(interface, None, host, device) if interface else f"GPIB{int(board or 0)}"
                primary, *secondary = (str(int(number)) for number in fields)
                return "::".join([bus, primary, *secondary])
            case ("ASRL", line) if tcp := re.fullmatch(r"socket://(.+):(\d+)", line, re.IGNORECASE):
                return _lan_port(host(tcp[1]), tcp[2])
            case ("ASRL", line):
                return f"ASRL{device(line)}"
            case ("PRLGX-ASRL", _):
                return f"ASRL{device(fields[0])}"
            case ("PRLGX-TCPIP", _):
                return _lan_port(host(fields[0]), *fields[1:] or [PROLOGIX_PORT])
            case ("TCPIP", _):
                return _lan_port(host(fields[0]), fields[1]) if is_socket else _lan_device(host, *fields)
            case ("USB", _):
                maker, model, serial, *_ = fields
                return f"USB::{int(maker, 0):#06x}::{int(model, 0):#06x}::{serial.upper()}"
    return address.strip().upper()


def _lan_port(host: str, port: str) -> str:
    return f"TCPIP::{host}" if port in SCPI_PORTS else f"TCPIP::{host}:{int(port)}"


def _lan_device(host: Callable[[str], str], host_text: str, device: str = "inst0") -> str:
    """Return the name of a LAN device; ``host_text`` may end with a port of VXI-11 (pyvisa-py)."""
    name, _, port = host_text.partition(",")
    match = re.fullmatch(r"(inst|hislip)(\d+)(?:,(\d+))?", device, re.IGNORECASE)
    number = int(match[2]) if match else 0
    port = (match[3] if match and match[3] not in (None, HISLIP_PORT) else "") or port
    name = f"TCPIP::{host(name)}" + (f":{int(port)}" if port else "")
    # Device 0 is the instrument itself; others are parts of it, or instruments behind a gateway (gpib0,10).
    if match:
        return f"{name}::{number}" if number else name
    return f"{name}::{device.lower().replace(' ', '')}"


def resource_names(bench: BenchFile) -> dict[str, str]:
    """Return the name of each generator by role, from the text of its address and the links of this computer."""
    return {
        role: canonical_resource(item.address or "", item.interface) for role, item in bench.generators.by_role.items()
    }


def resolved_names(bench: BenchFile) -> dict[str, str]:
    """Return the name of each generator by role, its host resolved; the wait is limited to `RESOLUTION_TIMEOUT_S`."""
    names = resource_names(bench)

    def resolve(role: str, address: str, interface: str | None) -> None:
        names[role] = canonical_resource(address, interface, resolved_host)

    # A resolver cannot be interrupted; a thread that is still waiting for it ends with the program.
    threads = [
        threading.Thread(target=resolve, args=(role, item.address or "", item.interface), daemon=True)
        for role, item in bench.generators.by_role.items()
    ]
    for thread in threads:
        thread.start()
    deadline_s = time.monotonic() + RESOLUTION_TIMEOUT_S
    for thread in threads:
        thread.join(max(0.0, deadline_s - time.monotonic()))
    return dict(names)


def shared_addresses(bench: BenchFile, names: Mapping[str, str]) -> Iterator[Mistake]:
    """Yield a mistake for each generator with the same instrument as another role."""
    roles: dict[str, str] = {}
    for role, name in names.items():
        first = roles.setdefault(name, role)
        if first == role:
            continue
        addresses = [bench.generators.by_role[item].address for item in (first, role)]
        spelled = repr(addresses[1]) if addresses[0] == addresses[1] else f"{addresses[1]!r} and {addresses[0]!r}"
        what = f"{first} and {role} have the same instrument, {spelled}"
        yield Mistake(f"generators.{role}.address", what, "the address of another instrument")
