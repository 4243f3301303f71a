"""The servers byte by byte, without a VISA library; they share one world, use loopback and close completely."""

from __future__ import annotations

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from sim_backend.settings import SimulationSettings
from sim_backend.transports.emulator import TRANSPORTS, Emulator
from sim_backend.transports.prologix import unescaped_lines
from sim_backend.world import GENERATORS, World

IDENTITY = b"Agilent Technologies,33250A,0,2.01-1.01-2.00-03-2\n"
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
OVER = [pytest.param(name, marks=needs_pty) if name == "serial" else name for name in TRANSPORTS]


@pytest.fixture
def world() -> World:
    return World(SimulationSettings(), [])


@contextmanager
def served(world: World, transport: str) -> Iterator[Emulator]:
    with Emulator(transport, world.connect, GENERATORS) as emulator:
        yield emulator


def tcp_port(address: str) -> int:
    """Return the port in a VISA resource name."""
    for part in address.replace(",", "::").split("::"):
        if part.isdigit() and int(part) > 1023:
            return int(part)
    raise AssertionError(address)


@contextmanager
def connected(address: str) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", tcp_port(address)), timeout=5) as peer:
        yield peer


def exactly(peer: socket.socket, size: int) -> bytes:
    received = b""
    while len(received) < size:
        chunk = peer.recv(size - len(received))
        assert chunk, received
        received += chunk
    return received


def line(peer: socket.socket) -> bytes:
    received = b""
    while not received.endswith(b"\n"):
        received += exactly(peer, 1)
    return received


@pytest.mark.parametrize("transport", OVER)
def test_every_generator_has_an_address_and_nothing_is_left_when_it_closes(world: World, transport: str) -> None:
    before = threading.active_count()
    with served(world, transport) as emulator:
        addresses = [served_generator.address for served_generator in emulator.served.values()]
        assert len(set(addresses)) == len(GENERATORS)
        assert threading.active_count() > before
    assert threading.active_count() == before


@pytest.mark.parametrize("transport", [name for name in TRANSPORTS if name != "serial"])
def test_only_loopback_is_listened_on(world: World, transport: str) -> None:
    with served(world, transport) as emulator:
        served_generator = emulator.served["master"]
        assert "127.0.0.1" in (served_generator.interface or served_generator.address)
        port = tcp_port(served_generator.interface or served_generator.address)
        with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.2", port), timeout=1):
            pass


def test_messages_are_split_at_line_feeds_however_they_arrive(world: World) -> None:
    with served(world, "socket") as emulator, connected(emulator.served["master"].address) as peer:
        peer.sendall(b"*ID")
        peer.sendall(b"N?\r\nFUNC?\nOUTP?\n*OP")
        peer.sendall(b"T?\nTRIG:SOUR?\n")
        assert [line(peer) for _ in range(4)] == [IDENTITY, b"SIN\n", b"0\n", b"IMM\n"]


def test_two_programs_at_one_instrument_get_the_replies_to_their_queries(world: World) -> None:
    with served(world, "socket") as emulator:
        wrong: list[bytes] = []

        def ask(query: bytes, answer: bytes) -> None:
            with connected(emulator.served["master"].address) as peer:
                for _ in range(200):
                    peer.sendall(query)
                    if (reply := line(peer)) != answer:
                        wrong.append(reply)

        threads = [threading.Thread(target=ask, args=pair) for pair in ((b"FUNC?\n", b"SIN\n"), (b"OUTP?\n", b"0\n"))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert wrong == []


def test_a_program_that_closes_within_a_message_disturbs_no_other(world: World) -> None:
    with served(world, "socket") as emulator, connected(emulator.served["master"].address) as peer:
        with connected(emulator.served["master"].address) as other:
            other.sendall(b"FUNC PULS")
        peer.sendall(b"FUNC?\n")
        assert line(peer) == b"SIN\n"


def test_the_generators_share_one_clock_and_one_trigger_wire() -> None:
    wiring = [("master.output", "toneburst.trigger", 0.0), ("toneburst.output", "transducer.drive", 0.0)]
    world = World(SimulationSettings(), wiring)
    with served(world, "socket") as emulator:
        program = {
            "toneburst": b"TRIG:SOUR EXT;:BURS:NCYC 3;:BURS:STAT 1;:FREQ 3E6;:OUTP 1;*OPC?\n",
            "master": b"OUTP:LOAD INF;:FUNC PULS;:VOLT:LOW 0;:VOLT:HIGH 4;:TRIG:SOUR BUS;:BURS:STAT 1;:OUTP 1;*OPC?\n",
        }
        for role, message in program.items():
            with connected(emulator.served[role].address) as peer:
                peer.sendall(message)
                assert line(peer) == b"1\n"
        before_s = world.clock.now_s()
        with connected(emulator.served["master"].address) as peer:
            peer.sendall(b"*TRG\n*OPC?\n")
            assert line(peer) == b"1\n"
        assert world.clock.now_s() > before_s
        assert world.emissions()[0].onset_ps.size == 1


@needs_pty
def test_a_serial_instrument_starts_in_local_mode_and_does_not_echo(world: World) -> None:
    with served(world, "serial") as emulator:
        name = emulator.served["master"].address.removeprefix("ASRL").removesuffix("::INSTR")
        # no terminal of this process's: else its end would hang up a suite that began without one, as services do
        with os.fdopen(os.open(name, os.O_RDWR | os.O_NOCTTY), "r+b", buffering=0) as terminal:
            terminal.write(b"FREQ 2E6\nSYST:ERR?\n")
            assert terminal.read(100) == b'+550,"Command not allowed in local"\n'
            terminal.write(b"SYST:REM\nFREQ 2E6\nFREQ?;:SYST:ERR?\n")
            assert terminal.read(100) == b'+2.0000000000000E+06;+0,"No error"\n'


def test_remote_mode_exists_on_rs_232_alone(world: World) -> None:
    with served(world, "socket") as emulator, connected(emulator.served["master"].address) as peer:
        peer.sendall(b"SYST:REM\nSYST:ERR?\n")
        assert line(peer) == b'+514,"Command allowed only with RS-232"\n'


def hislip(kind: int, parameter: int = 0, payload: bytes = b"", control: int = 0) -> bytes:
    return struct.pack("!2sBBIQ", b"HS", kind, control, parameter, len(payload)) + payload


def hislip_message(peer: socket.socket) -> tuple[int, int, int, bytes]:
    prologue, kind, control, parameter, size = struct.unpack("!2sBBIQ", exactly(peer, 16))
    assert prologue == b"HS"
    return kind, control, parameter, exactly(peer, size)


def test_hislip_answers_a_split_message_with_the_number_of_its_last_part(world: World) -> None:
    with served(world, "hislip") as emulator, connected(emulator.served["master"].address) as peer:
        peer.sendall(hislip(0, 0x01007878, b"hislip0"))
        kind, overlap, version_and_session, _ = hislip_message(peer)
        assert (kind, overlap, version_and_session >> 16) == (1, 0, 0x0100)
        peer.sendall(hislip(6, 0x10, b"*ID") + hislip(7, 0x12, b"N?\n"))
        assert hislip_message(peer) == (7, 0, 0x12, IDENTITY)
        peer.sendall(hislip(77))
        assert hislip_message(peer)[:2] == (3, 1)
        peer.sendall(hislip(8))
        assert hislip_message(peer)[0] == 9
        peer.sendall(b"GET / HTTP/1.1\r\n")
        assert peer.recv(1) == b""


def test_hislip_polls_the_status_on_its_second_connection(world: World) -> None:
    with served(world, "hislip") as emulator, connected(emulator.served["master"].address) as peer:
        peer.sendall(hislip(17, 1))
        assert hislip_message(peer)[0] == 18
        peer.sendall(hislip(15, 0, struct.pack("!Q", 1 << 20)))
        assert hislip_message(peer)[0] == 16
        world.connect("master").write("NONSENSE")
        peer.sendall(hislip(21))
        assert hislip_message(peer)[:2] == (22, 4)


def xdr(data: bytes) -> bytes:
    return struct.pack("!I", len(data)) + data + bytes(-len(data) % 4)


class Rpc:
    """One VXI-11 core connection, spoken by hand."""

    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer
        self._transaction = 0

    def call(self, procedure: int, arguments: bytes, program: int = 0x0607AF) -> tuple[int, bytes]:
        """Return the accept status and the result."""
        self._transaction += 1
        record = struct.pack("!10I", self._transaction, 0, 2, program, 1, procedure, 0, 0, 0, 0) + arguments
        # In two fragments, as a large call would come.
        self._peer.sendall(struct.pack("!I", 20) + record[:20])
        self._peer.sendall(struct.pack("!I", 1 << 31 | len(record) - 20) + record[20:])
        (mark,) = struct.unpack("!I", exactly(self._peer, 4))
        reply = exactly(self._peer, mark & 0x7FFFFFFF)
        transaction, kind, denied, _, _, status = struct.unpack_from("!6I", reply)
        assert (transaction, kind, denied) == (self._transaction, 1, 0)
        return status, reply[24:]

    def link(self, device: bytes) -> tuple[int, int]:
        _, result = self.call(10, struct.pack("!iiI", 1, 0, 0) + xdr(device))
        error, link, _, _ = struct.unpack("!iiII", result)
        return error, link

    def write(self, link: int, message: bytes, flags: int = 8) -> int:
        _, result = self.call(11, struct.pack("!iIIi", link, 100, 100, flags) + xdr(message))
        return struct.unpack("!iI", result)[0]

    def read(self, link: int, size: int = 4096, timeout_ms: int = 100) -> tuple[int, int, bytes]:
        _, result = self.call(12, struct.pack("!iIIIii", link, size, timeout_ms, 100, 0, 0))
        error, reason, length = struct.unpack_from("!iiI", result)
        return error, reason, result[12 : 12 + length]


def test_vxi11_reads_in_pieces_with_time_outs_and_checks_links(world: World) -> None:
    with served(world, "vxi11") as emulator, connected(emulator.served["master"].address) as peer:
        rpc = Rpc(peer)
        assert rpc.link(b"gpib0,29")[0] == 3
        assert rpc.link(b"inst0")[0] == 3
        error, link = rpc.link(b"gpib0,10")
        assert error == 0
        assert rpc.write(link, b"*ID", flags=0) == 0
        assert rpc.write(link, b"N?\n") == 0
        assert rpc.read(link, size=7) == (0, 1, b"Agilent")
        assert rpc.read(link) == (0, 4, IDENTITY[7:])
        started_s = time.monotonic()
        assert rpc.read(link, timeout_ms=100) == (15, 0, b"")
        assert time.monotonic() - started_s >= 0.1
        assert rpc.write(link + 1, b"*IDN?\n") == 4
        assert rpc.call(13, struct.pack("!iiII", link, 0, 0, 0))[1] == struct.pack("!iI", 0, 0)
        assert rpc.call(22, struct.pack("!i", link))[1] == struct.pack("!i", 8)
        assert rpc.call(10, b"", program=100000)[0] == 1
        assert rpc.call(23, struct.pack("!i", link))[1] == struct.pack("!i", 0)
        assert rpc.write(link, b"*IDN?\n") == 4


def test_vxi11_drops_an_unread_reply(world: World) -> None:
    with served(world, "vxi11") as emulator, connected(emulator.served["master"].address) as peer:
        rpc = Rpc(peer)
        _, link = rpc.link(b"gpib0,12")
        rpc.write(link, b"FUNC?\n")
        rpc.write(link, b"OUTP?\n")
        assert rpc.read(link)[2] == b"0\n"
        rpc.write(link, b"SYST:ERR?\n")
        assert rpc.read(link)[2] == b'-410,"Query INTERRUPTED"\n'


def test_prologix_uses_the_last_selected_address(world: World) -> None:
    with served(world, "prologix") as emulator, connected(emulator.served["master"].interface or "") as peer:
        peer.sendall(b"++mode 1\n++auto 0\n++addr 11\nFREQ 5E3\n++addr 10\nFREQ?\n++read eoi\n")
        assert line(peer) == b"+1.0000000000000E+03\n"
        peer.sendall(b"++addr 11\nFREQ?\n++read eoi\n")
        assert line(peer) == b"+5.0000000000000E+03\n"
        peer.sendall(b"NONSENSE\n++spoll\n")
        assert line(peer) == b"4\r\n"
        peer.sendall(b"++addr 25\n*IDN?\n++read eoi\n++ver\n")
        assert line(peer).startswith(b"Prologix")


def test_prologix_forwards_escaped_bytes_unchanged(world: World) -> None:
    with served(world, "prologix") as emulator, connected(emulator.served["master"].interface or "") as peer:
        peer.sendall(b"++addr 10\nVOLT:OFFS \x1b+1E-3\nVOLT:OFFS?\n++read eoi\n")
        assert line(peer) == b"+1.0000000000000E-03\n"


@pytest.mark.parametrize("cut", range(12))
def test_an_escaped_line_end_ends_no_line_wherever_the_data_are_cut(cut: int) -> None:
    data = b"A\x1b\nB\nC\r\n\x1b\x1b\nD"
    lines, incomplete = unescaped_lines(data[:cut])
    further_lines, incomplete = unescaped_lines(incomplete + data[cut:])
    assert ([*lines, *further_lines], incomplete) == ([b"A\x1b\nB", b"C", b"\x1b\x1b"], b"D")
