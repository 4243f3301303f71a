"""The generator roles on a scripted instrument: lost replies and connections, outputs that are proven off."""

from __future__ import annotations

import dataclasses
import math

import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.interfaces import (
    InstrumentError,
    PulseTrain,
    Toneburst,
    TriggerPulse,
)

PULSE = TriggerPulse(width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=0.0, load_ohm=50.0)
ROLES = [(Agilent33250A, PULSE), (Agilent33250A, TRAIN), (Agilent33250A, BURST)]


@pytest.mark.parametrize("late", [False, True], ids=["lost", "late"])
def test_a_missing_identity_is_queried_once_more_and_nothing_else_is_sent(scripted, monkeypatch, late: bool) -> None:
    connection = scripted()
    read, silent = connection.read, [True]

    def once_silent() -> str:
        if silent and silent.pop():
            if not late:
                connection.outbox.clear()
            raise TimeoutError("nothing to read")
        return read()

    monkeypatch.setattr(connection, "read", once_silent)
    generator = Agilent33250A(connection, "toneburst")
    assert generator.identify().model == "33250A"
    assert connection.messages == ["*IDN?", "*IDN?"]
    # A late first reply would answer the next query.
    generator.configure(BURST)


def test_an_instrument_without_identity_is_missing(scripted) -> None:
    connection, waits = scripted(replies={"*IDN": None}), list[str]()
    read = connection.read
    connection.read = lambda: (waits.append("time-out"), read())[1]
    with pytest.raises(InstrumentError, match=r"no reply to '\*IDN\?'"):
        Agilent33250A(connection, "master").identify()
    assert connection.messages == ["*IDN?", "*IDN?"]
    # One time-out for each query.
    assert len(waits) == 2


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_make_safe_works_without_configure_and_with_old_errors_queued(scripted, role_type, program) -> None:
    connection = scripted(errors=['-113,"Undefined header"'])
    connection.held["OUTP"] = "1"
    role_type(connection, "x").make_safe()
    assert connection.held["OUTP"] == "0"


def test_make_safe_sends_the_switch_even_when_replies_are_lost_and_says_that_it_is_not_proven(scripted) -> None:
    connection = scripted()
    connection.held["OUTP"] = "1"
    connection.read = lambda: (_ for _ in ()).throw(TimeoutError("silence"))
    with pytest.raises(InstrumentError, match="no reply"):
        Agilent33250A(connection, "toneburst").make_safe()
    assert connection.held["OUTP"] == "0"


def lose(connection) -> None:
    """Close ``connection`` at the instrument's end; ``reopen`` restores it."""
    write = connection.write

    def refuse(message: str) -> None:
        raise ConnectionResetError("closed by the instrument")

    connection.write, connection.timeout_s, connection.bus = refuse, 1.0, "GPIB0"
    connection.reopen = lambda: setattr(connection, "write", write)


def test_an_output_whose_connection_was_lost_is_proven_off_over_a_new_one(scripted) -> None:
    connection = scripted()
    connection.held["OUTP"] = "1"
    lose(connection)
    assert "opened again" in Agilent33250A(connection, "toneburst").make_safe()
    assert connection.held["OUTP"] == "0"


def test_a_connection_lost_between_two_shots_is_opened_again_if_the_same_instrument_answers(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    lose(connection)
    generator.configure(dataclasses.replace(BURST, cycles=300))
    assert connection.held["BURS:NCYC"] == "300"
    lose(connection)
    connection.replies["*IDN"] = connection.replies["*IDN"].replace("2.04", "1.00")
    with pytest.raises(InstrumentError, match="exchanged"):
        generator.configure(BURST)


def test_make_safe_raises_if_the_output_stays_on(scripted) -> None:
    with pytest.raises(InstrumentError, match="output_on"):
        Agilent33250A(scripted(replies={"OUTP": "1"}), "toneburst").make_safe()


@pytest.mark.parametrize(("reply", "passed"), [("+0", True), ("0", True), ("+1", False)])
def test_a_self_test_waits_and_has_the_output_off_before_and_after(scripted, reply: str, passed: bool) -> None:
    instrument = scripted(replies={"*TST": reply, "OUTP": "0"})
    read, silent = instrument.read, [TimeoutError(), TimeoutError()]

    def read_late() -> str:
        if instrument.commands[-1] == "*TST?" and silent:
            raise silent.pop()
        return read()

    instrument.read = read_late
    assert Agilent33250A(instrument, "burst_train").self_test() is passed
    test = instrument.commands.index("*TST?")
    assert instrument.commands[0] == "OUTP 0"
    assert "OUTP 0" in instrument.commands[test:]
    assert not silent


def test_an_instrument_that_never_ends_its_self_test_is_an_error_that_names_it(scripted) -> None:
    instrument = scripted(replies={"OUTP": "0"})
    with pytest.raises(InstrumentError, match=r"burst_train: no reply to '\*TST\?'"):
        Agilent33250A(instrument, "burst_train").self_test()


def fails_once(connection, query: str, error: Exception) -> None:
    """Let the next reply to a message with ``query`` be ``error``; later ones come as usual."""
    read = connection.read

    def read_or_fail() -> str:
        if query not in connection.messages[-1]:
            return read()
        connection.read = read
        connection.outbox.clear()
        raise error

    connection.read = read_or_fail


def test_a_recheck_asks_once_more_for_a_missing_reply_and_over_a_new_connection(scripted) -> None:
    connection = scripted()
    connection.timeout_s, connection.bus, reopened = 1.5, "GPIB0", list[str]()
    connection.reopen = lambda: reopened.append("GPIB0")
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    generator.enable_output()
    for error, count in ((TimeoutError("nothing"), 0), (ConnectionResetError("closed"), 1)):
        fails_once(connection, "OUTP?", error)
        generator.recheck()
        assert len(reopened) == count
    connection.held["OUTP"] = "0"
    with pytest.raises(InstrumentError, match=r"output_on \(OUTP\) programmed 1, read back 0"):
        generator.recheck()
    generator = Agilent33250A(scripted(), "toneburst")
    for act in (generator.recheck, generator.enable_output, generator.fire, generator.verify):
        with pytest.raises(InstrumentError, match=rf"{act.__name__} came before configure"):
            act()


def test_time_outs_are_short_while_an_output_is_switched_off_or_checked_and_as_before_afterwards(scripted) -> None:
    connection, waits_s = scripted(), list[float]()
    connection.timeout_s, connection.bus, connection.reopen = 1.5, "GPIB0", lambda: None
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    read = connection.read
    connection.read = lambda: (waits_s.append(connection.timeout_s), read())[1]
    generator.make_safe()
    generator.enable_output()
    generator.recheck()
    assert waits_s == [0.4, 1.5, 0.4, 0.4]
    assert connection.timeout_s == 1.5
    connection.timeout_s = 0.2
    generator.make_safe()
    assert (waits_s[-1], connection.timeout_s) == (0.2, 0.2)
    assert generator.bus == "GPIB0"
    assert Agilent33250A(scripted()).bus == ""


@pytest.mark.parametrize(
    ("loss", "proof"),
    [
        (TimeoutError("nothing"), "read back as off, answered late"),
        (ConnectionResetError("closed"), "read back as off, over the connection opened again"),
        ("1", "read back as off, after the instrument was taken back from local mode"),
    ],
)
def test_an_output_is_proven_off_at_the_second_attempt_with_the_way_in_words(scripted, loss, proof: str) -> None:
    connection = scripted()
    connection.timeout_s, connection.bus, connection.reopen = 1.5, "GPIB0", lambda: None
    if isinstance(loss, Exception):
        fails_once(connection, "OUTP?", loss)
    else:
        connection.replies["OUTP"] = "1"
        write = connection.write

        def end_local_mode(message: str) -> None:
            if message == "SYST:REM":
                del connection.replies["OUTP"]
            write(message)

        connection.write = end_local_mode
    generator = Agilent33250A(connection, "toneburst")
    assert generator.make_safe() == proof
    assert connection.commands.count("OUTP 0") == 2
    assert generator.make_safe() == "read back as off"
    lost = scripted()
    fails_once(lost, "OUTP?", ConnectionResetError("closed"))
    # A connection that cannot be opened again.
    with pytest.raises(InstrumentError, match="The connection is lost: closed"):
        Agilent33250A(lost, "toneburst").make_safe()


def test_a_lost_connection_is_opened_again_only_for_the_same_instrument_with_the_same_label(scripted) -> None:
    connection = scripted(replies={"MEM:STAT:NAME": '"BOX_1"'})
    connection.timeout_s, connection.bus = 1.5, "GPIB0"
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    connection.reopen = lambda: None
    fails_once(connection, "SYST:ERR?", TimeoutError("nothing"))
    generator.configure(dataclasses.replace(BURST, cycles=10))
    assert "*RST" in connection.commands
    assert connection.held["BURS:NCYC"] == "10"
    assert generator.serial_number() == "BOX_1"
    # Another box of the same model and firmware.
    connection.replies["MEM:STAT:NAME"] = '"BOX_2"'
    fails_once(connection, "SYST:ERR?", TimeoutError("nothing"))
    with pytest.raises(InstrumentError, match="Instruments or their addresses were exchanged"):
        generator.configure(dataclasses.replace(BURST, cycles=11))

    def refuse() -> None:
        raise ConnectionRefusedError("no answer")

    connection.reopen = refuse
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    fails_once(connection, "SYST:ERR?", TimeoutError("nothing"))
    with pytest.raises(InstrumentError, match="no reply to"):
        generator.configure(dataclasses.replace(BURST, cycles=10))
    with pytest.raises(InstrumentError, match="verify came before configure"):
        generator.verify()


def test_an_instrument_that_is_silent_in_local_mode_is_made_safe_at_once(scripted) -> None:
    connection = scripted()
    connection.held["OUTP"] = "1"
    obey = connection._obey
    connection._obey = lambda part: obey(part) if "SYST:REM" in connection.messages else None
    generator = Agilent33250A(connection, "toneburst")
    assert generator.make_safe().startswith("read back as off")
    assert connection.held["OUTP"] == "0"


@pytest.mark.parametrize(("stuck", "switch"), [("0", "enable_output"), ("1", "make_safe")])
def test_the_remedy_of_a_stuck_relay_does_not_mention_the_scene(scripted, stuck: str, switch: str) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    connection.replies["OUTP"] = stuck
    with pytest.raises(InstrumentError, match=r"read back [01]\. The relay at the output is stuck") as caught:
        getattr(generator, switch)()
    assert "scene" not in str(caught.value)
