"""Requests to stop a run in a folder where other users may place files."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from hpe_rig.measurement import (
    Progress,
    Step,
    StopRequested,
    clear_stale_stop,
    prepare,
    prepare_text,
    record_run,
    request_stop,
    stop_path,
    stop_requested,
)
from hpe_rig.measurement.requests import clear_stop, with_stop_requests, write_stop
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, new_run_id, read_run


def test_a_request_applies_to_its_run_and_an_empty_one_to_any_run(tmp_path: Path) -> None:
    write_stop(tmp_path / "run.h5", "one")
    assert stop_requested(tmp_path / "run.h5", "one")
    assert not stop_requested(tmp_path / "run.h5", "other")
    stop_path(tmp_path / "run.h5").write_text("", encoding="ascii")
    assert stop_requested(tmp_path / "run.h5", "other")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows makes links and pipes in other ways")
@pytest.mark.parametrize("planted", ["link", "pipe"])
@pytest.mark.parametrize("exchanged", [False, True], ids=["before", "between check and opening"])
def test_a_planted_link_or_pipe_is_no_request_and_delays_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planted: str, exchanged: bool
) -> None:
    path = stop_path(tmp_path / "run.h5")
    secret = tmp_path / "secret"
    secret.write_text("", encoding="ascii")
    if planted == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(secret)
    if exchanged:
        monkeypatch.setattr(Path, "lstat", lambda _: secret.stat())
    assert not stop_requested(tmp_path / "run.h5")


def test_a_name_that_cannot_be_cleared_refuses_the_run_with_its_path(tmp_path: Path) -> None:
    stop_path(tmp_path / "run.h5").mkdir()
    with pytest.raises(StoreError, match=r"run\.h5\.stop has the name of a request to stop this run"):
        clear_stop(tmp_path / "run.h5")


def test_a_request_is_looked_for_ten_times_a_second_but_not_once_the_records_of_a_shot_have_arrived(
    tmp_path: Path,
) -> None:
    path, shot, now_s, steps = tmp_path / "run.h5", prepare("table-1").plan.shots[0], [5.0], list[Step]()
    observe = with_stop_requests(lambda progress: steps.append(progress.step), path, "one", lambda: now_s[0])
    observe(Progress(Step.COLLECT, shot))
    write_stop(path, "other")
    now_s[0] = 6.0
    observe(Progress(Step.COLLECT, shot))
    write_stop(path, "one")
    for later_s in (6.0, 6.09):
        now_s[0] = later_s
        observe(Progress(Step.COLLECT, shot))
    now_s[0] = 6.125
    observe(Progress(Step.SAFE, shot))
    with pytest.raises(StopRequested):
        observe(Progress(Step.COLLECT, shot))
    assert steps == [Step.COLLECT] * 4 + [Step.SAFE, Step.COLLECT]
    # The first call looks, however early the clock is.
    with pytest.raises(StopRequested):
        with_stop_requests(steps.append, path, clock=lambda: 0.0)(Progress(Step.MOVE, shot))  # type: ignore[arg-type]
    now_s[0] = 0.0
    observe = with_stop_requests(lambda progress: None, tmp_path / "none.h5", clock=lambda: now_s[0])
    observe(Progress(Step.MOVE, shot))
    write_stop(tmp_path / "none.h5")
    now_s[0] = 0.1
    with pytest.raises(StopRequested):
        observe(Progress(Step.MOVE, shot))


def test_a_running_run_is_stopped_after_its_shot_and_one_that_has_ended_cannot_be(tmp_path: Path) -> None:
    path, run_id = tmp_path / "run.h5", new_run_id()
    text = shipped_scenes()["table-1"].replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256")

    def stop(progress: Progress) -> None:
        if progress.step is Step.SAFE:
            write_stop(path, "another run")
            # A program that starts meanwhile leaves the request of a run in progress alone.
            clear_stale_stop(path)
            assert stop_requested(path, "another run")
            request_stop(path)

    with pytest.raises(StopRequested):
        record_run(
            prepare_text("two", text), path, with_stop_requests(stop, path, run_id), options=WriteOptions(run_id=run_id)
        )
    assert read_run(path).shot_complete.tolist() == [True, False]
    clear_stop(path, "another run")
    assert stop_requested(path, run_id)
    with pytest.raises(StoreError, match=r"run\.h5 has ended \(aborted\): there is nothing to stop"):
        request_stop(path)
    clear_stale_stop(path)
    assert not stop_path(path).exists()
    with pytest.raises(StoreError, match=r"request to stop cannot be written beside .*Try: Ctrl-C where"):
        write_stop(tmp_path / "absent" / "run.h5")


def test_a_request_to_stop_ends_the_run_as_aborted_with_what_was_recorded(tmp_path: Path) -> None:
    setup = prepare("table-1")
    run_file = tmp_path / "run.h5"

    def ask_late(progress: Progress) -> None:
        if progress.step is Step.COLLECT and progress.records:
            request_stop(run_file)

    with pytest.raises(StopRequested):
        record_run(setup, run_file, with_stop_requests(ask_late, run_file, clock=iter(range(10**6)).__next__))
    stored = read_run(run_file)
    assert stored.status == "aborted"
    assert stored.records[0].valid.any()
    clear_stop(run_file)
    assert not stop_path(run_file).exists()


def test_a_stop_is_seen_while_the_next_shot_is_waited_for(tmp_path: Path) -> None:
    long = shipped_scenes()["table-1"].replace("[acquisition]", "[acquisition]\nrepeats = 2\nshot_period_s = 60.0")
    run_file, waits, fired = tmp_path / "run.h5", [0], [0]

    def ask(progress: Progress) -> None:
        waits[0] += progress.step is Step.WAIT
        fired[0] += progress.step is Step.FIRE
        if waits[0] == 3:
            request_stop(run_file)

    with pytest.raises(StopRequested):
        record_run(
            prepare_text("long", long), run_file, with_stop_requests(ask, run_file, clock=iter(range(10**6)).__next__)
        )
    assert (waits, fired) == ([3], [1])
    assert read_run(run_file).shot_complete.tolist() == [True, False]
