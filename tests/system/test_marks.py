"""A shot marked as bad enters no later result, and is named; the run file stays as it is."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.store import read_run, read_sealed

FIXTURES = Path(__file__).parents[1] / "fixtures" / "run_files"
WHY = "shot 2 left out: marked bad: cable touched"


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    """Return the path of a run of two shots."""
    return Path(shutil.copy(FIXTURES / "specimen.h5", tmp_path / "run.h5"))


def command(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == code, result.output
    return result.output


def test_a_bad_shot_enters_no_result_of_any_command(run_file: Path) -> None:
    whole, before = hpe.open_run(run_file).estimate(), hashlib.sha256(run_file.read_bytes()).digest()
    assert "shot 2 marked bad: cable touched\n1 of 2 shots" in command("mark", run_file, 2, "--bad", "cable touched")
    processed = json.loads(command("process", run_file, "--json"))
    assert [shot["shot"] for shot in processed["shots"]] == [1]
    assert WHY in processed["warnings"]
    assert hashlib.sha256(run_file.read_bytes()).digest() == before
    assert command("mark", run_file, 2, "--good").endswith("0 of 2 shots are marked bad\n")
    assert hpe.open_run(run_file).estimate().shots == whole.shots


@pytest.mark.slow
def test_means_report_sweep_and_comparison_leave_a_bad_shot_out(tmp_path: Path) -> None:
    settings = {"excitation.burst_count": 6, "processing.window_start_s": 0.0, "acquisition.repeats": 3}
    scene = hpe.load_scene("bovine-muscle").with_({**settings, "processing.estimator": "kasai"})
    run_file = hpe.measure(scene, path=tmp_path / "run.h5").path
    command("mark", run_file, 2, "--bad", "cable touched")
    assert WHY in " ".join(command("process", run_file, "--sweep", "gate_length_m=1e-3,2e-3").split())
    command("report", run_file)
    assert WHY in run_file.with_suffix(".html").read_text(encoding="utf-8")
    assert "(marked bad: cable touched)" in command("report", run_file, "--shot", 2, code=2)
    comparison = json.loads(command("compare", run_file, run_file, "--json"))
    assert comparison["results"][0]["shots"] == ["mean of 2", "mean of 2"]


def test_python_marks_a_shot_and_takes_the_mark_back(run_file: Path) -> None:
    run = hpe.open_run(run_file).mark(0, bad="air bubble")
    assert run.estimate().shots_without_result == ((1, "marked bad: air bubble"),)
    assert not run.mark(0, bad=None).estimate().shots_without_result
    with pytest.raises(IndexError, match="the run has 2"):
        run.mark(2, bad="none")


@pytest.mark.slow
def test_moduli_leave_a_bad_shot_out(tmp_path: Path) -> None:
    scene = hpe.load_scene("gelatin-moduli").with_(
        {"sweep.lateral_offset_m": [1e-3, 2.25e-3, 3.5e-3], "excitation.burst_count": 12}
    )
    run = hpe.measure(scene, path=tmp_path / "run.h5").mark(1, bad="cable touched")
    assert any("shot 2, marked bad: cable touched" in text for text in hpe.fit_moduli(run, laws=["voigt"]).omitted)


def test_a_run_without_a_good_shot_says_how_a_mark_is_taken_back(run_file: Path) -> None:
    command("mark", run_file, 1, 2, "--bad", "wrong specimen")
    assert "marked bad: wrong specimen. Try: hpe-rig mark RUN.h5 SHOT --good" in command("process", run_file, code=2)


def test_wrong_verdicts_are_refused_with_every_mistake(run_file: Path) -> None:
    output = command("mark", run_file, 3, 0, "--bad", " ", "--good", code=2)
    for text in ("shot 3 does not exist", "shot 0 does not exist", "a shot and a verdict", "the reason is empty"):
        assert text in output
    assert "a shot and a verdict" in command("mark", run_file, 1, code=2)
    assert not run_file.with_name("run.marks.json").exists()


def test_marks_of_an_earlier_release_have_no_checksum_and_are_applied(run_file: Path) -> None:
    command("mark", run_file, 2, "--bad", "cable touched")
    marks = run_file.with_name("run.marks.json")
    tables, _ = read_sealed(marks)
    marks.write_text(json.dumps(tables), encoding="utf-8")
    assert read_run(run_file).marks == {1: "marked bad: cable touched"}
