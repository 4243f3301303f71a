"""One SCPI session against scripts that coerce, queue errors, stay silent or answer late."""

from __future__ import annotations

import threading
import time
from collections import deque

import pytest

from drivers.agilent.read_back import Register
from drivers.agilent.scpi import QUEUE_READS, RefusedError, ScpiSession, joined
from drivers.interfaces import InstrumentError
from sim_backend.generator.instrument import Generator33250A
from sim_backend.wiring import SimulatedClock

RATE = Register("rate_hz", "FREQ", 100.0)
COUNT = Register("count", "BURS:NCYC", 20)


class LateConnection:
    """Answers each query with its own text; the reply to ``lost`` is ``stale`` and only comes after ``late`` reads.

    A connection keeps its order: the replies to later queries follow the late reply.
    """

    def __init__(self, lost: str, late: int, stale: str) -> None:
        self.lost, self.late, self.stale = lost, late, stale
        self.outbox: deque[str] = deque()
        self.reads_to_wait = 0
        self.held = "0"

    def write(self, message: str) -> None:
        for part in message.split(";"):
            if part == self.lost:
                self.lost, self.reads_to_wait = "", self.late
                self.outbox.append(self.stale)
            elif part.startswith("*ESE "):
                self.held = part.split()[1]
            elif part == "*ESE?":
                self.outbox.append(f"+{self.held}")
            elif part.endswith("?"):
                self.outbox.append(f"answer to {part}")

    def read(self) -> str:
        self.reads_to_wait -= 1
        if self.reads_to_wait >= 0 or not self.outbox:
            raise TimeoutError("nothing to read")
        return self.outbox.popleft()

    def close(self) -> None:
        pass


def test_joined_commands_each_start_at_the_root_and_common_ones_stay_bare() -> None:
    assert joined(["OUTP 0", "*CLS", "FUNC PULS", "PULS:WIDT 1E-5"]) == "OUTP 0;*CLS;:FUNC PULS;:PULS:WIDT 1E-5"


def test_a_group_goes_out_as_one_message_and_comes_back_with_the_error_queue_in_another(scripted) -> None:
    connection = scripted()
    ScpiSession(connection, "master").program("train", [RATE, COUNT])
    assert connection.messages == ["FREQ 1.000000000000E+02;:BURS:NCYC 20", "FREQ?;:BURS:NCYC?;:SYST:ERR?"]


@pytest.mark.parametrize("index", range(3))
def test_an_error_at_each_position_of_a_group_is_an_error_that_names_it(index: int) -> None:
    """The instrument stops at the first command that it does not know; what stands before it has been carried out."""
    registers = [RATE, COUNT, Register("delay_s", "TRIG:DEL", 1e-3)]
    registers[index] = Register("nonsense", "NON:SENS", 1.0)
    session = ScpiSession(Generator33250A(SimulatedClock(), 0.0), "master")
    with pytest.raises(InstrumentError) as caught:
        session.program("train", registers)
    assert "NON:SENS" in str(caught.value)
    assert "-113" in str(caught.value) or index == 0
    assert float(session.query("FREQ?")) == (1000.0 if index == 0 else 100.0)


@pytest.mark.parametrize("index", range(4))
def test_a_coercion_at_each_position_of_a_group_is_found(scripted, index: int) -> None:
    registers = [Register(f"key_{index}", f"HEAD:NUM{index}", 1.0) for index in range(4)]
    connection = scripted(replies={f"HEAD:NUM{index}": "+2.0000000000000E+00"})
    with pytest.raises(RefusedError, match=f"key_{index} "):
        ScpiSession(connection, "master").program("group", registers)


def test_an_overflowed_error_queue_is_reported_whole_and_empty_afterwards() -> None:
    session = ScpiSession(Generator33250A(SimulatedClock(), 0.0), "master")
    for _ in range(30):
        session.write("FREQ 1E12")
    errors = session.drain_errors()
    assert [error.number for error in errors] == [-222] * 19 + [-350]
    assert session.drain_errors() == ()


@pytest.mark.parametrize("reply", ["+1.0E+02", '+1.0E+02;+0,"No error"', "+1.0E+02;+20;", "\x00\xff;\x80;\x81", ";;"])
def test_partial_and_corrupt_replies_are_errors_and_the_next_reply_fits_its_query(scripted, reply: str) -> None:
    connection = scripted()
    session = ScpiSession(connection, "master")
    session.write(RATE.command, COUNT.command)
    read = connection.read
    connection.read = lambda: (setattr(connection, "read", read), connection.outbox.clear(), reply)[-1]
    with pytest.raises(InstrumentError, match="master"):
        session.verify("train", [RATE, COUNT])
    session.verify("train", [RATE, COUNT])


def test_a_reply_in_two_lines_shifts_no_later_reply(scripted) -> None:
    """The second line reads like an empty error queue."""
    connection = scripted()
    session = ScpiSession(connection, "master")
    session.write(RATE.command, COUNT.command)
    read = connection.read

    def first_line() -> str:
        connection.read = read
        head, _, tail = read().rpartition(";")
        connection.outbox.appendleft(tail)
        return head

    connection.read = first_line
    with pytest.raises(InstrumentError, match="3 queries had 2 replies"):
        session.verify("train", [RATE, COUNT])
    assert session.query("BURS:NCYC?") == "20"


def test_two_threads_share_one_session_without_mixing_replies() -> None:
    class Slow:
        """Gives way between question and answer, as every real connection does."""

        def __init__(self) -> None:
            self.instrument = Generator33250A(SimulatedClock(), 0.0)
            self.read, self.close = self.instrument.read, lambda: None

        def write(self, message: str) -> None:
            self.instrument.write(message)
            time.sleep(1e-3)

    session = ScpiSession(Slow(), "master")
    wrong: list[str] = []

    def ask(header: str, answer: str) -> None:
        for _ in range(10):
            try:
                reply = session.query(header)
            except InstrumentError as error:
                reply = str(error)
            wrong.extend([reply] if reply != answer else [])

    pairs = [("FUNC?", "SIN"), ("OUTP?", "0"), ("TRIG:SOUR?", "IMM")]
    threads = [threading.Thread(target=ask, args=pair) for pair in pairs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_coerced_value_is_an_error_that_names_the_setting_and_both_values(scripted) -> None:
    session = ScpiSession(scripted(replies={"FREQ": "+5.0000000000000E+07"}), "burst_train")
    with pytest.raises(InstrumentError) as caught:
        session.program("train", [Register("rate_hz", "FREQ", 6e7), COUNT])
    text = str(caught.value)
    assert caught.value.role == "burst_train"
    assert "rate_hz" in text
    assert "6.000000000000E+07" in text
    assert "+5.0000000000000E+07" in text
    assert "count" not in caught.value.what


def test_a_queued_error_is_an_error_even_if_every_value_reads_back(scripted) -> None:
    connection = scripted(errors=['-221,"Settings conflict; a, b"', '-222,"Data out of range"'])
    with pytest.raises(InstrumentError, match=r"-221 Settings conflict; a, b, -222 Data out of range"):
        ScpiSession(connection, "master").program("train", [RATE])
    assert not connection.errors


@pytest.mark.parametrize(
    ("sent", "times", "cause"),
    [
        ("FREQ 1E12", 1, "was clipped to it"),
        ("FREQ 1E12", 30, "more errors came than the queue holds"),
        ("NON:SENS 1", 1, "does not know a command"),
        ("*TRG", 1, "the trigger was ignored"),
    ],
)
def test_the_twins_errors_are_reported_with_their_cause(sent: str, times: int, cause: str) -> None:
    instrument = Generator33250A(SimulatedClock(), 0.0)
    session = ScpiSession(instrument, "master")
    for _ in range(times):
        instrument.write(sent)
    with pytest.raises(InstrumentError, match=f"(?i){cause}"):
        session.program("train", [RATE])


def test_a_session_names_its_bus(scripted) -> None:
    connection = scripted()
    assert ScpiSession(connection, "master").bus == ""
    connection.timeout_s, connection.bus, connection.reopen = 1.0, "GPIB0", lambda: None
    assert ScpiSession(connection, "master").bus == "GPIB0"


def test_every_difference_of_a_group_is_in_one_error(scripted) -> None:
    connection = scripted(replies={"FREQ": "+1.0E+00", "BURS:NCYC": "+1.0E+00"})
    with pytest.raises(InstrumentError) as caught:
        ScpiSession(connection, "master").program("train", [RATE, COUNT])
    assert "rate_hz" in caught.value.what
    assert "count" in caught.value.what


def test_an_error_queue_that_never_empties_ends_after_a_bounded_number_of_reads(scripted) -> None:
    connection = scripted(replies={}, errors=['-100,"again"'] * 1000)
    with pytest.raises(InstrumentError, match="not empty"):
        ScpiSession(connection, "master").drain_errors()
    assert len(connection.messages) == QUEUE_READS


def test_an_invalid_error_entry_is_reported_with_its_text_and_shifts_no_later_reply(scripted) -> None:
    connection = scripted()
    session = ScpiSession(connection, "master")
    session.write("FREQ 7")
    connection.outbox.append("hello")
    with pytest.raises(InstrumentError, match="'hello'"):
        session.drain_errors()
    assert session.query("FREQ?") == "7"


def test_silence_is_an_instrument_error_caused_by_the_timeout(scripted) -> None:
    with pytest.raises(InstrumentError, match=r"master: no reply to '\*OPT\?'") as caught:
        ScpiSession(scripted(), "master").query("*OPT?")
    assert isinstance(caught.value.__cause__, TimeoutError)


@pytest.mark.parametrize("late", range(1, 8))
@pytest.mark.parametrize("stale", ["+1.0E+02", "+1", "+2", "+3", '+0,"No error"', "answer to FREQ?"])
def test_a_late_reply_never_answers_a_later_query(late: int, stale: str) -> None:
    """``late`` covers arrival before, during and after the draining; ``stale`` includes the sync numbers themselves."""
    session = ScpiSession(LateConnection("VOLT?", late, stale), "toneburst")
    with pytest.raises(InstrumentError):
        session.query("VOLT?")
    answered = 0
    for query in ["TRIG:DEL?", "BURS:NCYC?"] * 5:
        try:
            assert session.query(query) == f"answer to {query}"
            answered += 1
        except InstrumentError:
            continue
    # Each refused query waits at least twice more for the late reply.
    assert answered >= 10 - late / 2


def test_an_interrupt_while_waiting_does_not_leave_the_reply_for_the_next_query() -> None:
    class InterruptedOnce(LateConnection):
        def read(self) -> str:
            if self.late:
                self.late = 0
                raise KeyboardInterrupt
            return super().read()

    session = ScpiSession(InterruptedOnce("", 1, ""), "master")
    with pytest.raises(KeyboardInterrupt):
        session.query("FREQ?")
    assert session.query("OUTP?") == "answer to OUTP?"


def test_a_session_that_cannot_resynchronise_refuses_queries_but_writes(scripted) -> None:
    connection = scripted(replies={"*ESE": "+300"})
    session = ScpiSession(connection, "master")
    for query in ("*OPT?", "OUTP?", "OUTP?"):
        with pytest.raises(InstrumentError):
            session.query(query)
    assert "OUTP?" not in connection.commands
    session.write("OUTP 0")
    assert connection.held["OUTP"] == "0"


@pytest.mark.parametrize("method", ["write", "read"])
def test_a_lost_connection_is_an_instrument_error_with_its_cause(scripted, method: str) -> None:
    def broken(*arguments: str) -> str:
        raise ConnectionResetError("peer left")

    connection = scripted()
    setattr(connection, method, broken)
    with pytest.raises(InstrumentError, match="peer left") as caught:
        ScpiSession(connection, "tracking_train").query("FREQ?")
    assert isinstance(caught.value.__cause__, ConnectionResetError)
