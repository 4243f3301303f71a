"""Options that exclude each other are refused before anything is measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app


@pytest.mark.parametrize("command", [["run", "table-1"], ["process", "run.h5"], ["list"]])
def test_two_formats_are_refused(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, [*command, "--json", "--csv"])
    assert done.exit_code != 0
    assert "--json, --csv: both formats are requested" in done.output
    assert not list(tmp_path.iterdir())


def test_settings_replace_those_of_the_scene_in_check_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    change = ["--set", "tracking.pulse_rate_hz=3000.0", "--set", "tracking.pulse_count = 250"]
    checked = json.loads(CliRunner().invoke(app, ["check", "table-1", *change, "--json"]).output)
    assert checked["can_be_measured"]
    assert (checked["pulse_rate_hz"], checked["pulses"]) == (3000.0, 250)
    assert CliRunner().invoke(app, ["run", "table-1", *change, "--json"]).exit_code == 0
    run = hpe.open_run(tmp_path / "table-1.h5")
    assert run.scene.tracking.pulse_rate_hz == 3000.0
    assert run.records[0].codes.shape[0] == 250


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["tracking.pulse_rate_hz"], "this is no setting"),
        (["=3"], "=3: this is no setting"),
        (["notes.run=1", "notes.run=2"], "notes.run: this key is given twice"),
        (["tracking.pulse_rate=3000.0"], "tracking.pulse_rate"),
        (["pulse_rate_hz=3000.0"], "did you mean tracking.pulse_rate_hz?"),
        (["tracking.burst_count=3"], "did you mean excitation.burst_count?"),
        (["tracking.pulse_rate_hz=fast"], "is not a number"),
        (["simulation.specimen.growth_per_s=-20"], "at least -1 1/s"),
    ],
)
def test_a_wrong_setting_is_refused_in_words(settings: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["check", "bovine-muscle", *(text for item in settings for text in ("--set", item))])
    assert done.exit_code == 2
    assert message in done.output


def test_the_shipped_scenes_are_listed_as_json() -> None:
    listed = json.loads(CliRunner().invoke(app, ["scenes", "--json"]).output)
    assert {"bovine-muscle", "table-1"} <= {scene["name"] for scene in listed}
