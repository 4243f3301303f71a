"""Content of a run file after an early end, and the log beside it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.bench import read_bench
from hpe_rig.measurement import Observer, Progress, Setup, Step, prepare_text, record_run, recording, run_log
from hpe_rig.measurement.background import BackgroundTasks, detached
from hpe_rig.measurement.provenance import provenance_now
from hpe_rig.measurement.recording import NOTHING_MEASURED
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, read_run, read_snapshots


@pytest.fixture(scope="module")
def setup() -> Setup:
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    return prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrecord_samples = 256"))


def failing_at(step: Step, records: bool = False) -> Observer:
    def fail(progress: Progress) -> None:
        if progress.step is step and bool(progress.records) == records:
            raise ZeroDivisionError("a fault of the observer")

    return fail


def test_an_early_end_says_what_the_run_file_holds_and_leaves_no_file_without_events(
    setup: Setup, tmp_path: Path
) -> None:
    def end_at(name: str, step: Step, records: bool = False, overwrite: bool = False) -> str:
        path = tmp_path / name
        options = WriteOptions(overwrite=overwrite)
        with pytest.raises(ZeroDivisionError) as caught:
            record_run(setup, path, failing_at(step, records), options=options)
        return " ".join(caught.value.__notes__).replace(str(path), name)

    assert NOTHING_MEASURED in end_at("a.h5", Step.VERIFY)
    assert not list(tmp_path.iterdir())
    assert "b.h5 holds no records: none had arrived" in end_at("b.h5", Step.ENABLE)
    assert not read_run(tmp_path / "b.h5").shot_complete.any()
    commands = "hpe-rig process c.h5 estimates them, hpe-rig resume c.h5 measures the others"
    assert f"c.h5 holds the records that had arrived: {commands}" in end_at("c.h5", Step.COLLECT, records=True)
    assert np.any(read_run(tmp_path / "c.h5").records[0].codes != np.iinfo(np.int16).min)
    # A run that is to be replaced is untouched until the first record of the new one has arrived.
    content = (tmp_path / "c.h5").read_bytes()
    assert "no record had arrived: c.h5 is unchanged" in end_at("c.h5", Step.COLLECT, overwrite=True)
    assert (tmp_path / "c.h5").read_bytes() == content
    record_run(setup, tmp_path / "c.h5", options=WriteOptions(overwrite=True))
    # The settings of the first shot came before its records, and before there was a new file.
    assert read_run(tmp_path / "c.h5").shot_complete.all()
    assert [settings["master"]["output_on"] for settings in read_snapshots(tmp_path / "c.h5")] == [False]


class SlowWriter:
    """A run file on a disk that writes nothing before ``answers`` is set."""

    progress = 0

    def __init__(self) -> None:
        self.answers, self.calls = threading.Event(), list[str]()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*_: object, **__: object) -> None:
            if name == "append":
                self.answers.wait(60)
            self.calls.append(name)

        return call


def test_a_disk_that_does_not_answer_ends_the_run_with_what_may_be_missing(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "DISK_TIMEOUT_S", 0.3)
    monkeypatch.setattr(recording, "RunWriter", object)
    writer = SlowWriter()
    create: Any = lambda cancelled: writer  # noqa: E731

    def record() -> None:
        with recording.RunRecorder(tmp_path / "run.h5", create, defer=False) as recorder:
            recorder._storage.submit(lambda: writer.append())
            recorder.check_file_present(wait=True)

    with pytest.raises(StoreError, match=r"has not answered for 0\.3 s.*hpe-rig resume run\.h5") as caught:
        record()
    assert caught.value.__notes__ == [
        f"the disk of {tmp_path / 'run.h5'} does not answer: its last records may be missing"
    ]
    assert "__exit__" not in writer.calls
    writer.answers.set()


def test_the_log_has_the_bench_the_versions_each_step_once_and_the_end(setup: Setup, tmp_path: Path) -> None:
    def logged(run_file: str, observer: Observer) -> list[str]:
        path = tmp_path / run_file
        with run_log(setup, path) as with_log:
            record_run(setup, path, with_log(observer))
        return (tmp_path / log_names[run_file]).read_text("utf-8").splitlines()

    log_names = {"a.h5": "a.log", "b.log": "b.log.log"}
    lines = logged("a.h5", lambda progress: None)
    assert lines[0].endswith(f"  {setup.scene.scene.title}")
    assert lines[1] == f"scene small, bench simulated: {setup.bench.bench.title}"
    assert lines[2].startswith("hpe_rig ")
    assert sum(line.startswith(("passed: ", "warning: ")) for line in lines) == len(setup.findings)
    steps = [line.partition(" s  ")[2] for line in lines if " s  " in line]
    named = [step for step in Step if step not in (Step.CONDITIONS, Step.WAIT)]
    collected = [f"shot 1: {records} of 48 records" for records in range(6, 49, 6)]
    assert steps == [
        *(f"shot 1: {step.value}" for step in named if step is not Step.SAFE),
        *collected,
        f"shot 1: {Step.SAFE.value}",
        "complete",
    ]
    times_s = [float(line.partition(" s  ")[0]) for line in lines if " s  " in line]
    assert 0 <= times_s[0] <= times_s[-1] < 60
    assert times_s == sorted(times_s)
    with pytest.raises(ZeroDivisionError):
        logged("b.log", failing_at(Step.CONFIGURE))
    text = (tmp_path / "b.log.log").read_text("utf-8")
    assert "ended by ZeroDivisionError: a fault of the observer\nTraceback (most recent" in text
    assert "complete" not in text
    # An existing log is extended.
    with pytest.raises(ZeroDivisionError):
        logged("b.log", failing_at(Step.CONFIGURE))
    assert (tmp_path / "b.log.log").read_text("utf-8").startswith(text)
    with pytest.raises(StoreError, match=r"run\.log cannot be written .*Try: another --output, or no --verbose"):
        run_log(setup, tmp_path / "absent" / "run.h5").__enter__()


def test_the_account_is_stored_if_the_bench_file_permits_it_and_versions_of_visa_if_it_is_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = read_bench().bench
    monkeypatch.setattr("getpass.getuser", lambda: "operator")
    monkeypatch.setattr("socket.gethostname", lambda: "rack")
    stored, served = provenance_now(bench), provenance_now(bench.model_copy(update={"transport": "socket"}))
    assert (stored.host, stored.user, stored.drivers) == ("rack", "operator", "")
    assert "T" in stored.started
    assert served.drivers.startswith("pyvisa ")
    assert provenance_now(bench.model_copy(update={"simulated": False})).drivers == served.drivers
    assert provenance_now(bench.model_copy(update={"store_user": False})).user == ""
    monkeypatch.setattr("socket.gethostname", lambda: "rack\x1b[2J")
    assert provenance_now(bench).host == ""
    monkeypatch.setattr("getpass.getuser", lambda: {}["USER"])
    assert provenance_now(bench).user == ""


def test_a_wait_for_tasks_lasts_as_long_as_they_end_or_their_progress_changes() -> None:
    tasks, gate, waits = BackgroundTasks("test"), threading.Event(), iter(range(1000))
    assert tasks.wait(0.0)
    tasks.submit(lambda: gate.wait(60) and None, 10)
    tasks.submit(lambda: None, 20)
    assert tasks.backlog_bytes == 30
    # A write that advances is no disk that hangs.
    progress = lambda: gate.set() if next(waits) > 3 else next(waits)  # noqa: E731
    assert tasks.wait(0.25, progress)
    assert (tasks.unfinished, tasks.backlog_bytes) == (0, 0)
    tasks.submit(lambda: gate.wait(60) and None, 10)
    tasks.wait_for_one(60.0)
    assert (tasks.unfinished, tasks.backlog_bytes) == (0, 0)
    gate.clear()
    done = list[int]()
    tasks.submit(lambda: gate.wait(60) and None)
    tasks.submit(lambda: done.append(1))
    tasks.discard()
    gate.set()
    assert tasks.wait(60.0)
    assert done == []
    tasks.end()


def test_an_observer_in_its_thread_is_called_again_once_it_has_returned_and_waited_for_at_the_end(setup: Setup) -> None:
    shot, calls, returned = setup.plan.shots[0], list[int](), threading.Event()

    def observe(progress: Progress) -> None:
        if progress.records == 3:
            threading.Event().wait(0.1)
        calls.append(progress.records)
        returned.set()

    with detached(observe) as detached_observe:
        for records in (1, 2, 3):
            detached_observe(Progress(Step.COLLECT, shot, records))
            if records < 3:
                assert returned.wait(60)
                returned.clear()
                # The thread reports the end of a call after the call.
                threading.Event().wait(0.05)
    assert calls == [1, 2, 3]
