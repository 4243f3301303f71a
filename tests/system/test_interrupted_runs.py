"""Runs with the instruments in another process: ended by signals at random times, and two programs at one bench.

What is judged is the instruments' own word, asked over connections of the test's, once the run's process is gone. Its
digitizer is the twin's, triggered by the same messages that go to the instruments.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from hpe_rig.bench import BenchFile, parse_bench
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import read_run

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows"),
    # By default `test_stalled_sinks.py` asks instruments of another process.
    pytest.mark.slow,
]

REPEATS = 3
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", "frequencies_hz = [100.0] #"),
    # No medium prior, whose computation would take most of the time.
    ("[processing]\n", '[processing]\nestimator = "kasai"\nharmonic = "least_squares"\n'),
    ("[acquisition]\n", f"[acquisition]\nrepeats = {REPEATS}\n"),
)
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
OUTPUTS = 5

# Loads everything once, then forks a run for each line it is sent: how slow, whether it waits with its first records
# until there is a file `go`, its folder and its command.
RUNNER = """
import dataclasses, json, os, signal, sys, threading, time, typer
from contextlib import suppress
from pathlib import Path
from drivers.alazar.digitizer import AlazarDigitizer
from hpe_rig.bench import opening
from hpe_rig.cli.app import main
import hpe_rig.measurement, hpe_rig.runs, hpe_rig.processing, hpe_rig.cli.watch, hpe_rig.cli.tables, hpe_rig.live
import pyvisa_py, scipy.linalg
signal.signal(signal.SIGINT, signal.default_int_handler)
# What media and beams can do is worked out once, here, for all runs.
hpe_rig.check(sys.argv[1])
SLOWLY_S, HELD = [0.0], [False]

class Both:
    '''An instrument in the other process, and the twin's of this one, which triggers the digitizer.'''
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
    return dataclasses.replace(there, connect=connect, library=here.alazar_library, clock=here.clock)
opening._connect = both
records = AlazarDigitizer.records
def slowly(board, deadline_s):
    for block in records(board, deadline_s):
        # As long as a shot takes, in the small pieces that a wait has.
        for _ in range(4):
            time.sleep(SLOWLY_S[0])
        while HELD[0] and not Path("go").exists():
            Path("held").touch()
            time.sleep(0.01)
        yield block
AlazarDigitizer.records = slowly

def hold(scene, bench):
    import hpe_rig
    with hpe_rig.open_bench(scene, bench):
        time.sleep(0.0 if HELD[0] else 1.0)
        while HELD[0] and not Path("go").exists():
            time.sleep(0.01)

print("ready", flush=True)
for line in sys.stdin:
    asked = json.loads(line)
    if isinstance(asked, int):
        print(os.waitstatus_to_exitcode(os.waitpid(asked, 0)[1]), flush=True)
        continue
    SLOWLY_S[0], HELD[0], folder, *arguments = asked
    child = os.fork()
    if not child:
        os.chdir(folder)
        for name, number in (("out", 1), ("err", 2)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.close(0)
        sys.argv = ["hpe-rig", *arguments]
        if arguments[0] == "library":
            from hpe_rig.cli.console import guarded
            main = lambda: guarded(lambda: hold(*arguments[1:]))()
        try:
            main()
        except SystemExit as end:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code or 0)
        except typer.Exit as end:
            os._exit(end.exit_code)
        os._exit(0)
    print(child, flush=True)
"""


@dataclass
class Rig:
    """Instruments in one process, runs in others; ``bench`` leads there."""

    folder: Path
    bench: BenchFile
    runner: subprocess.Popen[str]
    runs: int = 0

    def start(self, *arguments: str, slowly_s: float = 0.006, held: bool = False) -> tuple[Path, int]:
        """Start a command and return its folder and process; a record takes four times ``slowly_s``.

        ``held``: the first record, or a library's hold on the bench, lasts until there is a file ``go`` in the folder.
        """
        self.runs += 1
        place = self.folder / f"run-{self.runs}"
        place.mkdir()
        return place, self._told([slowly_s, held, str(place), *arguments])

    def ended(self, process: int) -> int:
        """Wait for a process to end and return its exit code, minus the signal where one killed it."""
        return self._told(process)

    def _told(self, asked: object) -> int:
        assert self.runner.stdin is not None
        assert self.runner.stdout is not None
        self.runner.stdin.write(f"{json.dumps(asked)}\n")
        self.runner.stdin.flush()
        return int(self.runner.stdout.readline())

    def outputs_on(self) -> list[str]:
        """Return the roles whose outputs are on, by the instruments' own word."""
        return [role for role, item in self.bench.generators.by_role.items() if asked(item.address or "", "OUTP?")]


def asked(address: str, query: str) -> bool:
    host, port = address.split("::")[1:3]
    with socket.create_connection((host, int(port)), timeout=20.0) as line:
        line.sendall(f"{query}\n".encode())
        return int(line.makefile().readline()) == 1


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("apart")
    text = shipped_scenes()["bovine-muscle-synchronous"]
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "scene.toml").write_text(text, encoding="utf-8")
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
        # Locks of its own: what else goes on on this machine is at other benches, if with a board of that number.
        own = {**os.environ, "HPE_RIG_LOCKS": str(folder)}
        loaded = [sys.executable, "-c", RUNNER, str(folder / "scene.toml")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        runner = stack.enter_context(
            subprocess.Popen(loaded, text=True, env=own, **pipes)  # type: ignore[call-overload]
        )
        stack.callback(runner.terminate)
        assert runner.stdout is not None
        assert runner.stdout.readline() == "ready\n"
        yield Rig(folder, parse_bench("metal", metal).bench, runner)


def wait_for(condition: Callable[[], bool], patience_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


RUN = ("run", "../scene.toml", "--bench", "../metal.toml", "--output", "run.h5")


@pytest.fixture(scope="module")
def undisturbed(rig: Rig) -> tuple[Path, float]:
    """Return the run file of a run that nobody ends, and how long it took, s."""
    start_s = time.monotonic()
    place, process = rig.start(*RUN)
    code = rig.ended(process)
    assert code == 0, (place / "err").read_text(encoding="utf-8")
    assert not rig.outputs_on()
    return place / "run.h5", time.monotonic() - start_s


@pytest.fixture(scope="module")
def undisturbed_s(undisturbed: tuple[Path, float]) -> float:
    return undisturbed[1]


def struck(rig: Rig, numbers: list[signal.Signals], delays_s: list[float]) -> tuple[str, int, list[str]]:
    """Return what a run said that the signals struck, its exit code, and which outputs were on at the first."""
    place, process = rig.start(*RUN)
    on: list[str] = []
    for position, (number, delay_s) in enumerate(zip(numbers, delays_s, strict=True)):
        time.sleep(delay_s)
        on = on if position else rig.outputs_on()
        try:
            os.kill(process, number)
        except ProcessLookupError:
            break
    code = rig.ended(process)
    return (place / "err").read_text(encoding="utf-8"), code, on


def judged(rig: Rig, said: str, code: int) -> list[str]:
    """Return what is wrong with how a struck run ended."""
    wrong = [f"{role} is on" for role in rig.outputs_on()]
    if "Traceback" in said or "Error" in said:
        wrong.append(f"not a message: {said}")
    if code < 0 and said and not said.endswith("\n"):
        wrong.append(f"killed by {-code} in the middle of {said!r}")
    if code not in (0, 3) and code > 0:
        wrong += [] if code in {130, 143, 129} else [f"exit code {code}: {said}"]
        known = re.search(
            r"every output is off, verified|nothing was measured|holds (no|the) records|is complete", said
        )
        # A bench that was never commissioned has its warning before anything is opened.
        outcome = re.sub(r"^WARNING commissioning.*\n", "", said, flags=re.MULTILINE).strip()
        wrong += [] if known or outcome in QUIET else [f"does not say what is known: {said!r}"]
    if code == 3:
        wrong.append(f"claims that an output may be on: {said}")
    return wrong


# Before an instrument was opened there is nothing to say.
QUIET = {"", "hpe-rig: interrupted", "hpe-rig: ended by SIGTERM", "hpe-rig: ended by SIGHUP"}


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("runs", [60])
def test_a_signal_at_any_time_leaves_all_outputs_of_another_process_off(
    rig: Rig, undisturbed_s: float, number: signal.Signals, runs: int
) -> None:
    chance = random.Random(1000 * runs + number)
    wrong, while_on, codes = [], 0, Counter[int]()
    for _ in range(runs):
        delay_s = chance.uniform(0.0, 1.05 * undisturbed_s)
        said, code, on = struck(rig, [number], [delay_s])
        while_on += len(on) >= OUTPUTS - 1
        codes[code] += 1
        wrong += [f"{number.name} after {delay_s:.3f} s: {what}" for what in judged(rig, said, code)]
    print(f"{number.name}: {runs} runs, {while_on} struck while outputs were on, exit codes {dict(codes)}")
    assert not wrong, "\n".join(wrong)
    assert while_on >= runs // 10


@pytest.mark.parametrize("storms", [40])
def test_a_storm_of_mixed_signals_leaves_all_outputs_off_and_says_what_is_known(
    rig: Rig, undisturbed_s: float, storms: int
) -> None:
    chance = random.Random(storms)
    wrong, while_on, codes = [], 0, Counter[int]()
    for _ in range(storms):
        numbers = chance.choices(SIGNALS, k=chance.randint(5, 30))
        first_s = chance.uniform(0.2, 0.9) * undisturbed_s
        delays_s = [first_s, *(chance.choice((0.0, 0.001, 0.01, 0.1)) * chance.random() for _ in numbers[1:])]
        said, code, on = struck(rig, numbers, delays_s)
        while_on += len(on) >= OUTPUTS - 1
        codes[code] += 1
        names = " ".join(number.name for number in numbers)
        wrong += [f"{names} from {first_s:.3f} s on: {what}" for what in judged(rig, said, code)]
    print(f"{storms} storms, {while_on} from a moment on when outputs were on, exit codes {dict(codes)}")
    assert not wrong, "\n".join(wrong)


SCENE = ("../scene.toml", "--bench", "../metal.toml")
COMMANDS = {
    "run": RUN,
    "resume": ("resume", "../aborted.h5", "--bench", "../metal.toml", "--output", "run.h5"),
    "align": ("align", *SCENE),
    "bench": ("bench", "../metal.toml"),
    "library": ("library", "../scene.toml", "../metal.toml"),
}
SECOND = {**COMMANDS, "off": ("bench", "../metal.toml", "--off"), "resume live": ()}


@pytest.fixture(scope="module")
def whole(rig: Rig, undisturbed: tuple[Path, float]) -> Path:
    """Return the run file of a run that nobody disturbed, beside that of one that stopped after its first shot."""
    place, process = rig.start(*RUN)
    wait_for(lambda: (place / "run.h5").exists() and read_run(place / "run.h5").shot_complete.any())
    os.kill(process, signal.SIGINT)
    assert rig.ended(process) == 130
    assert not rig.outputs_on()
    assert not read_run(place / "run.h5").shot_complete.all()
    (place / "run.h5").rename(rig.folder / "aborted.h5")
    return undisturbed[0]


def refused(said: str, process: int) -> bool:
    """Return whether a program was told that ``process`` has the bench, by its number, its command and since when."""
    return bool(re.search(rf"is in use by process {process} \(.*\), since 20\d\d-", said))


def like(run_file: Path, whole: Path) -> bool:
    """Return whether all that ``run_file`` says is complete and trusted is as in a run that nobody disturbed."""
    run, undisturbed = read_run(run_file), read_run(whole)
    shots = [shot for shot in range(REPEATS) if run.shot_complete[shot] and shot not in run.untrusted]
    return all((run.records[shot].codes == undisturbed.records[shot].codes).all() for shot in shots)


@pytest.mark.parametrize("second", SECOND)
@pytest.mark.parametrize("first", COMMANDS)
def test_of_two_programs_at_one_bench_the_second_is_refused_or_safe(
    rig: Rig, whole: Path, first: str, second: str
) -> None:
    # The first run goes on once the second program is over, which comes in between so, on a busy machine too.
    place, process = rig.start(*COMMANDS[first], held=first in ("run", "resume", "library"))
    wait_for(lambda: bool(rig.outputs_on()) if first in ("run", "resume") else holds(rig, process))
    live = place / "run.h5"
    command = SECOND[second] or ("resume", str(live), "--bench", "../metal.toml", "--output", "run.h5")
    other_place, other = rig.start(*command)
    if second == "align":
        # It goes on until it is stopped, where it is not refused.
        wait_for(lambda: "in use" in text_of(other_place / "err") or holds(rig, other))
        os.kill(other, signal.SIGINT)
    code = rig.ended(other)
    (place / "go").touch()
    if first == "align":
        os.kill(process, signal.SIGINT)
    first_code = rig.ended(process)
    said = [(there / "err").read_text(encoding="utf-8") for there in (place, other_place)]
    print(f"{first}, then {second}: {first_code} and {code}: {said[1].strip().splitlines()[:1]}")
    assert not rig.outputs_on()
    assert not any("Traceback" in text for text in said)
    if second == "off":
        # Whoever switches off is never refused; a run that was under way says that its shot is not to be trusted.
        assert code in (0, 1), said[1]
        assert (f"in use by process {process}" in said[1]) or first == "bench"
    elif first == "bench":
        # It may have been done with the bench before the other one came.
        assert refused(said[1], process) or code in (0, 1, 2, 130)
    elif second == "resume live":
        assert code != 0, said[1]
    else:
        assert code in (1, 130), said[1]
        assert refused(said[1], process), said[1]
        assert first_code == (130 if first == "align" else 0), said[0]
    for run_file in (live, other_place / "run.h5"):
        assert not run_file.exists() or like(run_file, whole)


def holds(rig: Rig, process: int) -> bool:
    """Return whether ``process`` has written its name beside a lock."""
    return any(f"process {process} " in text_of(lock) for lock in rig.folder.glob("hpe_rig-*.lock"))


def text_of(path: Path) -> str:
    with suppress(FileNotFoundError):
        return path.read_text(encoding="utf-8")
    return ""


def test_the_lock_of_a_killed_program_is_taken_over(rig: Rig, whole: Path) -> None:
    place, process = rig.start(*RUN, held=True)
    wait_for((place / "held").exists)
    os.kill(process, signal.SIGKILL)
    assert rig.ended(process) == -signal.SIGKILL
    _, switching = rig.start("bench", "../metal.toml", "--off")
    assert rig.ended(switching) in (0, 1)
    # A bench that is switched off anyway stays locked by the killed program's name.
    again, process_again = rig.start(*RUN)
    assert rig.ended(process_again) == 0
    assert f"was left locked by process {process} (hpe-rig run" in (again / "err").read_text(encoding="utf-8")
    assert like(again / "run.h5", whole)
