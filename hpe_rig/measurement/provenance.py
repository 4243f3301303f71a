"""Provenance of a run: start time with its offset from UTC, host, user and drivers."""

from __future__ import annotations

import getpass
import socket
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from importlib import metadata

from hpe_rig.bench import BenchFile
from hpe_rig.result import Provenance

VISA_PACKAGES = ("pyvisa", "pyvisa-py", "pyserial")


def provenance_now(bench: BenchFile) -> Provenance:
    """Return the provenance of a run that starts now; with the user's name only if the bench file permits it."""
    return Provenance(
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
        host=_printable(socket.gethostname()),
        user=_user() if bench.store_user else "",
        drivers=", ".join(_drivers(bench)),
    )


def _drivers(bench: BenchFile) -> Iterator[str]:
    """Yield the packages that connect to the generators; the twin in process uses none."""
    if bench.simulated and bench.transport is None:
        return
    for name in VISA_PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            yield f"{name} {metadata.version(name)}"


def _user() -> str:
    # An account may have no name, as in a container. That must not prevent a measurement.
    with suppress(OSError, KeyError, ImportError):
        return _printable(getpass.getuser())
    return ""


def _printable(text: str) -> str:
    return text if text.isprintable() else ""
