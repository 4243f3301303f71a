"""Finished cases on disk: one file a case, named by the hash of its definition, so that a study can go on."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.scene import Mistake, SettingsError

Record = dict[str, Any]

FIELDS = frozenset({"case", "estimates", "draws", "noise", "seconds", "peak_memory_bytes", "version"})
"""What a record holds."""


@dataclass(frozen=True, slots=True)
class CaseStore:
    """The finished cases below a folder; several studies may share one."""

    folder: Path

    def read(self, key: str) -> Record | None:
        """Return the record of a finished case; None where it is absent or its file is damaged."""
        try:
            record = json.loads(self._path(key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        whole = isinstance(record, dict) and record.keys() >= FIELDS and record["case"] == key
        return record if whole else None

    def write(self, record: Record) -> None:
        """Write a record whole or not at all; raises ``SettingsError`` where the folder cannot be written."""
        path = self._path(record["case"])
        write_whole(path, json.dumps(record))

    def _path(self, key: str) -> Path:
        # A folder for every 256th case: file managers take long over 1e5 files in one.
        return self.folder / key[:2] / f"{key}.json"


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` whole or not at all; raises ``SettingsError`` where that is impossible."""
    half = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        half.write_text(text, encoding="utf-8", newline="")
        half.replace(path)
    except OSError as error:
        mistake = Mistake(str(path), f"cannot be written ({error.strerror})", "another folder, by --output")
        raise SettingsError("study", [mistake]) from None
    finally:
        # Gone where all went well; where not, nothing of it is left.
        with suppress(OSError):
            half.unlink()
