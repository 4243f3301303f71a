"""A run file has one writer, and a request to stop is for one run: neither can be taken for another's."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import DISK_THREAD, opening
from hpe_rig.cli.app import app
from hpe_rig.measurement import (
    Progress,
    Setup,
    Step,
    StopRequested,
    clear_stale_stop,
    record_run,
    request_stop,
    stop_path,
    stop_requested,
)
from hpe_rig.measurement.requests import clear_stop, with_stop_requests
from hpe_rig.measurement.resumption import prepare_resumption
from hpe_rig.runs.run import process
from hpe_rig.store import StoreError, WriteOptions, read_run, result_path, results_of_other_runs, task

Prepare = Callable[..., Setup]
SMALL = (
    ("pulse_count = 101", "pulse_count = 48"),
    ("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256"),
)
MINE, OTHER = "a" * 32, "b" * 32


@pytest.fixture
def setup(prepared: Prepare) -> Setup:
    """Return a measurement of two shots."""
    return prepared("table-1", *SMALL)


def during(setup: Setup, path: Path, act: Callable[[], object], run_id: str = MINE) -> None:
    """Measure, and do ``act`` as the second shot's records come."""

    def observe(progress: Progress) -> None:
        if progress.shot.index == 1 and progress.step is Step.COLLECT and not progress.records:
            act()

    clock = iter(range(10**6)).__next__
    record_run(setup, path, with_stop_requests(observe, path, run_id, clock), options=WriteOptions(run_id=run_id))


def test_another_run_into_the_same_file_is_refused_and_the_first_goes_on(setup: Setup, tmp_path: Path) -> None:
    path, refused = tmp_path / "run.h5", []

    def another() -> None:
        for overwrite in (False, True):
            with pytest.raises(StoreError) as raised:
                record_run(setup, path, options=WriteOptions(overwrite=overwrite))
            refused.append(str(raised.value))
        with pytest.raises(StoreError, match="being written by a run"):
            prepare_resumption(path)

    during(setup, path, another)
    assert "already exists" in refused[0]
    assert "is being written by another run" in refused[1]
    assert read_run(path).status == "complete"
    assert read_run(path).shot_complete.all()


@pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows")
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_disk_that_hangs_as_the_file_is_made_keeps_no_output_on(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overwrite: bool
) -> None:
    path, answers, worlds, make = tmp_path / "run.h5", threading.Event(), [], opening._world
    before = record_run(setup, path).read_bytes() if overwrite else None

    def hangs(number: int) -> None:
        # Somebody loses patience once the disk is asked.
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        assert answers.wait(20)

    monkeypatch.setattr(opening, "_world", lambda *arguments: worlds.append(make(*arguments)) or worlds[0])
    monkeypatch.setattr(os, "fsync", hangs)
    with pytest.raises(KeyboardInterrupt):
        record_run(setup, path, options=WriteOptions(overwrite=overwrite))
    # An overwritten file is made with the first record, when outputs are on; a new one before the bench is opened.
    assert len(worlds) == overwrite
    assert not any(any(world.outputs_on().values()) for world in worlds)
    answers.set()
    for thread in threading.enumerate():
        if thread.name == DISK_THREAD:
            thread.join(10)
    assert [item.name for item in tmp_path.iterdir() if "h5" in item.name] == (["run.h5"] if overwrite else [])
    assert before is None or path.read_bytes() == before


@pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows")
def test_a_disk_that_hangs_under_the_result_is_left_by_ctrl_c_or_after_a_minute_and_an_earlier_result_stays(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, answers = record_run(setup, tmp_path / "run.h5"), threading.Event()
    process(path)
    before = result_path(path, "coherent").read_bytes()

    def hangs(number: int) -> None:
        if task.STEP_TIMEOUT_S == 60.0:
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        assert answers.wait(20)

    monkeypatch.setattr(os, "fsync", hangs)
    with pytest.raises(KeyboardInterrupt):
        process(path)
    monkeypatch.setattr(task, "STEP_TIMEOUT_S", 0.05)
    with pytest.raises(StoreError, match=r"has not answered for 0\.05 s.*The run file is as it was.*Try:"):
        process(path)
    answers.set()
    for thread in threading.enumerate():
        if thread.name == DISK_THREAD:
            thread.join(10)
    assert sorted(item.name for item in tmp_path.iterdir() if "h5" in item.name) == ["run.coherent.h5", "run.h5"]
    assert result_path(path, "coherent").read_bytes() == before


def test_only_a_run_file_is_overwritten_and_no_result_or_other_file(setup: Setup, tmp_path: Path) -> None:
    path = record_run(setup, tmp_path / "run.h5")
    result = result_path(path, process(path).estimator)
    before = result.read_bytes()
    scene = tmp_path / "table-1.toml"
    done = CliRunner().invoke(app, ["run", str(scene), "--output", str(result), "--overwrite"])
    assert done.exit_code == 2
    assert "not replaced" in done.output
    assert result.read_bytes() == before
    replace = ["run", str(scene), "--output", str(path), "--overwrite", "--json", "--estimator"]
    done = CliRunner().invoke(app, [*replace, "kasai"])
    assert done.exit_code == 0, done.output
    # The other estimator's result file is still that of the run before.
    assert f"{result}: of the run that was replaced" in done.stderr
    assert (
        json.loads(CliRunner().invoke(app, ["list", str(tmp_path), "--json"]).stdout)[0]["lead"]["estimator"] == "kasai"
    )
    CliRunner().invoke(app, ["process", str(path)])
    assert results_of_other_runs(path) == []


def test_a_stop_is_for_the_run_that_it_names(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with pytest.raises(StopRequested):
        during(setup, path, lambda: request_stop(path))
    assert stop_path(path).read_text() == MINE
    assert not stop_requested(path, OTHER)
    # Another run of that name neither ends by it nor takes it away; the run that it was for does.
    clear_stop(path, OTHER)
    assert stop_path(path).exists()
    clear_stop(path, MINE)
    assert not stop_path(path).exists()


def test_a_request_left_by_an_earlier_run_stops_no_later_one(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    stop_path(path).write_text(OTHER)
    during(setup, path, lambda: None)
    assert read_run(path).status == "complete"
    clear_stale_stop(path)
    assert not stop_path(path).exists()


def test_a_run_about_to_be_refused_takes_no_request_from_the_run_that_goes_on(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"

    def request_and_clear() -> None:
        request_stop(path)
        clear_stale_stop(path)

    with pytest.raises(StopRequested):
        during(setup, path, request_and_clear)


@pytest.mark.skipif(os.name == "nt", reason="needs fork and SIGKILL")
def test_a_run_that_was_killed_cannot_be_asked_to_stop_and_goes_on_at_once(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    pid = os.fork()
    if not pid:
        during(setup, path, lambda: os.kill(os.getpid(), signal.SIGKILL))
    os.waitpid(pid, 0)
    assert read_run(path).status == "killed"
    with pytest.raises(StoreError, match="its program was killed"):
        request_stop(path)
    # The system has released its lock.
    assert prepare_resumption(path).complete == 1
