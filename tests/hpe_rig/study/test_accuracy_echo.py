"""Error against run time of the echo engine."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.cli import app
from hpe_rig.study.accuracy_echo import Measurement, as_text, measurements, write_figure


@pytest.fixture(scope="module")
def rows() -> list[Measurement]:
    return list(measurements((100, 1000), (10, 30), (1e-2, 1e-6, 1e-10)))


def test_every_evaluation_keeps_its_tolerance_and_the_exact_ones_rounding(rows: list[Measurement]) -> None:
    assert {row.evaluation for row in rows} == {"direct", "running_sum", "interpolated", "series"}
    for row in rows:
        assert row.error <= (row.tolerance or 1e-12)
        assert row.time_s > 0


def test_table_reads_back_and_another_format_is_refused(rows: list[Measurement]) -> None:
    assert json.loads(as_text(rows, ".json"))[0]["scatterers"] == 100
    assert as_text(rows, ".csv").count("\n") == len(rows) + 1
    with pytest.raises(ValueError, match=r"'\.xls' is no table format here"):
        as_text(rows, ".xls")


def test_figure_is_written(rows: list[Measurement], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    write_figure(rows, tmp_path / "work.svg")
    assert "<svg" in (tmp_path / "work.svg").read_text(encoding="utf-8")


def test_command_writes_the_table(tmp_path: Path) -> None:
    path = tmp_path / "echo.csv"
    done = CliRunner().invoke(
        app, ["accuracy", "echo", "--output", str(path), "--largest", "100", "--most-echoes", "10"]
    )
    assert done.exit_code == 0, done.output
    assert path.read_text(encoding="utf-8").startswith("scatterers,echoes,samples,evaluation,tolerance")
