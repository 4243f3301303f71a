"""Queues of small runs on the twin: lists, states in the folder, failures, interrupts; results come from a stand-in."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hpe_rig.bench import read_bench, resources
from hpe_rig.bench.lock import holder_of
from hpe_rig.measurement import (
    Observer,
    Progress,
    QueueHooks,
    QueueRun,
    Setup,
    StopRequested,
    new_queue,
    prepare,
    queue_entries,
    read_queue,
    record_run,
    run_queue,
    stop_queue,
    stop_requested,
    time_left_s,
)
from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.store import StoreError, read_run, sealed_json

TWO_SHOTS = (
    shipped_scenes()["table-1"]
    .replace("pulse_count = 101", "pulse_count = 48")
    .replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256")
)


def scenes(folder: Path, names: str) -> list[tuple[str, None]]:
    for name in names:
        (folder / f"{name}.toml").write_text(TWO_SHOTS, "utf-8")
    return [(str(folder / f"{name}.toml"), None) for name in names]


class Caller:
    """Hooks of a queue: keeps the reports, calls ``observe`` at each step, and ``process`` in place of processing."""

    def __init__(
        self,
        observe: Observer = lambda progress: None,
        process: Callable[[Path], Any] = lambda path: f"result of {path.name}",
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.reports, self.watched = list[str](), list[tuple[str, str]]()
        self._observe, self._report = observe, report
        self.hooks = QueueHooks(self.report, self.watch, process)

    def report(self, text: str) -> None:
        self.reports.append(text)
        self._report(text)

    @contextmanager
    def watch(self, setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, None]]:
        self.watched.append((path.name, run_id))
        yield self._observe, None


def states(queue: tuple[QueueRun, ...]) -> list[str]:
    return [run.state for run in queue]


def test_states_times_and_reasons_are_stored_and_a_measured_run_is_only_processed_again(tmp_path: Path) -> None:
    folder, attempts = tmp_path / "night" / "queue", list[str]()

    def process(path: Path) -> Any:
        attempts.append(path.name)
        if attempts == ["01-a.h5"]:
            error = StoreError("no space left")
            error.add_note("1 MB is missing")
            raise error
        return f"result of {path.name}"

    queue = new_queue(scenes(tmp_path, "ab"), folder)
    duration_s = prepare(tmp_path / "a.toml").plan.duration_s
    assert queue == tuple(
        QueueRun(name, TWO_SHOTS, None, f"{number:02d}-{name}.h5", planned_s=duration_s)
        for number, name in enumerate("ab", 1)
    )
    assert read_queue(folder) == queue
    first, again = Caller(process=process), Caller(process=process)
    ended, results = run_queue(folder, queue, first.hooks)
    assert results == {1: "result of 02-b.h5"}
    assert states(ended) == ["failed", "done"]
    assert [run.why for run in ended] == ["no space left; 1 MB is missing", ""]
    assert [0 < run.took_s < 600 for run in ended] == [False, True]
    assert read_queue(folder, pytest.fail) == ended
    assert "run 1 failed: no space left; 1 MB is missing" in first.reports
    for (name, run_id), run in zip(first.watched, ended, strict=True):
        stored = read_run(folder / name)
        assert (name, stored.run_id) == (run.run_file, run_id)
        assert stored.provenance.started

    content = (folder / "01-a.h5").read_bytes()
    ended, results = run_queue(folder, read_queue(folder), again.hooks)
    assert (states(ended), results) == (["done"] * 2, {0: "result of 01-a.h5"})
    assert (ended[0].why, ended[0].took_s) == ("", 0.0)
    assert (again.watched, (folder / "01-a.h5").read_bytes()) == ([], content)
    starts = [text.partition(";") for text in (*first.reports, *again.reports) if " -> " in text]
    runs = "run 1 of 2: a -> 01-a.h5", "run 2 of 2: b -> 02-b.h5"
    assert [start for start, _, _ in starts] == [*runs, runs[0]]
    basis = [end.partition(" the queue ends at about ")[2].partition(", ")[2] for _, _, end in starts]
    assert basis == ["from the plans", "from the plans", "from the plans and the runs so far"]


def test_an_interrupted_run_of_a_queue_continues_after_its_complete_shots_in_a_file_of_its_own(tmp_path: Path) -> None:
    def interrupt(progress: Progress) -> None:
        if progress.shot.index == 1:
            raise KeyboardInterrupt

    folder = tmp_path / "queue"
    with pytest.raises(KeyboardInterrupt) as caught:
        run_queue(folder, new_queue(scenes(tmp_path, "ab"), folder), Caller(interrupt).hooks)
    assert f"hpe-rig queue --resume {folder} continues the queue" in caught.value.__notes__
    stopped = read_queue(folder)
    assert states(stopped) == ["stopped", "waiting"]
    assert stopped[0].why == "KeyboardInterrupt"
    # A name that is in use is left alone.
    (folder / "01-a-2.h5").write_bytes(b"")
    during, again = list[str](), Caller(lambda progress: during.append(read_queue(folder)[0].state))
    (ended,), _ = run_queue(folder, stopped[:1], again.hooks)
    assert again.reports[1] == "1 of 2 shots are complete: the others are written to 01-a-3.h5"
    assert (ended.run_file, ended.state, ended.why, ended.took_s) == ("01-a-3.h5", "done", "", 0.0)
    assert set(during) == {"running"}
    assert read_run(folder / "01-a-3.h5").shot_complete.all()
    assert read_run(folder / "01-a-3.h5").provenance.started


def test_a_request_to_stop_ends_the_queue_before_its_next_run_and_lasts_no_longer(tmp_path: Path) -> None:
    def interrupt(progress: Progress) -> None:
        raise KeyboardInterrupt

    folder = tmp_path / "queue"
    queue = new_queue(scenes(tmp_path, "a"), folder)
    # A request that came before the queue was started applies to an earlier one.
    stop_queue(folder)
    with pytest.raises(KeyboardInterrupt):
        run_queue(folder, queue, Caller(interrupt).hooks)
    assert read_queue(folder)[0].why == "KeyboardInterrupt"
    with pytest.raises(StopRequested):
        run_queue(folder, queue, Caller(report=lambda text: stop_queue(folder)).hooks)
    assert (read_queue(folder)[0].state, read_queue(folder)[0].why) == ("stopped", "StopRequested")
    assert not stop_requested(folder / "queue.json")
    # Nothing follows the last run that a request could stop.
    last = Caller(lambda progress: stop_queue(folder))
    assert states(run_queue(folder, read_queue(folder), last.hooks)[0]) == ["done"]
    assert not stop_requested(folder / "queue.json")


def test_a_real_bench_is_locked_from_the_first_run_to_the_last_and_a_failure_stops_the_queue_on_request(
    tmp_path: Path, real_bench: Callable[..., Path]
) -> None:
    folder, bench = tmp_path / "queue", real_bench()
    (name, *_) = resources(read_bench(bench).bench)
    entries: list[tuple[str, Path | None]] = [(scenes(tmp_path, "a")[0][0], bench), ("table-1", None)]
    queue = new_queue(entries, folder)
    assert queue[0].bench == str(bench.resolve())
    holders, refusals = list[str | None](), list[str]()

    def look(text: str) -> None:
        holders.append(holder_of(name))
        with pytest.raises(StoreError, match="another program measures the queue in") as refused:
            run_queue(folder, queue, Caller().hooks)
        refusals.append(str(refused.value))

    caller = Caller(report=look)
    ended, results = run_queue(folder, queue, caller.hooks, stop_on_failure=True)
    assert (states(ended), results) == (["failed", "waiting"], {})
    assert "GPIB" in ended[0].why
    assert caller.reports[-1] == "the queue stops after this failure, as requested"
    assert len(refusals) == 3
    assert all(holders)
    assert holder_of(name) is None


RUN = {"name": "a", "scene_toml": "", "bench": None, "run_file": "a.h5"}


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"format": "hpe_rig marks", "runs": [RUN]}, "it has no checksum, as lists of earlier releases"),
        ({"format": "hpe_rig queue", "runs": [RUN | {"state": "over"}]}, "its runs have other keys"),
        ({"format": "hpe_rig queue", "runs": [RUN | {"run_file": "../a.h5"}]}, r"run file '../a.h5' is no plain name"),
        ({"format": "hpe_rig queue", "runs": [RUN | {"run_file": "b\\a.h5"}]}, "is no plain name"),
        ({"format": "hpe_rig queue", "runs": [RUN | {"run_file": "a.txt"}]}, r"'a.txt' does not end in \.h5"),
        ({"format": "hpe_rig queue", "runs": []}, "it is empty"),
    ],
)
def test_a_list_that_no_queue_wrote_is_refused_and_its_copy_used(
    tmp_path: Path, tables: dict[str, Any], words: str
) -> None:
    path, copy, reports = tmp_path / "queue.json", tmp_path / "queue-copy.json", list[str]()
    path.write_text(sealed_json(tables), "utf-8")
    copy.write_text(path.read_text("utf-8"), "utf-8")
    with pytest.raises(StoreError, match=f"queue.json cannot be read .*{words}.*hpe-rig resume"):
        read_queue(tmp_path)
    copy.write_text(sealed_json({"format": "hpe_rig queue", "runs": [RUN]}), "utf-8")
    assert read_queue(tmp_path, reports.append) == (QueueRun("a", "", None, "a.h5"),)
    assert len(reports) == 1
    assert reports[0].startswith(f"{path} cannot be read (it ")
    assert reports[0].endswith("its copy queue-copy.json is used")


def test_a_list_without_checksum_is_refused(tmp_path: Path) -> None:
    for name in ("queue.json", "queue-copy.json"):
        (tmp_path / name).write_text(json.dumps({"format": "hpe_rig queue", "runs": [RUN]}), "utf-8")
    with pytest.raises(StoreError, match="it has no checksum"):
        read_queue(tmp_path)


def test_a_list_of_runs_is_a_single_file_and_the_command_lines_bench_replaces_its_default(tmp_path: Path) -> None:
    path, bench = tmp_path / "list.toml", tmp_path / "stated.toml"
    runs = '[[run]]\nscene = "a.toml"\n[[run]]\nscene = "table-1"\nbench = "c.toml"\n'
    path.write_text(f'bench = "b.toml"\non_failure = "go on"\n{runs}', "utf-8")
    a = str(tmp_path / "a.toml")
    assert queue_entries([str(path)], None) == ([(a, tmp_path / "b.toml"), ("table-1", tmp_path / "c.toml")], False)
    assert queue_entries([str(path)], bench) == ([(a, bench), ("table-1", tmp_path / "c.toml")], False)
    path.write_text(f'on_failure = "stop"\n{runs}', "utf-8")
    assert queue_entries([str(path)], None) == ([(a, None), ("table-1", tmp_path / "c.toml")], True)
    # Several sources, a scene file and a run file are no lists.
    assert queue_entries([str(path), "b.h5"], bench) == ([(str(path), bench), ("b.h5", bench)], False)
    (scene,) = scenes(tmp_path, "a")
    assert queue_entries([scene[0]], None) == ([scene], False)
    assert queue_entries(["run.h5"], bench) == ([("run.h5", bench)], False)


def test_the_mistakes_of_all_runs_are_listed_with_number_source_and_remedy(tmp_path: Path) -> None:
    (tmp_path / "wrong.toml").write_text(TWO_SHOTS.replace("= 4000.0", "= -1.0"), "utf-8")
    (tmp_path / "conflict.toml").write_text(TWO_SHOTS.replace("= 4000.0", "= 1e6"), "utf-8")
    sources = [str(tmp_path / name) for name in ("wrong.toml", "conflict.toml", "absent.h5")]
    entries: list[tuple[str, Path | None]] = [(source, None) for source in sources]
    folder = tmp_path / "queue"
    with pytest.raises(SettingsError) as caught:
        new_queue([("table-1", None), *entries, ("table-1", tmp_path / "no-bench.toml")], folder)
    mistakes = {mistake.path: mistake for mistake in caught.value.mistakes}
    wrong, *_, file, bench = mistakes
    assert wrong == f"run 2, {sources[0]}: tracking.pulse_rate_hz"
    assert f"run 3, {sources[1]}: depth" in mistakes
    assert all(path.startswith(f"run 3, {sources[1]}: ") for path in list(mistakes)[1:-2])
    assert file == f"run 4, {sources[2]}"
    assert bench == f"run 5, table-1, bench {tmp_path / 'no-bench.toml'}"
    assert not any("Try:" in item.what or item.remedy.endswith(".") for item in (mistakes[file], mistakes[bench]))
    assert not folder.exists()
    new_queue([("table-1", None)], folder)
    with pytest.raises(StoreError, match="exist"):
        new_queue([("table-1", None)], folder)


def test_a_run_file_is_measured_again_by_a_queue(tmp_path: Path) -> None:
    path = record_run(prepare(scenes(tmp_path, "a")[0][0]), tmp_path / "earlier.h5")
    (run,) = new_queue([(str(path), None)], tmp_path / "queue")
    assert (run.name, run.run_file, run.scene_toml) == ("a", "01-a.h5", TWO_SHOTS)


def run_of(state: Any, planned_s: float, took_s: float = 0.0) -> QueueRun:
    return replace(QueueRun("a", "", None, "a.h5"), state=state, planned_s=planned_s, took_s=took_s)


def test_the_time_left_counts_runs_from_the_next_one_on_that_are_not_done() -> None:
    waiting = [run_of("waiting", 600.0)]
    assert time_left_s(waiting * 3, 1) == 1200.0
    # Without duration: a resumed run says nothing about the pace.
    assert time_left_s([run_of("done", 600.0), *waiting], 1) == 600.0
    # 1 s by the plan, and 11 s for opening, programming and computing: a scale would give 12 times 20 minutes.
    assert time_left_s([run_of("done", 1.0, 12.0), *waiting * 2], 1) == pytest.approx(2 * (600 + 11))
    short = [run_of("done", 10.0, 30.0), run_of("done", 10.0, 20.0), run_of("done", 10.0, 5.0)]
    assert time_left_s([*short, *waiting * 2], 3) == pytest.approx(1200 + 2 * 25 / 3)
    # A run that was faster than planned makes none of the others shorter than planned.
    assert time_left_s([run_of("done", 10.0, 5.0), *waiting], 1) == 600.0
    # A later run of the list may be done already.
    assert time_left_s([*waiting, run_of("done", 600.0, 660.0), *waiting], 0) == pytest.approx(1320.0)
