"""JSON files with the SHA-256 of their content under the key ``sha256``: lists of queues, marks and studies."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

CHECKSUM: Final = "sha256"
MAX_BYTES: Final = 256_000_000
"""Maximum size of a file that is read."""


def sealed_json(tables: Mapping[str, Any]) -> str:
    """Return ``tables`` as JSON with their checksum."""
    return json.dumps({**tables, CHECKSUM: content_digest(tables)}, indent=1, ensure_ascii=False) + "\n"


def content_digest(content: Any) -> str:
    """Return the SHA-256 of JSON values. JSON round-trips every bit of a number, so the hash survives it."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_sealed(path: Path, max_bytes: int = MAX_BYTES) -> tuple[dict[str, Any], bool]:
    """Return the tables of a JSON file and whether it has a checksum, which files of earlier releases lack.

    Raises ``ValueError`` for other content and for a wrong checksum, and ``OSError`` for an unreadable file.
    """
    with path.open("rb") as file:
        text = file.read(max_bytes + 1)
    if len(text) > max_bytes:
        raise ValueError(f"it is larger than {max_bytes} bytes")
    try:
        tables = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("it is no JSON text: it was cut or changed") from None
    if not isinstance(tables, dict):
        raise ValueError("it holds no table: it was changed, or comes from an earlier release")
    stated = tables.pop(CHECKSUM, None)
    if stated is not None and stated != content_digest(tables):
        raise ValueError("its content does not match its checksum: it was changed")
    return tables, stated is not None
