"""What goes wrong on a connection, over every transport: always an error that says so, never another query's answer."""

from __future__ import annotations

import gc
import os
import re
import socket
import time
import warnings
from collections.abc import Callable, Iterator

import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.agilent.scpi import ScpiSession
from drivers.interfaces import InstrumentError, PulseTrain
from drivers.visa import PrologixAdapter, VisaConnection
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports.emulator import TRANSPORTS, Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=float("inf"))
TIMEOUT_S = 0.2

# pyvisa-py leaves the socket of a failed open over HiSLIP or VXI-11 to the garbage collector, and Python warns of it.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")


@pytest.fixture(scope="module", autouse=True)
def collect_sockets_of_failed_opens() -> Iterator[None]:
    yield
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


class Unreliable:
    """A simulated generator; ``mishap`` is called once with the reply to the first message that holds ``query``."""

    def __init__(self) -> None:
        self.generator = Generator33250A(SimulatedClock(), 100e-9)
        self._connection = GeneratorConnection(self.generator, SimulatedClock(), 0.0)
        self.query = ""
        self.mishap: Callable[[str], str] = str
        self._asked = False

    def write(self, message: str) -> None:
        if message != "SYST:REM":
            self._connection.write(message)
        self._asked = bool(self.query) and self.query in message

    def read(self) -> str:
        reply = self._connection.read()
        if not self._asked:
            return reply
        self.query, self._asked = "", False
        return self.mishap(reply)

    def serial_poll(self) -> int:
        return self._connection.serial_poll()


class Bench:
    """An unreliable generator, its emulator and the session that reaches it."""

    def __init__(self, transport: str) -> None:
        self.transport = transport
        self.instrument = Unreliable()
        self.emulator = Emulator(transport, lambda role, serial: self.instrument, ("x",))
        served = self.emulator.served["x"]
        self.interface = PrologixAdapter(served.interface, TIMEOUT_S) if served.interface else None
        self.connection = VisaConnection(served.address, TIMEOUT_S, "@py", self.interface)
        self.session = ScpiSession(self.connection, "toneburst")

    def close(self) -> None:
        self.session.close()
        if self.interface is not None:
            self.interface.close()
        self.emulator.close()


def test_a_serial_line_is_a_tcp_socket_on_systems_without_pseudo_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "openpty", raising=False)
    bench = Bench("serial")
    assert bench.connection.address.startswith("ASRLsocket://127.0.0.1:")
    bench.instrument.query, bench.instrument.mishap = "VOLT?", delayed(0.3)
    with pytest.raises(InstrumentError, match="no reply"):
        bench.session.query("VOLT?")
    assert {bench.session.query("FREQ?") for _ in range(5)} == {"+1.0000000000000E+03"}
    generator = Agilent33250A(bench.connection, "toneburst")
    generator.configure(TRAIN)
    generator.verify()
    bench.emulator.close()
    with pytest.raises(InstrumentError, match="closed the connection"):
        bench.session.query("*IDN?")
    bench.close()


@pytest.fixture(params=[pytest.param(name, id=name) for name in TRANSPORTS])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    new_bench = Bench(request.param)
    yield new_bench
    new_bench.close()


def delayed(delay_s: float) -> Callable[[str], str]:
    def wait(reply: str) -> str:
        time.sleep(delay_s)
        return reply

    return wait


@pytest.mark.parametrize("delay_s", [0.3, 0.5, pytest.param(1.5, marks=pytest.mark.slow)])
def test_a_late_reply_is_never_the_answer_to_a_later_query(bench: Bench, delay_s: float) -> None:
    """A VXI-11 gateway applies the time-out; pyvisa-py waits one second longer for its answer."""
    bench.instrument.query, bench.instrument.mishap = "VOLT?", delayed(delay_s)
    if bench.transport == "vxi11" and delay_s < TIMEOUT_S + 1.0:
        assert bench.session.query("VOLT?") == "+1.0000000000000E-01"
    else:
        with pytest.raises(InstrumentError, match="toneburst"):
            bench.session.query("VOLT?")
    answers = []
    for _ in range(12):
        try:
            answers.append(bench.session.query("FREQ?"))
        except InstrumentError:
            continue
    assert set(answers) == {"+1.0000000000000E+03"}
    assert len(answers) >= 8


@pytest.mark.parametrize("garbage", ["\x80\xff\xfe", "", "?", "+1.0E+02;+1.0E+02;0"])
def test_a_corrupt_read_back_is_an_error_and_the_output_can_still_be_switched_off(bench: Bench, garbage: str) -> None:
    generator = Agilent33250A(bench.connection, "tracking_train")
    bench.instrument.query, bench.instrument.mishap = "BURS:NCYC?", lambda reply: garbage
    with pytest.raises(InstrumentError, match="tracking_train"):
        generator.configure(TRAIN)
    # The replies that follow are sound, and late on a busy machine.
    bench.connection.timeout_s = 10.0
    bench.instrument.generator.write("OUTP 1")
    generator.make_safe()
    assert not bench.instrument.generator.registers.output
    generator.configure(TRAIN)
    generator.verify()


def test_a_partial_reply_is_an_error_and_its_remainder_answers_nothing(bench: Bench) -> None:
    bench.instrument.query = "BURS:NCYC?"
    bench.instrument.mishap = lambda reply: reply[: len(reply) // 2]
    generator = Agilent33250A(bench.connection, "tracking_train")
    with pytest.raises(InstrumentError, match="tracking_train"):
        generator.configure(TRAIN)
    bench.connection.timeout_s = 10.0
    generator.configure(TRAIN)
    assert generator.snapshot()["cycles"] == 1000


def test_a_peer_that_closes_is_an_error_at_every_query_and_at_making_safe(bench: Bench) -> None:
    assert "33250A" in bench.session.query("*IDN?")
    bench.emulator.close()
    for _ in range(2):
        with pytest.raises(InstrumentError, match="toneburst"):
            bench.session.query("*IDN?")
    with pytest.raises(InstrumentError, match="toneburst"):
        Agilent33250A(bench.connection, "toneburst").make_safe()


def test_a_connection_closed_during_a_read_is_distinguished_from_a_slow_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connection = VisaConnection(f"TCPIP0::127.0.0.1::{listener.getsockname()[1]}::SOCKET", TIMEOUT_S, "@py")
        peer, _ = listener.accept()
        connection.write("*IDN?")
        with pytest.raises(TimeoutError):
            connection.read()
        peer.recv(100)
        peer.close()
        with pytest.raises(ConnectionError, match="closed the connection"):
            connection.read()
        with pytest.raises(ConnectionError, match="closed the connection"):
            connection.write("*IDN?")
        connection.close()


REFUSED = {
    "socket": "TCPIP0::127.0.0.1::{port}::SOCKET",
    "hislip": "TCPIP0::127.0.0.1::hislip0,{port}::INSTR",
    "vxi11": "TCPIP0::127.0.0.1,{port}::gpib0,10::INSTR",
}


@pytest.mark.parametrize("address", REFUSED.values(), ids=REFUSED)
def test_a_refused_connection_is_an_error_that_names_the_address(address: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = address.format(port=listener.getsockname()[1])
    with pytest.raises(ConnectionError, match=re.escape(address)):
        VisaConnection(address, TIMEOUT_S, "@py")


def test_a_refused_adapter_is_an_error_that_names_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"PRLGX-TCPIP0::127.0.0.1::{listener.getsockname()[1]}::INTFC"
    with pytest.raises(ConnectionError, match="PRLGX"):
        PrologixAdapter(address, TIMEOUT_S)


def test_a_gateway_without_an_instrument_at_the_address_is_an_error() -> None:
    instrument = Unreliable()
    with Emulator("vxi11", lambda role, serial: instrument, ("x",)) as emulator:
        address = emulator.served["x"].address.replace("gpib0,10", "gpib0,29")
        with pytest.raises(ConnectionError, match="gpib0,29"):
            VisaConnection(address, TIMEOUT_S, "@py")
