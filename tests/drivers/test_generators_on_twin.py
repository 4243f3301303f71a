"""The generator roles on the simulated 33250A: every setting survives the round trip, every coercion is found."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.agilent_33250a import MasterTrigger33250A, PulseGenerator33250A, ToneburstGenerator33250A
from drivers.interfaces import InstrumentError, PulseTrain, Toneburst, TriggerPulse
from drivers.limits_33250a import pulse_train_mistakes, share_at_load, toneburst_mistakes
from drivers.scpi import ScpiSession
from sim_backend.clock import SimulatedClock
from sim_backend.generator_33250a import Generator33250A

PULSE = TriggerPulse(width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=1e-3, load_ohm=50.0)

loads_ohm = st.one_of(st.just(math.inf), st.floats(1.0, 10_000.0))
delays_s = st.floats(0.0, 85.0)
counts = st.integers(1, 1_000_000)


def twin() -> Generator33250A:
    return Generator33250A(SimulatedClock(), 100e-9)


@given(st.floats(1e-2, 1e6), st.floats(0.01, 0.9), counts, delays_s, st.floats(0.01, 1.0), loads_ohm)
def test_every_train_that_the_limits_allow_is_programmed_without_a_word_from_the_instrument(
    rate_hz: float, duty: float, count: int, delay_s: float, share: float, load_ohm: float
) -> None:
    train = PulseTrain(rate_hz, count, delay_s, duty / rate_hz, 10.0 * share * share_at_load(load_ohm), load_ohm)
    assert pulse_train_mistakes(train) == []
    generator = PulseGenerator33250A(twin(), "burst_train")
    generator.configure(train)
    generator.verify()
    read = generator.snapshot()
    assert read["frequency_hz"] == pytest.approx(rate_hz, rel=1e-10)
    assert read["period_s"] == pytest.approx(1 / rate_hz, rel=1e-10)
    assert read["width_s"] == pytest.approx(train.width_s, rel=1e-10)
    assert read["delay_s"] == pytest.approx(delay_s, rel=1e-10)
    assert read["high_v"] == pytest.approx(train.high_v, rel=1e-9)
    assert (read["cycles"], read["function"], read["trigger_source"]) == (count, "PULS", "EXT")
    assert (read["burst_on"], read["output_on"]) == (True, False)


@given(st.floats(1e-6, 25e6), counts, delays_s, st.floats(0.01, 1.0), loads_ohm)
def test_every_toneburst_that_the_limits_allow_is_programmed_without_a_word_from_the_instrument(
    carrier_hz: float, cycles: int, delay_s: float, share: float, load_ohm: float
) -> None:
    burst = Toneburst(carrier_hz, cycles, 20.0 * share * share_at_load(load_ohm), delay_s, load_ohm)
    assert toneburst_mistakes(burst) == []
    generator = ToneburstGenerator33250A(twin(), "toneburst")
    generator.configure(burst)
    read = generator.snapshot()
    assert read["frequency_hz"] == pytest.approx(carrier_hz, rel=1e-10)
    assert read["amplitude_vpp"] == pytest.approx(burst.amplitude_vpp, rel=1e-10)
    assert read["offset_v"] == pytest.approx(0.0, abs=1e-9)
    assert (read["cycles"], read["function"], read["amplitude_unit"]) == (cycles, "SIN", "VPP")


def test_one_instrument_can_play_one_role_after_the_other() -> None:
    instrument = twin()
    for load_ohm in (50.0, math.inf):
        PulseGenerator33250A(instrument, "a").configure(dataclasses.replace(TRAIN, load_ohm=load_ohm))
        ToneburstGenerator33250A(instrument, "b").configure(BURST)
        MasterTrigger33250A(instrument, "c").configure(PULSE)


def test_outputs_are_on_only_between_enable_and_make_safe() -> None:
    generator = PulseGenerator33250A(twin(), "burst_train")
    generator.configure(TRAIN)
    assert generator.snapshot()["output_on"] is False
    generator.enable_output()
    assert generator.snapshot()["output_on"] is True
    generator.make_safe()
    assert generator.snapshot()["output_on"] is False


def test_the_master_fires_on_the_twin_and_the_error_queue_stays_empty() -> None:
    master = MasterTrigger33250A(twin(), "master")
    master.configure(PULSE)
    master.enable_output()
    master.fire()
    master.verify()


def test_an_instrument_that_clips_the_amplitude_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver's own limit is lifted, so that the command reaches the instrument."""
    monkeypatch.setattr("drivers.agilent_33250a.toneburst_mistakes", lambda burst: [])
    generator = ToneburstGenerator33250A(twin(), "toneburst")
    with pytest.raises(InstrumentError) as caught:
        generator.configure(dataclasses.replace(BURST, amplitude_vpp=12.0))
    text = str(caught.value)
    assert "amplitude_vpp (VOLT) programmed 1.200000000000E+01, read back +1.0000000000000E+01" in text
    assert "-222" in text


def test_a_pulse_wider_than_its_period_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.agilent_33250a.pulse_train_mistakes", lambda train: [])
    with pytest.raises(InstrumentError, match=r"-22[12]"):
        PulseGenerator33250A(twin(), "x").configure(dataclasses.replace(TRAIN, width_s=300e-6))


def test_make_safe_works_on_an_instrument_left_in_any_state() -> None:
    instrument = twin()
    instrument.write("APPL:SIN 2E6,5,0")
    instrument.write("NONSENSE")
    instrument.write("FREQ?")
    ToneburstGenerator33250A(instrument, "toneburst").make_safe()
    instrument.write("OUTP?")
    assert instrument.read() == "0"


def test_an_unknown_query_times_out_and_the_session_goes_on_in_step() -> None:
    session = ScpiSession(twin(), "master")
    with pytest.raises(InstrumentError, match="no reply"):
        session.query("*OPT?")
    assert float(session.query("FREQ?")) == 1000.0
    assert session.drain_errors() == ()
