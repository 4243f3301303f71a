"""Marks of bad shots: the file beside the run file, its limits, and files that are not applied."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hpe_rig.store import StoreError
from hpe_rig.store.json_checksum import read_sealed, sealed_json
from hpe_rig.store.marks import identity_of, read_marks, write_marks

IDENTITY = identity_of("0" * 32, "2026-11-26T08:00:00+01:00")


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    return tmp_path / "run.h5"


def test_marks_are_read_as_they_were_written_with_shots_from_one_in_the_file(run_file: Path) -> None:
    assert read_marks(run_file, IDENTITY, 3) == ({}, "")
    path = write_marks(run_file, IDENTITY, {2: "the pump", 0: "marked bad: the \x1bbottle " + "x" * 600})
    assert path == run_file.with_name("run.marks.json")
    tables, has_checksum = read_sealed(path)
    assert (has_checksum, tables["run"]) == (True, IDENTITY)
    assert [entry["shot"] for entry in tables["bad"]] == [1, 3]
    assert [len(entry["why"]) for entry in tables["bad"]] == [500, 8]
    marks, why_ignored = read_marks(run_file, IDENTITY, 3)
    assert list(marks) == [0, 2]
    assert marks[2] == "marked bad: the pump"
    assert marks[0].startswith("marked bad: the \\x1bbottle x")
    assert why_ignored == ""


def test_marks_of_another_run_are_not_applied_and_that_is_said(run_file: Path) -> None:
    write_marks(run_file, identity_of("1" * 32, IDENTITY["started"]), {0: "the pump"})
    marks, why_ignored = read_marks(run_file, IDENTITY, 3)
    assert marks == {}
    assert why_ignored.startswith("run.marks.json belongs to another run than run.h5: its marks are not applied. Try:")


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"format": "hpe_rig queue"}, "it is no file of marks"),
        ({"bad": [{"shot": 0, "why": "a"}]}, "shot 0 of 3"),
        ({"bad": [{"shot": 4, "why": "a"}]}, "shot 4 of 3"),
        ({"bad": [{"shot": "1", "why": "a"}]}, "shot '1' of 3"),
        ({"bad": [{"shot": 1}]}, "KeyError: 'why'"),
        ({"bad": 3}, "TypeError"),
    ],
)
def test_a_file_that_marks_cannot_be_read_from_is_an_error(run_file: Path, changes: dict[str, Any], cause: str) -> None:
    path = write_marks(run_file, IDENTITY, {1: "the pump"})
    tables, _ = read_sealed(path)
    path.write_text(sealed_json(tables | {"bad": [{"shot": 3, "why": "a"}]}), "utf-8")
    assert list(read_marks(run_file, IDENTITY, 3)[0]) == [2]
    path.write_text(sealed_json(tables | changes), "utf-8")
    with pytest.raises(StoreError, match=rf"run\.marks\.json cannot be read as marks of shots .*{cause}.*hpe-rig mark"):
        read_marks(run_file, IDENTITY, 3)


def test_a_sealed_file_is_refused_if_it_is_changed_too_large_or_no_table(tmp_path: Path) -> None:
    path, tables = tmp_path / "a.json", {"format": "a", "numbers": [0.1, 1e300, 3]}
    path.write_text(sealed_json(tables), "utf-8")
    assert read_sealed(path) == (tables, True)
    size = path.stat().st_size
    assert read_sealed(path, size) == (tables, True)
    with pytest.raises(ValueError, match=f"it is larger than {size - 1} bytes"):
        read_sealed(path, size - 1)
    path.write_text(path.read_text("utf-8").replace("0.1", "0.2"), "utf-8")
    with pytest.raises(ValueError, match="does not match its checksum"):
        read_sealed(path)
    path.write_text(json.dumps(tables), "utf-8")
    assert read_sealed(path) == (tables, False)
    for text, words in (
        ("[]", "it holds no table"),
        ("{", "it is no JSON text"),
        ("[" * 100_000, "it is no JSON text"),
    ):
        path.write_text(text, "utf-8")
        with pytest.raises(ValueError, match=words):
            read_sealed(path)
