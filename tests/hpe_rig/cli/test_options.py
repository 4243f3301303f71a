"""Options that exclude each other are refused before anything is measured."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli import app as program
from hpe_rig.cli.app import app

COMMANDS: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
NO_FILE = {
    "commission": "it writes into the bench file",
    "live": "it serves a page",
    "align": "it serves a page",
}
"""Commands without -o, and why."""
NO_JSON = {
    "schema": "it prints JSON",
    "accuracy": "-o FILE.json",
    **dict.fromkeys(("report", "figure", "new", "bug-report", "emulate"), "it prints only the name of its file"),
    **NO_FILE,
}
"""Commands without --json, and why."""


def options(command: str) -> set[str]:
    return {name for parameter in COMMANDS[command].params for name in parameter.opts}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_has_the_options_that_people_try_first_and_names_the_value_of_each(command: str) -> None:
    assert ({"-o", "--output"} <= options(command)) == (command not in NO_FILE)
    assert ("--json" in options(command)) == (command not in NO_JSON)
    text = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80"}).output
    listed = text.partition("Options:")[2]
    # A choice may be listed, a type says nothing.
    assert re.findall(r"<(?:str|path|int|float|list)[^>]*>|\b(?:TEXT|PATH|INTEGER|FLOAT)\b(?! in)", listed) == []
    assert max(map(len, text.splitlines())) <= 80


def test_what_is_printed_goes_to_the_file_of_o(tmp_path: Path) -> None:
    for arguments in (["scenes"], ["check", "table-1"], ["bench", "--json"]):
        printed = CliRunner().invoke(app, arguments)
        written = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "out.txt")])
        assert (written.exit_code, written.stdout) == (printed.exit_code, "")
        times = r'"round_trip_s": [^,]*'
        assert re.sub(times, "", (tmp_path / "out.txt").read_text("utf-8")) == re.sub(times, "", printed.stdout)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "table-1", "--foo"], r"(.+ run): No such option: --foo\. Try: \1 --help"),
        (["study"], r"(.+ study): Missing argument 'STUDY'\. Try: \1 --help"),
        (
            ["run", "table-1", "--log-level", "debug"],
            r"(.+) run: No such option: --log-level\. Try: \1 --log-level ... run",
        ),
        (["figure", "a.h5", "-o", "a.png", "--kind", "x"], r"(.+ figure): Invalid value for '--kind': 'x' is not .+"),
        (["nothing"], r"(.+): No such command 'nothing'\. Try: \1 --help"),
    ],
)
def test_refused_arguments_end_with_one_sentence(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["hpe-rig", *arguments])
    assert program._run() == 2
    output = capsys.readouterr()
    assert re.fullmatch(message, output.err.strip())
    assert output.out == ""


def test_a_new_scene_goes_to_its_name_or_to_the_file_of_o(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (["new", "a"], ["new", "b.toml"], ["new", "-o", "c.toml"]):
        assert CliRunner().invoke(app, arguments).exit_code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.toml", "b.toml", "c.toml"]
    for arguments, what in ((["new"], "no file is named"), (["new", "d", "-o", "d.toml"], "two files are named")):
        assert f"NAME: {what}" in CliRunner().invoke(app, arguments).output


@pytest.mark.parametrize("command", [["run", "table-1"], ["process", "run.h5"], ["list"]])
def test_two_formats_are_refused(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, [*command, "--json", "--csv"])
    assert done.exit_code != 0
    assert "--json, --csv: both formats are requested" in done.output
    assert not list(tmp_path.iterdir())


def test_settings_replace_those_of_the_scene_in_check_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    change = ["--set", "tracking.pulse_rate_hz=3000.0", "--set", "tracking.pulse_count = 60"]
    checked = json.loads(CliRunner().invoke(app, ["check", "table-1", *change, "--json"]).output)
    assert checked["can_be_measured"]
    assert (checked["pulse_rate_hz"], checked["pulses"]) == (3000.0, 60)
    assert CliRunner().invoke(app, ["run", "table-1", *change, "--json"]).exit_code == 0
    run = hpe.open_run(tmp_path / "table-1.h5")
    assert run.scene.tracking.pulse_rate_hz == 3000.0
    assert run.records[0].codes.shape[0] == 60


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
