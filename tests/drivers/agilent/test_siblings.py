"""Siblings of the 33250A on the twin: the table of differences is chosen by ``*IDN?``, limits and spelling hold."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given, settings, strategies as st

from drivers.agilent.generator import Agilent33250A
from drivers.agilent.limits import mistakes
from drivers.agilent.models import MODELS, GeneratorModel, model_named
from drivers.interfaces import InstrumentError, PulseTrain, Toneburst, TriggerPulse
from sim_backend.generator import models as models_33250a
from sim_backend.generator.instrument import Generator33250A
from sim_backend.wiring import SimulatedClock

PULSE = TriggerPulse(width_s=10e-6, high_v=4.0, load_ohm=math.inf)
TRAIN = PulseTrain(rate_hz=5e3, count=1000, delay_s=10e-3, width_s=10e-6, high_v=4.0, load_ohm=math.inf)
BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=1e-3, load_ohm=50.0)
NAMES = [model.name for model in MODELS]


def twin(name: str) -> Generator33250A:
    return Generator33250A(SimulatedClock(), 100e-9, models_33250a.MODELS[name])


@pytest.mark.parametrize(
    ("answer", "name"),
    [
        ("33250A", "33250A"),
        ("33220A", "33220A"),
        ("33522B", "33500B"),
        ("33521A", "33500B"),
        ("33612A", "33600A"),
        ("33250B", None),
        ("33500", None),
        ("34401A", None),
        ("", None),
    ],
)
def test_the_second_field_of_the_identity_chooses_the_series(answer: str, name: str | None) -> None:
    model = model_named(answer)
    assert (model.name if model else None) == name


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_headers_name_the_channel_on_models_with_several(model: GeneratorModel) -> None:
    numbered = model.name in ("33500B", "33600A")
    for plain, with_channel in (("OUTP", "OUTP1"), ("TRIG:SOUR", "TRIG1:SOUR"), ("OUTP:TRIG", "OUTP:TRIG")):
        assert model.header(plain) == (with_channel if numbered else plain)


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_a_trigger_pulse_fills_at_most_half_of_the_longest_period(model: GeneratorModel) -> None:
    widest_s = model.width_s[1] / 2
    assert mistakes(dataclasses.replace(PULSE, width_s=widest_s), model) == []
    assert mistakes(dataclasses.replace(PULSE, width_s=math.nextafter(widest_s, math.inf)), model)


@pytest.mark.parametrize("name", NAMES)
def test_every_role_is_programmed_and_read_back_on_every_model(name: str) -> None:
    instrument = twin(name)
    for role, program in (
        (Agilent33250A(instrument, "a", name), PULSE),
        (Agilent33250A(instrument, "b", name), TRAIN),
        (Agilent33250A(instrument, "c", name), BURST),
    ):
        role.configure(program)
        role.verify()
        role.enable_output()
        assert role.snapshot()["output_on"] is True
        role.make_safe()
        assert role.snapshot()["output_on"] is False


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(MODELS),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(0, 1),
)
def test_trains_at_and_between_the_limits_of_every_model_read_back(model, rate, count, delay, width) -> None:
    low_hz, high_hz = model.pulse_rate_hz
    rate_hz = min(max(low_hz * (high_hz / low_hz) ** rate, low_hz), high_hz)
    period_s = model.shortest_period_s(rate_hz)
    min_width_s = model.min_width_s(period_s)
    widest_s = min(model.width_s[1], period_s - max(model.width_s[0], 1.6 * model.edge_s))
    train = PulseTrain(
        rate_hz=rate_hz,
        count=round(model.cycles[0] + count * (model.cycles[1] - model.cycles[0])),
        delay_s=delay * model.delay_s[1],
        width_s=min(max(min_width_s + width * (widest_s - min_width_s), min_width_s), widest_s),
        high_v=4.0,
        load_ohm=math.inf,
    )
    assert mistakes(train, model) == []
    generator = Agilent33250A(twin(model.name), "x")
    generator.configure(train)
    generator.verify()


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_the_drivers_limits_are_within_the_twins(model: GeneratorModel) -> None:
    """Both are written from the manuals, apart from each other; of a series the driver takes the smallest member."""
    instrument = models_33250a.MODELS[model.name]
    assert model.cycles == (1, instrument.max_cycles)
    assert model.delay_s == instrument.delay_limits_s
    assert model.width_s == instrument.width_limits_s
    assert model.edge_s == instrument.edge_limits_s[0]
    assert model.narrowest_s == instrument.min_width_by_period_s
    assert model.burst_carrier_hz == (1e-6, instrument.finite_burst_ceiling_hz)
    for limits, function in ((model.sine_hz, "SIN"), (model.pulse_rate_hz, "PULS")):
        lowest, highest = instrument.frequency_limits_hz[function]
        assert limits[0] == lowest
        assert limits[1] == highest if model.name in ("33250A", "33220A") else limits[1] <= highest


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
@pytest.mark.parametrize("value", [9.876543e-3, 0.5, 1.0, 8.7654321, 12.345678, 98765.4321, 7.6543219e6])
def test_the_resolution_of_a_number_follows_its_decade_and_digits(model: GeneratorModel, value: float) -> None:
    decade = math.floor(math.log10(value))
    digits = 9 if model.name == "33250A" else 15
    assert model.resolution("FREQ", value) == pytest.approx(max(1e-6, 10.0 ** (decade - digits + 1)))
    # Levels have four digits, and 0.1 mV at best: 1.234 V, 12.34 V.
    assert model.resolution("VOLT", value) == pytest.approx(max(1e-4, 10.0 ** (decade - 3)))
    assert model.resolution("BURS:NCYC", value) == 0.0


def test_the_shortest_period_is_that_of_the_rate_rounded_up() -> None:
    """Nine digits of a rate of 12 345.67891 Hz are 12 345.6789, the next is 0.0001 Hz up."""
    model = model_named("33250A")
    assert model is not None
    assert 1 / model.shortest_period_s(12345.67891) == pytest.approx(12345.6790, rel=1e-12)
    assert 1 / model.shortest_period_s(12345.6789) == pytest.approx(12345.6789, rel=1e-12)


LIMITS = [
    ("33220A", Agilent33250A, dataclasses.replace(TRAIN, count=50_001), "count = 50001"),
    ("33220A", Agilent33250A, dataclasses.replace(TRAIN, width_s=10e-9), "width_s = 1e-08"),
    ("33220A", Agilent33250A, dataclasses.replace(BURST, carrier_hz=9e6), "counted bursts of a 33220A"),
    ("33500B", Agilent33250A, dataclasses.replace(BURST, carrier_hz=9e6), "counted bursts of a 33500B"),
    ("33600A", Agilent33250A, dataclasses.replace(BURST, carrier_hz=9e6), "counted bursts of a 33600A"),
    ("33500B", Agilent33250A, dataclasses.replace(TRAIN, delay_s=1001.0), "delay_s = 1001"),
]


@pytest.mark.parametrize(("name", "role_type", "program", "text"), LIMITS)
def test_values_beyond_a_siblings_limits_are_refused_before_a_setting_is_sent(name, role_type, program, text) -> None:
    instrument = twin(name)
    before = instrument.registers
    with pytest.raises(InstrumentError, match=text):
        role_type(instrument, "x").configure(program)
    assert instrument.registers == before


def test_a_sibling_counts_and_waits_for_longer_than_a_33250a_can() -> None:
    train = dataclasses.replace(TRAIN, count=2_000_000, delay_s=90.0)
    assert len(mistakes(train)) == 2
    Agilent33250A(twin("33600A"), "x").configure(train)


@pytest.mark.parametrize("name", ["33220A", "33500B", "33600A"])
def test_the_33250as_pulse_headers_are_unknown_to_a_sibling(name: str) -> None:
    instrument = twin(name)
    instrument.write("PULS:WIDT 1E-5")
    instrument.write("SYST:ERR?")
    assert instrument.read() == '-113,"Undefined header"'


def test_only_two_channel_models_accept_channel_numbers() -> None:
    replies = []
    for name, header in (("33250A", "SOUR1:FREQ 2E3"), ("33600A", "SOUR2:FREQ 2E3"), ("33600A", "SOUR3:FREQ 2E3")):
        instrument = twin(name)
        instrument.write(header)
        instrument.write("SYST:ERR?")
        replies.append(int(instrument.read().split(",")[0]))
    assert replies == [-113, 0, -114]


def test_a_9_mhz_pulse_is_within_a_33250as_limits() -> None:
    assert mistakes(dataclasses.replace(BURST, carrier_hz=9e6, cycles=3)) == []


@pytest.mark.parametrize("name", NAMES)
def test_an_amplitude_beyond_the_resolution_is_accepted_and_reported_rounded(name: str) -> None:
    """Half the force asks for 0.70710678 Vpp; four digits are 0.7071."""
    generator = Agilent33250A(twin(name), "toneburst", name)
    generator.configure(dataclasses.replace(BURST, amplitude_vpp=math.sqrt(0.5)))
    assert generator.verify()["amplitude_vpp"] == pytest.approx(0.7071, rel=1e-12)


@pytest.mark.parametrize(("level", "off"), [("VOLT", 0.5012), ("VOLT:OFFS", 2e-4), ("FREQ", 3.0001e6)])
def test_a_difference_beyond_the_resolution_is_an_error(level: str, off: float) -> None:
    instrument = twin("33250A")
    generator = Agilent33250A(instrument, "toneburst")
    generator.configure(BURST)
    instrument.write(f"{level} {off}")
    with pytest.raises(InstrumentError, match="read back"):
        generator.verify()
