"""A run stopped in any shot has the results of its complete shots, and says what the others lack."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, Step
from hpe_rig.measurement.setup import Setup, prepare_text
from hpe_rig.result import Result
from hpe_rig.runs.run import process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, read_run

Prepare = Callable[..., Setup]
SHOTS = 3
THREE_FORCES = (
    ("burst_count = 20", "burst_count = 6\nforce_fraction = [1.0, 0.7, 0.4]"),
    ("window_start_s = 50e-3", ""),
)


def stopped_in(setup: Setup, path: Path, shot: int, records: int) -> Path:
    """Measure until ``records`` records of ``shot`` have arrived, and stop as Ctrl-C does."""

    def stop(progress: Progress) -> None:
        step = Step.COLLECT if records else Step.ARM
        if progress.shot.index == shot and progress.step is step and progress.records >= records:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, path, stop)
    return path


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = shipped_scenes()["bovine-muscle-synchronous"]
    for old, new in THREE_FORCES:
        assert old in text
        text = text.replace(old, new)
    return record_run(prepare_text("three", text), tmp_path_factory.mktemp("undisturbed") / "whole.h5")


@pytest.fixture(scope="module")
def whole(undisturbed: Path) -> Result:
    return process(undisturbed)


@pytest.mark.parametrize("shot", [pytest.param(0, marks=pytest.mark.slow), 1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_stopped_while_records_arrive_keeps_every_complete_shot(
    prepared: Prepare, whole: Result, tmp_path: Path, shot: int
) -> None:
    setup = prepared("bovine-muscle-synchronous", *THREE_FORCES)
    path = stopped_in(setup, tmp_path / "run.h5", shot, records=60)
    arrived = read_run(path).records.gated(shot, setup.plan.shots[shot].gate).valid
    assert arrived.sum() >= 60
    assert not read_run(path).shot_complete[shot]
    found = process(path)
    assert [each.estimates for each in found.shots if each.complete] == [each.estimates for each in whole.shots[:shot]]
    # What had come of the stopped shot is an estimate of its own where it resolves the harmonics, and marked.
    partial = [each for each in found.shots if not each.complete]
    without = [number for number, _ in found.shots_without_result]
    assert [*(each.shot for each in partial), *without] == list(range(shot + 1, SHOTS + 1))
    assert f"the run is aborted: {shot} of {SHOTS} shots are complete" in found.warnings
    for number in without:
        assert any("left out" in text and f"{number}" in text for text in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("shot", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_stopped_before_a_shots_first_record_is_processed_and_printed(
    prepared: Prepare, tmp_path: Path, shot: int
) -> None:
    path = stopped_in(prepared("bovine-muscle-synchronous", *THREE_FORCES), tmp_path / "run.h5", shot, records=0)
    done = CliRunner().invoke(app, ["process", str(path), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert [each["shot"] for each in result["shots"]] == list(range(1, shot + 1))
    assert [number for number, _ in result["shots_without_result"]] == list(range(shot + 1, SHOTS + 1))
    done = CliRunner().invoke(app, ["report", str(path)])
    assert done.exit_code == 0, done.output
    assert f"{shot} of {SHOTS} planned" in path.with_suffix(".html").read_text(encoding="utf-8")
    assert "left out: no record was acquired" in CliRunner().invoke(app, ["process", str(path)]).stdout


def test_too_few_records_of_one_shot_cost_no_other_its_result(undisturbed: Path, whole: Result, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(undisturbed.read_bytes())
    with h5py.File(path, "r+") as file:
        # As files of early releases are, which may be changed unnoticed.
        file.attrs.modify("format_version", 2)
        del file["checksum"]
        file["records/recorded"][1, 1:] = 0
    found = process(path)
    assert [shot.estimates for shot in found.shots] == [whole.shots[0].estimates, whole.shots[2].estimates]
    assert [number for number, _ in found.shots_without_result] == [2]
    assert any(text.startswith("shot 2 left out: ") for text in found.warnings)


def test_a_run_stopped_before_its_first_record_has_nothing_to_say(prepared: Prepare, tmp_path: Path) -> None:
    path = stopped_in(prepared("bovine-muscle-synchronous", *THREE_FORCES), tmp_path / "run.h5", 0, records=0)
    with pytest.raises(StoreError, match="holds no records"):
        process(path)
