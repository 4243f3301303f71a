"""Provenance of a run file's numbers: its attributes, its settings as read back, its fingerprint.

Everything read here may have been tampered with: it is bounded in size, taken as text, and never followed.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hpe_rig.store import UntrustedError, read_snapshots, trusted

LONGEST_TEXT = 200
MOST_ENTRIES = 64
LARGEST_HASHED_BYTES = 1 << 30


def attributes(path: Path, names: Iterable[str]) -> dict[str, str]:
    """Return those of the run file's text attributes ``names`` that it has, by name; raises ``StoreError``."""
    found = {}
    with trusted(path) as trust:
        for name in names:
            with contextlib.suppress(UntrustedError):
                found[name] = _short(trust.attribute(name, str))
    return found


def settings(path: Path, shot: int) -> dict[str, dict[str, str]]:
    """Return the instruments' settings of ``shot`` as read back, by role; empty where there are none."""
    snapshots = read_snapshots(path)
    if not 0 <= shot < len(snapshots):
        return {}
    return {_short(role): _table(table) for role, table in list(snapshots[shot].items())[:MOST_ENTRIES]}


def fingerprint(path: Path) -> str:
    """Return size and SHA-256 of the run file; without the digest where reading it all would take long."""
    size = path.stat().st_size
    if size > LARGEST_HASHED_BYTES:
        return f"{size / 1e9:.3g} GB, not hashed"
    with path.open("rb") as file:
        return f"{size / 1e6:.3g} MB, SHA-256 {hashlib.file_digest(file, 'sha256').hexdigest()}"


def _table(table: Any) -> dict[str, str]:
    if not isinstance(table, Mapping):
        return {"value": _short(table)}
    return {_short(name): _short(value) for name, value in list(table.items())[:MOST_ENTRIES]}


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}…"
