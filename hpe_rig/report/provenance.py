"""Provenance of a run file: attributes, settings read back from the instruments, fingerprint.

Any value of the file may be manipulated, so all are limited in size and displayed as plain text.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hpe_rig.store import InvalidContentError, open_checked, read_snapshots

MAX_TEXT = 200
MAX_ENTRIES = 64
MAX_HASHED_BYTES = 1 << 30


def attributes(path: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the text attributes ``names`` that the run file has; raises ``StoreError``."""
    texts = {}
    with open_checked(path) as checked:
        for name in names:
            with contextlib.suppress(InvalidContentError):
                texts[name] = _short(checked.attribute(name, str))
    return texts


def settings(path: Path, shot: int) -> dict[str, dict[str, str]]:
    """Return the settings read back from the instruments in ``shot``, by role; empty without a snapshot."""
    snapshots = read_snapshots(path)
    if not 0 <= shot < len(snapshots):
        return {}
    return {_short(role): _table(table) for role, table in list(snapshots[shot].items())[:MAX_ENTRIES]}


def fingerprint(path: Path) -> str:
    """Return size and SHA-256 of the run file; no digest above ``MAX_HASHED_BYTES``, where it takes too long."""
    size = path.stat().st_size
    if size > MAX_HASHED_BYTES:
        return f"{size / 1e9:.3g} GB, not hashed"
    with path.open("rb") as file:
        return f"{size / 1e6:.3g} MB, SHA-256 {hashlib.file_digest(file, 'sha256').hexdigest()}"


def _table(table: Any) -> dict[str, str]:
    if not isinstance(table, Mapping):
        return {"value": _short(table)}
    return {_short(name): _short(value) for name, value in list(table.items())[:MAX_ENTRIES]}


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}…"
