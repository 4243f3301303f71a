"""RS-232 lines: their settings, and pacing to an input buffer that loses further bytes."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.visa import SerialSettings, VisaConnection
from drivers.visa.resources import VisaLine
from drivers.visa.rs232 import INPUT_BUFFER_BYTES, PacedLine
from sim_backend.transports import lines
from sim_backend.transports.lines import SerialServer
from sim_backend.transports.loopback import Port

TIMEOUT_S = 1.0
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")


@contextmanager
def narrow_line(instrument, busy_s: float = 0.01) -> Iterator[SerialServer]:
    """Yield a line to ``instrument``, which holds 256 bytes and takes ``busy_s`` for each line."""
    server = SerialServer(Port(instrument, threading.RLock()), INPUT_BUFFER_BYTES, busy_s)
    try:
        yield server
    finally:
        server.close()


def settings(count: int, start: int = 0) -> list[str]:
    """Return ``count`` commands of 60 bytes, with the line end."""
    return [f"VOLT {number:054.48f}" for number in range(start, start + count)]


def test_messages_without_replies_reach_a_busy_instrument_without_a_lost_byte(scripted) -> None:
    instrument = scripted(replies={"*ESE": "0"})
    with narrow_line(instrument) as server:
        connection = VisaConnection(server.address, TIMEOUT_S, backend="@py")
        for command in settings(20):
            connection.write(command)
        connection.write("*IDN?")
        assert "33250A" in connection.read()
        connection.close()
        assert server.lost_bytes == 0
    assert [text for text in instrument.messages if text.startswith("VOLT")] == settings(20)
    # A probe for every four commands; a reply that is awaited anyway needs none.
    assert instrument.messages.count("*ESE?") == 4


def test_a_message_longer_than_the_buffer_arrives_command_by_command(scripted) -> None:
    instrument = scripted(replies={"*ESE": "0"})
    with narrow_line(instrument) as server:
        connection = VisaConnection(server.address, TIMEOUT_S, backend="@py")
        connection.write(";:".join(settings(12)) + ";*CLS")
        connection.write("*IDN?")
        assert "33250A" in connection.read()
        connection.close()
        assert server.lost_bytes == 0
    commands = [text for text in instrument.commands if text not in ("SYST:REM", "*ESE?", "*IDN?")]
    assert commands == [*settings(12), "*CLS"]


def test_without_pacing_the_line_of_these_tests_loses_bytes(scripted) -> None:
    with narrow_line(scripted()) as server:
        line = VisaLine(server.address, TIMEOUT_S, "@py", lock=False)
        for command in settings(20):
            line.write(f"{command}\n".encode())
        line.write(b"*IDN?\n")
        with pytest.raises(TimeoutError):
            line.read()
        line.close()
        assert server.lost_bytes > 100


def test_an_instrument_that_reads_nothing_is_a_lost_connection_within_two_time_outs(scripted) -> None:
    with narrow_line(scripted(replies={"*ESE": "0"}), busy_s=2.0) as server:
        connection = VisaConnection(server.address, 0.1, backend="@py")
        for command in settings(4):
            connection.write(command)
        # Once the instrument reads again, after 2 s, there is no error.
        with pytest.raises(ConnectionError, match=r"has not read \d+ bytes within 0\.2 s"):
            connection.write(*settings(1))
        connection.close()


class FakeLine:
    """Answers each probe and each query in order; interrupts the program at the first reading."""

    is_rs232 = True
    timeout_s = 0.1

    def __init__(self) -> None:
        self.replies: deque[bytes] = deque()
        self.interrupts = 1

    def write(self, message: bytes) -> None:
        if b"?" in message:
            self.replies.append(b"probe\n" if message.startswith(b"*ESE?") else b"0\n")

    def read(self) -> bytes:
        if self.interrupts:
            self.interrupts -= 1
            raise KeyboardInterrupt
        if not self.replies:
            raise TimeoutError
        return self.replies.popleft()

    def discard_replies(self) -> None: ...

    def close(self) -> None: ...


def test_the_reply_to_an_interrupted_probe_is_not_taken_for_the_state_of_an_output() -> None:
    line = PacedLine(FakeLine())
    line.write(b"a" * 249 + b"\n")
    with pytest.raises(KeyboardInterrupt):
        line.write(b"b" * 99 + b"\n")
    line.write(b"OUTP?\n")
    assert line.read() == b"0\n"
    with pytest.raises(TimeoutError):
        line.read()


def test_a_simulated_line_that_is_closed_during_an_answer_ends_without_an_error(scripted, monkeypatch) -> None:
    monkeypatch.setattr(lines, "CLOSING_S", 0.01)
    with narrow_line(scripted(), busy_s=0.2) as server:
        terminal = os.open(server.address.removeprefix("ASRL").removesuffix("::INSTR"), os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"*IDN?\n")
        os.close(terminal)
        time.sleep(0.05)
    # An error of the thread fails the test: its descriptors must be open until it ends.
    server._thread.join()


def test_switching_off_waits_for_no_probe_while_the_buffer_has_room() -> None:
    line = PacedLine(FakeLine())
    line.write(b"a" * 199 + b"\n")
    # It would be interrupted.
    line.write(b"OUTP 0\n")


@pytest.mark.parametrize(("handshake", "xon_xoff", "rts_cts"), [("none", 0, 0), ("xon_xoff", 1, 0), ("rts_cts", 0, 1)])
def test_speed_and_handshake_of_the_line_are_those_of_its_settings(
    scripted, handshake: str, xon_xoff: int, rts_cts: int
) -> None:
    import termios

    with narrow_line(scripted()) as server:
        serial = SerialSettings(9600, handshake)  # type: ignore[arg-type]
        connection = VisaConnection(server.address, TIMEOUT_S, backend="@py", serial=serial)
        flags_in, _, flags, _, speed, *_ = termios.tcgetattr(server._client_end)
        assert speed == termios.B9600
        assert bool(flags_in & termios.IXON) == bool(xon_xoff)
        assert bool(flags & termios.CRTSCTS) == bool(rts_cts)
        connection.close()


@pytest.mark.parametrize(("termination", "line_end"), [("lf", b"\n"), ("cr_lf", b"\r\n"), ("cr", b"\r")])
def test_commands_and_replies_end_as_the_settings_say(termination: str, line_end: bytes) -> None:
    import tty

    server, client = os.openpty()
    tty.setraw(client)
    serial = SerialSettings(termination=termination)  # type: ignore[arg-type]
    connection = VisaConnection(f"ASRL{os.ttyname(client)}::INSTR", TIMEOUT_S, backend="@py", serial=serial)
    os.write(server, b"first" + line_end + b"second" + line_end)
    connection.write("*IDN?")
    assert [connection.read(), connection.read()] == ["first", "second"]
    expected = b"SYST:REM" + line_end + b"*IDN?" + line_end
    # One read of a terminal may return a part of what was written.
    received = b""
    while len(received) < len(expected):
        received += os.read(server, 100)
    assert received == expected
    connection.close()
    os.close(server)
    os.close(client)
