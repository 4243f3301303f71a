"""VISA connection over a loopback socket or terminal to the simulated generator, or to a script that misbehaves."""

from __future__ import annotations

import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import IO

import pytest
import pyvisa
from pyvisa.constants import StatusCode

from drivers.agilent.generator import Agilent33250A
from drivers.agilent.scpi import ScpiSession
from drivers.interfaces import InstrumentError, PulseTrain
from drivers.visa import PrologixAdapter, VisaConnection, resources
from drivers.visa.resources import VisaLine
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports import Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TIMEOUT_S = 0.15


@contextmanager
def served(instrument) -> Iterator[str]:
    """Yield the VISA address of ``instrument``, whose messages are answered in order."""
    listener = socket.create_server(("127.0.0.1", 0))
    peers: list[socket.socket] = []

    def serve() -> None:
        try:
            peer, _ = listener.accept()
        except OSError:
            return
        peers.append(peer)
        with peer, peer.makefile("rwb") as lines:
            for line in lines:
                instrument.write(line.decode().rstrip("\r\n"))
                answer(instrument, lines)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"TCPIP0::127.0.0.1::{listener.getsockname()[1]}::SOCKET"
    finally:
        listener.close()
        for peer in peers:
            with_shutdown(peer)
        thread.join(timeout=30)
        assert not thread.is_alive()


def answer(instrument, lines) -> None:
    while True:
        try:
            reply = instrument.read()
        except TimeoutError:
            break
        lines.write(reply.encode() + b"\n")
    try:
        lines.flush()
    except OSError:
        return


def with_shutdown(peer: socket.socket) -> None:
    try:
        peer.shutdown(socket.SHUT_RDWR)
    except OSError:
        return


@pytest.fixture
def open_connection() -> Iterator[Callable[[str], VisaConnection]]:
    connections: list[VisaConnection] = []

    def open_connection(address: str) -> VisaConnection:
        connections.append(VisaConnection(address, TIMEOUT_S, backend="@py"))
        return connections[-1]

    yield open_connection
    for connection in connections:
        connection.close()


def test_a_reply_arrives_without_its_line_end(scripted, open_connection) -> None:
    with served(scripted()) as address:
        connection = open_connection(address)
        connection.write("*IDN?")
        assert connection.read() == "Agilent Technologies,33250A,0,2.04-1.01-2.00-03-2"
        connection.close()


def test_the_simulated_generator_behind_a_socket_is_programmed_as_it_is_directly(open_connection) -> None:
    direct, remote = (Generator33250A(SimulatedClock(), 100e-9) for _ in range(2))
    generators = [Agilent33250A(direct, "burst_train")]
    with served(remote) as address:
        generators.append(Agilent33250A(open_connection(address), "burst_train"))
        for generator in generators:
            generator.configure(TRAIN)
            generator.verify()
            generator.enable_output()
        assert generators[0].snapshot() == generators[1].snapshot()
        generators[1].make_safe()
        generators[1].close()
    assert remote.registers != direct.registers
    generators[0].make_safe()
    assert remote.registers == direct.registers


def test_silence_is_a_timeout_after_the_time_that_was_set(scripted, open_connection) -> None:
    with served(scripted()) as address:
        connection = open_connection(address)
        connection.write("*OPT?")
        started = time.monotonic()
        with pytest.raises(TimeoutError, match=r"within 0\.15 s"):
            connection.read()
        # The upper bound distinguishes 0.15 s from the default of 2 s on a busy machine.
        assert TIMEOUT_S * 0.9 < time.monotonic() - started < 1.5
        connection.close()


@pytest.mark.parametrize("delay_s", [0.0, 0.3])
def test_a_reply_that_is_late_on_the_socket_is_discarded(scripted, open_connection, delay_s: float) -> None:
    """The reply is sent after the time-out: at once, or while the session asks something else."""
    instrument, may_reply = scripted(replies={"VOLT": "late", "FREQ": "+1.0E+03"}), threading.Event()
    write = instrument.write

    def write_when_allowed(message: str) -> None:
        if message == "VOLT?":
            may_reply.wait(60.0)
        write(message)

    instrument.write = write_when_allowed
    with served(instrument) as address:
        session = ScpiSession(open_connection(address), "toneburst")
        with pytest.raises(InstrumentError, match=r"no reply to 'VOLT\?'"):
            session.query("VOLT?")
        threading.Timer(delay_s, may_reply.set).start()
        replies = list[str]()
        for _ in range(200):
            if len(replies) == 5:
                break
            with suppress(InstrumentError):
                replies.append(session.query("FREQ?"))
        assert replies == ["+1.0E+03"] * 5
        session.close()


def test_a_closed_port_is_an_instrument_error_that_names_the_address(open_connection) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises((ConnectionError, InstrumentError), match=f"127.0.0.1::{port}"):
        ScpiSession(open_connection(f"TCPIP0::127.0.0.1::{port}::SOCKET"), "master").query("*IDN?")


@pytest.mark.parametrize("address", ["NOSUCH::1::INSTR", "not an address", "ASRL/dev/no-such-tty::INSTR"])
def test_an_address_that_cannot_be_opened_is_named(address: str) -> None:
    with pytest.raises(ConnectionError, match="cannot open"):
        VisaConnection(address, TIMEOUT_S, backend="@py")


def test_a_connection_closed_by_the_instrument_is_an_error_not_a_reply(scripted, open_connection) -> None:
    with served(scripted()) as address:
        session = ScpiSession(open_connection(address), "master")
        assert session.query("*IDN?").startswith("Agilent")
    for _ in range(3):
        with pytest.raises(InstrumentError, match="master"):
            session.query("*IDN?")


def test_without_a_vendor_library_pyvisa_py_opens_the_address() -> None:
    generator = GeneratorConnection(Generator33250A(SimulatedClock(), 100e-9), SimulatedClock(), 0.0)
    with Emulator("hislip", lambda role, over_serial: generator, ("master",)) as emulator:
        connection = VisaConnection(emulator.served["master"].address, TIMEOUT_S, backend="/no/such/libvisa.so")
        connection.write("*IDN?")
        assert "33250A" in connection.read()
        connection.close()


class LockedResource:
    """A VISA resource whose exclusive lock fails with ``error_code``."""

    def __init__(self, error_code: StatusCode) -> None:
        self.error_code, self.closed = error_code, False

    def lock_excl(self, timeout_ms: float) -> None:
        raise pyvisa.VisaIOError(self.error_code)

    def close(self) -> None:
        self.closed = True


def test_an_instrument_locked_by_another_program_is_not_opened(monkeypatch) -> None:
    locked, unlockable = map(
        LockedResource, (StatusCode.error_resource_locked, StatusCode.error_nonsupported_operation)
    )
    resources_by_address = {"GPIB0::10::INSTR": locked, "GPIB0::11::INSTR": unlockable}
    monkeypatch.setattr(resources, "_message_resource", lambda address, backend: resources_by_address[address])
    with pytest.raises(OSError, match="another program holds its lock"):
        VisaLine("GPIB0::10::INSTR", TIMEOUT_S, "@py", lock=True)
    # Most transports have no locks.
    VisaLine("GPIB0::11::INSTR", TIMEOUT_S, "@py", lock=True)
    assert (locked.closed, unlockable.closed) == (True, False)


def test_closing_twice_is_no_error(scripted) -> None:
    with served(scripted()) as address:
        connection = VisaConnection(address, TIMEOUT_S, backend="@py")
        connection.close()
        connection.close()


@contextmanager
def terminal(converse: Callable[[IO[bytes]], None]) -> Iterator[str]:
    """Yield the device name of a pseudo terminal; ``converse`` has the other end, in a thread."""
    import tty

    server, client = os.openpty()
    tty.setraw(client)

    def serve() -> None:
        with open(server, "r+b", buffering=0, closefd=False) as line:
            converse(line)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield os.ttyname(client)
    thread.join(timeout=30)
    os.close(server)
    os.close(client)


def read_line(line: IO[bytes]) -> str:
    received = b""
    while not received.endswith(b"\n"):
        received += line.read(1)
    return received.decode().strip()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
def test_a_serial_address_ends_the_instruments_local_mode_first(scripted) -> None:
    instrument = scripted()

    def converse(line: IO[bytes]) -> None:
        instrument.write(read_line(line))
        instrument.write(read_line(line))
        line.write(instrument.read().encode() + b"\n")

    with terminal(converse) as device:
        connection = VisaConnection(f"ASRL{device}::INSTR", 1.0, backend="@py")
        connection.write("*IDN?")
        assert "33250A" in connection.read()
        connection.close()
    assert instrument.messages == ["SYST:REM", "*IDN?"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
def test_a_prologix_adapter_on_a_serial_line_reaches_its_instruments() -> None:
    received: list[str] = []

    def converse(line: IO[bytes]) -> None:
        while "++read eoi" not in received:
            received.append(read_line(line))
        line.write(b"33250A\n")

    with terminal(converse) as device:
        adapter = PrologixAdapter(f"PRLGX-ASRL::{device}::INTFC", 1.0, backend="@py")
        connection = VisaConnection("GPIB0::10::INSTR", 1.0, adapter=adapter)
        connection.write("*IDN?")
        assert connection.read() == "33250A"
        adapter.close()
    assert received[-3:] == ["++addr 10", "*IDN?", "++read eoi"]


@pytest.mark.parametrize("address", ["GPIB0::10::INSTR", "PRLGX-TCPIP0::10.0.0.1::INTFC"])
def test_an_invalid_adapter_address_is_refused_with_an_example(address: str) -> None:
    with pytest.raises(ConnectionError, match="such as PRLGX-TCPIP0::"):
        PrologixAdapter(address)
