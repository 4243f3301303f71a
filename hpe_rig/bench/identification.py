"""Identification of the generators by a person: each role on the display of the instrument at its address."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drivers.interfaces import Instrument, InstrumentError
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.bench_loading import parse_bench
from hpe_rig.bench.instruments import make_safe
from hpe_rig.bench.interrupts import uninterrupted
from hpe_rig.bench.opening import open_each
from hpe_rig.scene import edited_text


@contextmanager
def displayed_roles(bench: BenchFile) -> Iterator[Mapping[str, Instrument | Exception]]:
    """Yield every instrument by role, or its error, with outputs off and each generator's role on its display.

    The displays are cleared at the end, also after an interrupt.
    """
    with open_each(bench) as instruments:
        make_safe([item for item in instruments.values() if not isinstance(item, Exception)])
        generators: dict[str, Any] = {
            role: item for role, item in instruments.items() if role != "digitizer" and not isinstance(item, Exception)
        }
        try:
            for role, generator in generators.items():
                generator.display(role.replace("_", " ").upper())
            yield instruments
        finally:
            with uninterrupted():
                for generator in generators.values():
                    with suppress(InstrumentError):
                        generator.display("")


def lasting_serial(instrument: Any) -> str:
    """Return the serial number of ``instrument``, or its label; a generator without either is given a new label."""
    serial = str(instrument.serial_number())
    if not serial:
        serial = f"HPE_{secrets.token_hex(3).upper()}"
        instrument.store_label(serial)
    return serial


def with_serials(path: Path, serials: Mapping[str, str]) -> str:
    """Return the text of the bench file ``path`` with ``serials`` by role; comments and layout stay.

    Raises ``SettingsError`` if that is no bench file, such as one with the same number for two roles.
    """
    # Line ends stay as they are, so the text is not read with universal newlines.
    text = path.read_bytes().decode("utf-8-sig")
    sections = {role: ("digitizer",) if role == "digitizer" else ("generators", role) for role in serials}
    edited = edited_text(text, {(*sections[role], "serial"): serial for role, serial in serials.items()})
    parse_bench(path.stem, edited)
    return edited
