"""A terminal, pipe, log, disk or result file that stops at any step of a shot keeps no output on.

The generators are in another process, behind a bench file of a real bench; they are asked over the test's own
connections. The digitizer is the twin's, triggered by the same messages, and delivers its records slowly.
"""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import BenchFile, parse_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import Step
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import read_run

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs pseudo terminals, pipes with names and fork")

TRAIN_S = 1.0
"""Time in which the records of a shot arrive."""
OFF_S = 2.0
"""Time until every output is proven off: after a signal, or after the end of the train without one."""
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", "frequencies_hz = [100.0] #"),
    # No medium prior, whose computation would take most of the time.
    ("[processing]\n", '[processing]\nestimator = "kasai"\nharmonic = "least_squares"\n'),
    ("[acquisition]\n", "[acquisition]\nrepeats = 2\nshot_period_s = 2.0\n"),
)

# Loads everything once, then forks a run for each line: folder, stalling sink, step, shot, records and command.
RUNNER = """
import dataclasses, json, os, signal, sys, threading, time
from contextlib import suppress
from pathlib import Path
from drivers.alazar.digitizer import AlazarDigitizer
from hpe_rig.bench import opening
from hpe_rig.cli.app import main
from hpe_rig.measurement import requests, sequencer
from hpe_rig.store import log
import hpe_rig, hpe_rig.measurement.log, hpe_rig.runs, hpe_rig.processing, hpe_rig.cli.watch, hpe_rig.cli.tables
import rich.progress, scipy.linalg
signal.signal(signal.SIGINT, signal.default_int_handler)
hpe_rig.check(sys.argv[1])
TRAIN_S, SINK, STEP, hung = float(sys.argv[2]), [], [], threading.Event()

class Both:
    '''A generator in the other process, and the twin's in this one, which triggers the digitizer.'''
    guard = threading.RLock()
    def __init__(self, there, here):
        self.there, self.here = there, here
    def write(self, message):
        with self.guard:
            self.here.write(message)
        self.there.write(message)
    def read(self):
        with self.guard, suppress(TimeoutError):
            self.here.read()
        return self.there.read()
    def close(self):
        self.there.close()
    def reopen(self):
        self.there.reopen()
    bus = property(lambda self: self.there.bus)
    timeout_s = property(lambda self: self.there.timeout_s, lambda self, value: setattr(self.there, "timeout_s", value))

connections_of = opening._connect
def both(world, bench, *others, **options):
    there = connections_of(world, bench, *others, **options)
    here = opening._world({"scatterers": {"per_cell": 0.05}}, bench)
    connect = lambda role: Both(there.connect(role), here.connect(role))
    return dataclasses.replace(there, connect=connect, library=here.alazar_library)
opening._connect = both

records = AlazarDigitizer.records
def slowly(board, deadline_s):
    blocks = list(records(board, time.monotonic() + 60.0))
    for block in blocks:
        time.sleep(TRAIN_S / len(blocks))
        yield block
AlazarDigitizer.records = slowly

def full(path):
    descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    for size in (4096, 1):
        with suppress(BlockingIOError):
            while True:
                os.write(descriptor, bytes(size))
    os.close(descriptor)

def stall():
    if SINK[0] == "disk":
        hung.set()
    elif SINK[0] != "file on a full disk":
        full(SINK[1])
    Path("stalled").touch()

def answering(function):
    def call(*arguments):
        while hung.is_set():
            time.sleep(0.01)
        return function(*arguments)
    return call
log.LogWriter._write = answering(log.LogWriter._write)
requests.read_request = answering(requests.read_request)

logging_of = sequencer._with_step_logging
def stalling(observer):
    observer = logging_of(observer)
    def observe(progress):
        if [progress.step, progress.shot.index, progress.records > 0] == STEP and not Path("stalled").exists():
            stall()
        observer(progress)
    return observe
sequencer._with_step_logging = stalling

print("ready", flush=True)
for line in sys.stdin:
    asked = json.loads(line)
    if isinstance(asked, int):
        ended, status = os.waitpid(asked, os.WNOHANG)
        print(os.waitstatus_to_exitcode(status) if ended else "None", flush=True)
        continue
    folder, SINK, STEP, errors, arguments = asked
    child = os.fork()
    if not child:
        os.chdir(folder)
        for name, number in (("out", 1), (errors, 2)):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOCTTY), number)
        os.close(0)
        sys.argv = ["hpe-rig", *arguments]
        if SINK[0] == "log":
            # A disk that takes no more, in the place of that of the log.
            hpe_rig.measurement.log.open_ordinary = lambda path, flags: os.open(SINK[1], os.O_WRONLY)
        try:
            main()
        except SystemExit as end:
            os._exit(end.code or 0)
        os._exit(0)
    print(child, flush=True)
"""


@dataclass
class Rig:
    """Generators in one process, runs in others; ``bench`` leads there."""

    folder: Path
    bench: BenchFile
    runner: subprocess.Popen[str]
    runs: int = 0
    codes: dict[int, int] = field(default_factory=dict)

    def start(self, sink: str, step: tuple[Step, int, bool], scene: str = "scene.toml") -> tuple[Path, int]:
        """Start a run with a ``sink`` that stalls at a step; return its folder and its process."""
        self.runs += 1
        place = self.folder / f"run-{self.runs}"
        place.mkdir()
        arguments = ["--log-level", "debug", "run", f"../{scene}", "--bench", "../metal.toml", "--output", "run.h5"]
        errors, path = "err", ""
        if sink == "terminal":
            errors = path = os.ttyname(os.openpty()[1])
        elif sink == "pipe":
            errors = path = "stopped"
            os.mkfifo(place / path)
        elif sink == "log":
            path = "slow disk"
            arguments.append("--verbose")
            os.mkfifo(place / path)
            # Opened for both, so that the run finds a reader, who never reads.
            os.open(place / path, os.O_RDWR)
        elif sink == "file on a full disk":
            errors = "/dev/full"
        return place, self._answer([str(place), [sink, path], step, errors, arguments])

    def exit_code(self, process: int) -> int | None:
        """Return the exit code of a process, None while it runs."""
        if process not in self.codes and (code := self._answer(process)) is not None:
            self.codes[process] = code
        return self.codes.get(process)

    def kill(self, process: int) -> None:
        if self.exit_code(process) is None:
            os.kill(process, signal.SIGKILL)
            wait_for(lambda: self.exit_code(process) is not None)

    def _answer(self, asked: object) -> int | None:
        assert self.runner.stdin is not None
        assert self.runner.stdout is not None
        self.runner.stdin.write(f"{json.dumps(asked)}\n")
        self.runner.stdin.flush()
        answer = self.runner.stdout.readline()
        return None if answer == "None\n" else int(answer)

    def outputs_on(self) -> list[str]:
        """Return the roles whose outputs are on, by the instruments' own word."""
        return [role for role, item in self.bench.generators.by_role.items() if is_on(item.address or "")]

    def time_until_off_s(self, patience_s: float) -> float:
        """Return how long outputs stay on from now; they must be off three times in a row."""
        start_s, off_s, times = time.monotonic(), 0.0, 0
        while times < 3:
            now_s = time.monotonic() - start_s
            if now_s > patience_s:
                return now_s
            times = 0 if self.outputs_on() else times + 1
            time.sleep(0.02)
            off_s = off_s if times > 1 else now_s
        return off_s


def is_on(address: str) -> bool:
    host, port = address.split("::")[1:3]
    with socket.create_connection((host, int(port)), timeout=20.0) as line:
        line.sendall(b"OUTP?\n")
        return int(line.makefile().readline()) == 1


def wait_for(condition: Callable[[], bool], patience_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("stalled")
    text = shipped_scenes()["bovine-muscle-synchronous"]
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    # Between two shots outputs are off for a moment only, which is easily missed.
    (folder / "single.toml").write_text(text.replace("repeats = 2\n", ""), encoding="utf-8")
    served = folder / "served.toml"
    with ExitStack() as stack:
        printed = stack.enter_context(served.open("w+b"))
        command = [sys.executable, "-m", "hpe_rig", "emulate"]
        emulator = stack.enter_context(subprocess.Popen(command, stdout=printed))
        stack.callback(emulator.terminate)
        wait_for(lambda: "transducer.drive" in served.read_text(encoding="utf-8"))
        metal = served.read_text(encoding="utf-8").replace('transport = "socket"\n', "")
        for simulated, real in (
            ("simulated = true", "simulated = false"),
            ("Simulated bench, wired as Fig. 2 of the paper", "Instruments in another process"),
            ("assumed: no hydrophone has seen it", "A. Tester, with a hydrophone"),
        ):
            metal = metal.replace(simulated, real)
        metal = re.sub(r"(\[generators\.\w+\]\n)", r'\1serial = "none"\n', metal)
        (folder / "metal.toml").write_text(metal, encoding="utf-8")
        environment = {**os.environ, "HPE_RIG_LOCKS": str(folder)}
        loaded = [sys.executable, "-c", RUNNER, str(folder / "scene.toml"), str(TRAIN_S)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        runner = stack.enter_context(
            subprocess.Popen(loaded, text=True, env=environment, **pipes)  # type: ignore[call-overload]
        )
        stack.callback(runner.terminate)
        assert runner.stdout is not None
        assert runner.stdout.readline() == "ready\n"
        yield Rig(folder, parse_bench("metal", metal).bench, runner)


SINKS = ("terminal", "pipe", "log", "disk", "file on a full disk")
COLLECTING = (Step.COLLECT, 0, True)
STEPS = (
    (Step.CONFIGURE, 0, False),
    (Step.VERIFY, 0, False),
    (Step.ARM, 0, False),
    (Step.ENABLE, 0, False),
    (Step.FIRE, 0, False),
    (Step.COLLECT, 0, False),
    COLLECTING,
    (Step.SAFE, 0, True),
    (Step.WAIT, 1, False),
    (Step.COLLECT, 1, True),
)


def cases(*fast: str) -> list[Any]:
    """Return every sink at every step; all but the ``fast`` sinks while records arrive are marked slow."""
    return [
        pytest.param(
            sink,
            step,
            id=f"{sink}-{step[0].value}-{step[1] + 1}-{step[2]:d}",
            marks=() if step == COLLECTING and sink in fast else pytest.mark.slow,
        )
        for sink in SINKS
        for step in STEPS
    ]


@pytest.mark.parametrize(("sink", "step"), cases("disk"))
def test_a_signal_switches_off_within_two_seconds_whatever_sink_has_stopped(
    rig: Rig, sink: str, step: tuple[Step, int, bool]
) -> None:
    place, process = rig.start(sink, step)
    try:
        wait_for((place / "stalled").exists)
        on = rig.outputs_on()
        os.kill(process, signal.SIGTERM if step[1] else signal.SIGINT)
        off_s = rig.time_until_off_s(60.0)
        print(f"{sink}, {step[0].value}: {len(on)} outputs on, off {off_s:.2f} s after the signal")
        assert off_s < OFF_S
        if sink == "disk":
            # The first signal leaves a slow disk its time, the second one does not.
            time.sleep(1.2)
            os.kill(process, signal.SIGTERM)
        # Messages get two seconds, requests beside the run file two, and its last step five.
        wait_for(lambda: rig.exit_code(process) is not None, 20.0)
        assert rig.exit_code(process) == (143 if step[1] else 130)
    finally:
        rig.kill(process)


@pytest.mark.parametrize(("sink", "step"), cases("pipe"))
def test_a_shot_ends_within_two_seconds_of_its_train_whatever_sink_has_stopped(
    rig: Rig, sink: str, step: tuple[Step, int, bool]
) -> None:
    place, process = rig.start(sink, step, "scene.toml" if step[1] else "single.toml")
    try:
        wait_for((place / "stalled").exists)
        off_s = rig.time_until_off_s(60.0)
        print(f"{sink}, {step[0].value}: off {off_s:.2f} s after the sink stopped")
        assert off_s < TRAIN_S + OFF_S
        if sink != "disk":
            wait_for(lambda: rig.exit_code(process) is not None)
            assert rig.exit_code(process) == 0
            assert read_run(place / "run.h5").shot_complete.all()
    finally:
        rig.kill(process)
    assert not rig.outputs_on() or sink == "disk"


def test_no_trigger_starts_the_trains_of_a_killed_run_again(rig: Rig) -> None:
    """Once the master has fired its output is off: neither its key nor another program's trigger reaches the others."""
    place, process = rig.start("pipe", COLLECTING, "single.toml")
    wait_for((place / "stalled").exists)
    rig.kill(process)
    # Nobody was there to switch the others off.
    assert set(rig.outputs_on()) == set(rig.bench.generators.by_role) - {"master"}
    switched = CliRunner().invoke(app, ["bench", str(rig.folder / "metal.toml"), "--off"])
    assert "read back as off" in switched.output
    assert not rig.outputs_on()
