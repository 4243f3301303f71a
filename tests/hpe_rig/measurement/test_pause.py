"""Pauses between shots: requests beside the run file, waits for a movement, and the observer that obeys them."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from hpe_rig.measurement import (
    Progress,
    Step,
    StopRequested,
    awaited_offset_m,
    clearing_requests,
    pause_requested,
    requests,
    stop_path,
    stop_requested,
    toggle_pause,
    wait_for_move,
    with_requests,
)
from hpe_rig.measurement.requests import clear_pause, pause_path, with_pauses, write_stop
from hpe_rig.measurement.setup import prepare
from hpe_rig.plan import Shot
from hpe_rig.store import StoreError


@pytest.fixture(scope="module")
def shot() -> Shot:
    return prepare("table-1").plan.shots[0]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.h5"


def test_a_request_to_pause_is_made_and_ended_by_the_same_call_and_belongs_to_its_run(path: Path) -> None:
    assert toggle_pause(path, "one")
    assert pause_path(path) == path.with_name("run.h5.pause")
    assert [pause_requested(path, run_id) for run_id in ("one", "", "other")] == [True, True, False]
    clear_pause(path, "other")
    assert pause_requested(path, "one")
    assert awaited_offset_m(path, "one") is None
    assert not toggle_pause(path, "one")
    assert not pause_path(path).exists()
    # Made by hand, it applies to any run.
    pause_path(path).write_text("", "ascii")
    assert pause_requested(path, "one")
    clear_pause(path, "one")
    assert not pause_path(path).exists()


def test_a_request_that_cannot_be_written_or_removed_is_an_error_with_a_remedy(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "not yours")

    absent = path.parent / "absent" / "run.h5"
    with pytest.raises(StoreError, match=r"request to pause cannot be written beside .*run\.h5 .*Try: Ctrl-C"):
        toggle_pause(absent)
    with pytest.raises(StoreError, match=r"wait for the transducer at 2\.25 mm cannot be written beside .*--yes"):
        wait_for_move(absent, "one", 2.25e-3, lambda: True)
    toggle_pause(path)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(StoreError, match=r"request to pause cannot be removed beside .*not yours"):
        toggle_pause(path)


def test_a_movement_is_awaited_at_its_offset_until_it_is_confirmed(path: Path) -> None:
    answers, offsets = iter([False, False, True]), list[float | None]()

    def is_confirmed() -> bool:
        assert awaited_offset_m(path, "other") is None
        offsets.append(awaited_offset_m(path, "one"))
        return next(answers)

    sleeps = list[float]()
    wait_for_move(path, "one", 2.25e-3, is_confirmed, sleeps.append)
    assert (offsets, sleeps) == ([2.25e-3] * 3, [0.1, 0.1])
    assert not pause_path(path).exists()
    assert awaited_offset_m(path, "one") is None


def test_a_movement_that_is_not_confirmed_ends_with_the_pause_or_with_a_stop(path: Path) -> None:
    wait_for_move(path, "one", 0.0, lambda: False, lambda seconds: toggle_pause(path, "one") and None)
    assert not pause_path(path).exists()
    with pytest.raises(StopRequested):
        wait_for_move(path, "one", 0.0, lambda: False, lambda seconds: write_stop(path, "one"))
    assert not pause_path(path).exists()


@pytest.mark.parametrize("step", Step)
def test_a_run_pauses_before_a_shot_alone_and_calls_its_observer_meanwhile(shot: Shot, step: Step) -> None:
    calls, reports, sleeps = list[Step](), list[str](), list[float]()
    answers = iter([True, True, True, False])
    observe = with_pauses(
        lambda progress: calls.append(progress.step), lambda: next(answers), reports.append, sleeps.append
    )
    observe(Progress(step, shot))
    if step in (Step.MOVE, Step.CONDITIONS, Step.CONFIGURE):
        assert reports == ["paused before shot 1, all outputs are off: p continues, Ctrl-C stops", "continuing"]
        assert (sleeps, calls) == ([0.1, 0.1], [step] * 3)
        assert next(answers, None) is None
    else:
        assert (reports, sleeps, calls) == ([], [], [step])
        # The key was read once.
        assert list(answers) == [True, True, False]


def test_a_request_to_stop_ends_a_pause(shot: Shot, path: Path) -> None:
    def report(text: str) -> None:
        assert text.startswith("paused")
        write_stop(path, "one")

    observe = with_requests(lambda progress: None, path, "one", lambda: True, report)
    with pytest.raises(StopRequested):
        observe(Progress(Step.CONFIGURE, shot))


def test_requests_end_with_their_run_and_not_later_than_its_disk_allows(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(run_id: str) -> None:
        with clearing_requests(path, run_id):
            raise ZeroDivisionError

    toggle_pause(path, "one")
    write_stop(path, "one")
    for run_id, is_left in (("other", True), ("one", False)):
        with pytest.raises(ZeroDivisionError):
            run(run_id)
        assert (pause_requested(path), stop_requested(path)) == (is_left, is_left)
    assert not pause_path(path).exists()
    assert not stop_path(path).exists()
    answers = threading.Event()
    monkeypatch.setattr(requests, "CLEAR_S", 0.1)
    monkeypatch.setattr(requests, "clear_pause", lambda run_file, run_id: answers.wait(60))
    write_stop(path, "one")
    with clearing_requests(path, "one"):
        pass
    assert stop_requested(path, "one")
    answers.set()
