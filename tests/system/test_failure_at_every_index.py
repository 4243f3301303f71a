"""A complete measurement with a fault injected at each I/O call in turn: whatever happens, the bench ends safe.

Wires and library are wrapped from outside; the twin underneath knows what is really on.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.page_buffer import PageBuffer
from drivers.interfaces import InstrumentError
from hpe_rig.acquire.run import Setup, record_run
from hpe_rig.bench.instruments import UnsafeBenchError
from hpe_rig.bench.interrupts import Terminated
from hpe_rig.store import StoredRun, read_run
from sim_backend.world import World

Prepare = Callable[..., Setup]

KINDS = ("exception", "timeout", "late reply", "garbage", "peer close", "interrupt", "interrupts", "terminate")
SIGNALS = {"interrupt": signal.SIGINT, "interrupts": signal.SIGINT, "terminate": signal.SIGTERM}
IMPATIENCE = 10
"""How many calls in a row the impatient user's Ctrl-C strikes: the first unwinds, the others meet what makes safe."""
WAIT_TIMEOUT, BUFFER_OVERFLOW = 579, 582
STRIDE = 3
"""The default suite takes every third call, with the kinds in turn; all calls with all kinds are marked slow."""

# Five generators and short trains on prescribed motion: every kind of call is made, the physics costs nothing.
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", "frequencies_hz = [100.0] #"),
    ("[simulation.specimen]", "[[simulation.motion]]\nfrequency_hz = 100.0\namplitude_m = 1e-6 #"),
    ("shear_modulus_pa = 9.0e3\nshear_viscosity_pa_s = 2.0\nforce_density_n_per_m3 = 5.0e6\n", ""),
    ("[simulation.receiver]", "[simulation.scatterers]\nper_cell = 0.05\n[simulation.receiver]"),
)
SINGLE_PORT = ("[simulation]\n", "[simulation]\ninstruments = {dual_port_memory = false}\n")


class InjectedError(Exception):
    """What an injected exception is."""


@dataclass
class Tap:
    """Counts every I/O call of a bench and misbehaves at call ``index``; keeps what the twin and memory know."""

    index: int | None = None
    kind: str = "exception"
    calls: int = 0
    watch: Callable[[], None] = lambda: None
    worlds: list[World] = field(default_factory=list)
    buffers: list[PageBuffer] = field(default_factory=list)
    arrived: int = 0

    def strikes(self) -> bool:
        """Count a call; raise what is raised before any call, else return whether this one goes wrong."""
        self.watch()
        now, self.calls = self.calls == self.index, self.calls + 1
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

    def write(self, message: str) -> None:
        strikes = self._strikes()
        if not strikes or self._tap.kind != "timeout":
            self._wire.write(message)
        if strikes:
            raise TimeoutError("injected")

    def read(self) -> str:
        strikes = self._strikes()
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

    def _strikes(self) -> bool:
        strikes = self._tap.strikes()
        self._open = self._open and not (strikes and self._tap.kind == "peer close")
        if not self._open:
            raise ConnectionResetError("injected")
        return strikes


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
            if strikes:
                return BUFFER_OVERFLOW if self._tap.kind == "garbage" else WAIT_TIMEOUT
            return whole(*arguments)

        function.__name__ = name
        return function


@pytest.fixture
def tapped(monkeypatch: pytest.MonkeyPatch) -> Callable[[Tap], None]:
    """Return a function that puts a tap on every bench opened from then on."""
    wire, library = World.connect, World.alazar_library
    records, make_buffer = AlazarDigitizer.records, PageBuffer.__init__

    def put(tap: Tap) -> None:
        def tapped_wire(world: World, role: str) -> Any:
            tap.worlds.append(world)
            return TappedWire(wire(world, role), tap)

        def counted(board: AlazarDigitizer, deadline_s: float) -> Iterator[Any]:
            for block in records(board, deadline_s):
                tap.arrived += len(block.codes)
                yield block

        def noted(buffer: PageBuffer, size_bytes: int) -> None:
            make_buffer(buffer, size_bytes)
            tap.buffers.append(buffer)

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


def faults_of(tap: Tap, error: BaseException | None, path: Path, whole: StoredRun) -> Iterator[str]:
    """Yield everything that is not as it must be after a measurement with an injected fault."""
    reported = error.roles if isinstance(error, UnsafeBenchError) else ()
    if reported and tap.kind != "peer close":
        yield f"{reported} reported as unreachable after a passing fault"
    world = tap.worlds[0]
    yield from (f"{role} on and not reported" for role, on in world.outputs_on().items() if on and role not in reported)
    if "digitizer" not in reported:
        if not world.digitizer_idle():
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
    if not np.array_equal(run.records[0].codes[valid], whole.records[0].codes[valid]):
        yield "records in the file differ from those of a run without faults"


@pytest.mark.parametrize("memory", ["dual port", "single port"])
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
        tap = Tap(index, kind)
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
    assert len(cases) >= 80
    # A measurement may ride out one lost reply of a query asked again; it must not ride out everything.
    assert raised > len(cases) / 2
    # Nor can an instrument that is gone be proven off.
    assert 0 < reported <= sum(kind == "peer close" for _, kind in cases)
