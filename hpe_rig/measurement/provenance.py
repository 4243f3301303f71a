"""Provenance of a run that starts now: the time with its offset from UTC, host, user and drivers."""

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
    """Return when and where a run on ``bench`` starts; the user's name only where the bench file lets it be stored."""
    return Provenance(
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
        host=_printable(socket.gethostname()),
        user=_user() if bench.store_user else "",
        drivers=", ".join(_drivers(bench)),
    )


def _drivers(bench: BenchFile) -> Iterator[str]:
    """Yield the packages that the generators are reached through; the twin in process needs none."""
    if bench.simulated and bench.transport is None:
        return
    for name in VISA_PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            yield f"{name} {metadata.version(name)}"


def _user() -> str:
    # An account without a name, as in a container, is no reason not to measure.
    with suppress(OSError, KeyError, ImportError):
        return _printable(getpass.getuser())
    return ""


def _printable(text: str) -> str:
    return text if text.isprintable() else ""
