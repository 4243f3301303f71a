"""Commands with --json: standard output is one JSON document, messages go to standard error."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from hpe_rig.cli.app import app

PrintedBy = Callable[[str], Any]

SCENE = """
title = "One line"
[tracking]
[acquisition]
gate_depth_m = 1e-3
gate_length_m = 1e-3
[processing]
frequencies_hz = [200.0]
"""
STUDY = """
title = "One rate"
scene = "table-1"
readings = {"physical" = ["kasai"]}
scatterers = 2
set = {"simulation.scatterers.per_cell" = 5.0}
[[axes]]
name = "f_prf"
unit = "Hz"
keys = {"tracking.pulse_rate_hz" = [2000.0]}
"""
SMALL = ["table-1", "--set", "tracking.pulse_count=48", "--set", "acquisition.record_samples=256"]
SERIES = ["--scene", "s.toml", "--set", "pulse_rate_hz=4e3"]
ECHOES = [*SERIES, "--set", "axes=pulse,sample", "--set", "sample_rate_hz=50e6", "--set", "carrier_hz=9e6"]
MOTION = [*SERIES, "--set", "axes=line,pulse", "--set", "quantity=displacement_m"]
COMMANDS = {
    "run": [*SMALL, "-o", "second.h5"],
    "process": ["run.h5"],
    "queue": ["table-1", "-o", "night"],
    "check": ["table-1"],
    "scenes": [],
    "extensions": [],
    "bench": [],
    "compare": ["run.h5", "run.h5"],
    "mark": ["run.h5"],
    "verify": ["run.h5"],
    "list": ["."],
    "import": ["rf.npy", *ECHOES],
    "map": ["u.npy", *MOTION],
    "export": ["run.h5", "-o", "run.mat"],
    "study": ["study.toml", "--workers", "1"],
    "design": ["table-1", "--over", "pulse_count", "--draws", "8", "--longest-s", "0.03"],
}
ELSEWHERE = {"resume", "moduli", "dispersion"}
"""Commands that take longer: test_resume.py and test_moduli.py."""
EXPECTED_KEYS = {
    "design": {"request", "varied", "before", "after", "remarks"},
    "queue": {"folder", "runs"},
    "import": {"run_file", "inferred"},
    "export": {"file", "messages"},
    "map": {"lines", "gates", "pixels_estimated", "pixels_excluded", "frequencies", "inferred", "moduli"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Change to a folder with a small run, recordings, a scene and a study."""
    folder = tmp_path_factory.mktemp("json")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        (folder / "s.toml").write_text(SCENE)
        (folder / "study.toml").write_text(STUDY)
        time_s = np.arange(60) / 4e3
        np.save("u.npy", 1e-6 * np.sin(2 * np.pi * 200.0 * time_s)[None].repeat(3, 0))
        np.save("rf.npy", np.random.default_rng(1).normal(scale=1e3, size=(40, 200)).astype(np.int16))
        done = CliRunner().invoke(app, ["run", *SMALL, "-o", "run.h5"])
        assert done.exit_code == 0, done.output
        yield folder


@pytest.fixture(scope="module")
def printed_by(folder: Path) -> PrintedBy:
    """Return the JSON document of a command, which is run once for all tests."""

    @cache
    def run(command: str) -> Any:
        done = CliRunner().invoke(app, [command, *COMMANDS[command], "--json"])
        assert done.exit_code == 0, done.output
        # JSON has neither NaN nor infinity.
        return json.loads(done.stdout, parse_constant=pytest.fail)

    return run


def test_every_command_with_json_is_tried() -> None:
    commands: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    options = {name: {text for item in command.params for text in item.opts} for name, command in commands.items()}
    assert {*COMMANDS, *ELSEWHERE} == {name for name, texts in options.items() if "--json" in texts}


@pytest.mark.parametrize(
    "command", [pytest.param(name, marks=pytest.mark.slow) if name == "study" else name for name in COMMANDS]
)
def test_standard_output_is_one_json_document(command: str, printed_by: PrintedBy) -> None:
    printed = printed_by(command)
    assert printed
    if command in EXPECTED_KEYS:
        assert set(printed) == EXPECTED_KEYS[command]


def test_json_states_the_values_of_the_table(printed_by: PrintedBy) -> None:
    (run,) = printed_by("queue")["runs"]
    (row,) = json.loads(CliRunner().invoke(app, ["list", "night", "--json"]).stdout)
    assert (run["scene"], run["state"], run["frequency_hz"]) == ("table-1", "done", 200.0)
    assert run["amplitude_m"] == row["lead"]["amplitude_m"]
    *inferred, text = CliRunner().invoke(app, ["import", "rf.npy", *ECHOES, "-o", "text.h5"]).stdout.splitlines()
    assert printed_by("import") == {"inferred": inferred, "run_file": "rf.h5"}
    assert text.startswith("text.h5: ")
    (pixels,) = printed_by("map")["frequencies"]
    assert pixels["median_amplitude_m"] == pytest.approx(1e-6)
    assert pixels["frequency_hz"] == 200.0


@pytest.mark.slow
def test_json_of_a_design_states_the_numbers_of_its_table(folder: Path) -> None:
    command = ["design", "table-1", "--over", "pulse_count", "--draws", "32", "--longest-s", "0.03"]
    printed = json.loads(CliRunner().invoke(app, [*command, "--json", "-o", "better.toml"]).stdout)
    table = {line[:28].strip(): line[28:].split() for line in CliRunner().invoke(app, command).stdout.splitlines()}
    (varied,) = printed["varied"]
    assert table["tracking.pulse_count"] == [str(varied["before"]), str(varied["after"])]
    after = printed["after"]
    assert table["jitter, predicted"][-2] == f"{after['predicted_jitter_m'] * 1e9:.4g}"
    simulated = f"{after['simulated_jitter_m'] * 1e9:.3g} +- {after['simulated_jitter_se_m'] * 1e9:.2g} nm"
    assert " ".join(table["jitter, simulated"]).endswith(simulated)
    assert table["time"][-2] == f"{after['duration_s']:.4g}"
