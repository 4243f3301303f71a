"""Lines of text without an instrument: addresses, bytes for a Prologix adapter, sockets, and reasons of failures."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Iterator
from typing import Any

import pytest
import pyvisa
from pyvisa.constants import StatusCode

from drivers.visa import (
    NoVisaError,
    OpenError,
    PrologixAdapter,
    SerialSettings,
    VisaConnection,
    bounded,
    connection as connection_module,
    prologix,
    resources,
    sockets,
)
from drivers.visa.failures import MUTE, NO_DEVICE, REFUSED, UNREACHABLE, Failure
from drivers.visa.prologix import PrologixInstrument
from drivers.visa.resources import VisaLine, open_failure
from drivers.visa.rs232 import PacedLine
from drivers.visa.sockets import TcpLine, tcp_endpoint


class Line:
    """A line that keeps what is sent; ``replies`` are returned in order, a missing one is a time-out."""

    timeout_s = 1.5

    def __init__(self, *replies: bytes, is_rs232: bool = False) -> None:
        self.sent, self.replies, self.discarded = list[bytes](), deque(replies), 0
        self.is_rs232, self.closed = is_rs232, False

    def write(self, message: bytes) -> None:
        self.sent.append(message)

    def read(self) -> bytes:
        if not self.replies:
            raise TimeoutError
        return self.replies.popleft()

    def discard_replies(self) -> None:
        self.discarded += 1

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("address", "endpoint"),
    [
        ("TCPIP0::192.168.1.20::5025::SOCKET", ("192.168.1.20", 5025)),
        ("tcpip::rack::1::socket", ("rack", 1)),
        ("PRLGX-TCPIP0::rack::1234::INTFC", ("rack", 1234)),
        ("ASRLsocket://rack:4001::INSTR", ("rack", 4001)),
        ("TCPIP0::rack::inst0::INSTR", None),
        ("TCPIP0::rack::5025::INSTR", None),
        ("ASRL/dev/ttyUSB0::INSTR", None),
    ],
)
def test_only_raw_sockets_have_an_endpoint(address: str, endpoint: tuple[str, int] | None) -> None:
    assert tcp_endpoint(address) == endpoint


@pytest.fixture
def adapter_line(monkeypatch: pytest.MonkeyPatch) -> Line:
    line = Line()
    monkeypatch.setattr(prologix, "TcpLine", lambda endpoint, timeout_s: line)
    return line


SET_UP = b"++mode 1\n++auto 0\n++eos 3\n++eoi 1\n++eot_enable 0\n"


def test_an_adapter_gets_its_settings_then_addresses_and_escaped_messages(adapter_line: Line) -> None:
    line = adapter_line
    adapter = PrologixAdapter("PRLGX-TCPIP0::rack::1234::INTFC", 1.5)
    first = PrologixInstrument(adapter, "GPIB0::10::INSTR")
    second = PrologixInstrument(adapter, "gpib1::11::3")
    assert line.sent == [SET_UP + b"++read_tmo_ms 1200\n"]
    line.sent.clear()
    first.write(b"A+B\x1b\rC\n")
    assert line.sent == [b"++addr 10\nA\x1b+B\x1b\x1b\x1b\rC\n"]
    line.replies.extend([b"one", b"two", b"three"])
    assert (first.read(), first.read(), second.read()) == (b"one", b"two", b"three")
    # A reply is requested once a message; another instrument is selected before it is read.
    assert line.sent[1:] == [b"++read eoi\n", b"++addr 11 3\n"]
    assert line.discarded == 1
    line.sent.clear()
    with pytest.raises(TimeoutError):
        first.read()
    second.write(b"X?\n")
    first.write(b"Y?\n")
    first.write(b"Z?\n")
    # An instrument whose reply is missing is cleared once, before its next message.
    assert line.sent == [b"++addr 10\n", b"++addr 11 3\nX?\n", b"++addr 10\n++clr\nY?\n", b"Z?\n"]
    assert line.discarded == 4
    first.close()
    first.discard_replies()
    assert not line.closed
    adapter.close()
    assert line.closed


def test_the_wait_of_an_adapter_is_shorter_than_that_of_the_program_within_its_limits(adapter_line: Line) -> None:
    line = adapter_line
    adapter = PrologixAdapter("PRLGX-TCPIP0::rack::1234::INTFC", 1.5)
    instrument = PrologixInstrument(adapter, "GPIB0::10::INSTR")
    for timeout_s, command in ((0.4, b"320"), (10.0, b"3000"), (1e-4, b"1"), (3.75, b"3000")):
        instrument.timeout_s = timeout_s
        assert line.sent[-1] == b"++read_tmo_ms " + command + b"\n"
        assert (instrument.timeout_s, line.timeout_s) == (timeout_s, timeout_s)
    count = len(line.sent)
    instrument.timeout_s = 3.75
    assert len(line.sent) == count
    adapter.reopen()
    # The settings of the adapter are sent again, and no instrument is selected.
    assert line.sent[-1] == SET_UP + b"++read_tmo_ms 3000\n"
    assert line.closed
    instrument.write(b"A\n")
    assert line.sent[-1] == b"++addr 10\nA\n"


@pytest.mark.parametrize("address", ["GPIB0::INSTR", "GPIB0::10::INSTR::x"])
def test_an_instrument_behind_an_adapter_has_a_gpib_address(adapter_line: Line, address: str) -> None:
    adapter = PrologixAdapter("PRLGX-TCPIP0::rack::1234::INTFC")
    with pytest.raises(OpenError, match="GPIB0::10::INSTR") as caught:
        VisaConnection(address, adapter=adapter)
    assert address in str(caught.value)
    assert VisaConnection("GPIB0::10::INSTR", adapter=adapter).bus == adapter.address


def test_a_connection_ends_messages_decodes_replies_and_names_the_address_of_failures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = Line(b"\xb5V\r\n", b"1\n")
    monkeypatch.setattr(connection_module, "TcpLine", lambda endpoint, timeout_s, is_rs232: line)
    opened = VisaConnection("TCPIP0::rack::5025::SOCKET", 0.7)
    assert (opened.bus, opened.timeout_s, line.timeout_s) == ("TCPIP0::rack::5025::SOCKET", 0.7, 0.7)
    opened.write("FREQ?")
    assert line.sent == [b"FREQ?\n"]
    assert (opened.read(), opened.read()) == ("\xb5V", "1")
    with pytest.raises(TimeoutError, match=r"no reply from 'TCPIP0::rack::5025::SOCKET' within 0\.7 s"):
        opened.read()

    def fail(*_: object) -> bytes:
        raise ConnectionResetError(104, "reset")

    monkeypatch.setattr(Line, "read", fail)
    monkeypatch.setattr(Line, "write", fail)
    for act, verb in ((opened.read, "read from"), (lambda: opened.write("A"), "write to")):
        with pytest.raises(ConnectionError, match=f"cannot {verb} 'TCPIP0::rack::5025::SOCKET': the instrument closed"):
            act()


def test_a_serial_line_is_paced_and_ended_as_its_settings_say(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(is_rs232=True)
    seen = list[bool]()
    monkeypatch.setattr(
        connection_module, "TcpLine", lambda endpoint, timeout_s, is_rs232: (seen.append(is_rs232), line)[1]
    )
    opened = VisaConnection("asrlsocket://rack:4001::INSTR", serial=SerialSettings(termination="cr_lf"))
    opened.write("A")
    assert (seen, line.sent) == ([True], [b"SYST:REM\r\n", b"A\r\n"])
    VisaConnection("TCPIP0::rack::5025::SOCKET")
    assert seen == [True, False]


def test_a_paced_line_keeps_within_the_buffer_of_256_bytes() -> None:
    """A probe has 6 bytes, so that 250 may wait in front of it."""
    line = Line()
    paced = PacedLine(line)
    paced.write(b"A" * 124 + b"\n")
    paced.write(b"B" * 124 + b"\n")
    assert len(line.sent) == 2
    line.replies.append(b"0")
    paced.write(b"C\n")
    assert line.sent[2:] == [b"*ESE?\n", b"C\n"]
    # A reply proves that everything before it was read; a message of 250 bytes is sent whole, a longer one in parts.
    line.replies.append(b"reply")
    assert paced.read() == b"reply"
    line.sent.clear()
    whole = b"A" * 124 + b";:" + b"B" * 123 + b"\n"
    paced.write(whole)
    assert line.sent == [whole]
    line.replies.extend([b"0", b"0"])
    paced.write(b"A" * 124 + b";:" + b"B" * 124 + b";*CLS\n")
    assert line.sent[1:] == [b"*ESE?\n", b"A" * 124 + b"\n", b"*ESE?\n", b":" + b"B" * 124 + b"\n", b"*CLS\n"]
    line.replies.clear()
    with pytest.raises(ConnectionError, match=r"has not read 131 bytes within 3 s"):
        paced.write(b"D" * 249 + b"\n")
    paced.timeout_s = 0.5
    assert (paced.timeout_s, line.timeout_s) == (0.5, 0.5)
    # The replies to two probes are missing, and come before the next reply.
    line.replies.extend([b"0", b"late"])
    assert paced.read() == b"late"
    with pytest.raises(TimeoutError):
        paced.read()
    paced.discard_replies()
    paced.close()
    assert (line.discarded, line.closed) == (1, True)


@pytest.fixture
def pair() -> Iterator[tuple[TcpLine, socket.socket]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = TcpLine(server.getsockname(), 5.0)
        peer, _ = server.accept()
        with peer:
            yield line, peer
        line.close()


def test_a_socket_returns_lines_in_order_drops_what_is_late_and_notices_the_end(
    pair: tuple[TcpLine, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    line, peer = pair
    assert line._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    peer.sendall(b"one\ntwo\nthr")
    assert (line.read(), line.read()) == (b"one", b"two")
    line.timeout_s = 0.05
    with pytest.raises(TimeoutError):
        line.read()
    # The incomplete line was dropped.
    line.timeout_s = 5.0
    peer.sendall(b"ee\nfour\n")
    assert line.read() == b"ee"
    line.discard_replies()
    peer.sendall(b"five\n")
    assert line.read() == b"five"
    line.write(b"A\n")
    assert peer.recv(10) == b"A\n"
    # Data that wait to be read are no end.
    peer.sendall(b"six\n")
    line.write(b"B\n")
    assert (line.read(), peer.recv(10)) == (b"six", b"B\n")
    peer.close()
    with pytest.raises(ConnectionError, match="the instrument closed the connection"):
        line.read()
    with pytest.raises(ConnectionError, match="the instrument closed the connection"):
        line.write(b"C\n")
    line.close()
    with pytest.raises(OSError, match="descriptor"):
        line.write(b"D\n")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("GPIB0::10::INSTR", ("GPIB", ", or linux-gpib and pip install gpib-ctypes")),
        ("usb0::1::2::3::INSTR", ("USB", ", or pip install pyusb and a libusb")),
        ("PXI0::1", ("this kind of address", "Keysight IO Libraries")),
    ],
)
def test_a_missing_driver_is_named_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch, address: str, words: tuple[str, str]
) -> None:
    class Manager:
        def open_resource(self, name: str, open_timeout: int) -> None:
            raise ValueError("Please install a package")

    monkeypatch.setattr(resources, "_resource_manager", lambda backend: Manager())
    with pytest.raises(NoVisaError) as caught:
        VisaConnection(address)
    assert str(caught.value) == f"cannot open {address!r}: no VISA driver for {words[0]} is installed"
    assert caught.value.remedy.endswith(words[1])


PROBES = [
    ("TCPIP0::rack::inst0::INSTR", ("rack", 111)),
    ("TCPIP0::rack", ("rack", 111)),
    ("TCPIP0::rack,1024::inst0::INSTR", ("rack", 1024)),
    ("TCPIP0::rack::hislip0::INSTR", ("rack", 4880)),
    ("TCPIP0::rack::HISLIP0,4999::INSTR", ("rack", 4999)),
    ("TCPIP0::rack::5025::SOCKET", None),
    ("GPIB0::10::INSTR", None),
]


@pytest.mark.parametrize(("address", "probed"), PROBES)
def test_a_host_on_the_network_is_probed_for_the_reason_of_a_failure(
    monkeypatch: pytest.MonkeyPatch, address: str, probed: tuple[str, int] | None
) -> None:
    probes, answer = list[tuple[str, int]](), list[OSError]()

    def connect(host: str, port: int) -> None:
        probes.append((host, port))
        for error in answer:
            raise error

    monkeypatch.setattr(resources, "_connect_once", connect)
    other = Failure("its own words", "the address, the cable or the power is wrong", "")
    absent, timeout = OSError(2, "no such file"), TimeoutError("timed out")
    assert open_failure(address, timeout) == (MUTE if probed else UNREACHABLE)
    assert open_failure(address, absent) == (MUTE if probed else NO_DEVICE)
    assert open_failure(address, Exception("its own words")).what == other.what
    answer.append(ConnectionRefusedError(111, "refused"))
    assert open_failure(address, timeout) == (REFUSED if probed else UNREACHABLE)
    assert probes == [probed] * 4 if probed else not probes


class Resource(pyvisa.resources.MessageBasedResource):
    """A resource of pyvisa without a session; ``answers`` are replies or errors in order."""

    def __init__(self, *answers: Any) -> None:
        self.answers, self.calls = deque(answers), list[str]()
        self.settings: dict[str, Any] = {}

    timeout = read_termination = property(lambda self: self.settings.get("timeout"), lambda self, value: None)  # type: ignore[assignment]

    def read_raw(self, size: int | None = None) -> bytes:
        answer = self.answers.popleft()
        if isinstance(answer, Exception):
            raise answer
        return answer  # type: ignore[no-any-return]

    def write_raw(self, message: bytes) -> int:
        self.calls.append(message.decode())
        return len(message)

    def clear(self) -> None:
        self.calls.append("clear")
        raise OSError("no clear")

    def lock_excl(self, timeout: Any = None) -> None:
        self.calls.append(f"lock {timeout}")
        for answer in self.answers:
            raise answer

    def close(self) -> None:
        self.calls.append("close")

    def __del__(self) -> None: ...


def visa_line(monkeypatch: pytest.MonkeyPatch, resource: Resource, lock: bool = False) -> VisaLine:
    monkeypatch.setattr(resources, "_message_resource", lambda address, backend: resource)
    return VisaLine("GPIB0::10::INSTR", 1.5, "", lock)


def test_a_missing_reply_is_a_time_out_and_other_errors_are_those_of_the_library(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing, lost = pyvisa.VisaIOError(StatusCode.error_timeout), pyvisa.VisaIOError(StatusCode.error_connection_lost)
    resource = Resource(missing, b"one\n", lost, missing, b"")
    line = visa_line(monkeypatch, resource)
    line._has_device_clear = True
    with pytest.raises(TimeoutError):
        line.read()
    line.write(b"A")
    line.write(b"B")
    # A failure of the clear shows at the message.
    assert resource.calls == ["clear", "A", "B"]
    assert line.read() == b"one\n"
    with pytest.raises(pyvisa.VisaIOError):
        line.read()
    line.write(b"C")
    assert resource.calls[3:] == ["C"]
    line._has_device_clear = False
    with pytest.raises(TimeoutError):
        line.read()
    line.write(b"D")
    assert resource.calls[4:] == ["D"]
    # Nothing at once is a missing reply too.
    with pytest.raises(TimeoutError):
        line.read()


def test_a_resource_is_locked_on_request_and_a_library_without_locks_is_no_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for errors in ([], [pyvisa.VisaIOError(StatusCode.error_nonsupported_operation)]):
        resource = Resource(*errors)
        visa_line(monkeypatch, resource, lock=True)
        assert resource.calls == ["lock 200"]
    locked = Resource(pyvisa.VisaIOError(StatusCode.error_resource_locked))
    with pytest.raises(OSError, match="another program holds its lock"):
        visa_line(monkeypatch, locked, lock=True)
    assert locked.calls == ["lock 200", "close"]
    unlocked = Resource()
    visa_line(monkeypatch, unlocked)
    assert unlocked.calls == []


def test_a_resource_without_messages_is_closed_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Register:
        closed = False

        def close(self) -> None:
            self.closed = True

    register = Register()

    class Manager:
        def open_resource(self, name: str, open_timeout: int) -> Register:
            assert open_timeout == 2500
            return register

    monkeypatch.setattr(resources, "_resource_manager", lambda backend: Manager())
    with pytest.raises(OpenError, match="Register carries no text messages"):
        VisaConnection("VXI0::1::INSTR")
    assert register.closed


def test_a_line_that_opens_too_late_is_closed_and_a_call_needs_no_thread_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import threading

    opened, line = threading.Event(), Line()

    def open_line() -> Line:
        opened.wait(30.0)
        return line

    with pytest.raises(TimeoutError, match=r"longer than 0\.05 s"):
        bounded.open_within(0.05, open_line)
    opened.set()
    for _ in range(600):
        if line.closed:
            break
        threading.Event().wait(0.01)
    assert line.closed
    assert bounded.open_within(30.0, open_line) is line

    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread at interpreter shutdown")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    assert bounded.within(1.0, lambda: 3) == 3


def test_the_librarys_own_limit_of_an_opening_ends_before_that_of_the_call_around_it() -> None:
    assert resources.OPEN_TIMEOUT_MS / 1e3 < sockets.OPEN_TIMEOUT_S
