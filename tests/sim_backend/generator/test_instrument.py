"""The simulated 33250A over SCPI: formats, chains, limits, coercions, errors."""

import math

import pytest
from hypothesis import given, strategies as st

from sim_backend.generator.instrument import Generator33250A
from sim_backend.generator.models import MODELS
from sim_backend.wiring import SimulatedClock

NO_ERROR = '+0,"No error"'


@pytest.fixture
def generator():
    return Generator33250A(SimulatedClock(), 100e-9)


def ask(generator, message):
    generator.write(message)
    return generator.read()


def errors(generator):
    numbers = []
    while (reply := ask(generator, "SYST:ERR?")) != NO_ERROR:
        numbers.append(int(reply.split(",")[0]))
    return numbers


POWER_ON = {
    "FUNC?": "SIN",
    "FREQ?": "+1.0000000000000E+03",
    "VOLT?": "+1.0000000000000E-01",
    "VOLT:OFFS?": "+0.0000000000000E+00",
    "VOLT:HIGH?": "+5.0000000000000E-02",
    "VOLT:LOW?": "-5.0000000000000E-02",
    "VOLT:UNIT?": "VPP",
    "FUNC:SQU:DCYC?": "+5.0000000000000E+01",
    "FUNC:RAMP:SYMM?": "+1.0000000000000E+02",
    "OUTP?": "0",
    "OUTP:LOAD?": "+5.0000000000000E+01",
    "OUTP:POL?": "NORM",
    "OUTP:SYNC?": "1",
    "PULS:PER?": "+1.0000000000000E-03",
    "PULS:WIDT?": "+1.0000000000000E-04",
    "PULS:TRAN?": "+5.0000000000000E-09",
    "BURS:STAT?": "0",
    "BURS:MODE?": "TRIG",
    "BURS:NCYC?": "+1.0000000000000E+00",
    "BURS:INT:PER?": "+1.0000000000000E-02",
    "BURS:PHAS?": "+0.0000000000000E+00",
    "TRIG:SOUR?": "IMM",
    "TRIG:SLOP?": "POS",
    "TRIG:DEL?": "+0.0000000000000E+00",
    "OUTP:TRIG?": "0",
    "OUTP:TRIG:SLOP?": "POS",
    "UNIT:ANGL?": "DEG",
    "SYST:BEEP:STAT?": "1",
    "SYST:ERR?": NO_ERROR,
    "SYST:VERS?": "1999.0",
    "*STB?": "+0",
    "*OPC?": "1",
}


@pytest.mark.parametrize(("query", "reply"), POWER_ON.items())
def test_power_on_state_answers_as_measured(generator, query, reply):
    assert ask(generator, query) == reply


def test_reset_restores_the_power_on_state_except_the_beeper(generator):
    generator.write("FUNC PULS;:OUTP:LOAD INF;:TRIG:SOUR EXT;:BURS:NCYC 7;STAT 1;:OUTP 1;:SYST:BEEP:STAT 0;:*RST")
    generator.write("*CLS;*RST")
    different = {query for query, reply in POWER_ON.items() if ask(generator, query) != reply}
    assert different == {"SYST:BEEP:STAT?"}


@pytest.mark.parametrize(
    ("message", "query", "reply"),
    [
        ("FREQ 5000.001", "FREQ?", "+5.0000010000000E+03"),
        ("frequency 5 khz", "FREQ?", "+5.0000000000000E+03"),
        (":SOURce:FREQuency:CW 2.5MHZ", "SOUR:FREQ:CW?", "+2.5000000000000E+06"),
        ("FREQ 7e3 Hz", ":freq?", "+7.0000000000000E+03"),
        ("VOLT 2.5 V", "VOLT?", "+2.5000000000000E+00"),
        ("VOLT:LEV:IMM:AMPL 250 MVPP", "VOLT:AMPL?", "+2.5000000000000E-01"),
        ("VOLT 1 VRMS", "VOLT?", "+2.8280000000000E+00"),
        ("VOLT 10 DBM", "VOLT?", "+2.0000000000000E+00"),
        ("VOLT 2 VPP;:VOLT:UNIT DBM", "VOLT?", "+1.0000000000000E+01"),
        ("TRIG:SOUR EXT;DEL 300 us", "TRIG:DEL?", "+3.0000000000000E-04"),
        ("PULS:PER 200us;WIDT 10 us;TRAN 8NS", "PULS:WIDT?;TRAN?", "+1.0000000000000E-05;+8.0000000000000E-09"),
        ("OUTP:LOAD 10 KOHM", "OUTP:LOAD?", "+1.0000000000000E+04"),
        ("OUTP:LOAD INFinity", "OUTP:LOAD?", "+9.9000000000000E+37"),
        ("OUTP ON", "OUTP:STAT?", "1"),
        ("OUTP:SYNC OFF", "OUTP:SYNC:STAT?", "0"),
        ("FUNC:SHAP SQUare", "FUNC?", "SQU"),
        ("TRIG:SOUR BUS;:BURS:NCYC INF", "BURS:NCYC?", "+9.9000000000000E+37"),
        ("BURS:PHAS 90;:UNIT:ANGL RAD", "BURS:PHAS?", f"{math.pi / 2:+.13E}"),
        ('DISP:TEXT "A;B"', "DISP:TEXT?", '"A;B"'),
        ("FREQ MAX", "FREQ?", "+8.0000000000000E+07"),
        ("FREQ MINimum", "FREQ?", "+1.0000000000000E-06"),
        ("FUNC RAMP", "FREQ? MAX", "+1.0000000000000E+06"),
        ("OUTP:LOAD INF", "VOLT? MAX", "+2.0000000000000E+01"),
        ("", "VOLT? MIN", "+1.0000000000000E-03"),
        ("", "TRIG:DEL? MAX", "+8.5000000000000E+01"),
    ],
)
def test_settings_read_back(generator, message, query, reply):
    generator.write(message)
    assert ask(generator, query) == reply
    assert errors(generator) == []


def test_a_header_after_a_semicolon_continues_in_the_previous_branch(generator):
    generator.write("TRIG:SOUR EXT;SLOP NEG;*WAI;DEL 1;:FREQ 100;:BURS:NCYC 20;STAT ON")
    assert ask(generator, "TRIG:SLOP?;DEL?;:FREQ?;BURS:NCYC?;STAT?").split(";")[0] == "NEG"
    assert ask(generator, "BURS:STAT?") == "1"
    assert errors(generator) == []
    generator.write("PULS:PER 1;PULS:WIDT 1e-3")
    assert errors(generator) == [-113]


@pytest.mark.parametrize(
    ("message", "number"),
    [
        ("*OPT?", -113),
        ("NONSENSE 1", -113),
        ("*RST?", -113),
        ("*IDN", -113),
        ("FREQ", -109),
        ("FREQ 1,2", -108),
        ("FREQ FAST", -148),
        ("FREQ 1 VPP", -131),
        ("BURS:NCYC 3 S", -138),
        ("FUNC TRIANGLE", -224),
        ("FUNC 3", -128),
        ("OUTP MAYBE", -224),
        ("FREQ? 3", -224),
        ("DISP:TEXT hello", -151),
        ("*TRG", -211),
        ("TRIG", -211),
        ("SYST:REM", 514),
    ],
)
def test_a_mistake_queues_its_number_and_answers_nothing(generator, message, number):
    generator.write(message)
    with pytest.raises(TimeoutError):
        generator.read()
    assert errors(generator) == [number]


def test_a_mistake_ends_the_message_after_the_commands_before_it(generator):
    generator.write("FREQ 5;:NONSENSE;:FREQ 7")
    assert ask(generator, "FREQ?") == "+5.0000000000000E+00"


@pytest.mark.parametrize(
    ("message", "number", "query", "value"),
    [
        ("FREQ 90 MHZ", -222, "FREQ?", 80e6),
        ("FREQ 0", -222, "FREQ?", 1e-6),
        ("VOLT 12", -222, "VOLT?", 10.0),
        ("VOLT 1e-5", -222, "VOLT?", 1e-3),
        ("TRIG:SOUR EXT;:BURS:NCYC 2000000", -222, "BURS:NCYC?", 1e6),
        ("TRIG:SOUR EXT;DEL 90", -222, "TRIG:DEL?", 85.0),
        ("OUTP:LOAD 20000", -222, "OUTP:LOAD?", 1e4),
        ("PULS:PER 1e-9", -222, "PULS:PER?", 20e-9),
        ("BURS:PHAS 400", -222, "BURS:PHAS?", 360.0),
        ("FREQ 60 MHZ;:FUNC PULS", -221, "FREQ?", 50e6),
        ("FREQ 30 MHZ;:FUNC RAMP", -221, "FREQ?", 1e6),
        ("VOLT 1;:VOLT:OFFS 4.5;:VOLT 4", -221, "VOLT:OFFS?", 3.0),
        ("VOLT 8;:VOLT:OFFS 2", -221, "VOLT?", 6.0),
        ("VOLT:HIGH -1", -221, "VOLT:LOW?", -1.001),
        ("VOLT:LOW 3", -221, "VOLT:HIGH?", 3.001),
        ("VOLT:UNIT DBM;:OUTP:LOAD INF", -221, "VOLT?", 0.2),
        ("FUNC PULS;:PULS:PER 50 US", -222, "PULS:WIDT?", 50e-6 - 1.6 * 5e-9),
        ("PULS:WIDT 10US;TRAN 5US;WIDT 1US", -221, "PULS:TRAN?", 0.625e-6),
        ("PULS:WIDT 2", -222, "PULS:WIDT?", 1e-3 - 1.6 * 5e-9),
        ("PULS:WIDT 10US;TRAN 1MS", -222, "PULS:TRAN?", 6.25e-6),
        ("FUNC SQU;:FUNC:SQU:DCYC 30;:FREQ 40 MHZ", -221, "FUNC:SQU:DCYC?", 40.0),
        ("BURS:NCYC 1000", -221, "BURS:INT:PER?", 1.0 + 200e-9),
        ("BURS:NCYC 100;INT:PER 1E-3", -222, "BURS:INT:PER?", 0.1 + 200e-9),
        ("TRIG:DEL 1", -221, "TRIG:DEL?", 9e-3 - 200e-9),
        ("TRIG:SOUR EXT;:OUTP:TRIG 1", -221, "OUTP:TRIG?", 0),
        ("OUTP:TRIG 1;:TRIG:SOUR EXT", -221, "OUTP:TRIG?", 0),
        ("OUTP:TRIG 1;:BURS:MODE GAT", -221, "OUTP:TRIG?", 0),
        ("BURS:MODE GAT;STAT 1;:OUTP:TRIG 1", -221, "OUTP:TRIG?", 0),
        ("FUNC DC;:BURS:STAT 1", -221, "BURS:STAT?", 0),
        ("BURS:STAT 1;:FUNC DC", -221, "BURS:STAT?", 0),
        ("TRIG:SOUR EXT;:FREQ 30 MHZ;:BURS:STAT 1", -221, "FREQ?", 25e6),
    ],
)
def test_a_setting_that_does_not_fit_is_coerced_with_an_error(generator, message, number, query, value):
    generator.write(message)
    assert float(ask(generator, query)) == pytest.approx(value, rel=1e-12)
    queued = errors(generator)
    assert number in queued
    assert set(queued) <= {-221, -222}


@pytest.mark.parametrize(
    "message", ["BURS:STAT 1;:OUTP:TRIG 1", "BURS:MODE GAT;:OUTP:TRIG 1", "OUTP:TRIG 1;:BURS:MODE TRIG;STAT 1"]
)
def test_trig_out_can_be_on_if_its_connector_is_no_input(generator, message):
    generator.write(message)
    assert (ask(generator, "OUTP:TRIG?"), errors(generator)) == ("1", [])


def test_an_endless_burst_and_the_internal_trigger_exclude_each_other(generator):
    generator.write("BURS:NCYC INF")
    assert (ask(generator, "TRIG:SOUR?"), errors(generator)) == ("BUS", [-221])
    generator.write("FREQ 1 MHZ;:TRIG:SOUR IMM")
    assert float(ask(generator, "BURS:NCYC?")) == 1_000_000
    assert set(errors(generator)) == {-221}


def test_errors_of_coercion_name_the_limit(generator):
    generator.write("FREQ 90 MHZ")
    assert ask(generator, "SYST:ERR?") == '-222,"Data out of range; frequency; value clipped to upper limit"'
    generator.write("VOLT 8;:VOLT:OFFS 2")
    assert ask(generator, "SYST:ERR?").startswith('-221,"Settings conflict; amplitude changed due to offset')


def test_declared_load_rescales_levels_and_limits(generator):
    generator.write("VOLT:HIGH 2;LOW 0")
    generator.write("OUTP:LOAD INF")
    assert ask(generator, "VOLT:HIGH?") == "+4.0000000000000E+00"
    assert float(ask(generator, "VOLT:HIGH? MAX")) == 10.0
    generator.write("OUTP:LOAD 75")
    assert float(ask(generator, "VOLT?")) == pytest.approx(4 * 75 / 125, rel=1e-13)
    assert generator.registers.high_v == 4.0


def test_error_queue_is_first_in_first_out_20_deep_and_overflows(generator):
    for _ in range(19):
        generator.write("NONSENSE")
    generator.write("FREQ 90 MHZ")
    generator.write("FREQ")
    generator.write("FREQ")
    assert errors(generator) == [-113] * 19 + [-350]
    generator.write("FREQ")
    assert errors(generator) == [-109]


def test_status_byte_and_event_register_follow_the_queue(generator):
    assert ask(generator, "*ESR?") == "+128"
    generator.write("NONSENSE")
    generator.write("FREQ 90 MHZ")
    assert ask(generator, "*STB?") == "+4"
    assert ask(generator, "*ESR?") == "+48"
    assert ask(generator, "*ESR?") == "+0"
    generator.write("*ESE 48;*CLS;:NONSENSE")
    assert ask(generator, "*STB?") == "+36"
    generator.write("*CLS")
    assert ask(generator, "*STB?") == "+0"
    assert errors(generator) == []


def test_an_unread_reply_is_lost_with_an_error(generator):
    generator.write("FREQ?")
    assert ask(generator, "FUNC?") == "SIN"
    assert errors(generator) == [-410]


def test_opc_waits_for_the_burst_that_the_bus_started():
    clock = SimulatedClock()
    generator = Generator33250A(clock, 0.0)
    generator.write("TRIG:SOUR BUS;:BURS:NCYC 20;STAT 1;:OUTP 1;:FREQ 100;*TRG")
    assert ask(generator, "*OPC?") == "1"
    assert clock.now_s() == pytest.approx(0.2, abs=1e-12)


@given(
    st.floats(1e-3, 40e6),
    st.floats(2e-3, 9.9),
    st.integers(1, 1_000_000),
    st.floats(0, 85),
    st.sampled_from([50, 75, 1e4]),
)
def test_settings_are_rounded_to_the_manuals_resolution(frequency_hz, amplitude_v, cycles, delay_s, load_ohm):
    generator = Generator33250A(SimulatedClock(), 0.0)
    generator.write(f"OUTP:LOAD {load_ohm:.10E};:TRIG:SOUR EXT;DEL {delay_s:.12E}")
    generator.write(f"FREQ {frequency_hz:.12E};:VOLT {amplitude_v:.12E};:BURS:NCYC {cycles}")
    replies = [float(reply) for reply in ask(generator, "FREQ?;VOLT?;BURS:NCYC?;:TRIG:DEL?").split(";")]
    assert errors(generator) == []
    # Frequency: 1 uHz or 9 digits. Amplitude: 0.1 mV or 4 digits. To the nearest, so by half a step at most.
    assert replies[0] == pytest.approx(frequency_hz, rel=0.5e-8, abs=0.5e-6 * (1 + 1e-9))
    assert replies[1] == pytest.approx(amplitude_v, rel=0.5e-3, abs=0.5e-4 * (1 + 1e-9))
    assert replies[2:] == pytest.approx([cycles, delay_s], rel=1e-10, abs=1e-15)


def test_a_siblings_duty_cycle_is_limited_by_its_narrowest_pulse():
    generator = Generator33250A(SimulatedClock(), 0.0, MODELS["33500B"])
    generator.write("FUNC SQU;:FREQ 1 MHZ")
    least, most = (float(ask(generator, f"FUNC:SQU:DCYC? {end}")) for end in ("MIN", "MAX"))
    # 16 ns of 1 us
    assert (least, most) == pytest.approx((1.6, 98.4))
    generator.write("FREQ 1 KHZ")
    # 16 ns of 1 ms would be less than 0.01 %, the least there is
    least, most = (float(ask(generator, f"FUNC:SQU:DCYC? {end}")) for end in ("MIN", "MAX"))
    assert (least, most) == pytest.approx((0.01, 99.99), rel=1e-12)


def test_edges_are_limited_by_width_and_period(generator):
    generator.write("FUNC PULS;:PULS:PER 1E-6;WIDT 9E-7")
    # 1.6 edges fit between the pulses; of a narrow pulse an edge is at most 0.625
    assert float(ask(generator, "PULS:TRAN? MAX")) == pytest.approx(1e-7 / 1.6)
    generator.write("PULS:WIDT 1E-7")
    assert float(ask(generator, "PULS:TRAN? MAX")) == pytest.approx(0.625e-7)


def test_the_burst_count_is_limited_by_the_internal_trigger_period(generator):
    # 500 s at most between two triggers, at 1 kHz.
    generator.write("BURS:NCYC 500000")
    assert float(ask(generator, "BURS:NCYC?")) == 500_000
    # The burst period gives way, the count does not.
    assert errors(generator) == [-221]
    generator.write("BURS:NCYC 500001")
    assert float(ask(generator, "BURS:NCYC?")) == 500_000
    assert errors(generator) == [-221]


def test_a_burst_longer_than_its_trigger_period_lengthens_the_period_or_raises_the_frequency(generator):
    generator.write("FUNC SIN;:FREQ 1E6;:BURS:NCYC 5;:BURS:INT:PER 1E-5;:TRIG:SOUR IMM;:BURS:STAT 1")
    assert errors(generator) == []
    # 15 us of burst and 200 ns, where there were 10 us.
    generator.write("BURS:NCYC 15")
    assert float(ask(generator, "BURS:INT:PER?")) == pytest.approx(15.2e-6)
    assert errors(generator) == [-221]
    # 500 s is the longest period: not one cycle of 1 mHz fits.
    generator.write("BURS:NCYC 1;:FREQ 1E-3")
    assert float(ask(generator, "FREQ?")) == pytest.approx(2e-3)


def test_the_burst_period_is_at_least_the_burst_and_200_ns(generator):
    # 10 cycles of 1 MHz.
    generator.write("FUNC SIN;:FREQ 1E6;:BURS:NCYC 10;:TRIG:SOUR IMM;:BURS:STAT 1")
    generator.write("BURS:INT:PER 1.02E-5")
    assert float(ask(generator, "BURS:INT:PER?")) == pytest.approx(10.2e-6)
    assert errors(generator) == []
    generator.write("BURS:INT:PER 1E-5")
    assert float(ask(generator, "BURS:INT:PER?")) == pytest.approx(10.2e-6)
    assert errors(generator) == [-222]
