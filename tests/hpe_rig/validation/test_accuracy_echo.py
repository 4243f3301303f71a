"""Error against run time of the echo engine."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.validation.accuracy.echo import ENGINE, Measurement, draw_echo, measurements
from hpe_rig.validation.accuracy.work_precision import Point, draw_points, write_rows


@pytest.fixture(scope="module")
def rows() -> list[Measurement]:
    return list(measurements((100,), (10, 30), (1e-2, 1e-8), longest_s=0.1))


def test_the_error_of_every_evaluation_is_within_tolerance_or_rounding(rows: list[Measurement]) -> None:
    assert {row.evaluation for row in rows} == {"direct", "running_sum", "series", ENGINE}
    for row in rows:
        assert row.error <= (row.tolerance or 1e-12)
        assert row.time_s > 0


def test_table_and_figure_read_back(rows: list[Measurement], tmp_path: Path) -> None:
    write_rows(rows, tmp_path / "t.json", tmp_path / "work.svg", draw_echo, print)
    assert json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))[0]["scatterers"] == 100
    write_rows(rows, tmp_path / "t.csv", None, draw_echo, print)
    assert (tmp_path / "t.csv").read_text(encoding="utf-8").count("\n") == len(rows) + 1
    assert "<svg" in (tmp_path / "work.svg").read_text(encoding="utf-8")


def test_command_writes_the_table(tmp_path: Path) -> None:
    path = tmp_path / "echo.csv"
    done = CliRunner().invoke(
        app,
        ["accuracy", "echo", "--output", str(path), "--largest", "100", "--most-echoes", "10", "--longest-s", "0.1"],
    )
    assert done.exit_code == 0, done.output
    assert path.read_text(encoding="utf-8").startswith("scatterers,echoes,samples,evaluation,method,tolerance")


@pytest.mark.parametrize(("option", "value"), [("--largest", "5"), ("--most-echoes", "0"), ("--longest-s", "0")])
def test_sizes_without_any_scene_are_refused(option: str, value: str) -> None:
    done = CliRunner().invoke(app, ["accuracy", "echo", option, value])
    assert done.exit_code == 2
    assert option in done.output


@pytest.mark.parametrize("part", ["echo", "specimen", "chain"])
def test_invalid_file_names_are_refused_before_the_first_measurement(
    tmp_path: Path, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.perf_counter", lambda: pytest.fail("a measurement began"))
    wrong = ["--output", str(tmp_path / "no" / "a.txt"), "--figure", str(tmp_path / "b.bmp")]
    done = CliRunner().invoke(app, ["accuracy", part, *wrong])
    assert done.exit_code == 2, done.output
    for words in ("a.txt: unknown format", "does not exist", "b.bmp: unknown format"):
        assert words in done.output


def test_points_until_an_interruption_are_written(tmp_path: Path) -> None:
    def points() -> Iterator[Point]:
        yield Point("case", "method", "setting", 1e-3, 0.5)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_rows(points(), tmp_path / "a.csv", None, draw_points, print)
    assert (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[1] == "case,method,setting,0.001,0.5"
