"""A finished study on disk: its definition and a row for every case, estimator and frequency, as JSON and as CSV."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.study.case_store import Record, write_whole
from hpe_rig.study.cases import Point
from hpe_rig.study.definition import Definition

STUDY, SUMMARY = "study.json", "summary.csv"
OF_CASE = ("draws", "noise", "seconds", "peak_memory_bytes", "case")


@dataclass(frozen=True, slots=True)
class StudyResult:
    """A finished study. A row holds the axes by name, ``reading``, and what the engine's record says of an estimate."""

    name: str
    definition: Definition
    rows: list[dict[str, Any]]
    versions: tuple[str, ...]
    """Versions of this package that computed its cases."""

    @property
    def seconds(self) -> float:
        """Processor time of all its cases, those taken over from another study included."""
        return sum({row["case"]: float(row["seconds"]) for row in self.rows}.values())

    @property
    def realisations(self) -> int:
        """Number of realisations of all its cases."""
        return sum({row["case"]: int(row["draws"] * row["noise"]) for row in self.rows}.values())


def result_of(name: str, definition: Definition, points: list[Point], records: dict[str, Record]) -> StudyResult:
    """Return the study's rows, in the order of its points."""
    rows = []
    for point in points:
        record = records[point.case.key]
        for estimate in record["estimates"]:
            start = {**point.coordinates, "reading": point.reading}
            rows.append({**start, **estimate, **{key: record[key] for key in OF_CASE}})
    return StudyResult(name, definition, rows, tuple(sorted({record["version"] for record in records.values()})))


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
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(result.rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(result.rows)
    write_whole(folder / SUMMARY, text.getvalue())


def read_study(folder: Path) -> StudyResult:
    """Return a finished study; raise ``SettingsError`` where ``folder`` holds none."""
    try:
        tables = json.loads((folder / STUDY).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        mistake = Mistake(str(folder), f"no finished study here ({error})", "hpe-rig study NAME first")
        raise SettingsError("study", [mistake]) from None
    definition = Definition.model_validate(tables["definition"])
    return StudyResult(tables["name"], definition, tables["rows"], tuple(tables["versions"]))
