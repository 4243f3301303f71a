"""Who, when, what: times, host and notes with every run, listed and found again, and runs that are measured again."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import jsonschema
import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare, provenance_now, record_run
from hpe_rig.report.page import render
from hpe_rig.runs import json_schema
from hpe_rig.scene import SettingsError, parse_scene, shipped_scenes
from hpe_rig.store import WriteOptions, list_runs, matching_runs, read_run, verify

NOTES = '\n[notes]\noperator = "A. B."\n"sample id" = 7\ntemperature_c = 21.5\nday = 2026-03-05\n'


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("notes") / "noted.toml"
    path.write_text(shipped_scenes()["table-1"] + NOTES, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(scene: Path) -> hpe.Run:
    run = hpe.measure(scene, path=scene.with_name("noted.h5"))
    run.save(run.estimate())
    return run


def test_a_run_file_says_when_where_and_by_whom_it_was_measured(run: hpe.Run) -> None:
    found = run.stored.provenance
    started, ended = datetime.fromisoformat(found.started), datetime.fromisoformat(found.ended)
    assert started.utcoffset() is not None
    assert timedelta() <= ended - started < timedelta(minutes=2)
    assert abs(datetime.now().astimezone() - ended) < timedelta(hours=1)
    assert found.host
    assert verify(run.path).as_dict()["sound"]


def test_a_bench_file_can_keep_the_user_s_name_out() -> None:
    bench = read_bench().bench
    assert provenance_now(bench.model_copy(update={"store_user": False})).user == ""


def test_two_runs_of_a_scene_differ_in_their_provenance_alone(run: hpe.Run, scene: Path, tmp_path: Path) -> None:
    """All else of a simulated run stays the same bit for bit, also where it says who measured when."""
    setup = prepare(scene)
    late = provenance_now(setup.bench.bench)
    other = record_run(setup, tmp_path / "other.h5", options=WriteOptions(provenance=late))
    values = []
    for path in (run.path, other):
        with h5py.File(path) as file:
            found = dict[str, bytes]()
            file.visititems(
                lambda name, item, found=found: found.update(
                    {name: item[()].tobytes()} if hasattr(item, "dtype") else {}
                )
            )
            values.append({name: value for name, value in found.items() if "provenance" not in name})
    assert values[0] == values[1]
    assert len(values[0]) > 20


def test_a_run_that_stops_says_when(scene: Path, tmp_path: Path) -> None:
    def stop(progress: object) -> None:
        raise KeyboardInterrupt

    setup = prepare(scene)
    options = WriteOptions(provenance=provenance_now(setup.bench.bench))
    # Programmed and stopped: the file is there, and nothing arrived.
    with pytest.raises(KeyboardInterrupt):
        record_run(
            setup,
            tmp_path / "stopped.h5",
            lambda progress: stop(progress) if progress.records else None,
            options=options,
        )
    stored = read_run(tmp_path / "stopped.h5")
    assert stored.status == "aborted"
    assert stored.provenance.ended


def test_notes_stand_in_result_exports_and_report(run: hpe.Run) -> None:
    notes = {"operator": "A. B.", "sample id": 7, "temperature_c": 21.5, "day": "2026-03-05"}
    result = run.estimate()
    assert result.notes == notes
    table = result.as_dict()
    assert table["notes"] == notes
    assert table["provenance"]["host"] == run.stored.provenance.host
    assert result.to_frame()["note_sample_id"].tolist() == [7]


@pytest.mark.slow
def test_notes_stand_in_the_report(run: hpe.Run) -> None:
    page = render(run.path)
    assert "<dt>operator</dt><dd>A. B.</dd>" in page
    assert f"<dt>host</dt><dd>{run.stored.provenance.host}</dd>" in page


def test_every_wrong_note_is_named_at_once() -> None:
    wrong = '\n[notes]\na = ["x"]\nb = { c = 1 }\nd = "\\u0007"\n'
    with pytest.raises(SettingsError, match=r"(?s)3 mistakes.*notes\.a.*notes\.b.*notes\.d") as caught:
        parse_scene("x", shipped_scenes()["table-1"] + wrong)
    assert "Try" in str(caught.value)


def test_runs_are_listed_and_found_by_note_and_date(run: hpe.Run) -> None:
    folder = run.path.parent
    (folder / "cut.h5").write_bytes(run.path.read_bytes()[:3000])
    entries, unreadable = list_runs(folder)
    (entry,) = entries
    assert len(unreadable) == 1
    assert "cut.h5" in unreadable[0]
    assert entry.lead is not None
    assert entry.lead.amplitude_m == run.estimate().shots[0].estimates[0].amplitude_m
    assert matching_runs(entries, ["operator: a. b.", "TABLE"]) == entries
    assert matching_runs(entries, ["somebody"]) == []
    assert matching_runs(entries, [], since=entry.date + timedelta(seconds=1)) == []
    done = CliRunner().invoke(app, ["list", str(folder), "--find", "sample id: 7", "--json"])
    (row,) = json.loads(done.stdout)
    validator = jsonschema.Draft202012Validator(json_schema("list"))
    validator.validate([row])
    assert len(list(validator.iter_errors([row | {"shots": "two", "another": 1}]))) == 2
    assert row["notes"]["temperature_c"] == 21.5
    stated = f"{entry.lead.amplitude_m * 1e9:.0f} +- {entry.lead.amplitude_uncertainty_m * 1e9:.0f} nm"
    assert stated in CliRunner().invoke(app, ["list", str(folder)]).stdout
    refused = CliRunner().invoke(app, ["list", str(folder), "--since", "yesterday"])
    assert refused.exit_code == 2
    assert "--since" in refused.stderr


def test_a_run_file_is_taken_where_a_scene_is(
    run: hpe.Run, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = prepare(run.path)
    assert (setup.scene.name, setup.scene.text) == ("noted", scene.read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["new", "again", "--like", str(run.path)]).exit_code == 0
    assert (tmp_path / "again.toml").read_text(encoding="utf-8") == scene.read_text(encoding="utf-8")
    absent = CliRunner().invoke(app, ["check", "nowhere.h5"])
    assert absent.exit_code == 2
    assert "does not exist" in absent.stderr
