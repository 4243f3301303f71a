"""The generator roles on a scripted instrument: messages, their order, and refused values."""

from __future__ import annotations

import dataclasses
import math
import re

import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.agilent.limits import mistakes
from drivers.agilent.models import AGILENT_33250A
from drivers.agilent.programs import READABLE
from drivers.interfaces import (
    Identity,
    InstrumentError,
    MasterTrigger,
    PulseGenerator,
    PulseTrain,
    Toneburst,
    ToneburstGenerator,
    TriggerPulse,
)

PULSE = TriggerPulse(width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=0.0, load_ohm=50.0)
ROLES = [(Agilent33250A, PULSE), (Agilent33250A, TRAIN), (Agilent33250A, BURST)]


def answer_everything(connection) -> None:
    """Add replies for settings that were not programmed."""
    connection.replies |= {item.header: "0" for item in READABLE if item.header not in connection.held}


def test_the_roles_satisfy_their_interfaces(scripted) -> None:
    master: MasterTrigger = Agilent33250A(scripted(), "master")
    pulses: PulseGenerator = Agilent33250A(scripted(), "burst_train")
    bursts: ToneburstGenerator = Agilent33250A(scripted(), "toneburst")
    assert [master.role, pulses.role, bursts.role] == ["master", "burst_train", "toneburst"]


def test_the_tracking_train_is_programmed_as_the_reference_recipe_says(scripted) -> None:
    connection = scripted()
    Agilent33250A(connection, "tracking_train").configure(TRAIN)
    sent = {
        "OUTP:LOAD": "+9.9000000000000E+37",
        "VOLT:UNIT": "VPP",
        "FUNC": "PULS",
        "VOLT:LOW": "0.000000000000E+00",
        "VOLT:HIGH": "4.000000000000E+00",
        "OUTP:TRIG": "0",
        "TRIG:SOUR": "EXT",
        "TRIG:SLOP": "POS",
        "TRIG:DEL": "1.000000000000E-02",
        "BURS:MODE": "TRIG",
        "BURS:NCYC": "1000",
        "BURS:PHAS": "0.000000000000E+00",
        "BURS:STAT": "1",
        "PULS:WIDT": "1.000000000000E-05",
        "FREQ": "5.000000000000E+03",
        "OUTP": "0",
    }
    assert sent.items() <= connection.held.items()


def test_the_toneburst_is_a_counted_sine_burst_on_external_trigger(scripted) -> None:
    connection = scripted()
    Agilent33250A(connection, "toneburst").configure(BURST)
    assert connection.held["FUNC"] == "SIN"
    assert float(connection.held["FREQ"]) == 3.0e6
    assert float(connection.held["VOLT"]) == 0.5
    assert float(connection.held["VOLT:OFFS"]) == 0.0
    assert connection.held["BURS:NCYC"] == "600"
    # Phase 0: the burst starts at a rising zero crossing.
    assert float(connection.held["BURS:PHAS"]) == 0.0
    assert connection.held["TRIG:SOUR"] == "EXT"
    assert float(connection.held["OUTP:LOAD"]) == 50.0


def test_the_master_fires_one_pulse_by_command(scripted) -> None:
    connection = scripted()
    master = Agilent33250A(connection, "master")
    master.configure(PULSE)
    master.enable_output()
    assert connection.held["BURS:NCYC"] == "1"
    assert connection.held["TRIG:SOUR"] == "BUS"
    master.fire()
    assert connection.commands.count("*TRG") == 1
    # Its output goes off at once, so that no other trigger can start the trains again.
    assert connection.commands[-4:] == ["*TRG", "OUTP 0", "OUTP?", "SYST:ERR?"]


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_the_output_is_off_before_anything_is_programmed_and_stays_off(scripted, role_type, program) -> None:
    connection = scripted()
    role_type(connection, "x").configure(program)
    changes = [command for command in connection.commands if "?" not in command]
    assert changes[0] == "OUTP 0"
    assert "OUTP 1" not in changes
    assert not any(command.upper().startswith("APPL") for command in changes)


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_bursts_are_never_gated_nor_endless_and_enabled_last(scripted, role_type, program) -> None:
    connection = scripted()
    role_type(connection, "x").configure(program)
    changes = [command for command in connection.commands if "?" not in command]
    assert changes[-1] == "BURS:STAT 1"
    assert not any(re.search(r"GAT|NCYC INF", command) for command in changes)


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_every_changed_setting_is_read_back_with_the_error_queue(scripted, role_type, program) -> None:
    connection = scripted()
    role_type(connection, "x").configure(program)
    for index, message in enumerate(connection.messages):
        if "?" not in message and "*RST" not in message:
            headers = [part.lstrip(":").split()[0] for part in message.split(";")]
            assert connection.messages[index + 1].split(";:") == [*(f"{header}?" for header in headers), "SYST:ERR?"]


@pytest.mark.parametrize("width_s", [1e-6, 100e-6, 150e-6])
def test_no_intermediate_state_has_a_pulse_wider_than_its_period(scripted, width_s: float) -> None:
    """After a reset the width is 100 us and the period 1 ms (docs/explanation/instruments.md, 1.3)."""
    connection = scripted()
    rate_hz = 0.9 / width_s if width_s < 100e-6 else 5e3
    Agilent33250A(connection, "x").configure(dataclasses.replace(TRAIN, rate_hz=rate_hz, width_s=width_s))
    state = {"FREQ": 1e3, "PULS:WIDT": 100e-6}
    for command in connection.commands:
        header, _, value = command.partition(" ")
        if header in state:
            state[header] = float(value)
            assert state["PULS:WIDT"] < 1 / state["FREQ"]


def test_another_model_is_refused_before_anything_is_sent_to_it(scripted) -> None:
    connection = scripted(replies={"*IDN": "HEWLETT-PACKARD,34401A,0,10-5-2"})
    with pytest.raises(InstrumentError, match="34401A"):
        Agilent33250A(connection, "burst_train").configure(TRAIN)
    assert connection.messages == ["*IDN?"]


def test_the_later_vendor_name_is_accepted(scripted) -> None:
    connection = scripted(replies={"*IDN": "Keysight Technologies,33250A,0,2.04-1.01-2.00-03-2"})
    identity = Agilent33250A(connection, "master").identify()
    assert identity == Identity("Keysight Technologies", "33250A", "0", "2.04-1.01-2.00-03-2")


def test_verify_reports_a_setting_changed_at_the_front_panel(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "burst_train")
    generator.configure(TRAIN)
    answer_everything(connection)
    generator.verify()
    connection.held["BURS:NCYC"] = "+5.0000000000000E+02"
    with pytest.raises(InstrumentError, match=r"cycles .*programmed 1000, read back \+5\.0000000000000E\+02"):
        generator.verify()


def test_after_a_failed_configure_the_role_is_unconfigured(scripted) -> None:
    generator = Agilent33250A(scripted(replies={"BURS:NCYC": "+1.0E+00"}), "burst_train")
    with pytest.raises(InstrumentError):
        generator.configure(TRAIN)
    with pytest.raises(InstrumentError, match="before configure"):
        generator.enable_output()


def test_firing_with_the_output_off_is_refused(scripted) -> None:
    connection = scripted()
    master = Agilent33250A(connection, "master")
    master.configure(PULSE)
    with pytest.raises(InstrumentError, match="output_on"):
        master.fire()
    assert "*TRG" not in connection.commands


def test_an_ignored_trigger_is_an_error(scripted) -> None:
    connection = scripted()
    master = Agilent33250A(connection, "master")
    master.configure(PULSE)
    master.enable_output()
    send = connection.write

    def ignoring(message: str) -> None:
        send(message)
        if message == "*TRG":
            connection.errors.append('-211,"Trigger ignored"')

    connection.write = ignoring
    with pytest.raises(InstrumentError, match="-211 Trigger ignored"):
        master.fire()


def test_an_output_that_does_not_switch_on_is_an_error(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    connection.replies["OUTP"] = "0"
    with pytest.raises(InstrumentError, match=r"output_on .*programmed 1, read back 0"):
        generator.enable_output()


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_verify_returns_every_setting_in_few_messages_without_repeats(scripted, role_type, program) -> None:
    connection = scripted()
    generator = role_type(connection, "x")
    generator.configure(program)
    answer_everything(connection)
    connection.messages.clear()
    read = generator.verify()
    assert len(connection.messages) == 3
    assert sorted(connection.commands) == sorted([*(f"{item.header}?" for item in READABLE), "SYST:ERR?"])
    assert read == generator.snapshot()
    assert read["burst_on"] is True


IMPOSSIBLE = [
    (Agilent33250A, dataclasses.replace(PULSE, high_v=11.0), ["high_v = 11", "10"]),
    (Agilent33250A, dataclasses.replace(PULSE, width_s=1e-9), ["width_s = 1e-09", "8e-09"]),
    (Agilent33250A, dataclasses.replace(TRAIN, rate_hz=60e6), ["rate_hz = 60000000", "50000000"]),
    (Agilent33250A, dataclasses.replace(TRAIN, count=0), ["count = 0", "1000000"]),
    (Agilent33250A, dataclasses.replace(TRAIN, count=1_000_001), ["count = 1000001", "1000000"]),
    (Agilent33250A, dataclasses.replace(TRAIN, delay_s=90.0), ["delay_s = 90", "85"]),
    (Agilent33250A, dataclasses.replace(TRAIN, delay_s=-1e-3), ["delay_s = -0.001", "0 .. 85"]),
    (Agilent33250A, dataclasses.replace(TRAIN, width_s=200e-6), ["width_s = 0.0002", "0.000199992"]),
    (Agilent33250A, dataclasses.replace(TRAIN, rate_hz=0.01, width_s=100e-9), ["width_s = 1e-07", "2e-07"]),
    (Agilent33250A, dataclasses.replace(TRAIN, load_ohm=50.0, high_v=5.5), ["high_v = 5.5", "5 into 50 ohm"]),
    (Agilent33250A, dataclasses.replace(TRAIN, rate_hz=math.nan), ["rate_hz = nan"]),
    (Agilent33250A, dataclasses.replace(BURST, carrier_hz=30e6), ["carrier_hz = 30000000", "25000000"]),
    (Agilent33250A, dataclasses.replace(BURST, amplitude_vpp=12.0), ["amplitude_vpp = 12", "10"]),
    (Agilent33250A, dataclasses.replace(BURST, load_ohm=0.5), ["load_ohm = 0.5", "10000"]),
    (Agilent33250A, dataclasses.replace(BURST, cycles=0, delay_s=99.0), ["cycles = 0", "delay_s = 99"]),
]


@pytest.mark.parametrize(("role_type", "program", "texts"), IMPOSSIBLE)
def test_invalid_tasks_are_refused_with_value_and_limit_before_a_setting_is_sent(
    scripted, role_type, program, texts
) -> None:
    connection = scripted()
    with pytest.raises(InstrumentError) as caught:
        role_type(connection, "x").configure(program)
    assert all(text in str(caught.value) for text in texts)
    assert connection.messages == ["*IDN?"]


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_a_swing_above_max_vpp_is_refused_before_a_setting_is_sent(scripted, role_type, program) -> None:
    connection = scripted()
    with pytest.raises(InstrumentError, match=r"is above max_vpp = 0\.1"):
        role_type(connection, "x", max_vpp=0.1).configure(program)
    assert connection.messages == ["*IDN?"]


@pytest.mark.parametrize(
    ("changes", "sent"),
    [
        ({}, "OUTP 0"),
        ({"delay_s": 2e-3}, "OUTP 0;:TRIG:DEL 2.000000000000E-03"),
        ({"rate_hz": 4e3, "count": 7}, "OUTP 0;:FREQ 4.000000000000E+03;:BURS:NCYC 7"),
        ({"high_v": 3.0}, "OUTP 0;:VOLT:HIGH 3.000000000000E+00"),
    ],
)
def test_a_sweep_sends_only_what_changed_in_one_message_with_one_reply(scripted, changes, sent) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "tracking_train")
    generator.configure(TRAIN)
    connection.messages.clear()
    generator.configure(dataclasses.replace(TRAIN, **changes))
    assert connection.messages[0] == sent
    assert len(connection.messages) == 2


@pytest.mark.parametrize("changes", [{"load_ohm": 50.0}, {"rate_hz": 2e4, "width_s": 2e-6}])
def test_settings_that_change_others_are_programmed_from_the_reset_state(scripted, changes) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "tracking_train")
    generator.configure(TRAIN)
    connection.messages.clear()
    generator.configure(dataclasses.replace(TRAIN, **changes))
    assert "OUTP 0;*CLS;*RST" in connection.messages


def test_after_a_failure_everything_is_programmed_again(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "tracking_train")
    generator.configure(TRAIN)
    connection.errors.append('-222,"Data out of range"')
    with pytest.raises(InstrumentError):
        generator.configure(dataclasses.replace(TRAIN, delay_s=0.0))
    connection.messages.clear()
    generator.configure(TRAIN)
    assert "OUTP 0;*CLS;*RST" in connection.messages


def test_a_declared_model_that_does_not_answer_is_refused(scripted) -> None:
    with pytest.raises(InstrumentError, match="expected model 33500B"):
        Agilent33250A(scripted(), "burst_train", series="33500B").configure(TRAIN)


@pytest.mark.parametrize(
    "reply", ["", "garbage", "33250A", "Agilent Technologies,33250A", "a,33250A,0", "a,33251A,0,1"]
)
def test_a_wrong_identity_is_refused(scripted, reply: str) -> None:
    connection = scripted(replies={"*IDN": reply})
    with pytest.raises(InstrumentError, match="expected model 33250A or"):
        Agilent33250A(connection, "master").identify()


def test_a_reply_that_is_no_number_is_an_instrument_error_in_the_snapshot(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "burst_train")
    generator.configure(TRAIN)
    connection.replies |= {item.header: "+1" for item in READABLE} | {"TRIG:DEL": "?!"}
    with pytest.raises(InstrumentError, match=r"TRIG:DEL\? was answered with '\?!', which is no delay_s"):
        generator.snapshot()


def test_high_impedance_doubles_the_largest_amplitude(scripted) -> None:
    burst = dataclasses.replace(BURST, amplitude_vpp=20.0, load_ohm=math.inf)
    Agilent33250A(scripted(), "toneburst").configure(burst)


def test_recheck_reports_a_foreign_change_and_the_next_task_starts_from_reset(scripted) -> None:
    connection = scripted()
    generator = Agilent33250A(connection, "toneburst")
    generator.configure(BURST)
    generator.enable_output()
    generator.recheck()
    connection.replies["VOLT"] = "+2.0000000000000E+00"
    with pytest.raises(InstrumentError, match=r"amplitude_vpp .*read back \+2\.0.*Another program, or a person"):
        generator.recheck()
    # The next task is programmed from the reset state, whatever else was changed.
    del connection.replies["VOLT"]
    connection.messages.clear()
    generator.configure(BURST)
    assert any("*RST" in message for message in connection.messages)


@pytest.mark.parametrize(("role_type", "program"), ROLES)
def test_a_swing_of_exactly_max_vpp_is_programmed(scripted, role_type, program) -> None:
    swing_v = getattr(program, "high_v", None) or program.amplitude_vpp
    role_type(scripted(), "x", max_vpp=swing_v).configure(program)


@pytest.mark.parametrize("reply", ["", "STATE_4", '"STATE_4"'])
def test_an_unnamed_state_is_no_label(scripted, reply: str) -> None:
    assert Agilent33250A(scripted(replies={"MEM:STAT:NAME": reply}), "toneburst").serial_number() == ""


@pytest.mark.parametrize(
    ("condition", "locked"), [("512", True), ("+512", True), ("0", False), ("544", False), ("32", False), ("513", True)]
)
def test_the_clock_must_be_locked_to_its_reference_if_that_is_asked_for(scripted, condition: str, locked: bool) -> None:
    """Bit 9: the external reference is used. Bit 5: the loop is unlocked."""
    connection = scripted(replies={"STAT:QUES:COND": condition})
    generator = Agilent33250A(connection, "toneburst", external_reference=True)
    if locked:
        generator.configure(BURST)
        connection.replies["STAT:QUES:COND"] = "0"
    for act in (generator.configure, lambda task: generator.recheck()):
        with pytest.raises(
            InstrumentError, match=rf"not locked to the 10 MHz input .*{condition if not locked else 0}"
        ):
            act(BURST)
    connection.replies["STAT:QUES:COND"] = "x"
    with pytest.raises(InstrumentError, match=r"STAT:QUES:COND\? was answered with 'x', which is no questionable"):
        generator.configure(BURST)
    free = Agilent33250A(scripted(), "toneburst")
    free.configure(BURST)


def test_a_label_is_stored_for_a_model_without_serial_number_and_one_that_is_not_kept_is_an_error(scripted) -> None:
    connection = scripted(replies={"MEM:STAT:NAME": '"HPE_1"'})
    generator = Agilent33250A(connection, "toneburst")
    generator.store_label("HPE_1")
    assert "MEM:STAT:NAME 4,HPE_1" in connection.commands
    assert "MEM:STAT:NAME? 4" in connection.commands
    with pytest.raises(InstrumentError, match=r"label HPE_2 was stored, and reads back as 'HPE_1'.*serial = \"none\""):
        generator.store_label("HPE_2")
    sibling = scripted(replies={"*IDN": "Agilent Technologies,33220A,MY44012345,2.00-2.00-22-2,more"})
    known = Agilent33250A(sibling, "toneburst")
    assert known.serial_number() == "MY44012345"
    assert known.identify().firmware == "2.00-2.00-22-2,more"
    assert "MEM:STAT:NAME? 4" not in sibling.commands
    refusing = scripted(errors=['-224,"Illegal parameter value"'])
    with pytest.raises(InstrumentError, match="-224 Illegal parameter value"):
        Agilent33250A(refusing, "toneburst").store_label("HPE_1")
    for text, command in (("MASTER", 'DISP:TEXT "MASTER"'), ("", "DISP:TEXT:CLE")):
        Agilent33250A(connection, "toneburst").display(text)
        assert connection.commands[-2] == command
        with pytest.raises(InstrumentError, match="-113"):
            Agilent33250A(scripted(errors=['-113,"Undefined header"']), "toneburst").display(text)


def test_a_burst_by_command_ends_with_the_output_off_and_errors_after_a_shot_are_listed(scripted) -> None:
    connection = scripted()
    master = Agilent33250A(connection, "master")
    master.configure(PULSE)
    master.enable_output()
    connection.messages.clear()
    master.fire()
    assert connection.messages == ["OUTP?;:SYST:ERR?", "*TRG", "OUTP 0", "OUTP?;:SYST:ERR?"]
    # The output is expected off afterwards.
    master.recheck()
    answer_everything(connection)
    connection.errors.extend(['-221,"Settings conflict"', '-410,"Query INTERRUPTED"'])
    settings, errors = master.snapshot_and_errors()
    assert errors == ("-221 Settings conflict", "-410 Query INTERRUPTED")
    assert settings == master.snapshot()
    assert settings["output_on"] is False
    assert master.snapshot_and_errors()[1] == ()


def test_a_sine_is_programmed_without_burst_into_its_load_and_switched_on(scripted) -> None:
    connection = scripted()
    Agilent33250A(connection, "generator").sine(1e6, 0.5, 75.0)
    sent = [command for command in connection.commands if "?" not in command]
    assert sent == [
        "OUTP 0", "*CLS", "*RST",
        "OUTP:LOAD 7.500000000000E+01", "VOLT:UNIT VPP", "OUTP:POL NORM",
        "BURS:STAT 0",
        "FUNC SIN", "FREQ 1.000000000000E+06", "VOLT 5.000000000000E-01", "VOLT:OFFS 0.000000000000E+00",
        "OUTP 1",
    ]  # fmt: skip


def test_levels_and_loads_at_their_limits_are_accepted_and_beyond_them_refused() -> None:
    """The source has 50 ohm: 10 V peak without load are 5 V into 50 ohm, and 2 mVpp without load 1 mVpp."""
    at_limits = [
        (BURST, {"amplitude_vpp": 1e-3}, 0.999e-3), (BURST, {"amplitude_vpp": 10.0}, 10.01),
        (BURST, {"load_ohm": 1.0, "amplitude_vpp": 0.1}, None), (BURST, {"load_ohm": 10_000.0}, 10_001.0),
        (PULSE, {"high_v": 10.0}, 10.01), (PULSE, {"high_v": 2e-3}, 1.99e-3),
    ]  # fmt: skip
    for task, changes, beyond in at_limits:
        assert mistakes(dataclasses.replace(task, **changes)) == []
        if beyond is not None:
            (key,) = changes
            (text,) = mistakes(dataclasses.replace(task, **{key: beyond}))
            assert text.startswith(f"{key} = {beyond:.10g} is outside")
    assert len(mistakes(dataclasses.replace(BURST, load_ohm=0.99))) == 1
    assert mistakes(dataclasses.replace(PULSE, load_ohm=50.0, high_v=5.01))[0].endswith("5 into 50 ohm")
    # The edges of 5 ns take 1.6 times that of a period, and the gap at least the least width, 8 ns.
    assert mistakes(dataclasses.replace(TRAIN, rate_hz=10e6, width_s=91.9e-9)) == []
    assert mistakes(dataclasses.replace(TRAIN, rate_hz=10e6, width_s=92.1e-9))
    slow_edges = dataclasses.replace(AGILENT_33250A, edge_s=10e-9)
    assert mistakes(dataclasses.replace(TRAIN, rate_hz=10e6, width_s=83.9e-9), slow_edges) == []
    assert mistakes(dataclasses.replace(TRAIN, rate_hz=10e6, width_s=84.1e-9), slow_edges)
