"""The generator roles on the simulated 33250A over every connection: all settings survive, every coercion is found."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given, settings, strategies as st

from drivers.agilent.generator import Agilent33250A
from drivers.agilent.limits import load_divider, mistakes
from drivers.agilent.scpi import ScpiSession
from drivers.interfaces import InstrumentError, PulseTrain, Toneburst, TriggerPulse
from sim_backend.generator.instrument import Generator33250A
from sim_backend.generator.models import MODELS
from sim_backend.transports.emulator import TRANSPORTS
from sim_backend.wiring import SimulatedClock

PULSE = TriggerPulse(width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=1e-3, load_ohm=50.0)

loads_ohm = st.one_of(st.just(math.inf), st.floats(1.0, 10_000.0))
delays_s = st.floats(0.0, 85.0)
counts = st.integers(1, 1_000_000)
# The 33250A's manual: 1 uHz or 9 digits, 0.1 mV or 4 digits; rounded, by half of that at most.
FREQUENCY = {"rel": 0.5e-8, "abs": 0.5e-6 * (1 + 1e-9)}
LEVEL = {"rel": 0.5e-3, "abs": 0.5e-4 * (1 + 1e-9)}
few = settings(max_examples=25, deadline=None)
"""Each example takes some tens of messages; with six connections that is enough of them."""
one_line = pytest.mark.parametrize(
    "line", ["in process", *(pytest.param(name, marks=pytest.mark.slow) for name in TRANSPORTS)], indirect=True
)
"""Over the other transports the random trains are marked slow."""


def twin() -> Generator33250A:
    return Generator33250A(SimulatedClock(), 100e-9)


@one_line
@few
@given(st.floats(1e-2, 1e6), st.floats(0.01, 0.9), counts, delays_s, st.floats(0.01, 1.0), loads_ohm)
def test_every_train_that_the_limits_allow_reads_back_within_the_resolution(
    line, rate_hz: float, duty: float, count: int, delay_s: float, share: float, load_ohm: float
) -> None:
    train = PulseTrain(rate_hz, count, delay_s, duty / rate_hz, 10.0 * share * load_divider(load_ohm), load_ohm)
    assert mistakes(train) == []
    generator = Agilent33250A(line.connection, "burst_train")
    generator.configure(train)
    generator.verify()
    read = generator.snapshot()
    assert read["frequency_hz"] == pytest.approx(rate_hz, **FREQUENCY)
    assert read["period_s"] == pytest.approx(1 / read["frequency_hz"], rel=1e-10)
    assert read["width_s"] == pytest.approx(train.width_s, rel=1e-10)
    assert read["delay_s"] == pytest.approx(delay_s, rel=1e-10)
    assert read["high_v"] == pytest.approx(train.high_v, **LEVEL)
    assert (read["cycles"], read["function"], read["trigger_source"]) == (count, "PULS", "EXT")
    assert (read["burst_on"], read["output_on"]) == (True, False)


@one_line
@few
@given(st.floats(1e-6, 25e6), counts, delays_s, st.floats(0.01, 1.0), loads_ohm)
def test_every_toneburst_that_the_limits_allow_reads_back_within_the_resolution(
    line, carrier_hz: float, cycles: int, delay_s: float, share: float, load_ohm: float
) -> None:
    burst = Toneburst(carrier_hz, cycles, 20.0 * share * load_divider(load_ohm), delay_s, load_ohm)
    assert mistakes(burst) == []
    generator = Agilent33250A(line.connection, "toneburst")
    generator.configure(burst)
    read = generator.snapshot()
    assert read["frequency_hz"] == pytest.approx(carrier_hz, **FREQUENCY)
    assert read["amplitude_vpp"] == pytest.approx(burst.amplitude_vpp, **LEVEL)
    assert read["offset_v"] == pytest.approx(0.0, abs=1e-9)
    assert (read["cycles"], read["function"], read["amplitude_unit"]) == (cycles, "SIN", "VPP")


trains = st.builds(
    PulseTrain, st.floats(1.0, 1e5), counts, delays_s, st.floats(1e-7, 5e-6), st.floats(0.1, 10.0), st.just(math.inf)
)


@one_line
@few
@given(st.lists(trains, min_size=2, max_size=4))
def test_the_state_after_a_sweep_is_that_of_its_last_step_alone(line, sweep: list[PulseTrain]) -> None:
    swept = Agilent33250A(line.connection, "burst_train")
    for train in sweep:
        swept.configure(train)
        swept.verify()
    alone = Agilent33250A(twin(), "burst_train")
    alone.configure(sweep[-1])
    assert swept.snapshot() == alone.snapshot()


impossible = st.one_of(
    st.builds(dataclasses.replace, st.just(TRAIN), rate_hz=st.one_of(st.floats(50.1e6, 1e12), st.floats(1e-9, 499e-6))),
    st.builds(dataclasses.replace, st.just(TRAIN), count=st.one_of(st.integers(-9, 0), st.integers(1_000_001, 10**9))),
    st.builds(dataclasses.replace, st.just(TRAIN), delay_s=st.one_of(st.floats(-9, -1e-9), st.floats(85.001, 1e6))),
    st.builds(dataclasses.replace, st.just(TRAIN), width_s=st.one_of(st.floats(0, 7.9e-9), st.floats(200e-6, 10))),
    st.builds(dataclasses.replace, st.just(TRAIN), high_v=st.one_of(st.floats(-9, 0), st.floats(10.01, 1e3))),
    st.builds(dataclasses.replace, st.just(TRAIN), load_ohm=st.one_of(st.floats(-9, 0.9), st.floats(10_001, 1e6))),
)


@one_line
@few
@given(impossible)
def test_every_impossible_train_is_refused_with_the_output_off_and_the_setting_unsent(line, train: PulseTrain) -> None:
    before = line.instrument.registers
    generator = Agilent33250A(line.connection, "burst_train")
    with pytest.raises(InstrumentError):
        generator.configure(train)
    assert line.instrument.registers == before
    with pytest.raises(InstrumentError, match="before configure"):
        generator.enable_output()


@one_line
@few
@given(impossible)
def test_the_read_back_reports_every_impossible_train_that_is_sent(line, train: PulseTrain) -> None:
    """The driver's own limits are lifted, so that the instrument clips or substitutes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drivers.agilent.generator.mistakes", lambda task, model, max_vpp: [])
        generator = Agilent33250A(line.connection, "burst_train")
        with pytest.raises(InstrumentError):
            generator.configure(train)
        with pytest.raises(InstrumentError, match="before configure"):
            generator.enable_output()
    assert not line.instrument.registers.output


def test_one_instrument_can_have_several_roles_in_succession(line) -> None:
    for load_ohm in (50.0, math.inf):
        Agilent33250A(line.connection, "a").configure(dataclasses.replace(TRAIN, load_ohm=load_ohm))
        Agilent33250A(line.connection, "b").configure(BURST)
        Agilent33250A(line.connection, "c").configure(PULSE)


def test_outputs_are_on_only_between_enable_and_make_safe(line) -> None:
    generator = Agilent33250A(line.connection, "burst_train")
    generator.configure(TRAIN)
    assert generator.snapshot()["output_on"] is False
    generator.enable_output()
    assert generator.snapshot()["output_on"] is True
    generator.make_safe()
    assert generator.snapshot()["output_on"] is False


def test_the_master_fires_on_the_twin_and_the_error_queue_stays_empty(line) -> None:
    line.instrument.forget_past()
    master = Agilent33250A(line.connection, "master")
    master.configure(PULSE)
    master.enable_output()
    master.fire()
    master.verify()
    master.make_safe()
    assert len(line.instrument._software_ps) == 1


def test_a_clipped_amplitude_is_an_error(line, monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver's own limit is lifted, so that the command reaches the instrument."""
    monkeypatch.setattr("drivers.agilent.generator.mistakes", lambda task, model, max_vpp: [])
    generator = Agilent33250A(line.connection, "toneburst")
    with pytest.raises(InstrumentError) as caught:
        generator.configure(dataclasses.replace(BURST, amplitude_vpp=12.0))
    text = str(caught.value)
    assert "amplitude_vpp (VOLT) programmed 1.200000000000E+01, read back +1.0000000000000E+01" in text
    assert "-222" in text


def test_a_pulse_wider_than_its_period_is_caught(line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.agilent.generator.mistakes", lambda task, model, max_vpp: [])
    with pytest.raises(InstrumentError, match=r"-22[12]"):
        Agilent33250A(line.connection, "x").configure(dataclasses.replace(TRAIN, width_s=300e-6))


# Held at their reset state, and still not to be found otherwise.
GUARDED = ["OUTP:POL INV", "BURS:PHAS 45", "TRIG:SLOP NEG", "TRIG:SOUR IMM", "BURS:MODE GAT", "VOLT:UNIT VRMS"]


@pytest.mark.parametrize("others", ["BURS:NCYC 3", "TRIG:DEL 0", "VOLT:HIGH 1", "BURS:STAT 0", *GUARDED, "*RST"])
def test_verify_reports_a_foreign_change_after_configure(line, others: str) -> None:
    generator = Agilent33250A(line.connection, "burst_train")
    generator.configure(TRAIN)
    line.instrument.write(others)
    with pytest.raises(InstrumentError, match="read back"):
        generator.verify()


def test_make_safe_works_in_every_state_of_the_instrument(line) -> None:
    line.instrument.write("OUTP 1;:FREQ 2E6")
    line.instrument.write("NONSENSE")
    line.instrument.write("FREQ?")
    Agilent33250A(line.connection, "toneburst").make_safe()
    assert not line.instrument.registers.output


def test_an_unknown_query_times_out_and_the_session_stays_synchronised(line) -> None:
    line.instrument.write("*CLS;*RST")
    session = ScpiSession(line.connection, "master")
    with pytest.raises(InstrumentError, match="no reply"):
        session.query("*OPT?")
    assert float(session.query("FREQ?")) == 1000.0
    assert session.drain_errors() == ()


def test_an_instrument_in_local_mode_is_recognised_and_made_safe(line) -> None:
    generator = Agilent33250A(line.connection, "burst_train")
    generator.configure(TRAIN)
    generator.enable_output()
    line.instrument.write("SYST:LOC", over_serial=True)
    if line.transport == "serial":
        with pytest.raises(InstrumentError, match=r"550 .*local mode"):
            generator.configure(dataclasses.replace(TRAIN, delay_s=0.0))
    assert line.instrument.registers.output
    generator.make_safe()
    assert not line.instrument.registers.output


def test_a_self_test_has_the_output_off_and_forgets_the_programmed_settings(line) -> None:
    generator = Agilent33250A(line.connection, "toneburst")
    generator.configure(BURST)
    generator.enable_output()
    assert generator.self_test()
    assert not line.instrument.registers.output
    with pytest.raises(InstrumentError, match="before configure"):
        generator.verify()


@pytest.mark.parametrize("line", TRANSPORTS, indirect=True)
def test_a_label_is_the_serial_number_of_a_model_without_one_and_survives_a_reset(line) -> None:
    generator = Agilent33250A(line.connection, "toneburst")
    assert (generator.identify().serial, generator.serial_number()) == ("0", "")
    generator.store_label("HPE_3F9A1C")
    generator.configure(BURST)
    assert generator.serial_number() == "HPE_3F9A1C"
    assert generator.snapshot()["output_on"] is False


def test_a_sibling_is_known_by_the_serial_number_of_its_identity() -> None:
    sibling = Agilent33250A(Generator33250A(SimulatedClock(), 0.0, MODELS["33500B"]))
    assert sibling.serial_number() == "MY52000001"


def test_a_label_that_the_instrument_refuses_is_an_error() -> None:
    with pytest.raises(InstrumentError, match=r"label.*-112 Program mnemonic too long"):
        Agilent33250A(twin(), "master").store_label("LONGER_THAN_TWELVE")


@pytest.mark.parametrize("line", TRANSPORTS, indirect=True)
def test_the_front_panel_shows_a_text_until_it_is_cleared(line) -> None:
    generator = Agilent33250A(line.connection, "toneburst")
    generator.display("TONEBURST")
    assert line.instrument.registers.display_text == "TONEBURST"
    generator.display("")
    assert line.instrument.registers.display_text == ""
    assert not line.instrument.registers.output


def test_an_instrument_that_does_not_know_names_of_states_has_no_label() -> None:
    class WithoutNames:
        def __init__(self) -> None:
            self.twin = twin()

        def write(self, message: str) -> None:
            self.twin.write(message.replace("MEM:STAT:NAME?", "MEM:STAT:NONE?"))

        def read(self) -> str:
            return self.twin.read()

    generator = Agilent33250A(WithoutNames(), "toneburst")
    assert generator.serial_number() == ""
    generator.configure(BURST)
    assert generator.verify()["output_on"] is False
