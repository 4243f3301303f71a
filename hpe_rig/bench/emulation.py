"""Emulation of a whole bench for any VISA program on this computer, and the bench file that describes it."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from hpe_rig.bench.bench_file import TRANSPORTS, BenchFile, Transport
from hpe_rig.bench.bench_loading import BenchText
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.bench.opening import open_emulator
from hpe_rig.bench.resource_name import LOOPBACK, literal_host
from hpe_rig.scene import (
    KeyPath,
    Mistake,
    Number,
    Scene,
    SettingsError,
    edited_text,
    parse_toml,
    read_settings_text,
)

INTERFACE = re.compile(r"^\s*interface\s*=.*\n", re.MULTILINE)
RAW_SOCKET = re.compile(r"TCPIP\d*::(?P<host>[^:]+|\[.+\])::(?P<port>\d+)::SOCKET", re.IGNORECASE)
HEAD = """\
# Emulated: generators served on loopback over {transport} until hpe-rig emulate ends, each at an address, in one world
# with one clock. The digitizer has no address. With this file run, check, commission and bench serve such generators
# again, with the digitizer's library emulated, in their process and at other addresses.
"""


def is_bench_file(name: str) -> bool:
    """Return whether ``name`` is a TOML file with generators, which no scene has."""
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        return False
    try:
        return "generators" in parse_toml(read_settings_text(path), name)
    except (OSError, ValueError, SettingsError):
        # Whatever it is, its reader reports what is wrong with it.
        return False


def emulate(scene: Scene, bench: BenchText, transport: str, announce: Callable[[str], None]) -> None:
    """Serve the generators of ``bench``, simulated, until Ctrl-C; announce the bench file that reaches them.

    Generators with a raw socket on this machine are served at their addresses. Those of a real bench have the serial
    numbers of its file. Raises ``SettingsError`` for an unknown transport, ``InstrumentError`` if it is not available.
    """
    known_transport = next((name for name in TRANSPORTS if name == transport), None)
    if known_transport is None:
        mistake = Mistake("transport", f"{transport} is no transport", ", ".join(TRANSPORTS))
        raise SettingsError("command line", [mistake])
    twin = bench.bench.model_copy(update=_emulation(bench.bench))
    try:
        with open_emulator(scene, twin, known_transport, _loopback_ports(bench.bench)) as addresses:
            announce(addressed(bench, known_transport, addresses))
            while True:
                # In short pieces, because on Windows a long wait would not end for Ctrl-C.
                time.sleep(0.2)
    except (KeyboardInterrupt, Terminated):
        return


def _emulation(bench: BenchFile) -> dict[str, bool]:
    """Return the keys that make ``bench`` a simulated one."""
    return {"simulated": True, "emulated": bench.emulated or not bench.simulated}


def _loopback_ports(bench: BenchFile) -> dict[str, int]:
    """Return by role the port of each generator with a raw socket on this machine."""
    sockets = {role: RAW_SOCKET.fullmatch(item.address or "") for role, item in bench.generators.by_role.items()}
    return {
        role: int(match["port"])
        for role, match in sockets.items()
        if match is not None and literal_host(match["host"]) == LOOPBACK
    }


def addressed(bench: BenchText, transport: Transport, addresses: Mapping[str, tuple[str, str | None]]) -> str:
    """Return the text of ``bench`` with its transport and each generator's VISA address."""
    values: dict[KeyPath, Number | str] = {("simulated",): True, ("transport",): transport}
    if _emulation(bench.bench)["emulated"]:
        values["emulated",] = True
    for role, (address, interface) in addresses.items():
        values["generators", role, "address"] = address
        if interface:
            values["generators", role, "interface"] = interface
    # The adapters of a real bench are not those of the emulated generators.
    return HEAD.format(transport=transport) + edited_text(INTERFACE.sub("", bench.text), values)
