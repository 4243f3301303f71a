"""A file that cannot be written is refused before its command computes anything."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from matplotlib.figure import Figure
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli import stored
from hpe_rig.cli.app import app
from hpe_rig.cli.console import print_json
from hpe_rig.result import MotionMap
from hpe_rig.store import StoreError, result_path

SCENE = """
title = "Map"
[tracking]
[acquisition]
gate_depth_m = 1e-3
gate_length_m = 1e-3
[processing]
frequencies_hz = [200.0]
"""
SETTINGS = ["axes=line,pulse", "quantity=displacement_m", "pulse_rate_hz=4e3"]
MAP = ["map", "u.npy", "--scene", "s.toml", *(word for text in SETTINGS for word in ("--set", text))]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(SCENE)
    (tmp_path / "taken.h5").write_bytes(b"an important file")
    np.save(tmp_path / "u.npy", 1e-6 * np.sin(2 * np.pi * 200.0 * np.arange(60) / 4e3)[None].repeat(3, 0))
    return tmp_path


@pytest.mark.parametrize(
    ("command", "message"),
    [
        # The inputs do not exist: a command that read them first would say so.
        (["map", "absent.npy", "--scene", "s.toml", "--figure", "no/a.png"], "the folder no does not exist"),
        (["map", "absent.npy", "--scene", "s.toml", "--figure", "a.docx"], "Matplotlib has no format '.docx'"),
        (["map", "absent.npy", "--scene", "s.toml", "-o", "no/a.nc"], "the folder no does not exist"),
        (["import", "absent.npy", "--scene", "s.toml", "-o", "no/a.h5"], "the folder no does not exist"),
        (["import", "absent.npy", "--scene", "s.toml", "-o", "taken.h5"], "taken.h5 already exists"),
        (["compare", "absent.h5", "absent.h5", "--figure", "a.docx"], "Matplotlib has no format '.docx'"),
        (["moduli", "absent.h5", "--figure", "no/a.png"], "the folder no does not exist"),
        (["dispersion", "absent.h5", "--figure", "a.docx"], "Matplotlib has no format '.docx'"),
        (["figure", "absent.h5", "-o", "no/a.png"], "the folder no does not exist"),
        (["report", "absent.h5", "--output", "no/a.html"], "the folder no does not exist"),
    ],
)
def test_an_output_is_refused_before_the_input_is_read(command: list[str], message: str, folder: Path) -> None:
    done = CliRunner().invoke(app, command)
    assert done.exit_code != 0
    assert message in " ".join(done.output.split()), done.output
    assert sorted(path.name for path in folder.iterdir()) == ["s.toml", "taken.h5", "u.npy"]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["verify", "taken.h5", "-o", "./taken.h5"], "taken.h5 is read by this command: it stays unchanged"),
        (["check", "s.toml", "-o", "s.toml"], "s.toml is read by this command: it stays unchanged"),
        (["map", "u.npy", "--scene", "s.toml", "-o", "u.npy"], "u.npy is read by this command: it stays unchanged"),
        # A recording or a run is not replaced by a text.
        (["scenes", "-o", "u.npy"], "u.npy exists and is no text: it stays unchanged"),
    ],
)
def test_a_file_that_is_read_and_a_binary_file_are_not_replaced(command: list[str], message: str, folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    done = CliRunner().invoke(app, command)
    assert done.exit_code != 0
    assert message in " ".join(done.output.split()), done.output
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def figure_options() -> dict[str, tuple[list[str], str]]:
    """Return the command line with dummy inputs, and the name of the option, of every command that writes a figure."""
    commands: Any = typer.main.get_command(app)
    found = {}
    for name, command in commands.commands.items():
        for option in command.params:
            if ".svg, .png or .pdf" in (getattr(option, "help", None) or ""):
                needed = [parameter for parameter in command.params if parameter.required and parameter is not option]
                inputs = [[*parameter.opts[-1:] * parameter.opts[0].startswith("-"), "absent"] for parameter in needed]
                found[name] = [name, *(word for words in inputs for word in words)], option.opts[0]
    return found


def test_every_command_that_writes_a_figure_refuses_its_format_before_the_input_is_read(folder: Path) -> None:
    """Also an option that is added later, if its help names the formats."""
    options = figure_options()
    assert set(options) == {"accuracy", "compare", "dispersion", "figure", "map", "moduli"}
    # It reports the name together with its other mistakes: tests/hpe_rig/validation/test_accuracy_echo.py.
    del options["accuracy"]
    for command, option in options.values():
        for name, why in (("a.xyz", "Matplotlib has no format '.xyz'"), ("a", "Matplotlib has no format ''")):
            done = CliRunner().invoke(app, [*command, option, name])
            message = " ".join(done.output.split())
            assert done.exit_code == 2, message
            assert f"{name} cannot be written ({why}). Try: a name that ends in .svg, .png or .pdf." in message


@pytest.mark.parametrize("command", ["compare", "dispersion", "moduli"])
def test_a_table_is_not_written_under_the_name_of_a_figure(command: str, folder: Path) -> None:
    done = CliRunner().invoke(app, [command, "absent.h5", "absent.h5", "-o", "a.PDF"])
    assert done.exit_code == 2
    assert "the printed text is no figure. Try: --figure a.PDF." in " ".join(done.output.split())


def test_a_result_file_is_refused_before_the_run_is_estimated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pulse = np.cos(2 * np.pi * 9e6 * np.arange(200) / 50e6) * np.hanning(200)
    rf = np.round(1000 * pulse + np.random.default_rng(1).normal(size=(40, 200))).astype(np.int16)
    rates = {"sample_rate_hz": 50e6, "pulse_rate_hz": 4e3, "carrier_hz": 9e6}
    run = hpe.import_records(rf, "s.toml", "run.h5", axes="pulse,sample", **rates)
    result_path(run.path, "coherent").mkdir()

    def fail(*arguments: object) -> None:
        raise AssertionError("the run is estimated")

    monkeypatch.setattr(hpe.Run, "estimate", fail)
    done = CliRunner().invoke(app, ["process", "run.h5"])
    assert done.exit_code == 2, done.output
    assert "run.coherent.h5 cannot be written" in " ".join(done.output.split())


def test_a_map_file_needs_its_extra_before_anything_is_computed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    done = CliRunner().invoke(app, [*MAP, "-o", "a.nc", "--figure", "a.png"])
    assert done.exit_code != 0
    assert 'pip install "hpe-rig[frames]"' in " ".join(done.output.split())
    assert "pixels estimated" not in done.output


def test_the_figure_is_written_if_the_map_cannot_be(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path, dataset: object) -> None:
        raise StoreError(f"{path} cannot be written (No space left on device)")

    monkeypatch.setattr(stored, "write_map_file", fail)
    monkeypatch.setattr(MotionMap, "figure", lambda *_, **__: Figure())
    done = CliRunner().invoke(app, [*MAP, "-o", "a.nc", "--figure", "a.png"])
    assert done.exit_code != 0
    assert "No space left on device" in done.output
    assert (folder / "a.png").stat().st_size > 1000


def test_numbers_that_are_not_finite_are_null_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"change_over_u": math.inf, "rows": [(math.nan, -math.inf, 1.5)]})
    printed = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert printed == {"change_over_u": None, "rows": [[None, None, 1.5]]}
