"""Settings that another program changes after a shot was armed: found, and the shot is marked wherever it is shown."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import opening
from hpe_rig.cli.bench import bench_state, compare_with
from hpe_rig.cli.tables import print_result
from hpe_rig.measurement import sequencer
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.measurement.setup import Setup, prepare
from hpe_rig.report import write_report
from hpe_rig.result import result_csv
from hpe_rig.runs.run import process
from hpe_rig.scene import load_scene
from hpe_rig.store import StoredRun, read_run
from sim_backend.world import World

Prepare = Callable[..., Setup]
SHORT = ("burst_count = 20", "burst_count = 6"), ("window_start_s = 50e-3", "")
TWICE = (*SHORT, ("[acquisition]\n", "[acquisition]\nrepeats = 2\n"))
GO_ON = (*SHORT, ("[acquisition]\n", '[acquisition]\nrepeats = 2\nchanged_settings = "continue"\n'))
FOREIGN = {
    "burst_train": "BURS:STAT 0",
    "toneburst": "VOLT 2",
    "tracking_pulser": "TRIG:SOUR IMM",
    "tracking_train": "FREQ 3500",
    "master": "VOLT:HIGH 3",
}


@pytest.fixture
def worlds(monkeypatch: pytest.MonkeyPatch) -> list[World]:
    """Return a list that every simulated world made from now on is put into."""
    made: list[World] = []
    make = opening._world

    def noted(*arguments: object) -> World:
        made.append(make(*arguments))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(opening, "_world", noted)
    return made


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    """Return two shots of a run that nobody meddled with."""
    changes = {"acquisition.repeats": 2, "excitation.burst_count": 6, "processing.window_start_s": 0.0}
    scene = load_scene("bovine-muscle-synchronous").with_(changes)
    return read_run(record_run(prepare(scene), tmp_path_factory.mktemp("undisturbed") / "run.h5"))


def another_program(worlds: list[World], role: str, command: str, step: Step = Step.COLLECT) -> Observer:
    """Return an observer that has another program send ``command`` as the first shot enters ``step``."""

    def observe(progress: Progress) -> None:
        if progress.step is step and progress.shot.index == 0 and not progress.records:
            worlds[0].connect(role).write(command)

    return observe


@pytest.mark.parametrize(
    "role",
    [name if name == "master" else pytest.param(name, marks=pytest.mark.slow) for name in FOREIGN],
)
def test_what_another_program_changes_after_arming_is_found_and_ends_the_run(
    prepared: Prepare, tmp_path: Path, worlds: list[World], role: str
) -> None:
    path = tmp_path / "run.h5"
    meddler = another_program(worlds, role, FOREIGN[role])
    with pytest.raises(InstrumentError, match=rf"shot 1 is not to be trusted: {role}: .*Another program"):
        record_run(prepared("bovine-muscle-synchronous", *TWICE), path, meddler)
    assert not any(worlds[0].outputs_on().values())
    run = read_run(path)
    assert list(run.untrusted) == [0]
    assert role in run.untrusted[0]
    # Not complete, so that resuming measures it again.
    assert not run.shot_complete.any()


@pytest.mark.parametrize("role", ["toneburst", pytest.param("tracking_pulser", marks=pytest.mark.slow)])
def test_an_output_switched_off_by_another_program_is_found(
    prepared: Prepare, tmp_path: Path, worlds: list[World], role: str
) -> None:
    meddler = another_program(worlds, role, "OUTP 0")
    with pytest.raises(InstrumentError, match=rf"{role}: .*output_on \(OUTP\) programmed 1, read back 0"):
        record_run(prepared("bovine-muscle-synchronous", *TWICE), tmp_path / "run.h5", meddler)


def test_a_setting_that_no_shot_programs_is_stored_if_it_differs_after_the_shot(
    prepared: Prepare, tmp_path: Path, worlds: list[World]
) -> None:
    path = tmp_path / "run.h5"
    record_run(prepared("bovine-muscle-synchronous", *TWICE), path, another_program(worlds, "toneburst", "OUTP:SYNC 0"))
    stored = read_run(path)
    assert list(stored.changed_settings) == [0]
    assert not stored.untrusted
    text = "toneburst generator: sync output on in the settings before the shot, off in those after it"
    assert stored.changed_settings[0] == text
    assert f"shot 1: settings read back after it differ: {text}" in process(path, "kasai").warnings
    (line,) = (line for line in compare_with(path, bench_state(None)).splitlines() if line.startswith("shot 1 of"))
    assert line == f"shot 1 of run.h5: after it {text}"


def test_a_setting_changed_and_changed_back_is_found_where_an_error_was_queued_meanwhile(
    prepared: Prepare, tmp_path: Path, worlds: list[World]
) -> None:
    path = tmp_path / "run.h5"
    meddler = another_program(worlds, "toneburst", "VOLT 2;NONSENSE;VOLT 1")
    with pytest.raises(InstrumentError, match=r"shot 1 is not to be trusted: toneburst: .*error queue: -113"):
        record_run(prepared("bovine-muscle-synchronous", *TWICE), path, meddler)
    assert "error queue: -113" in read_run(path).untrusted[0]


def test_an_error_that_is_queued_after_the_outputs_are_off_is_stored(
    prepared: Prepare, tmp_path: Path, worlds: list[World]
) -> None:
    path = tmp_path / "run.h5"

    def observe(progress: Progress) -> None:
        if progress.step is Step.SAFE and progress.shot.index == 0:
            worlds[0].connect("tracking_train").write("NONSENSE")

    record_run(prepared("bovine-muscle-synchronous", *TWICE), path, observe)
    assert read_run(path).changed_settings == {0: "tracking_train: error queue: -113 Undefined header"}


def test_looking_at_the_instruments_during_a_shot_changes_no_record(
    prepared: Prepare, tmp_path: Path, undisturbed: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequencer, "RECHECK_INTERVAL_S", 0.02)
    watched = read_run(record_run(prepared("bovine-muscle-synchronous", *TWICE), tmp_path / "watched.h5"))
    for one, other in zip(watched.records, undisturbed.records, strict=True):
        assert (one.codes == other.codes).all()


def test_a_change_in_a_long_shot_ends_it_before_its_last_record(
    prepared: Prepare, tmp_path: Path, worlds: list[World], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequencer, "RECHECK_INTERVAL_S", 0.02)
    meddler = another_program(worlds, "toneburst", "VOLT 2")
    with pytest.raises(InstrumentError, match="shot 1 is not to be trusted: toneburst"):
        record_run(prepared("bovine-muscle-synchronous", *TWICE), tmp_path / "run.h5", meddler)
    assert 0 < read_run(tmp_path / "run.h5").records[0].valid.sum() < 240


@pytest.mark.parametrize(
    "role", [pytest.param(role, marks=() if role == "master" else pytest.mark.slow) for role in FOREIGN]
)
def test_a_run_that_goes_on_marks_the_shot_and_programs_the_next_one_anew(
    prepared: Prepare, tmp_path: Path, worlds: list[World], undisturbed: StoredRun, role: str
) -> None:
    path, setup = tmp_path / "run.h5", prepared("bovine-muscle-synchronous", *GO_ON)
    record_run(setup, path, another_program(worlds, role, FOREIGN[role]))
    run = read_run(path)
    assert run.status == "complete"
    assert list(run.untrusted) == [0]
    # The second shot is as in a run that nobody meddled with.
    assert (run.records[1].codes == undisturbed.records[1].codes).all()


def test_an_untrusted_shot_is_marked_in_the_result_its_table_and_the_report(
    prepared: Prepare,
    tmp_path: Path,
    worlds: list[World],
    capsys: pytest.CaptureFixture[str],
    page_without_pictures: None,
) -> None:
    path, setup = tmp_path / "run.h5", prepared("bovine-muscle-synchronous", *GO_ON)
    record_run(setup, path, another_program(worlds, "master", FOREIGN["master"]))
    result = process(path)
    assert [bool(shot.untrusted) for shot in result.shots] == [True, False]
    # The mean over repeats is of those that can be trusted, of which one is left.
    assert not result.means
    rows = list(csv.DictReader(io.StringIO(result_csv(result))))
    assert {row["shot"] for row in rows if row["untrusted"]} == {"1"}
    assert "UNTRUSTED" in str(result)
    print_result(result)
    shown = capsys.readouterr().out
    assert shown.count("UNTRUSTED") == 1
    assert "WARNING shot 1 is not to be trusted" in shown
    assert json.loads(json.dumps(result.as_dict()))["shots"][0]["untrusted"]
    page = write_report(path).read_text(encoding="utf-8")
    assert "1 (untrusted)" in page
    assert "2 (untrusted)" not in page
    assert "1 of them untrusted" in page


def test_a_run_nobody_meddles_with_is_trusted(undisturbed: StoredRun) -> None:
    assert not undisturbed.untrusted
    assert undisturbed.shot_complete.all()
