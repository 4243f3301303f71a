"""Results on disk: a file for each finished case, so that a study can continue, and a table for each finished one."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.result import csv_text
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import atomic_file, unwritable
from hpe_rig.study.cases import GridPoint
from hpe_rig.study.definition import Definition

CaseRecord = dict[str, Any]
"""One finished case: ``estimates``, a row an estimator and frequency, and what else `FIELDS` names."""

FIELDS = frozenset({"case", "estimates", "draws", "noise", "seconds", "peak_memory_bytes", "version"})
STUDY, SUMMARY = "study.json", "summary.csv"
OF_CASE = ("draws", "noise", "seconds", "peak_memory_bytes", "case")


@dataclass(frozen=True, slots=True)
class CaseStore:
    """The finished cases below a folder, each named by the hash of its definition; several studies may share one."""

    folder: Path

    def read(self, key: str) -> CaseRecord | None:
        """Return the record of a finished case; None where it is absent or its file is not as it was written."""
        try:
            stored = json.loads(self._path(key).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        record = stored.get("record") if isinstance(stored, dict) else None
        if not isinstance(record, dict) or stored.get("sha256") != _digest(record):
            return None
        return record if record.keys() >= FIELDS and record["case"] == key else None

    def is_damaged(self, key: str) -> bool:
        """Return whether there is a file of that case that ``read`` does not trust."""
        return self._path(key).exists() and self.read(key) is None

    def write(self, record: CaseRecord) -> None:
        """Write a record and its hash, whole or not at all; raises ``SettingsError`` where that is impossible."""
        write_whole(self._path(record["case"]), json.dumps({"sha256": _digest(record), "record": record}))

    def prepare(self) -> None:
        """Make the folder; raise ``SettingsError`` where nothing can be written there, before anything is computed."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(self.folder, error.strerror) from None
        if why := unwritable(self.folder / STUDY):
            raise _unwritable(self.folder, why)

    def _path(self, key: str) -> Path:
        # A folder for every 256th case: file managers take long over 1e5 files in one.
        return self.folder / key[:2] / f"{key}.json"


def _digest(record: CaseRecord) -> str:
    """Return the hash of a record, the same before and after JSON: numbers survive that to the last bit."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class StudyResult:
    """A finished study. A row holds the axes by name, ``reading``, and what the engine's record says of an estimate."""

    name: str
    definition: Definition
    rows: list[dict[str, Any]]
    versions: tuple[str, ...]
    """Versions of this package that computed its cases."""

    @property
    def cases(self) -> dict[str, dict[str, Any]]:
        """One row of each case, by the case's key."""
        return {row["case"]: row for row in self.rows}

    @property
    def seconds(self) -> float:
        """Processor time of all its cases, those taken over from another study included."""
        return sum(float(row["seconds"]) for row in self.cases.values())

    @property
    def realisations(self) -> int:
        """Number of realisations of all its cases."""
        return sum(int(row["draws"] * row["noise"]) for row in self.cases.values())

    @property
    def peak_memory_mib(self) -> float:
        """Largest resident size of a process that computed any of its cases."""
        return float(max(row["peak_memory_bytes"] for row in self.rows) / 2**20)


def result_of(
    name: str, definition: Definition, points: list[GridPoint], records: dict[str, CaseRecord]
) -> StudyResult:
    """Return the study's rows, in the order of its points."""
    rows, versions = [], set()
    for point in points:
        record = records[point.case.key]
        versions.add(record["version"])
        start = {**point.coordinates, "reading": point.reading}
        rows += [{**start, **estimate, **{key: record[key] for key in OF_CASE}} for estimate in record["estimates"]]
    return StudyResult(name, definition, rows, tuple(sorted(versions)))


def write_study(result: StudyResult, folder: Path) -> None:
    """Write ``study.json`` and ``summary.csv`` to ``folder``."""
    tables = {
        "name": result.name,
        "definition": result.definition.model_dump(mode="json"),
        "versions": list(result.versions),
        "seconds": result.seconds,
        "rows": result.rows,
    }
    write_whole(folder / STUDY, json.dumps(tables) + "\n")
    write_whole(folder / SUMMARY, csv_text(result.rows))


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` whole or not at all, its folder too; raises ``SettingsError`` where that is impossible."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as draft:
            draft.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise _unwritable(path, error.strerror) from None


def _unwritable(path: Path, why: str | None) -> SettingsError:
    mistake = Mistake(str(path), f"cannot be written ({why})", "another folder, by --output")
    return SettingsError("command line", [mistake])
