"""Tables read back: CSV in full precision, text aligned and never cut."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

from hpe_rig.result.tables import csv_text, text_table


@dataclass(frozen=True)
class Row:
    name: str
    length_m: float | None


def test_csv_reads_back_in_full_precision_from_dataclasses_and_mappings_alike() -> None:
    rows = [Row('a "b", c', 0.1 + 0.2), Row("", None)]
    text = csv_text(rows)
    assert text == csv_text([{"name": row.name, "length_m": row.length_m} for row in rows])
    first, second = csv.DictReader(io.StringIO(text))
    assert (first["name"], float(first["length_m"])) == ('a "b", c', 0.1 + 0.2)
    assert second == {"name": "", "length_m": ""}


def test_columns_of_words_start_and_columns_of_numbers_end_together() -> None:
    path = "a/" * 200
    lines = text_table(("name", "results", "m"), [("[bold]x", path, "1"), ("y", "b", "1000")], words=2).splitlines()
    assert [line.split() for line in lines] == [["name", "results", "m"], ["[bold]x", path, "1"], ["y", "b", "1000"]]
    assert len({len(line) for line in lines}) == 1
    assert {line.index(cell) for line, cell in zip(lines, ("results", path, "b"), strict=True)} == {9}
