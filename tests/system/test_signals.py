"""Killed, lost, clipped, unreachable: what is left running, what the file holds and what the user is told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.agilent.generator import Agilent33250A
from drivers.interfaces import DeadlineError, InstrumentError
from hpe_rig.bench import instruments as open_instruments, opening as bench_module
from hpe_rig.bench.instruments import UnsafeBenchError, proven_off
from hpe_rig.bench.opening import open_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import acquire
from hpe_rig.measurement.setup import Setup
from hpe_rig.plan.shots import SAFETY_MARGIN_S
from hpe_rig.runs.run import process
from hpe_rig.store import RunWriter, read_run
from sim_backend.wiring import PS_PER_S
from sim_backend.world import World

Prepare = Callable[..., Setup]
posix = pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows")


@pytest.fixture
def worlds(monkeypatch: pytest.MonkeyPatch) -> list[World]:
    """Return a list that every simulated world made from now on is put into."""
    made: list[World] = []
    make = World.__init__

    def noted(world: World, *args: Any, **kwargs: Any) -> None:
        make(world, *args, **kwargs)
        made.append(world)

    monkeypatch.setattr(World, "__init__", noted)
    return made


def assert_safe(world: World) -> None:
    assert not any(world.outputs_on().values())
    assert not world.board.running


def test_whenever_the_program_is_killed_no_toneburst_comes_after_the_programmed_train(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    """SIGKILL stops everything between two I/O calls: the twin then runs on with what is programmed by then."""
    setup = prepared("bovine-muscle-synchronous")
    shot = setup.plan.shots[0]
    train_s = shot.timeline.burst_onset_s[-1] + shot.timeline.burst_length_s
    fired_s: list[float] = []
    left_s: list[float] = []
    fire = Agilent33250A.fire

    def noted_fire(master: Agilent33250A) -> None:
        fired_s.append(worlds[0].clock.now_s())
        fire(master)

    def if_killed_now() -> None:
        (world,) = worlds
        tonebursts, pulses, _ = world.emissions()
        ends_ps = np.concatenate([tonebursts.end_ps, pulses.end_ps])
        left_s.append(max(0.0, (ends_ps.max(initial=0) - world.clock.now_ps) / PS_PER_S))
        latest_ps = world.clock.now_ps + round((train_s + 1e-3) * PS_PER_S)
        assert tonebursts.end_ps.max(initial=0) <= latest_ps
        assert tonebursts.onset_ps.size <= 20

    wire = World.connect

    def watched_wire(world: World, role: str) -> Any:
        made = wire(world, role)
        write = made.write

        def watched(message: str) -> None:
            write(message)
            if_killed_now()

        made.write = watched
        return made

    monkeypatch.setattr(World, "connect", watched_wire)
    monkeypatch.setattr(Agilent33250A, "fire", noted_fire)
    record_run(setup, tmp_path / "run.h5")
    assert len(fired_s) == 1
    print(f"killed at any of {len(left_s)} messages: the bench goes on for at most {max(left_s):.4f} s")
    # It must have been seen running, and never for longer than its finite trains.
    assert 0 < max(left_s) <= shot.train_end_s + 1e-3


@posix
@pytest.mark.slow
def test_a_killed_run_leaves_a_readable_file_that_no_later_run_overwrites(tmp_path: Path) -> None:
    script = """
import os, signal, sys
from hpe_rig.measurement.recording import RunRecorder
write = RunRecorder.write
def killed(recorder, event, *others):
    write(recorder, event, *others)
    if type(event).__name__ == "ShotBlock":
        os.kill(os.getpid(), signal.SIGKILL)
RunRecorder.write = killed
sys.argv = ["hpe-rig", "run", "table-1", "--output", "run.h5"]
from hpe_rig.cli.app import main
main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, cwd=tmp_path, check=False)
    assert done.returncode == -signal.SIGKILL
    left = read_run(tmp_path / "run.h5")
    assert left.status == "killed"
    assert not left.records[0].valid.all()
    again = subprocess.run(
        [sys.executable, "-m", "hpe_rig", "run", "table-1", "--output", "run.h5"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert again.returncode == 2
    assert "already exists" in again.stderr


def test_an_error_while_records_are_stored_leaves_the_bench_safe(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    append, calls = RunWriter.append, []

    def full(writer: RunWriter, *arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) == 3:
            raise OSError("no space left on the device")
        append(writer, *arguments)

    monkeypatch.setattr(RunWriter, "append", full)
    with pytest.raises(OSError, match="no space left"):
        record_run(prepared("bovine-muscle-synchronous"), tmp_path / "run.h5")
    assert_safe(worlds[0])
    run = read_run(tmp_path / "run.h5")
    assert run.status == "failed"
    assert run.records[0].valid.sum() == 2 * len(calls[0][1].codes)


def test_an_error_while_processing_leaves_the_bench_safe_and_the_run_complete(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    def fails(*arguments: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("hpe_rig.processing.estimate_run", fails)
    path = record_run(prepared("table-1"), tmp_path / "run.h5")
    with pytest.raises(ZeroDivisionError):
        process(path)
    assert_safe(worlds[0])
    assert read_run(path).status == "complete"


def test_a_lost_master_ends_the_shot_when_the_plan_says_so(
    prepared: Prepare, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    setup = prepared("bovine-muscle-synchronous")
    fired_s: list[float] = []
    monkeypatch.setattr(Agilent33250A, "fire", lambda master: fired_s.append(worlds[0].clock.now_s()))

    def run() -> None:
        with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
            for _ in acquire(setup.plan, bench):
                pass

    with pytest.raises(DeadlineError, match="0 of 800"):
        run()
    assert_safe(worlds[0])
    waited_s = worlds[0].clock.now_s() - fired_s[0]
    # Making the bench safe afterwards takes a message of 1 ms each and the session's own waits.
    assert waited_s <= setup.plan.shots[0].train_end_s + SAFETY_MARGIN_S + 0.5


def test_an_input_beyond_its_range_becomes_a_warning_of_the_result(prepared: Prepare, tmp_path: Path) -> None:
    edits = ('disturbed = "skip"', 'disturbed = "keep"'), ("[acquisition]", "[acquisition]\ninput_range_v = 0.2")
    loud = process(record_run(prepared("bovine-muscle", *edits), tmp_path / "loud.h5"))
    assert any("shot 1: the digitizer's input left its range of 0.2 V" in warning for warning in loud.warnings)
    with h5py.File(tmp_path / "loud.h5") as file:
        assert file["records/clipped"][()].tolist() == [1]


def test_an_output_that_cannot_be_proven_off_is_named_even_when_ctrl_c_comes_meanwhile(
    prepared: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = prepared("bovine-muscle-synchronous")
    proof = Agilent33250A.prove_off
    deaf: list[str] = []

    def unreachable(generator: Agilent33250A) -> str:
        if generator.role in deaf:
            signal.raise_signal(signal.SIGINT)
            raise InstrumentError(generator.role, "no reply", "its power is off", "switch it off by hand")
        return proof(generator)

    monkeypatch.setattr(Agilent33250A, "prove_off", unreachable)
    monkeypatch.setattr(Agilent33250A, "make_safe", unreachable)

    def run() -> None:
        with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles):
            deaf.append("toneburst")

    with pytest.raises(UnsafeBenchError, match=r"MAY STILL BE DRIVING.*toneburst") as caught:
        run()
    assert caught.value.roles == ("toneburst",)
    assert "by hand, now" in str(caught.value)


def test_an_unreachable_output_has_its_own_exit_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    proof, calls = Agilent33250A.prove_off, list[str]()

    def deaf(generator: Agilent33250A) -> str:
        calls.append(generator.role)
        if calls.count("toneburst") > 1 and generator.role == "toneburst":
            raise TimeoutError("nothing came")
        return proof(generator)

    monkeypatch.setattr(Agilent33250A, "prove_off", deaf)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["run", "bovine-muscle-synchronous", "--output", "run.h5"])
    assert done.exit_code == 3
    assert "THE BENCH MAY STILL BE DRIVING: not proven off: toneburst" in done.stderr
    assert "Known to be off: burst_train, master, tracking_pulser, tracking_train read back as off" in done.stderr
    assert "run.h5 holds the records that had arrived: hpe-rig process run.h5" in done.stderr
    assert "Traceback" not in done.stderr


def test_outputs_left_on_are_off_where_somebody_answers_and_nothing_is_claimed_of_the_others(
    prepared: Prepare, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    """Of two roles another instrument answers; every output was left on by a program before."""
    wire = World.connect

    class Stranger:
        def __init__(self, inner: Any) -> None:
            self.inner, self.close = inner, inner.close

        def write(self, message: str) -> None:
            assert message == "*IDN?"
            self.inner.write(message)

        def read(self) -> str:
            return str(self.inner.read()).replace("33250A", "34401A")

    def left_on(world: World, role: str) -> Any:
        opened = wire(world, role)
        opened.write("OUTP 1")
        return Stranger(opened) if role in ("toneburst", "tracking_train") else opened

    monkeypatch.setattr(World, "connect", left_on)
    setup = prepared("bovine-muscle-synchronous")
    with (
        pytest.raises(InstrumentError, match=r"toneburst: .*34401A") as caught,
        open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles),
    ):
        pass
    assert {role for role, on in worlds[0].outputs_on().items() if on} == {"toneburst", "tracking_train"}
    other, state = caught.value.__notes__
    assert "tracking_train: *IDN? was answered with" in other
    assert "not proven off: toneburst, tracking_train: look" in state


def test_the_checks_of_these_tests_can_fail(
    prepared: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worlds: list[World]
) -> None:
    """A bench that is left as it is, is seen to drive."""
    for module in (bench_module, open_instruments):
        monkeypatch.setattr(module, "make_safe", lambda instruments: None)
    record_run(prepared("bovine-muscle-synchronous"), tmp_path / "run.h5")
    with pytest.raises(AssertionError):
        assert_safe(worlds[0])


def test_of_a_simulated_bench_that_was_never_reached_nobody_is_sent_to_look(
    prepared: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any, **__: Any) -> World:
        raise KeyboardInterrupt

    monkeypatch.setattr(bench_module, "_world", interrupted)
    setup = prepared("bovine-muscle-synchronous")
    with (
        pytest.raises(KeyboardInterrupt) as caught,
        open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles),
    ):
        pass
    assert not getattr(caught.value, "__notes__", [])


def test_nobody_is_sent_to_look_at_a_digitizer_which_has_no_output() -> None:
    proven = {"master": "read back as off"}
    assert "every output is off" in proven_off(["master", "digitizer"], proven)
    assert "burst_train: look whether it is on" in proven_off(["master", "burst_train", "digitizer"], proven)
