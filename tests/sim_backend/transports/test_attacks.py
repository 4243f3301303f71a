"""Servers under attack: whatever arrives, memory and threads stay bounded, and everybody else is served."""

from __future__ import annotations

import os
import random
import select
import socket
import struct
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from sim_backend.settings import SimulationSettings
from sim_backend.transports.emulator import TRANSPORTS, Emulator
from sim_backend.transports.lines import LineBuffer
from sim_backend.transports.loopback import MAX_BYTES, MAX_PEERS
from sim_backend.world import GENERATORS, World

IDENTITY = b"Agilent Technologies,33250A,0,2.01-1.01-2.00-03-2\n"
LONG_REPLY = b"*IDN?" + b";*IDN?" * 20 + b"\n"
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
ON_TCP = [name for name in TRANSPORTS if name != "serial"]
OVER = [*ON_TCP, pytest.param("serial", marks=needs_pty)]
MEBIBYTE = 1 << 20


def tcp_port(emulator: Emulator) -> int:
    served = emulator.served["master"]
    parts = (served.interface or served.address).replace(",", "::").split("::")
    return next(int(part) for part in parts if part.isdigit() and int(part) > 1023)


@contextmanager
def served(transport: str) -> Iterator[Emulator]:
    with Emulator(transport, World(SimulationSettings(), []).connect, GENERATORS) as emulator:
        yield emulator


@contextmanager
def connected(emulator: Emulator) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", tcp_port(emulator)), timeout=20) as peer:
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


def xdr(data: bytes) -> bytes:
    return struct.pack("!I", len(data)) + data + bytes(-len(data) % 4)


def rpc(procedure: int, arguments: bytes, program: int = 0x0607AF) -> bytes:
    record = struct.pack("!10I", 7, 0, 2, program, 1, procedure, 0, 0, 0, 0) + arguments
    return struct.pack("!I", 1 << 31 | len(record)) + record


def rpc_reply(peer: socket.socket) -> tuple[int, bytes]:
    """Return accept status and result."""
    (mark,) = struct.unpack("!I", exactly(peer, 4))
    reply = exactly(peer, mark & 0x7FFFFFFF)
    return struct.unpack_from("!6I", reply)[5], reply[24:]


def call(peer: socket.socket, procedure: int, arguments: bytes) -> bytes:
    peer.sendall(rpc(procedure, arguments))
    status, result = rpc_reply(peer)
    assert status == 0
    return result


def link(peer: socket.socket, exclusive: int = 0) -> int:
    error, number, _, _ = struct.unpack(
        "!iiII", call(peer, 10, struct.pack("!iII", 1, exclusive, 0) + xdr(b"gpib0,10"))
    )
    assert error == 0
    return number


def hislip(kind: int, payload: bytes = b"", control: int = 0, parameter: int = 0) -> bytes:
    return struct.pack("!2sBBIQ", b"HS", kind, control, parameter, len(payload)) + payload


def hislip_message(peer: socket.socket) -> tuple[int, int, int, bytes]:
    prologue, kind, control, parameter, size = struct.unpack("!2sBBIQ", exactly(peer, 16))
    assert prologue == b"HS"
    return kind, control, parameter, exactly(peer, size)


def terminal(emulator: Emulator) -> str:
    return emulator.served["master"].address.removeprefix("ASRL").removesuffix("::INSTR")


@contextmanager
def opened_terminal(emulator: Emulator) -> Iterator[int]:
    descriptor = os.open(terminal(emulator), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def ask_terminal(descriptor: int, message: bytes, ending: bytes = b"\n") -> bytes:
    received, deadline_s = b"", time.monotonic() + 30
    while message:
        select.select([], [descriptor], [], 1.0)
        with suppress(BlockingIOError):
            message = message[os.write(descriptor, message) :]
    while not received.endswith(ending) and time.monotonic() < deadline_s:
        if select.select([descriptor], [], [], 0.5)[0]:
            received += os.read(descriptor, 4096)
    return received


def reply_over(transport: str, peer: socket.socket, *messages: bytes) -> bytes:
    """Send ``messages``, the last of which is a query, and return the reply."""
    if transport == "vxi11":
        number = link(peer)
        for text in messages:
            call(peer, 11, struct.pack("!iIIi", number, 100, 100, 8) + xdr(text + b"\n"))
        result = call(peer, 12, struct.pack("!iIIIii", number, 4096, 1000, 100, 0, 0))
        return result[12 : 12 + struct.unpack_from("!I", result, 8)[0]]
    if transport == "hislip":
        peer.sendall(hislip(0, b"hislip0", 0, 0x01007878) + b"".join(hislip(7, text + b"\n") for text in messages))
        hislip_message(peer)
        return hislip_message(peer)[3]
    lines = b"".join(text + b"\n" for text in messages)
    peer.sendall(b"++addr 10\n" + lines + b"++read eoi\n" if transport == "prologix" else lines)
    return line(peer)


def identity(transport: str, emulator: Emulator) -> bytes:
    """Return the reply to a well-behaved client."""
    if transport == "serial":
        with opened_terminal(emulator) as descriptor:
            # The line feed ends incomplete messages of other clients.
            while select.select([descriptor], [], [], 0.1)[0]:
                os.read(descriptor, 4096)
            # Replies to other clients may come late.
            return ask_terminal(descriptor, b"\n*IDN?\n", IDENTITY)[-len(IDENTITY) :]
    with connected(emulator) as peer:
        return reply_over(transport, peer, b"*IDN?")


def hung_up(peer: socket.socket) -> bool:
    """Return whether the server closes the connection within its time-out."""
    with suppress(ConnectionError):
        while peer.recv(65536):
            pass
    return True


def assert_threads_end(before: int) -> None:
    """Wait until no more than ``before`` threads run, at most 30 s."""
    deadline_s = time.monotonic() + 30
    while threading.active_count() > before and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert threading.active_count() <= before


def flood(peer: socket.socket, chunk: bytes, size: int) -> None:
    with suppress(ConnectionError):
        for _ in range(size // len(chunk)):
            peer.sendall(chunk)


@pytest.mark.parametrize("transport", OVER)
@pytest.mark.parametrize(
    "message",
    [b"OUTP 1E400", b"VOLT 1e9 DBM", b"*ESE \xb2", b"*ESE " + b"1" * 5000, b"FREQ\x00\xff", b"*ESE" + b" " * 9000],
)
def test_an_oversized_message_is_an_error_in_the_queue(transport: str, message: bytes) -> None:
    with served(transport) as emulator:
        errors = message + b"\nSYST:ERR?\n"
        if transport == "serial":
            with opened_terminal(emulator) as descriptor:
                reply = ask_terminal(descriptor, b"SYST:REM\n" + errors)
        else:
            with connected(emulator) as peer:
                reply = reply_over(transport, peer, message, b"SYST:ERR?")
        assert reply.startswith(b"-"), reply
        assert identity(transport, emulator) == IDENTITY


@pytest.mark.parametrize("address", [b"abc", b"31", b"-1", b"1" * 5000, b"\xb2", b"10 96 7"])
def test_an_invalid_prologix_address_is_refused_and_the_selection_kept(address: bytes) -> None:
    with served("prologix") as emulator, connected(emulator) as peer:
        peer.sendall(b"++addr 11\n++addr " + address + b"\n")
        assert line(peer) == b"Unrecognized command\r\n"
        peer.sendall(b"FREQ 5E3\n++addr 10\nFREQ?\n++read\n")
        assert line(peer) == b"+1.0000000000000E+03\n"


def test_a_short_vxi11_call_is_answered_as_garbage_and_a_cut_off_one_ends_the_connection() -> None:
    with served("vxi11") as emulator:
        with connected(emulator) as peer:
            number = link(peer)
            for procedure in (10, 11, 12, 13, 18, 23):
                peer.sendall(rpc(procedure, b"\0\0"))
                assert rpc_reply(peer)[0] == 4
            # Says that 1000 bytes follow, and sends four.
            peer.sendall(rpc(11, struct.pack("!iIIiI", number, 1, 1, 8, 1000) + b"*RST"))
            assert rpc_reply(peer)[0] == 4
            peer.sendall(struct.pack("!I", 1 << 31 | 4) + b"\0\0\0\1")
            assert hung_up(peer)
        assert identity("vxi11", emulator) == IDENTITY


def test_endless_reads_end_when_their_clients_close() -> None:
    with served("vxi11") as emulator:
        before = threading.active_count()
        for _ in range(50):
            with connected(emulator) as peer:
                number = link(peer)
                peer.sendall(rpc(12, struct.pack("!iIIIii", number, 10, (1 << 31) - 1, 0, 0, 0)))
        assert identity("vxi11", emulator) == IDENTITY
        assert_threads_end(before)


@pytest.mark.parametrize("transport", OVER)
def test_60_megabytes_without_line_end_use_bounded_memory_and_end_the_connection(transport: str) -> None:
    size, chunk = 60 * MEBIBYTE, bytes(65) * 1000
    with served(transport) as emulator:
        tracemalloc.start()
        try:
            if transport == "serial":
                with opened_terminal(emulator) as descriptor:
                    for _ in range(4 * MAX_BYTES // 4096):
                        select.select([], [descriptor], [], 1.0)
                        with suppress(BlockingIOError):
                            os.write(descriptor, b"A" * 4096)
            else:
                with connected(emulator) as peer:
                    if transport == "hislip":
                        peer.sendall(hislip(0, b"hislip0", 0, 0x01007878))
                        flood(peer, hislip(6, chunk), size)
                    elif transport == "vxi11":
                        flood(peer, struct.pack("!I", len(chunk)) + chunk, size)
                    else:
                        flood(peer, b"A" * 65536, size)
                    assert hung_up(peer)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 16 * MEBIBYTE
        assert identity(transport, emulator) == IDENTITY


def test_complete_lines_received_with_one_that_is_too_long_are_answered() -> None:
    lines = LineBuffer()
    received = lines.feed(b"OUTP 0\nOUTP?\n" + b"A" * (MAX_BYTES + 1))
    assert [next(received), next(received)] == [b"OUTP 0", b"OUTP?"]
    with pytest.raises(EOFError):
        next(received)
    # The line that was too long is dropped.
    assert list(lines.feed(b"*IDN?\n")) == [b"*IDN?"]


def test_an_endless_vxi11_write_is_out_of_resources() -> None:
    with served("vxi11") as emulator, connected(emulator) as peer:
        number, errors = link(peer), []
        for _ in range(MAX_BYTES // 60_000 + 2):
            result = call(peer, 11, struct.pack("!iIIi", number, 100, 100, 0) + xdr(b"A" * 60_000))
            errors.append(struct.unpack_from("!i", result)[0])
        assert 9 in errors
        assert set(errors) == {0, 9}


def test_too_many_links_are_out_of_resources() -> None:
    with served("vxi11") as emulator, connected(emulator) as peer:
        request = struct.pack("!iII", 1, 0, 0) + xdr(b"gpib0,10")
        errors = [struct.unpack_from("!i", call(peer, 10, request))[0] for _ in range(100)]
        assert errors == [0] * 64 + [9] * 36


@pytest.mark.parametrize("transport", ON_TCP)
def test_many_connections_use_a_bounded_number_of_threads(transport: str) -> None:
    with served(transport) as emulator:
        before = threading.active_count()
        peers = [socket.create_connection(("127.0.0.1", tcp_port(emulator)), timeout=5) for _ in range(MAX_PEERS + 20)]
        assert hung_up(peers[-1])
        assert threading.active_count() <= before + MAX_PEERS
        for peer in peers:
            peer.close()
        assert_threads_end(before)
        assert identity(transport, emulator) == IDENTITY


def test_a_client_that_reads_nothing_does_not_delay_others() -> None:
    with served("socket") as emulator, connected(emulator) as deaf:
        deaf.setblocking(False)
        with suppress(BlockingIOError):
            for _ in range(20_000):
                deaf.send(LONG_REPLY)
        assert identity("socket", emulator) == IDENTITY


@needs_pty
def test_an_unread_terminal_does_not_prevent_the_server_from_closing() -> None:
    with served("serial") as emulator, opened_terminal(emulator) as descriptor:
        for _ in range(100):
            select.select([], [descriptor], [], 0.1)
            with suppress(BlockingIOError):
                os.write(descriptor, LONG_REPLY * 10)
        threads = threading.active_count()
    assert threading.active_count() == threads - len(GENERATORS)


def lock(peer: socket.socket, number: int, timeout_ms: int = 0) -> int:
    return struct.unpack("!i", call(peer, 18, struct.pack("!iII", number, 1, timeout_ms)))[0]


def test_one_vxi11_link_holds_the_lock_and_others_get_an_error() -> None:
    with served("vxi11") as emulator, connected(emulator) as client, connected(emulator) as theirs:
        mine, yours = link(client), link(theirs)
        assert [lock(client, mine), lock(theirs, yours, 60), lock(client, mine)] == [0, 11, 11]
        write = struct.pack("!iIIi", yours, 100, 50, 1 | 8) + xdr(b"FREQ 5E3\n")
        assert struct.unpack_from("!i", call(theirs, 11, write))[0] == 11
        for procedure in (12, 13, 14, 15):
            arguments = struct.pack("!iIIIii", yours, 0, 0, 0, 0, 0)
            assert struct.unpack_from("!i", call(theirs, procedure, arguments))[0] == 11
        assert struct.unpack("!i", call(theirs, 19, struct.pack("!i", yours)))[0] == 12
        request = struct.pack("!iII", 1, 1, 0) + xdr(b"gpib0,10")
        assert struct.unpack_from("!i", call(theirs, 10, request))[0] == 11
        assert struct.unpack("!i", call(client, 19, struct.pack("!i", mine)))[0] == 0
        assert struct.unpack_from("!i", call(theirs, 11, write))[0] == 0


def test_a_lock_goes_with_the_client_that_held_it() -> None:
    with served("vxi11") as emulator, connected(emulator) as theirs:
        yours = link(theirs)
        with connected(emulator) as client:
            assert lock(client, link(client)) == 0
            assert lock(theirs, yours) == 11
        assert lock(theirs, yours, 5000) == 0


def test_one_of_many_simultaneous_clients_gets_the_lock() -> None:
    with served("vxi11") as emulator:
        granted = []

        def ask() -> None:
            with connected(emulator) as peer:
                granted.append(lock(peer, link(peer)))
                done.wait(10)

        done = threading.Event()
        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        while len(granted) < len(threads):
            time.sleep(0.01)
        done.set()
        for thread in threads:
            thread.join()
        assert sorted(granted) == [0] + [11] * 7


def test_a_hislip_lock_makes_the_messages_of_others_wait() -> None:
    with served("hislip") as emulator, connected(emulator) as client, connected(emulator) as other_client:
        client.sendall(hislip(0, b"hislip0", 0, 0x01007878))
        session = hislip_message(client)[2] & 0xFFFF
        other_client.sendall(hislip(17, b"", 0, session) + hislip(4, b"", 1, 0))
        assert [hislip_message(other_client)[:2] for _ in range(2)] == [(18, 0), (5, 1)]
        with connected(emulator) as theirs:
            theirs.sendall(hislip(0, b"hislip0", 0, 0x01007878) + hislip(7, b"FREQ 5E3;FREQ?\n"))
            hislip_message(theirs)
            client.sendall(hislip(7, b"FREQ?\n"))
            assert hislip_message(client)[3] == b"+1.0000000000000E+03\n"
            other_client.sendall(hislip(4, b"", 0, 0))
            assert hislip_message(other_client)[:2] == (5, 1)
            assert hislip_message(theirs)[3] == b"+5.0000000000000E+03\n"


# Fuzzing: words and characters of messages, and plain bytes

WORDS = b"""*IDN? OUTP 1E400 ; : ? , VOLT DBM #0 ' " ++addr ++read ++ HS *TRG """.split()
HEADS = (b" ", b"\xb2", b"\n", b"\x1b", b"\x00\x00\x00\x01", b"\x80\x00\x00\x30")
PIECES = st.one_of(st.sampled_from([*WORDS, *HEADS]), st.binary(max_size=24))
STREAMS = st.lists(PIECES, max_size=12).map(b"".join)
MESSAGES: dict[str, Callable[[bytes], bytes]] = {
    "socket": lambda data: data,
    "prologix": lambda data: data,
    "hislip": lambda data: hislip(0, b"", 0, 0x01000000) + hislip(data[0] % 30 if data else 7, data[1:]),
    "vxi11": lambda data: (
        rpc(10, struct.pack("!iII", 1, 0, 0) + xdr(b"gpib0,10")) + rpc(data[0] % 30 if data else 11, data[1:])
    ),
}


def throw(emulator: Emulator, data: bytes) -> None:
    """Send ``data`` on a new connection and close it."""
    # The server may have closed the connection by then.
    with connected(emulator) as peer, suppress(OSError):
        peer.sendall(data)
        peer.shutdown(socket.SHUT_WR)
        hung_up(peer)


@pytest.fixture(scope="module", params=ON_TCP)
def target(request: pytest.FixtureRequest) -> Iterator[tuple[str, Emulator]]:
    with served(request.param) as emulator:
        before = threading.active_count()
        yield request.param, emulator
        # A connection keeps no thread, whatever it sent.
        assert_threads_end(before)


def assert_served_after(transport: str, emulator: Emulator, data: bytes) -> None:
    """Send ``data`` as it is and inside messages of the transport; then a well-behaved client must get its reply."""
    for stream in (data, MESSAGES[transport](data)):
        throw(emulator, stream)
    assert identity(transport, emulator) == IDENTITY


def fuzzing(examples: int) -> settings:
    return settings(max_examples=examples, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@fuzzing(10)
@given(STREAMS)
def test_after_any_words_and_bytes_the_next_client_is_served(target: tuple[str, Emulator], data: bytes) -> None:
    assert_served_after(*target, data)


@pytest.mark.slow
@fuzzing(3000)
@given(STREAMS)
def test_after_any_words_and_bytes_the_next_client_is_served_long(target: tuple[str, Emulator], data: bytes) -> None:
    assert_served_after(*target, data)


@needs_pty
def test_a_terminal_full_of_random_bytes_is_still_an_instrument_afterwards() -> None:
    generator = random.Random(15)
    with served("serial") as emulator:
        with opened_terminal(emulator) as descriptor:
            for _ in range(200):
                select.select([], [descriptor], [], 1.0)
                with suppress(BlockingIOError):
                    os.write(descriptor, generator.randbytes(200))
        assert identity("serial", emulator) == IDENTITY
