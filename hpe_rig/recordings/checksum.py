"""SHA-256 of a recording, computed in a thread while it is read."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_BYTES = 1 << 20
"""Bytes that the checksum takes at a time."""


class Checksum:
    """SHA-256 in a thread; the end of the context stops it, so that no message waits for a long file."""

    def __init__(self) -> None:
        self.stopped = False

    def __enter__(self) -> Checksum:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stopped = True

    def __call__(self, data: Path | NDArray[Any]) -> str:
        """Return the hexadecimal SHA-256 of a file or array; of a part of it once stopped."""
        digest = hashlib.sha256()
        with data.open("rb") if isinstance(data, Path) else io.BytesIO(np.ascontiguousarray(data).data) as file:
            while not self.stopped and (block := file.read(BLOCK_BYTES)):
                digest.update(block)
        return digest.hexdigest()
