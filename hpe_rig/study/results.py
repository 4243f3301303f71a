"""Results on disk: one file for each completed case, so that a study can continue, and one table for each study."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.result import csv_text
from hpe_rig.store import content_digest, make_folder, refuse_unwritable, sealed_json, write_file
from hpe_rig.study.cases import GridPoint
from hpe_rig.study.definition import Definition

CaseRecord = dict[str, Any]
"""One completed case: ``estimates``, a row for each estimator and frequency, and the other `FIELDS`."""

FIELDS = frozenset({"case", "estimates", "draws", "noise", "seconds", "peak_memory_bytes", "version"})
STUDY_FILE, SUMMARY_FILE = "study.json", "summary.csv"
CASE_COLUMNS = ("draws", "noise", "seconds", "peak_memory_bytes", "case")


@dataclass(frozen=True, slots=True)
class CaseStore:
    """The completed cases below a folder, each named by the hash of its definition; several studies may share one."""

    folder: Path

    def read(self, key: str) -> CaseRecord | None:
        """Return the record of a completed case; None if it is absent or its file fails its checksum."""
        try:
            stored = json.loads(self._path(key).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        record = stored.get("record") if isinstance(stored, dict) else None
        if not isinstance(record, dict) or stored.get("sha256") != content_digest(record):
            return None
        return record if record.keys() >= FIELDS and record["case"] == key else None

    def is_damaged(self, key: str) -> bool:
        """Return whether the case has a file that ``read`` rejects."""
        return self._path(key).exists() and self.read(key) is None

    def write(self, record: CaseRecord) -> None:
        """Write a record and its hash atomically; raise ``StoreError`` if that is impossible."""
        path = self._path(record["case"])
        make_folder(path.parent)
        write_file(path, json.dumps({"sha256": content_digest(record), "record": record}))

    def prepare(self) -> None:
        """Make the folder; raise ``StoreError``, before any computation, if it is not writable."""
        make_folder(self.folder)
        refuse_unwritable(self.folder / STUDY_FILE)

    def _path(self, key: str) -> Path:
        # 256 subfolders: file managers are slow with 1e5 files in one folder.
        return self.folder / key[:2] / f"{key}.json"


@dataclass(frozen=True, slots=True)
class StudyResult:
    """A completed study.

    A row holds the value of each axis by its name, ``reading``, and the engine's record of one estimate.
    """

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
        """Processor time of all its cases, including those that another study computed."""
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
        coordinates = {**point.coordinates, "reading": point.reading}
        case_values = {key: record[key] for key in CASE_COLUMNS}
        rows += [{**coordinates, **estimate, **case_values} for estimate in record["estimates"]]
    return StudyResult(name, definition, rows, tuple(sorted(versions)))


def write_study(result: StudyResult, folder: Path) -> None:
    """Write ``study.json`` and ``summary.csv`` to ``folder``."""
    summary = csv_text(result.rows)
    tables = {
        "format": "hpe_rig study",
        "name": result.name,
        "definition": result.definition.model_dump(mode="json"),
        "versions": list(result.versions),
        "seconds": result.seconds,
        "rows": result.rows,
        # ``hpe-rig verify`` compares it: CSV has no field for a checksum.
        "summary_sha256": hashlib.sha256(summary.encode()).hexdigest(),
    }
    make_folder(folder)
    write_file(folder / SUMMARY_FILE, summary)
    write_file(folder / STUDY_FILE, sealed_json(tables))
