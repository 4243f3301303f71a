"""Where a run file's numbers come from: its attributes, its settings as read back, its fingerprint, its run time.

Everything read here may have been tampered with: it is bounded in size, taken as text, and never followed.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py

from hpe_rig.store import result_path

LONGEST_TEXT = 200
LONGEST_JSON = 200_000
MOST_ENTRIES = 64
LARGEST_HASHED_BYTES = 1 << 30
AGAIN = ("read", "process", "write result")
"""Stages that the report itself runs, so that an earlier run's times for them say nothing."""


def attributes(path: Path) -> dict[str, str]:
    """Return the run file's attributes as short texts, by name."""
    with h5py.File(path, "r") as file:
        names = sorted(file.attrs)[:MOST_ENTRIES]
        return {_short(name): _short(file.attrs[name]) for name in names}


def settings(path: Path, shot: int) -> dict[str, dict[str, str]]:
    """Return the instruments' settings of ``shot`` as read back, by role; empty where there are none."""
    try:
        with h5py.File(path, "r") as file:
            text = file["snapshot"].asstr()[shot]
        tables = json.loads(text) if len(text) <= LONGEST_JSON else {}
    except (KeyError, IndexError, ValueError, TypeError, OSError, RecursionError):
        return {}
    if not isinstance(tables, dict):
        return {}
    return {_short(role): _table(table) for role, table in list(tables.items())[:MOST_ENTRIES]}


def fingerprint(path: Path) -> str:
    """Return size and SHA-256 of the run file; without the digest where reading it all would take long."""
    size = path.stat().st_size
    if size > LARGEST_HASHED_BYTES:
        return f"{size / 1e9:.3g} GB, not hashed"
    with path.open("rb") as file:
        return f"{size / 1e6:.3g} MB, SHA-256 {hashlib.file_digest(file, 'sha256').hexdigest()}"


def earlier_run_time_s(path: Path, estimator: str) -> dict[str, float]:
    """Return the wall times of planning and acquiring that an earlier result beside the run holds, by stage."""
    try:
        with h5py.File(result_path(path, estimator), "r") as file:
            text = file["json"].asstr()[()]
        stages = json.loads(text)["run_time_s"] if len(text) <= 100 * LONGEST_JSON else {}
        return {
            _short(name): float(seconds)
            for name, seconds in list(stages.items())[:MOST_ENTRIES]
            if name not in AGAIN and math.isfinite(float(seconds)) and float(seconds) >= 0
        }
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RecursionError):
        return {}


def _table(table: Any) -> dict[str, str]:
    if not isinstance(table, Mapping):
        return {"value": _short(table)}
    return {_short(name): _short(value) for name, value in list(table.items())[:MOST_ENTRIES]}


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}…"
