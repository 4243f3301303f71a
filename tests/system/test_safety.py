"""Whatever happens at whatever step, every output of the twin is off and its digitizer idle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.alazar.digitizer import AlazarDigitizer
from drivers.interfaces import InstrumentError, RecordBlock
from hpe_rig.bench import Condition
from hpe_rig.bench.instruments import Bench, UnsafeBenchError, has_tried, proven_off
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.bench.opening import open_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement.sequencer import SAFETY_MARGIN_S, Progress, Step, acquire
from hpe_rig.measurement.setup import Setup

Prepare = Callable[..., Setup]


ABSENT = Condition(name="level", command=("no-such-program-here",))
"""A condition without limits, so that every shot has the step that reads conditions."""


def run_until(setup: Setup, step: Step, error: BaseException) -> Bench:
    """Run the sequencer, raise ``error`` as it enters ``step``, and return the bench as it was left."""
    seen: list[Bench] = []

    def observe(progress: Progress) -> None:
        if progress.step is step:
            raise error

    def measure() -> None:
        with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
            seen.append(bench)
            for _ in acquire(setup.plan, bench, observe, conditions=[ABSENT]):
                pass

    with pytest.raises(type(error)):
        measure()
    return seen[0]


def assert_safe(bench: Bench) -> None:
    world = bench.world
    assert world is not None
    assert not any(world.outputs_on().values())
    assert not world.is_capturing()


ERRORS = (KeyboardInterrupt(), Terminated(), RuntimeError("a bug"))


@pytest.mark.parametrize(
    ("step", "error"),
    [
        # By default Ctrl-C comes at every step, the other errors while outputs are on.
        pytest.param(
            step,
            error,
            id=f"{type(error).__name__}-{step}",
            marks=() if error is ERRORS[0] or step is Step.COLLECT else pytest.mark.slow,
        )
        for error in ERRORS
        for step in Step
    ],
)
@pytest.mark.parametrize("dual_port", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_an_interruption_at_any_step_leaves_outputs_off_and_the_digitizer_idle(
    prepared: Prepare, step: Step, error: BaseException, dual_port: bool
) -> None:
    memory = ("[simulation]\n", f"[simulation]\ninstruments = {{dual_port_memory = {str(dual_port).lower()}}}\n")
    twice = ("[acquisition]\n", "[acquisition]\nrepeats = 2\nshot_period_s = 1.0\n")
    assert_safe(run_until(prepared("bovine-muscle", memory, twice), step, error))


def test_outputs_are_on_when_the_master_fires(prepared: Prepare) -> None:
    setup = prepared("bovine-muscle")
    on: dict[str, bool] = {}
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        assert bench.world is not None
        world = bench.world

        def observe(progress: Progress) -> None:
            if progress.step is Step.FIRE:
                on.update(world.outputs_on())

        for _ in acquire(setup.plan, bench, observe):
            pass
    assert all(on.values())
    assert_safe(bench)


def test_what_is_off_is_claimed_of_nobody_else() -> None:
    known = {"master": "read back as off", "digitizer": "idle"}
    assert proven_off(["master", "digitizer"], known).startswith("every output is off, verified: ")
    # The digitizer drives nothing by itself.
    assert proven_off(["master", "digitizer"], {"master": "read back as off"}).startswith("every output is off")
    said = proven_off(["master", "toneburst"], known)
    assert said.startswith("not identified, so not proven off: toneburst: look whether it is on; the others are off")
    assert "they are on; there are no others" in proven_off(["master", "toneburst"], {})


@pytest.mark.parametrize(("scene", "role"), [("bovine-muscle", "toneburst"), ("table-1", "tracking_pulser")])
def test_no_driver_drives_a_transducer_harder_than_the_bench_allows(prepared: Prepare, scene: str, role: str) -> None:
    setup = prepared(scene)
    bench_file = setup.bench.bench
    limited = bench_file.model_copy(update={"limits": bench_file.limits.model_copy(update={"max_drive_vpp": 0.05})})
    with (
        open_bench(setup.scene.scene, limited, setup.plan.roles) as bench,
        pytest.raises(InstrumentError, match=rf"{role}.*0\.05"),
    ):
        for _ in acquire(setup.plan, bench):
            pass
    assert_safe(bench)


def test_records_are_waited_for_until_the_train_has_ended_and_counted_as_they_come(
    prepared: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, given, counted, records = prepared("table-1"), [], [], AlazarDigitizer.records

    def noted(board: AlazarDigitizer, deadline_s: float) -> Iterator[RecordBlock]:
        given.append(deadline_s - bench.clock.now_s())
        yield from records(board, deadline_s)

    monkeypatch.setattr(AlazarDigitizer, "records", noted)
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        for _ in acquire(setup.plan, bench, lambda progress: counted.append((progress.step, progress.records))):
            pass
    (shot,) = setup.plan.shots
    assert given == pytest.approx([shot.train_end_s + SAFETY_MARGIN_S])
    come = [count for step, count in counted if step is Step.COLLECT]
    assert (come[0], come[-1]) == (0, 101)
    assert come == sorted(come)


def test_an_error_concerns_the_instruments_that_were_tried_and_no_others(prepared: Prepare) -> None:
    setup = prepared("bovine-muscle")
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        first, *others = bench.instruments
        error = UnsafeBenchError([(first.role, RuntimeError("no reply"))], {}, [first])
        assert has_tried(error, [first])
        assert not has_tried(error, others)
        assert not has_tried(error, [first, *others])


def test_a_consumer_that_stops_early_leaves_outputs_off(prepared: Prepare) -> None:
    setup = prepared("bovine-muscle")
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        events = acquire(setup.plan, bench)
        next(events)
        next(events)
        events.close()
        assert_safe(bench)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="a console's Ctrl-C cannot be sent to one process on Windows")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_in_the_middle_of_a_run_ends_with_its_code_and_a_readable_file(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    script = f"""
import os, signal, sys
from hpe_rig.measurement import sequencer
fire = sequencer._collect
def collect(*args):
    os.kill(os.getpid(), {int(number)})
    yield from fire(*args)
sequencer._collect = collect
sys.argv = ["hpe-rig", "run", "table-1", "--output", "run.h5"]
from hpe_rig.cli.app import main
main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == code, done.stderr
    assert "every output is off, verified" in done.stderr
    assert "Traceback" not in done.stderr
    again = CliRunner().invoke(app, ["process", str(tmp_path / "run.h5")])
    assert again.exception is None or isinstance(again.exception, SystemExit)
