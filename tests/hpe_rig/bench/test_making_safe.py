"""What is said of instruments that cannot be verified as off: driving, answered late, or without an output."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from drivers.agilent.generator import Agilent33250A
from drivers.interfaces import InstrumentError
from drivers.visa import PrologixAdapter, VisaConnection
from hpe_rig.bench import TRANSPORTS, open_bench, read_bench
from hpe_rig.bench.instruments import (
    SAFE_ORDER,
    DigitizerNotIdleError,
    UnsafeBenchError,
    has_tried,
    make_safe,
    proven_off,
)
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


class AnsweringInstrument(DeadInstrument):
    """An instrument whose answers are ``proof`` or, from the first call on, exceptions; counts the calls."""

    def __init__(self, role: str, *answers: Any, bus: str = "") -> None:
        super().__init__(role)
        self.bus, self.calls = bus, list[str]()
        self._answers = iter(answers)

    def _answer(self, call: str) -> Any:
        self.calls.append(call)
        answer = next(self._answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def switch_off(self) -> None:
        self._answer("switch_off")

    def prove_off(self) -> str:
        return str(self._answer("prove_off"))

    def make_safe(self) -> str:  # type: ignore[override]
        return str(self._answer("make_safe"))


@pytest.mark.parametrize("bus", ["", "GPIB0"])
def test_an_instrument_without_proof_is_made_safe_once_more_whatever_the_first_attempts_raised(bus: str) -> None:
    lost, proof = InstrumentError("master", "lost", "why", "what"), "read back as off"
    sure = AnsweringInstrument("toneburst", None, proof, bus=bus)
    again = AnsweringInstrument("master", OSError("gone"), lost, proof, bus=f"{bus}2" if bus else "")
    proofs = make_safe([sure, again])  # type: ignore[list-item]
    assert proofs == {"toneburst": proof, "master": proof}
    assert sure.calls == ["switch_off", "prove_off"]
    assert again.calls == ["switch_off", "prove_off", "make_safe"]
    never = AnsweringInstrument("master", None, OSError("first"), lost, bus=bus)
    board = AnsweringInstrument("digitizer", None, "idle", bus=bus)
    with pytest.raises(UnsafeBenchError) as caught:
        make_safe([never, board])  # type: ignore[list-item]
    error = caught.value
    assert (error.roles, error.reasons, error.proven) == (("master",), {"master": str(lost)}, {"digitizer": "idle"})
    assert error.tried == (never, board)
    assert str(error).splitlines()[1:] == [
        "  master: lost. Why. Try: what.",
        "Switch these outputs off by hand, now; programmed trains are finite and end by themselves.",
        "Known to be off: digitizer idle.",
    ]


def test_a_board_that_is_busy_does_not_hide_that_outputs_are_off_and_a_retry_of_others_is_known() -> None:
    board = AnsweringInstrument("digitizer", None, OSError("a"), OSError("busy"))
    sure = AnsweringInstrument("toneburst", None, "read back as off")
    with pytest.raises(DigitizerNotIdleError) as caught:
        make_safe([sure, board])  # type: ignore[list-item]
    error = caught.value
    assert "it is not verified to be idle (busy)" in str(error)
    assert "it drives nothing; off, verified: toneburst read back as off" in str(error)
    assert (error.proven, list(error.reasons)) == ({"toneburst": "read back as off"}, ["digitizer"])
    instruments: Any = [sure, board, AnsweringInstrument("master")]
    assert has_tried(error, instruments[:2])
    assert not has_tried(error, instruments)
    assert not has_tried(OSError(), [])


def test_outputs_without_an_identified_instrument_are_named_and_the_digitizer_is_not() -> None:
    proof = "read back as off"
    roles = ("master", "toneburst", "digitizer")
    both = {"master": proof, "toneburst": proof}
    assert proven_off(roles, both) == f"every output is off, verified: master, toneburst {proof}"
    assert proven_off(roles, {"master": proof}) == (
        f"not identified, so not proven off: toneburst: look whether it is on; the others are off, verified: "
        f"master {proof}"
    )
    assert proven_off(roles, {}) == (
        "not identified, so not proven off: master, toneburst: look whether they are on; there are no others"
    )


def test_changes_of_settings_errors_and_instruments_without_answer_are_named_after_a_shot() -> None:
    with open_bench(None, read_bench().bench, SAFE_ORDER) as bench:
        settings = {item.role: item.snapshot() for item in bench.instruments}
        assert bench.world is not None
        assert bench.changed_since(settings) == ()
        bench.world.connect("toneburst").write("OUTP:SYNC 0;NONSENSE")
        assert bench.changed_since(settings) == (
            "toneburst generator: sync output on in the settings before the shot, off in those after it",
            "toneburst: error queue: -113 Undefined header",
        )
        assert [item.role for item in bench.generators] == [
            "master", "burst_train", "toneburst", "tracking_train", "tracking_pulser"
        ]  # fmt: skip
        assert [item.role for item in bench.instruments] == list(SAFE_ORDER)
