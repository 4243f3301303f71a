"""A complete measurement with a fault injected at each I/O call in turn: whatever happens, the bench ends safe.

Wires and library are wrapped from outside; the twin underneath knows what is really on, and when that ended.
"""

from __future__ import annotations

import os
import signal
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count, cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.page_buffer import PageBuffer
from drivers.interfaces import InstrumentError
from hpe_rig.bench import TRANSPORTS, instruments, opening, read_bench
from hpe_rig.bench.instruments import UnsafeBenchError
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup
from hpe_rig.store import StoredRun, read_run
from sim_backend.world import World

Prepare = Callable[..., Setup]
needs_pty = pytest.mark.skipif(os.name == "nt", reason="needs a pseudo terminal")

PASSING = (
    "exception",
    "timeout",
    "late reply",
    "garbage",
    "interrupt",
    "interrupts",
    "terminate",
    "hang up",
    "foreign",
)
"""Faults after which every instrument can be proven off; "foreign" is another program's setting, output on included."""
LASTING = ("peer close", "mute", "dead", "stuck relay")
"""Faults that last: hung up for good, obeying without a word, neither, and an output that no switch turns off."""
KINDS = (*PASSING, *LASTING)
OVER_A_LINE = ("dropped link", *KINDS)
"""A dropped link can be opened again, which a wire in the same process cannot."""
SIGNALS = {"interrupt": signal.SIGINT, "interrupts": signal.SIGINT, "terminate": signal.SIGTERM}
SIGNALS["hang up"] = getattr(signal, "SIGHUP", signal.SIGTERM)
IMPATIENCE = 10
"""How many calls in a row the impatient user's Ctrl-C strikes: the first unwinds, the others meet what makes safe."""
WAIT_TIMEOUT, BUFFER_OVERFLOW = 579, 582
STRIDE = 24
"""The default suite takes every 24th call, with the kinds in turn; all calls with all kinds are marked slow."""

# Five generators and short trains on prescribed motion: every kind of call is made, the physics costs nothing.
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", "frequencies_hz = [100.0] #"),
    ("[simulation.specimen]", "[[simulation.motion]]\nfrequency_hz = 100.0\namplitude_m = 1e-6 #"),
    ('preset = "bovine_muscle" ', "#"),
    ("force_density_n_per_m3 = 2.2e6 ", "#"),
    ("[simulation.receiver]", "[simulation.scatterers]\nper_cell = 0.05\n[simulation.receiver]"),
)
SINGLE_PORT = ("[simulation]\n", "[simulation]\ninstruments = {dual_port_memory = false}\n")


class InjectedError(Exception):
    """What an injected exception is."""


@dataclass
class Tap:
    """Counts every I/O call of a bench and misbehaves at call ``index``; keeps what the twin and memory know.

    ``last_switch`` is the last call that switched an output off; ``proven``: whether all were proven off before the
    fault, so that what another program switches on is its own.
    """

    index: int | None = None
    kind: str = "exception"
    calls: int = 0
    watch: Callable[[], None] = lambda: None
    worlds: list[World] = field(default_factory=list)
    buffers: list[PageBuffer] = field(default_factory=list)
    arrived: int = 0
    struck_s: float | None = None
    last_switch: int = 0
    proven: bool = False
    meddle: Callable[[], None] = lambda: None
    guard: Any = field(default_factory=threading.Lock)

    def strikes(self) -> bool:
        """Count a call; raise what is raised before any call, else return whether this one goes wrong."""
        self.watch()
        with self.guard:
            now, self.calls = self.calls == self.index, self.calls + 1
        if now:
            self.struck_s = time.monotonic()
        if now and self.kind == "foreign":
            self.meddle()
            return False
        again = self.kind == "interrupts" and self.index is not None and 0 <= self.calls - 1 - self.index < IMPATIENCE
        if (now or again) and self.kind in SIGNALS:
            signal.raise_signal(SIGNALS[self.kind])
        if now and self.kind == "exception":
            raise InjectedError
        return now and self.kind not in SIGNALS


class TappedWire:
    """A text connection that can go wrong."""

    def __init__(self, wire: Any, tap: Tap) -> None:
        self._wire, self._tap, self._open, self._late = wire, tap, True, list[str]()
        self._lasting = ""

    def write(self, message: str) -> None:
        strikes = self._strikes()
        if "OUTP 0" in message:
            self._tap.last_switch = self._tap.calls
        if self._lasting == "stuck relay":
            # The switch is taken and nothing happens, which the read-back tells.
            message = message.replace("OUTP 0", "*WAI")
        if self._lasting != "dead" and not (strikes and self._tap.kind in ("timeout", "dropped link")):
            self._wire.write(message)
        if strikes and not self._lasting:
            raise TimeoutError("injected")

    def read(self) -> str:
        strikes = self._strikes()
        if self._lasting in ("mute", "dead"):
            until_s = time.monotonic() + getattr(self, "timeout_s", 0.0)
            self._drop()
            time.sleep(max(0.0, until_s - time.monotonic()))
            raise TimeoutError("injected")
        if self._lasting:
            return self._wire.read()
        reply = self._late.pop(0) if self._late else self._wire.read()
        if strikes and self._tap.kind == "garbage":
            return "\x00\xff,;garbage"
        if strikes and self._tap.kind == "late reply":
            self._late.append(reply)
        if strikes:
            raise TimeoutError("injected")
        return reply

    def close(self) -> None:
        self._wire.close()

    def _drop(self) -> None:
        """Let nobody read what the instrument says."""
        if self._lasting == "mute":
            with suppress(TimeoutError):
                self._wire.read()

    def _strikes(self) -> bool:
        strikes = self._tap.strikes()
        if strikes and self._tap.kind in ("mute", "dead", "stuck relay"):
            self._lasting = self._tap.kind
        if strikes and self._tap.kind == "dropped link":
            self._open = False
        self._open = self._open and not (strikes and self._tap.kind == "peer close")
        if not self._open:
            raise ConnectionResetError("injected")
        return strikes


class TappedLine(TappedWire):
    """A connection over a real transport: it can be opened again, unless its peer has gone for good."""

    bus = property(lambda line: line._wire.bus)
    timeout_s = property(lambda line: line._wire.timeout_s, lambda line, value: setattr(line._wire, "timeout_s", value))

    def reopen(self) -> None:
        if self._tap.kind == "peer close" and not self._open:
            raise ConnectionRefusedError("injected")
        self._wire.reopen()
        self._open = True


class TappedLibrary:
    """The vendor's functions, which can go wrong: unreachable is the board that answers no call any more."""

    def __init__(self, library: Any, tap: Tap) -> None:
        self._library, self._tap, self._alive = library, tap, True

    def __getattr__(self, name: str) -> Any:
        whole = getattr(self._library, name)

        def function(*arguments: Any) -> Any:
            strikes = self._tap.strikes()
            self._alive = self._alive and not (strikes and self._tap.kind == "peer close")
            if not self._alive:
                raise OSError("injected")
            if strikes and self._tap.kind == "late reply":
                whole(*arguments)
            if strikes and self._tap.kind == "stuck relay":
                return whole(*arguments)
            if strikes:
                return BUFFER_OVERFLOW if self._tap.kind == "garbage" else WAIT_TIMEOUT
            return whole(*arguments)

        function.__name__ = name
        return function


@pytest.fixture
def transport() -> str:
    return ""


@pytest.fixture
def tapped(monkeypatch: pytest.MonkeyPatch, transport: str) -> Callable[[Tap], None]:
    """Return a function that puts a tap on every bench opened from then on."""
    wire, library = World.connect, World.alazar_library
    records, make_buffer = AlazarDigitizer.records, PageBuffer.__init__
    make_world, over_visa = opening._world, opening._visa_connections

    def put(tap: Tap) -> None:
        def noted_world(*arguments: Any) -> World:
            tap.worlds.append(make_world(*arguments))
            tap.meddle = lambda: wire(tap.worlds[0], "toneburst").write("VOLT 2;:OUTP 1")
            return tap.worlds[0]

        def tapped_wire(world: World, role: str, *over_serial: bool) -> Any:
            made = wire(world, role, *over_serial)
            # Behind a transport it is the other end that is tapped.
            return made if transport else TappedWire(made, tap)

        def tapped_lines(*arguments: Any) -> Callable[[str], TappedLine]:
            connect = over_visa(*arguments)
            return lambda role: TappedLine(connect(role), tap)

        def counted(board: AlazarDigitizer, deadline_s: float) -> Iterator[Any]:
            for block in records(board, deadline_s):
                tap.arrived += len(block.codes)
                yield block

        def noted(buffer: PageBuffer, size_bytes: int) -> None:
            make_buffer(buffer, size_bytes)
            tap.buffers.append(buffer)

        monkeypatch.setattr(opening, "_world", noted_world)
        monkeypatch.setattr(opening, "_visa_connections", tapped_lines)
        monkeypatch.setattr(World, "connect", tapped_wire)
        monkeypatch.setattr(World, "alazar_library", lambda world: TappedLibrary(library(world), tap))
        monkeypatch.setattr(AlazarDigitizer, "records", counted)
        monkeypatch.setattr(PageBuffer, "__init__", noted)

    return put


def attempt(setup: Setup, path: Path) -> BaseException | None:
    """Measure and return what was raised."""
    try:
        record_run(setup, path)
    except (InstrumentError, UnsafeBenchError, InjectedError, KeyboardInterrupt, Terminated) as error:
        return error
    return None


def reported_roles(error: BaseException | None) -> tuple[str, ...]:
    """Return the roles that ``error`` names as not verified; the digitizer may be in a note of another error."""
    outputs = error.roles if isinstance(error, UnsafeBenchError) else ()
    said = " ".join([str(error), *getattr(error, "__notes__", ())])
    return (*outputs, *(["digitizer"] if "digitizer: it is not verified to be idle" in said else []))


def faults_of(tap: Tap, error: BaseException | None, path: Path, whole: StoredRun) -> Iterator[str]:
    """Yield everything that is not as it must be after a measurement with an injected fault."""
    reported = reported_roles(error)
    if isinstance(error, UnsafeBenchError) and set(reported) <= {"digitizer"}:
        yield "the bench is said to be driving, and every output is proven off"
    if reported and tap.kind not in LASTING:
        yield f"{reported} reported as unreachable after a passing fault"
    world = tap.worlds[0]
    said = " ".join([str(error), *getattr(error, "__notes__", ())])
    if "every output is off" in said and any(world.outputs_on().values()) and not tap.proven:
        yield "claims that every output is off"
    if not tap.proven:
        on = [role for role, on in world.outputs_on().items() if on and role not in reported]
        yield from (f"{role} on and not reported" for role in on)
    if "digitizer" not in reported:
        if world.is_capturing():
            yield "digitizer capturing and not reported"
        if any(not buffer.freed for buffer in tap.buffers):
            yield "buffers not freed"
    if not path.exists():
        # Nothing was programmed yet.
        if tap.arrived or error is None:
            yield f"no file after {error!r} and {tap.arrived} records"
        return
    run = read_run(path)
    if (run.status == "complete") != (error is None):
        yield f"status {run.status} after {error!r}"
    valid = run.records[0].valid
    if int(valid.sum()) != tap.arrived:
        yield f"{tap.arrived} records arrived, {int(valid.sum())} are in the file"
    if run.untrusted and tap.kind not in ("foreign", *LASTING):
        yield f"marked as untrusted: {run.untrusted}"
    if run.untrusted:
        # Nobody is to rely on what arrived.
        return
    if not np.array_equal(run.records[0].codes[valid], whole.records[0].codes[valid]):
        yield "records in the file differ from those of a run without faults"


@pytest.mark.parametrize("memory", ["dual port", pytest.param("single port", marks=pytest.mark.slow)])
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["sample", "every"])
def test_a_fault_at_any_io_call_leaves_the_bench_safe_and_the_records_kept(
    prepared: Prepare, tmp_path: Path, tapped: Callable[[Tap], None], memory: str, every: bool
) -> None:
    setup = prepared("bovine-muscle-synchronous", *SHORT, *([SINGLE_PORT] if memory == "single port" else []))
    clean = Tap()
    tapped(clean)
    whole = read_run(record_run(setup, tmp_path / "whole.h5"))
    assert clean.arrived == 16
    if every:
        cases = [(index, kind) for kind in KINDS for index in range(clean.calls)]
    else:
        offset = STRIDE // 2 if memory == "single port" else 0
        cases = [(index, KINDS[index // STRIDE % len(KINDS)]) for index in range(offset, clean.calls, STRIDE)]
    unsafe, raised, reported = [], 0, 0
    for number, (index, kind) in zip(count(), cases, strict=False):
        tap = Tap(index, kind, proven=kind == "foreign" and index >= clean.last_switch)
        tapped(tap)
        path = tmp_path / f"{number}.h5"
        error = attempt(setup, path)
        raised += error is not None
        reported += isinstance(error, UnsafeBenchError)
        assert tap.calls > index
        unsafe += [f"{kind} at call {index}: {fault} ({error!r})" for fault in faults_of(tap, error, path, whole)]
        path.unlink(missing_ok=True)
    print(f"{memory}: {len(cases)} faults at {clean.calls} calls, {raised} ended the run, ", end="")
    print(f"{reported} named an instrument as unreachable, {len(unsafe)} unsafe")
    assert not unsafe, "\n".join(unsafe)
    assert len(cases) >= len(KINDS)
    # A measurement may ride out one lost reply of a query asked again; it must not ride out everything.
    assert raised > len(cases) / 2
    # Nor can an instrument that is gone be proven off.
    assert 0 < reported <= sum(kind in LASTING for _, kind in cases)


@contextmanager
def outputs_watched(tap: Tap) -> Iterator[dict[str, float]]:
    """Yield what ends up with the time of the last moment at which each output was on, by role."""
    last_s, done = dict[str, float](), threading.Event()

    def watch() -> None:
        while not done.wait(0.001):
            for role, on in tap.worlds[0].outputs_on().items() if tap.worlds else ():
                if on:
                    last_s[role] = time.monotonic()

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield last_s
    finally:
        done.set()
        watcher.join()


@pytest.mark.parametrize(
    "transport",
    [
        TRANSPORTS[0],
        *(
            pytest.param(name, marks=[pytest.mark.slow, *([needs_pty] if name == "serial" else [])])
            for name in TRANSPORTS[1:]
        ),
    ],
)
@pytest.mark.slow
@pytest.mark.parametrize("every", [False, True], ids=["few", "many"])
def test_a_fault_over_a_real_transport_leaves_the_bench_safe(
    prepared: Prepare,
    tmp_path: Path,
    tapped: Callable[[Tap], None],
    monkeypatch: pytest.MonkeyPatch,
    transport: str,
    every: bool,
) -> None:
    bench = tmp_path / "bench.toml"
    simulated = f'simulated = true\ntransport = "{transport}"'
    bench.write_text(read_bench().text.replace("simulated = true", simulated), encoding="utf-8")
    setup = prepared("bovine-muscle-synchronous", *SHORT, bench=bench)
    clean = Tap()
    tapped(clean)
    whole = read_run(record_run(setup, tmp_path / "whole.h5"))
    started: list[float] = []
    make_safe = instruments.make_safe

    def noted(*arguments: Any) -> Any:
        started.append(time.monotonic())
        return make_safe(*arguments)

    for module in (instruments, opening):
        monkeypatch.setattr(module, "make_safe", noted)
    if every:
        # Sparsely while the bench is programmed, closely where outputs are on.
        indices = [*range(26, clean.calls - 60, 53), *range(clean.calls - 60, clean.calls, 11)]
        cases = [(index, kind) for index in indices for kind in OVER_A_LINE]
    else:
        cases = list(zip(range(14, clean.calls, 61), cycle(OVER_A_LINE), strict=False))
    unsafe, raised, reported, off_s, ended_s, since_fault_s = [], 0, 0, [], [], []
    for number, (index, kind) in enumerate(cases):
        # The lines end at the same time: which call of theirs is the last to switch is chance.
        tap = Tap(index, kind, proven=kind == "foreign" and index >= clean.last_switch - 10)
        tapped(tap)
        started.clear()
        path = tmp_path / f"{number}.h5"
        with outputs_watched(tap) as last_s:
            error = attempt(setup, path)
            end_s = time.monotonic()
        raised += error is not None
        reported += isinstance(error, UnsafeBenchError)
        unsafe += [f"{kind} at call {index}: {fault} ({error!r})" for fault in faults_of(tap, error, path, whole)]
        begun_s = [at_s for at_s in started if tap.struck_s is not None and at_s >= tap.struck_s]
        # One that is dead or stuck stays on, which is reported: what counts is that the others do not wait for it.
        left = error.roles if isinstance(error, UnsafeBenchError) and kind != "mute" else ()
        on_s = [last for role, last in last_s.items() if role not in left]
        if begun_s and error is not None and not tap.proven:
            off_s.append(max([0.0, *(last - begun_s[0] for last in on_s)]))
            since_fault_s.append(max([0.0, *(last - (tap.struck_s or 0.0) for last in on_s)]))
            ended_s.append((end_s - begun_s[0], f"{kind} at call {index}"))
    print(f"{transport}: {len(cases)} faults at {clean.calls} calls, {raised} ended the run, ", end="")
    print(f"{reported} named an instrument, {len(unsafe)} unsafe or claimed wrongly; all outputs off after ", end="")
    print(f"{statistics.median(off_s):.3f} s (worst {max(off_s):.3f} s) of making safe, ", end="")
    print(f"{statistics.median(since_fault_s):.3f} s (worst {max(since_fault_s):.3f} s) of the fault; ", end="")
    worst_s, when = max(ended_s)
    print(f"run ended after {statistics.median(took for took, _ in ended_s):.3f} s (worst {worst_s:.3f} s, {when})")
    assert not unsafe, "\n".join(unsafe)
