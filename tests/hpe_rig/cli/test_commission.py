"""The command ``commission``: on the simulated bench it asks nothing, on a real one it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import read_bench
from hpe_rig.cli import commands, commission as command
from hpe_rig.cli.options import WatchOptions
from hpe_rig.cli.watch import supervise
from hpe_rig.measurement import CableResult, prepare
from hpe_rig.plan import CheckResult


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "room.toml"
    path.write_text(read_bench().text, encoding="utf-8")
    return path


def test_the_simulated_bench_is_commissioned_without_questions(path: Path) -> None:
    done = CliRunner().invoke(commands, ["commission", str(path)])
    assert done.exit_code == 0, done.output
    assert done.output.count("proven") == 8
    assert "13 of 13: T piece at transducer.drive, where the cable from tracking_pulser.output ends" in done.output
    record = read_bench(path).bench.commissioning
    assert record is not None
    assert len(record.cables) == 7


def test_a_fault_is_printed_with_its_cable_and_nothing_is_recorded(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_text(encoding="utf-8")
    results = [CableResult("master.output", "burst_train.trigger", fault="no signal. The cable is open. Try: its ends")]
    monkeypatch.setattr(command, "commission", lambda *_: results)
    done = CliRunner().invoke(commands, ["commission", str(path)])
    assert done.exit_code == 1
    assert "master.output -> burst_train.trigger: no signal." in done.output
    assert "1 of 1 cables are not proven" in done.output
    assert path.read_text(encoding="utf-8") == before


def test_a_run_on_an_unproven_bench_warns_before_an_output_is_enabled(tmp_path: Path) -> None:
    announced: list[str] = []
    for finding in (CheckResult("commissioning", level, "text", "remedy") for level in ("passed", "warning")):
        setup = replace(prepare("bovine-muscle"), findings=(finding,))
        with supervise(setup, tmp_path / "run.h5", "run", WatchOptions(), announced.append):
            pass
    assert announced == ["WARNING commissioning: text. Try: remedy."]


def test_a_real_bench_needs_a_terminal_and_an_amplifier_that_is_off(
    real_bench: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the bench was opened")

    monkeypatch.setattr(command, "commission", refuse)
    path = real_bench()
    done = CliRunner().invoke(commands, ["commission", str(path)])
    assert (done.exit_code, "there is no terminal" in done.output) == (2, True)
    monkeypatch.setattr(command, "answer", lambda question: "no")
    monkeypatch.setattr(command, "has_terminal", lambda: True)
    done = CliRunner().invoke(commands, ["commission", str(path)])
    assert (done.exit_code, "the power amplifier must be off" in done.output) == (2, True)
