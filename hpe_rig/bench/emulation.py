"""Emulation of a whole bench for any VISA program on this computer, and the bench file that describes it."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping

from hpe_rig.bench.bench_file import TRANSPORTS, Transport
from hpe_rig.bench.bench_loading import BenchText, parse_bench
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.bench.opening import open_emulator
from hpe_rig.scene import Mistake, Scene, SettingsError

ADDRESSING = re.compile(r"^\s*(address|interface|transport)\s*=.*\n", re.MULTILINE)
HEAD = """\
# Served on loopback over {transport} until this program ends: a generator an address, one world, one clock.
# The digitizer has no address. hpe-rig run --bench THIS.toml serves such a bench again, with the digitizer, in its
# process and at other addresses.
"""


def emulate(scene: Scene, bench: BenchText, transport: str, announce: Callable[[str], None]) -> None:
    """Serve the simulated generators of ``bench`` until Ctrl-C; announce the bench file that reaches them.

    Raises ``SettingsError`` for a real bench and an unknown transport, ``InstrumentError`` if the platform lacks it.
    """
    known_transport = next((name for name in TRANSPORTS if name == transport), None)
    if known_transport is None:
        mistake = Mistake("transport", f"{transport} is no transport", ", ".join(TRANSPORTS))
        raise SettingsError("command line", [mistake])
    if not bench.bench.simulated:
        remedy = "simulated = true, or leave --bench out"
        raise SettingsError(f"bench {bench.name}", [Mistake("simulated", "a real bench is not emulated", remedy)])
    try:
        with open_emulator(scene, bench.bench, known_transport) as addresses:
            announce(addressed(bench, known_transport, addresses))
            while True:
                # In short pieces, because on Windows a long wait would not end for Ctrl-C.
                time.sleep(0.2)
    except (KeyboardInterrupt, Terminated):
        return


def addressed(bench: BenchText, transport: Transport, addresses: Mapping[str, tuple[str, str | None]]) -> str:
    """Return the text of ``bench`` with its transport and each generator's VISA address.

    Raises ``SettingsError`` if the generators of its file are not tables with headers.
    """
    # The addresses of the file are replaced, and each generator's is put below the header of its table.
    text = ADDRESSING.sub("", bench.text)
    lines = f'simulated = true\ntransport = "{transport}"'
    text = re.sub(r"^simulated\s*=.*$", lines, text, count=1, flags=re.MULTILINE)
    for role, (address, interface) in addresses.items():
        lines = f'[generators.{role}]\naddress = "{address}"'
        lines += f'\ninterface = "{interface}"' if interface else ""
        text = text.replace(f"[generators.{role}]", lines, 1)
    # An inline table would not have got its address.
    parsed = {role: item.address for role, item in parse_bench(bench.name, text).bench.generators.by_role.items()}
    if parsed != {role: address for role, (address, _) in addresses.items()}:
        what = "the generators have no separate tables"
        raise SettingsError(f"bench {bench.name}", [Mistake("generators", what, "write [generators.master] and so on")])
    return HEAD.format(transport=transport) + text
