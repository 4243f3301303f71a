"""Connections that the peer ends between two shots, while every output is off: opened again, and the run goes on."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.interfaces import InstrumentError, Toneburst
from drivers.visa import PrologixAdapter, VisaConnection
from hpe_rig.bench import TRANSPORTS, read_bench
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, Step
from hpe_rig.measurement.setup import prepare
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import read_run
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports import Emulator
from sim_backend.transports.loopback import Listener
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

BURST = Toneburst(carrier_hz=3e6, cycles=300, amplitude_vpp=0.2, delay_s=0.0, load_ohm=50.0)
SHOTS = 2
FEW = [pytest.param(name, marks=[] if name == "socket" else pytest.mark.slow) for name in TRANSPORTS]
"""Without and with an adapter; the other transports are marked slow."""

# pyvisa-py leaves the socket of a lost connection to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> list[socket.socket]:
    """Return the instruments' ends of all connections made from now on; a serial line is a TCP connection."""
    sockets: list[socket.socket] = []
    serve = Listener._serve

    def recorded(listener: Listener, peer: socket.socket) -> None:
        sockets.append(peer)
        serve(listener, peer)

    monkeypatch.setattr(Listener, "_serve", recorded)
    monkeypatch.delattr(os, "openpty", raising=False)
    return sockets


def hang_up(peers: list[socket.socket]) -> None:
    """End every connection from the instruments' side."""
    for peer in peers:
        with suppress(OSError):
            peer.shutdown(socket.SHUT_RDWR)
    peers.clear()


@pytest.fixture(params=TRANSPORTS)
def remote(
    request: pytest.FixtureRequest, peers: list[socket.socket]
) -> Iterator[tuple[Generator33250A, Agilent33250A]]:
    """Yield a simulated generator and its driver at the other end of a transport."""
    instrument = Generator33250A(SimulatedClock(), 100e-9)

    def connect(role: str, over_serial: bool) -> GeneratorConnection:
        return GeneratorConnection(instrument, SimulatedClock(), 0.0, over_serial)

    with Emulator(request.param, connect, ("toneburst",)) as emulator:
        served = emulator.served["toneburst"]
        adapter = PrologixAdapter(served.interface) if served.interface else None
        connection = VisaConnection(served.address, backend="@py", adapter=adapter)
        yield instrument, Agilent33250A(connection, "toneburst")
        connection.close()
        if adapter:
            adapter.close()


def test_a_connection_lost_while_idle_is_opened_again_and_everything_programmed(
    remote: tuple[Generator33250A, Agilent33250A], peers: list[socket.socket], caplog: pytest.LogCaptureFixture
) -> None:
    instrument, driver = remote
    driver.identify()
    driver.configure(BURST)
    settings = driver.verify()
    # As after a power cut: the settings are lost as well.
    instrument.write("*RST")
    hang_up(peers)
    with caplog.at_level(logging.WARNING, "drivers"):
        driver.configure(BURST)
    assert driver.verify() == settings
    assert not instrument.registers.output
    assert [record.message for record in caplog.records if "toneburst: the connection was lost" in record.message]


@pytest.mark.parametrize("remote", FEW, indirect=True)
def test_a_connection_lost_while_the_output_is_on_is_an_error(
    remote: tuple[Generator33250A, Agilent33250A], peers: list[socket.socket]
) -> None:
    instrument, driver = remote
    driver.configure(BURST)
    driver.enable_output()
    hang_up(peers)
    with pytest.raises(InstrumentError, match="toneburst"):
        driver.verify()
    driver.make_safe()
    assert not instrument.registers.output


@pytest.mark.parametrize("remote", FEW, indirect=True)
def test_another_instrument_behind_the_connection_is_an_error(
    remote: tuple[Generator33250A, Agilent33250A], peers: list[socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    instrument, driver = remote
    driver.identify()
    driver.configure(BURST)
    read = GeneratorConnection.read
    monkeypatch.setattr(GeneratorConnection, "read", lambda line: read(line).replace("33250A,0,", "33250A,1,"))
    hang_up(peers)
    with pytest.raises(InstrumentError, match="were exchanged"):
        driver.configure(BURST)
    assert not instrument.registers.output


@pytest.mark.parametrize("transport", FEW)
def test_a_run_goes_on_after_every_connection_was_lost_between_two_shots(
    tmp_path: Path, transport: str, peers: list[socket.socket]
) -> None:
    scene = tmp_path / "scene.toml"
    text = shipped_scenes()["table-1"].replace("[acquisition]\n", f"[acquisition]\nrepeats = {SHOTS}\n")
    scene.write_text(text, encoding="utf-8")
    bench = tmp_path / "bench.toml"
    bench.write_text(read_bench().text.replace("simulated = true", f'simulated = true\ntransport = "{transport}"'))
    undisturbed = read_run(record_run(prepare(str(scene), bench), tmp_path / "undisturbed.h5"))

    def lose(progress: Progress) -> None:
        if progress.step is Step.CONFIGURE and progress.shot.index:
            hang_up(peers)

    disturbed = read_run(record_run(prepare(str(scene), bench), tmp_path / "run.h5", lose))
    assert (disturbed.status, len(disturbed.records)) == ("complete", SHOTS)
    assert not disturbed.untrusted
    for one, other in zip(disturbed.records, undisturbed.records, strict=True):
        np.testing.assert_array_equal(one.valid, other.valid)
