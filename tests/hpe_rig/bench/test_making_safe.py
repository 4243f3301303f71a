"""What is said of instruments that cannot be verified as off: driving, answered late, or without an output."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from drivers.agilent.generator import Agilent33250A
from drivers.visa import PrologixAdapter, VisaConnection
from hpe_rig.bench import TRANSPORTS
from hpe_rig.bench.instruments import UnsafeBenchError, make_safe
from hpe_rig.cli.app import app
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports import Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection, World

LATE_S = 0.7
"""Longer than the short time-out of making safe, shorter than the usual one."""


@pytest.fixture(params=["socket", *(pytest.param(name, marks=pytest.mark.slow) for name in TRANSPORTS[1:])])
def late(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Agilent33250A]]:
    """Yield a simulated generator with its output on, and the driver; every reply comes ``LATE_S`` late."""
    instrument = Generator33250A(SimulatedClock(), 100e-9)

    def connect(role: str, over_serial: bool) -> GeneratorConnection:
        return GeneratorConnection(instrument, SimulatedClock(), 0.0, over_serial)

    with Emulator(request.param, connect, ("toneburst",)) as emulator:
        served = emulator.served["toneburst"]
        adapter = PrologixAdapter(served.interface) if served.interface else None
        connection = VisaConnection(served.address, backend="@py", adapter=adapter)
        driver = Agilent33250A(connection, "toneburst")
        driver.identify()
        instrument.write("OUTP 1")
        read = GeneratorConnection.read

        def slow_read(line: GeneratorConnection) -> str:
            reply = read(line)
            time.sleep(LATE_S)
            return reply

        monkeypatch.setattr(GeneratorConnection, "read", slow_read)
        yield instrument, driver
        connection.close()
        if adapter:
            adapter.close()


def test_an_instrument_that_answers_late_is_proven_off(late: tuple[Any, Agilent33250A]) -> None:
    instrument, driver = late
    proofs = make_safe([driver])
    assert not instrument.registers.output
    assert proofs["toneburst"].startswith("read back as off")


class StuckBoard:
    """The vendor's library with a board that never becomes idle."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        return (lambda *_: 1) if name == "AlazarBusy" else getattr(self._library, name)


@pytest.fixture
def stuck_board(monkeypatch: pytest.MonkeyPatch) -> None:
    library = World.alazar_library
    monkeypatch.setattr(World, "alazar_library", lambda world: StuckBoard(library(world)))


@pytest.mark.usefixtures("stuck_board")
@pytest.mark.parametrize("command", [("bench", "--off"), ("run", "table-1", "--output", "run.h5")])
def test_a_board_that_does_not_become_idle_drives_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 1
    assert "drives nothing" in result.output
    assert "read back as off" in result.output
    assert "MAY STILL BE DRIVING" not in result.output
    assert "NOT PROVEN" not in result.output


class DeadInstrument:
    """An instrument that cannot be verified in any way."""

    bus = ""

    def __init__(self, role: str) -> None:
        self.role = role

    def switch_off(self) -> None: ...

    def prove_off(self) -> str:
        raise OSError("no answer")

    make_safe = prove_off


def test_only_outputs_are_named_as_driving() -> None:
    with pytest.raises(UnsafeBenchError) as caught:
        make_safe([DeadInstrument("master"), DeadInstrument("digitizer")])  # type: ignore[list-item]
    first_line = str(caught.value).splitlines()[0]
    assert first_line == "THE BENCH MAY STILL BE DRIVING: not proven off: master"
    assert caught.value.roles == ("master", "digitizer")
    assert "no answer" in str(caught.value)
