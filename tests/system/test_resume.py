"""A run goes on where it stopped, also when SIGTERM came at an awkward moment; its file says what took how long."""

from __future__ import annotations

import itertools
import json
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.agilent.generator import Agilent33250A
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.cli.app import app
from hpe_rig.measurement import requests as live_stop, run as run_module
from hpe_rig.measurement.requests import request_stop, stop_path
from hpe_rig.measurement.resumption import prepare_resumption, resume
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress
from hpe_rig.measurement.setup import Setup
from hpe_rig.result.provenance import Stages
from hpe_rig.runs.run import process
from hpe_rig.store import read_run, writer as store_writer
from hpe_rig.store.format import STAGES

Prepare = Callable[..., Setup]
SWEEP = (
    ("burst_length_s = 100e-6", "burst_length_s = [50e-6, 100e-6]"),
    ("burst_count = 20", "burst_count = 6"),
    ("window_start_s = 50e-3", ""),
    ("[acquisition]", "[acquisition]\nrepeats = 2"),
)
CLOCK_ERRORS = {
    "master": 2e-5,
    "burst_train": -1e-5,
    "toneburst": 3e-5,
    "tracking_train": 4e-5,
    "tracking_pulser": -3e-5,
    "digitizer": -2e-5,
}


def table(path: Path) -> dict[str, Any]:
    """Return everything a result says but its file's name and the time it took."""
    result = process(path).as_dict()
    return {key: value for key, value in result.items() if key not in ("run_file", "run_time_s")}


def resumed_table(path: Path) -> dict[str, Any]:
    """Return the table of the run that goes on from ``path``."""
    done = resume(prepare_resumption(path))
    assert read_run(done).predecessor == path.name
    return table(done)


def stopped_after(setup: Setup, path: Path, shots: int) -> Path:
    """Measure ``shots`` shots and stop."""

    def stop(progress: Progress) -> None:
        if progress.shot.index == shots:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, path, stop)
    return path


@pytest.mark.slow
def test_a_resumed_run_can_be_killed_and_resumed_again(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared("bovine-muscle-synchronous", *SWEEP)
    expected = table(record_run(setup, tmp_path / "whole.h5"))
    path = tmp_path / "first.h5"
    for stop_at, name in ((1, "first"), (3, "second")):
        path, earlier = tmp_path / f"{name}.h5", path

        def stop(progress: Progress, stop_at: int = stop_at) -> None:
            if progress.shot.index == stop_at:
                raise KeyboardInterrupt

        go_on = partial(record_run, setup) if name == "first" else partial(resume, prepare_resumption(earlier))
        with pytest.raises(KeyboardInterrupt):
            go_on(path, stop)
    assert read_run(path).shot_complete.tolist() == [True, True, True, False]
    assert resumed_table(path) == expected


@pytest.mark.slow
def test_resuming_gives_the_same_table_when_no_period_fits_the_sample_clock(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared(
        "bovine-muscle-synchronous",
        *SWEEP[:-1],
        ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 3333.0"),
        ("synchronous = true", ""),
        ("[acquisition]", "[acquisition]\nshot_period_s = 0.1234567"),
        ("delay_s = 130e-6", 'delay_s = 130e-6\ndisturbed = "keep"'),
    )
    expected = table(record_run(setup, tmp_path / "whole.h5"))
    assert resumed_table(stopped_after(setup, tmp_path / "run.h5", 1)) == expected


@pytest.mark.slow
def test_resuming_gives_the_same_table_when_every_clock_is_off(prepared: Prepare, tmp_path: Path) -> None:
    errors = "\n".join(f"{role} = {error}" for role, error in CLOCK_ERRORS.items())
    clocks = f"[simulation.instruments.clock_error]\n{errors}\n\n[simulation.receiver]"
    setup = prepared("bovine-muscle-synchronous", *SWEEP, ("[simulation.receiver]", clocks))
    expected = table(record_run(setup, tmp_path / "whole.h5"))
    assert resumed_table(stopped_after(setup, tmp_path / "run.h5", 2)) == expected


def test_resume_from_the_command_line_logs_and_stops_like_run(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = stopped_after(prepared("bovine-muscle-synchronous", *SWEEP), tmp_path / "run.h5", 2)

    fire = Agilent33250A.fire

    def fire_and_ask(master: Agilent33250A) -> None:
        request_stop(tmp_path / "run-2.h5")
        fire(master)

    with monkeypatch.context() as patched:
        patched.setattr(Agilent33250A, "fire", fire_and_ask)
        patched.setattr(live_stop, "POLL_INTERVAL_S", 0.0)
        done = CliRunner().invoke(app, ["resume", str(path), "--verbose"])
    assert done.exit_code == 130, done.output
    assert "2 of 4 shots are complete" in done.output
    assert "stopped from the live page" in done.output
    assert "every output is off, verified" in done.output
    assert "StopRequested" in (tmp_path / "run-2.log").read_text()
    assert not stop_path(tmp_path / "run-2.h5").exists()
    done = CliRunner().invoke(app, ["resume", str(tmp_path / "run-2.h5"), "--json"])
    assert done.exit_code == 0, done.output
    assert len(json.loads(done.stdout)["shots"]) == 4
    # The copied shots are older than the start of the run.
    assert json.loads(done.stdout)["provenance"]["continues"] == "run-2.h5"
    assert (
        "after the shots copied from run-2.h5"
        in CliRunner().invoke(app, ["process", str(tmp_path / "run-2-2.h5")]).output
    )
    assert read_run(tmp_path / "run-2-2.h5").status == "complete"


@pytest.mark.slow
def test_run_times_stand_in_the_file_where_they_are_asked_for(prepared: Prepare, tmp_path: Path) -> None:
    """The clock counts its readings, so that every stage has a time of its own and none is counted twice."""
    ticks = itertools.count()
    stages = Stages(lambda: float(next(ticks)))
    setup = prepared("bovine-muscle-synchronous", *SWEEP)
    path = record_run(setup, tmp_path / "run.h5", stages=stages)
    stored = read_run(path).run_time_s
    assert list(stored) == [
        name for name in STAGES if name not in ("load", "plan", "take over", "read conditions", "wait")
    ]
    assert process(path).run_time_s.keys() > stored.keys()
    # Between the first reading and the last all time but that between stages belongs to one of them.
    assert sum(stages.run_time_s.values()) == next(ticks) - 3
    plain = record_run(setup, tmp_path / "plain.h5")
    assert read_run(plain).run_time_s == {}
    with h5py.File(path, "r") as timed, h5py.File(plain, "r") as untimed:
        for name in ("records/echo", "records/trigger_time_s", "truth/displacement_m", "snapshot"):
            np.testing.assert_array_equal(timed[name], untimed[name])


def terminated(*arguments: Any) -> Any:
    """Stand for something during which SIGTERM arrives."""
    signal.raise_signal(signal.SIGTERM)


def test_a_sigterm_between_the_file_and_the_bench_leaves_no_file(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = prepared("table-1")
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "open_bench", terminated)
        with pytest.raises(Terminated) as caught:
            record_run(setup, tmp_path / "run.h5")
    assert caught.value.__notes__ == ["nothing was measured, and there is no run file"]
    assert not list(tmp_path.glob("*.h5"))


def test_a_sigterm_while_the_file_appears_waits_until_it_can_be_closed(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = store_writer.LogWriter

    def interrupted(path: Path) -> Any:
        terminated()
        return opened(path)

    monkeypatch.setattr(store_writer, "LogWriter", interrupted)
    with pytest.raises(Terminated):
        record_run(prepared("table-1"), tmp_path / "run.h5")
    assert not list(tmp_path.glob("*.h5"))
