"""Error against run time of the echo engine."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.validation.accuracy.echo import ENGINE, Measurement, count_good_choices, measurements, write_figure
from hpe_rig.validation.accuracy.work_precision import Point, draw_points, write_rows


@pytest.fixture(scope="module")
def rows() -> list[Measurement]:
    return list(measurements((100, 400), (10, 30), (1e-2, 1e-8), longest_s=0.1))


def test_the_error_of_every_evaluation_is_within_tolerance_or_rounding(rows: list[Measurement]) -> None:
    assert {row.evaluation for row in rows} == {"direct", "running_sum", "series", ENGINE}
    for row in rows:
        assert row.error <= (row.tolerance or 1e-12)
        assert row.time_s > 0


def test_the_engine_is_compared_with_every_evaluation_of_the_same_scene_and_tolerance() -> None:
    def row(evaluation: str, tolerance: float, time_s: float, echoes: int = 10) -> Measurement:
        return Measurement(100, echoes, 130, evaluation, "series", tolerance, 3, 0.0, time_s, 0.0, 2)

    rows = [
        row("running_sum", 0.0, 1.0),
        row("series", 1e-6, 0.4),
        row("series", 1e-2, 0.1),
        row(ENGINE, 1e-6, 0.8),
        row(ENGINE, 1e-2, 0.3),
        row("series", 1e-2, 1e-9, echoes=20),
    ]
    assert count_good_choices(rows) == (1, 2)
    assert count_good_choices(rows, 3.1) == (2, 2)


def test_table_and_figure_read_back(rows: list[Measurement], tmp_path: Path) -> None:
    write_rows(rows, tmp_path / "t.json", tmp_path / "work.svg", write_figure, print)
    assert json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))[0]["scatterers"] == 100
    write_rows(rows, tmp_path / "t.csv", None, write_figure, print)
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


def test_all_invalid_options_are_reported_before_the_first_measurement(tmp_path: Path) -> None:
    wrong = ["--output", str(tmp_path / "a.xls"), "--figure", str(tmp_path / "no" / "b.svg"), "--largest", "5"]
    done = CliRunner().invoke(app, ["accuracy", "echo", *wrong, "--most-echoes", "0", "--longest-s", "0"])
    assert done.exit_code == 2
    for option in ("--output", "--figure", "--largest", "--most-echoes", "--longest-s"):
        assert option in done.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("part", ["specimen", "chain"])
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


def test_measurements_until_an_interruption_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The interruption comes while a later scene is measured, as Ctrl-C would."""
    from hpe_rig.validation.accuracy import echo as accuracy_echo

    measure_scene = accuracy_echo._of_scene

    def interrupted(count: int, *arguments: Any) -> Iterator[Measurement]:
        if count > 100:
            raise KeyboardInterrupt
        return measure_scene(count, *arguments)

    monkeypatch.setattr(accuracy_echo, "_of_scene", interrupted)
    path = tmp_path / "echo.json"
    with pytest.raises(KeyboardInterrupt):
        accuracy_echo.write_accuracy(path, None, 1000, 10, 0.1, print)
    assert {row["scatterers"] for row in json.loads(path.read_text(encoding="utf-8"))} == {100}
