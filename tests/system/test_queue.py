"""Queues: checked as a whole, a failing bench, an interrupt, what is left taken up again; pauses between shots."""

from __future__ import annotations

import itertools
import os
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.cli.app import app
from hpe_rig.cli.watch import _announce_moves, _ask_for_moves
from hpe_rig.live.queue_source import QueueSource
from hpe_rig.measurement import (
    Observer,
    Progress,
    QueueHooks,
    QueueRun,
    Setup,
    Step,
    new_queue,
    pause_requested,
    prepare,
    queue_entries,
    read_queue,
    record_run,
    run_queue,
    toggle_pause,
)
from hpe_rig.measurement.requests import with_pauses
from hpe_rig.result import amplitude_text
from hpe_rig.runs import json_schema, process
from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.store import StoreError, read_run, verify


def scenes(folder: Path, count: int) -> list[Path]:
    """Write ``count`` scenes of two shots each, of different seeds."""
    text = shipped_scenes()["table-1"].replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256", 1)
    text = text.replace("pulse_count = 101", "pulse_count = 40")
    paths = [folder / f"scene-{number}.toml" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_text(text.replace("seed = 1", f"seed = {number + 1}"), encoding="utf-8")
    return paths


def absent_bench(folder: Path) -> Path:
    """Write the bench file of a real bench that does not answer."""
    text = read_bench().text.replace("simulated = true", "simulated = false").partition("[calibration]")
    generators = "[generators.master]" + text[2].partition("[generators.master]")[2]
    for port, role in enumerate(("master", "burst_train", "toneburst", "tracking_train", "tracking_pulser"), 1):
        address = f'address = "TCPIP::127.0.0.1::{port}::SOCKET"'
        generators = generators.replace(f"[generators.{role}]", f"[generators.{role}]\n{address}")
    path = folder / "absent.toml"
    named = text[0].replace("Simulated bench, wired as Fig. 2 of the paper", "A bench that is switched off")
    path.write_text(named + generators, encoding="utf-8")
    return path


class Watcher:
    """Watches a queue; interrupts it in shot ``shot`` of the run whose file is named ``run_file``."""

    def __init__(self, run_file: str = "", shot: int = 1) -> None:
        self.said: list[str] = []
        self.steps: list[tuple[str, int, Step]] = []
        self._run_file, self._shot = run_file, shot

    @contextmanager
    def watch(self, setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, None]]:
        def observe(progress: Progress) -> None:
            if not self.steps or self.steps[-1] != (path.name, progress.shot.index, progress.step):
                self.steps.append((path.name, progress.shot.index, progress.step))
            if path.name == self._run_file and progress.shot.index == self._shot and progress.records:
                raise KeyboardInterrupt

        yield observe, None

    @property
    def watching(self) -> QueueHooks:
        return QueueHooks(self.said.append, self.watch, process)


def goes_through(folder: Path, count: int, failing: int, stopped: int) -> tuple[QueueRun, ...]:
    """Run a queue of ``count`` with a failing bench, stop it once, take it up again, and return what became of it."""
    paths, absent = scenes(folder, count), absent_bench(folder)
    runs = [(str(path), absent if number == failing else None) for number, path in enumerate(paths)]
    queue = new_queue(runs, folder / "queue")
    first = Watcher(f"{stopped + 1:02d}-scene-{stopped}.h5")
    with pytest.raises(KeyboardInterrupt) as caught:
        run_queue(folder / "queue", queue, first.watching)
    assert any("--resume" in note for note in caught.value.__notes__)
    states = [run.state for run in read_queue(folder / "queue")]
    assert states == ["failed" if number == failing else "done" for number in range(stopped)] + [
        "stopped",
        *["waiting"] * (count - stopped - 1),
    ]
    again = Watcher()
    ended, results = run_queue(folder / "queue", read_queue(folder / "queue"), again.watching)
    assert [run.state for run in ended] == ["failed" if number == failing else "done" for number in range(count)]
    assert ended == read_queue(folder / "queue")
    assert "1 of 2 shots are complete" in " ".join(again.said)
    assert sum("failed" in text for text in again.said) == 1
    assert sorted(results) == list(range(stopped, count))
    # Each shot began with nothing on: the one before had ended with its outputs off, or was the last of its bench.
    for steps in (first.steps, again.steps):
        before = {step: previous for previous, step in itertools.pairwise(steps)}
        for name, shot, step in steps:
            if step is Step.CONFIGURE and shot:
                assert before[(name, shot, step)][2] in (Step.SAFE, Step.MOVE)
    return ended


def nothing_is_lost(folder: Path, ended: tuple[QueueRun, ...]) -> None:
    for run in ended:
        if run.state == "done":
            found = read_run(folder / "queue" / run.run_file)
            assert found.status == "complete"
            assert verify(found.path).as_dict()["sound"]
            alone = hpe.open_run(record_run(prepare(folder / f"{run.name}.toml"), folder / f"alone-{run.name}.h5"))
            for shot in range(2):
                np.testing.assert_array_equal(found.records[shot].codes, alone.records[shot].codes)


def test_a_queue_outlives_a_failing_bench_and_an_interrupt(tmp_path: Path) -> None:
    ended = goes_through(tmp_path, count=3, failing=0, stopped=1)
    assert ended[1].run_file == "02-scene-1-2.h5"
    # What was done in two goes says nothing of how long the others take.
    assert [run.took_s > 0 for run in ended] == [False, False, True]
    assert "the host refuses the connection" in ended[0].why
    nothing_is_lost(tmp_path, ended[1:2])


@pytest.mark.slow
def test_ten_runs_one_failing_bench_one_interrupt_and_nothing_is_lost(tmp_path: Path) -> None:
    nothing_is_lost(tmp_path, goes_through(tmp_path, count=10, failing=3, stopped=6))


def test_the_page_of_a_queue_follows_its_runs_and_says_which_of_how_many_and_how_long(tmp_path: Path) -> None:
    runs = [(str(path), None) for path in scenes(tmp_path, 2)]
    folder, now_s = tmp_path / "queue", [0.0]
    queue = new_queue(runs, folder)
    source = QueueSource(folder, lambda: now_s[0])
    waiting = source.poll()
    assert waiting is not None
    assert (waiting["status"], waiting["queue"]["run"], waiting["queue"]["runs"]) == ("waiting", 1, 2)
    # Nothing is measured yet: the plans alone say how long it takes.
    assert waiting["queue"]["left_s"] == pytest.approx(2 * prepare(runs[0][0]).plan.duration_s, abs=0.06)
    seen = list[dict[str, Any]]()

    @contextmanager
    def watch(setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, None]]:
        def observe(progress: Progress) -> None:
            if progress.shot.index == 1 and progress.step is Step.CONFIGURE:
                seen.append(source.poll() or {})
                source.pause()
                assert pause_requested(path, run_id)
                source.pause()
                assert not pause_requested(path, run_id)

        yield observe, None

    run_queue(folder, queue, QueueHooks(lambda text: None, watch, process))
    assert [(state["status"], state["file"], state["shot"]) for state in seen] == [
        ("running", "01-scene-0.h5", 1),
        ("running", "02-scene-1.h5", 1),
    ]
    assert [(state["queue"]["run"], state["queue"]["done"]) for state in seen] == [(1, 0), (2, 1)]
    # At the pace of the first run, whose plan was as long as the second one's.
    assert seen[1]["queue"]["left_s"] == pytest.approx(read_queue(folder)[0].took_s, rel=1e-3, abs=0.06)
    ended = source.poll()
    assert ended is not None
    assert (ended["status"], ended["ended"].partition(";")[0]) == (
        "complete",
        "The queue has ended: 2 of 2 runs are done",
    )
    with pytest.raises(StoreError, match="has ended"):
        source.stop()


def test_the_page_of_a_queue_that_was_stopped_ends_once_no_run_follows(tmp_path: Path) -> None:
    runs = [(str(path), None) for path in scenes(tmp_path, 2)]
    folder, now_s = tmp_path / "queue", [0.0]
    with pytest.raises(KeyboardInterrupt):
        run_queue(folder, new_queue(runs, folder), Watcher("01-scene-0.h5", 0).watching)
    source = QueueSource(folder, lambda: now_s[0])
    between = source.poll()
    assert between is not None
    assert between["status"] == "running"
    now_s[0] = 3.0
    ended = source.poll()
    assert ended is not None
    assert (ended["status"], ended["queue"]["done"]) == ("aborted", 0)


@pytest.mark.parametrize("content", ["", "[]", "{}", '[{"name": 1}]', "[" * 2000, "\0\xff"])
def test_a_damaged_list_is_said_on_the_page_and_refused_by_the_command(content: str, tmp_path: Path) -> None:
    (tmp_path / "queue.json").write_text(content, encoding="latin-1")
    state = QueueSource(tmp_path).poll()
    assert state is not None
    assert (state["status"], "it lists no runs of a queue" in state["why"]) == ("waiting", True)
    for words in (["queue", "--resume", str(tmp_path)], ["live", str(tmp_path)]):
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 2
        assert "it lists no runs of a queue" in " ".join(done.output.split())


def test_two_programs_do_not_measure_the_queue_of_one_folder(tmp_path: Path) -> None:
    queue = new_queue([(str(scenes(tmp_path, 1)[0]), None)], tmp_path / "queue")
    refusals = list[str]()

    @contextmanager
    def watch(setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, None]]:
        with pytest.raises(StoreError, match=r"another program measures the queue in .*Try") as caught:
            run_queue(tmp_path / "queue", queue, Watcher().watching)
        refusals.append(str(caught.value))
        yield lambda progress: None, None

    ended, _ = run_queue(tmp_path / "queue", queue, QueueHooks(refusals.append, watch, process))
    assert [run.state for run in ended] == ["done"]
    assert any("another program" in text for text in refusals)
    # The lock ends with the queue.
    run_queue(tmp_path / "queue", ended, Watcher().watching)


def test_a_list_names_scenes_and_benches_from_its_own_folder(tmp_path: Path) -> None:
    path = tmp_path / "list.toml"
    runs = '[[run]]\nscene = "a.toml"\n[[run]]\nscene = "table-1"\nbench = "c.toml"\n'
    path.write_text(f'bench = "b.toml"\non_failure = "stop"\n{runs}', "utf-8")
    found, stops = queue_entries([str(path)], None)
    assert stops
    assert found == [(str(tmp_path / "a.toml"), tmp_path / "b.toml"), ("table-1", tmp_path / "c.toml")]
    validator = jsonschema.Draft202012Validator(json_schema("queue"))
    validator.validate(tomllib.loads(path.read_text("utf-8")))
    path.write_text(runs.replace("bench", "bank"), "utf-8")
    assert not validator.is_valid(tomllib.loads(path.read_text("utf-8")))
    with pytest.raises(SettingsError, match="bank"):
        queue_entries([str(path)], None)


def test_a_pause_waits_before_a_shot_with_every_output_off(tmp_path: Path) -> None:
    setup, path = prepare(scenes(tmp_path, 1)[0]), tmp_path / "run.h5"
    steps, said = list[Step](), list[str]()

    def observe(progress: Progress) -> None:
        steps.append(progress.step)
        if progress.shot.index == 0 and progress.step is Step.COLLECT and not progress.records:
            assert toggle_pause(path)

    def go_on(seconds: float) -> None:
        assert steps[-1] in (Step.MOVE, Step.CONFIGURE)
        assert Step.SAFE in steps
        assert read_run(path).shot_complete.tolist() == [True, False]
        assert not toggle_pause(path)

    record_run(setup, path, with_pauses(observe, lambda: pause_requested(path), said.append, go_on))
    assert said == ["paused before shot 2, all outputs are off: p continues, Ctrl-C stops", "continuing"]
    assert read_run(path).status == "complete"


def test_at_a_place_enter_goes_on_and_yes_only_says_where_to(tmp_path: Path) -> None:
    path, said, keys = tmp_path / "run.h5", list[str](), iter(["\n", "x", "\n"])
    _ask_for_moves(path, "one", lambda: next(keys), said.append, has_page=False)(2.25e-3)
    _announce_moves(said.append)(3e-3)
    where = "move the tracking transducer to a lateral offset of {} mm from the push"
    assert said[0] == f"{where.format(2.25)}; all outputs are off. Enter after the movement"
    assert said[1] == where.format(3)
    # The first Enter was pressed before the request.
    assert next(keys, None) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
def test_the_key_p_pauses_and_goes_on_at_a_terminal(tmp_path: Path) -> None:
    import pty
    import time

    (path,) = scenes(tmp_path, 1)
    many = path.read_text(encoding="utf-8").replace("repeats = 2", "repeats = 40")
    path.write_text(many, encoding="utf-8")
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, "-m", "hpe_rig", "run", str(path)])
    seen, pressed = b"", 0
    deadline_s = time.monotonic() + 120
    while time.monotonic() < deadline_s:
        try:
            seen += os.read(terminal, 4096)
        except OSError:
            break
        if b"shot 2" in seen and not pressed:
            os.write(terminal, b"p")
            pressed = 1
        if b"paused before shot" in seen and pressed == 1:
            os.write(terminal, b"p")
            pressed = 2
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert b"continuing" in seen
    assert read_run(tmp_path / "scene-0.h5").status == "complete"
    assert not list(tmp_path.glob("*.pause"))


def test_queue_and_list_state_the_mean_over_repeats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (scene,) = scenes(tmp_path, 1)
    # Repeats differ in the printed digits.
    scene.write_text(scene.read_text(encoding="utf-8").replace("snr_db = 40.0", "snr_db = 15.0"), encoding="utf-8")
    printed = CliRunner().invoke(app, ["queue", str(scene), "--output", "night"]).output
    result = hpe.open_run(tmp_path / "night" / "01-scene-0.h5").estimate()
    (mean,) = result.means
    text, *others = (
        amplitude_text(item.amplitude_m, item.amplitude_uncertainty_m)
        for item in (mean, *(shot.estimates[0] for shot in result.shots))
    )
    assert text not in others
    for output in (printed, CliRunner().invoke(app, ["list", "night"]).output):
        assert text in " ".join(output.split())
