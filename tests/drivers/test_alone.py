"""A driver alone in a script: the example of the package, a plain sine, and an output that is off at the end."""

from __future__ import annotations

import doctest
import math

import pytest

import drivers
from drivers.agilent.generator import Agilent33250A
from drivers.agilent.limits import mistakes
from drivers.agilent.models import MODELS
from drivers.interfaces import ContinuousSine, InstrumentError, Toneburst
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports.emulator import Emulator
from sim_backend.wiring import PS_PER_S, SimulatedClock, no_steps

BURST = Toneburst(carrier_hz=3.0e6, cycles=600, amplitude_vpp=0.5, delay_s=0.0, load_ohm=50.0)


@pytest.fixture
def instrument() -> Generator33250A:
    return Generator33250A(SimulatedClock(), 100e-9)


class Sharing:
    """The instrument as every transport wants it: it outlives the connection."""

    def __init__(self, instrument: Generator33250A) -> None:
        self.write, self.read, self.serial_poll = instrument.write, instrument.read, instrument.serial_poll


def test_the_packages_example_runs_at_another_address(instrument: Generator33250A) -> None:
    with Emulator("socket", lambda role, over_serial: Sharing(instrument), ("generator",)) as emulator:
        example = drivers.__doc__ or ""
        assert "GPIB0::10::INSTR" in example
        example = example.replace("GPIB0::10::INSTR", emulator.served["generator"].address)
        parsed = doctest.DocTestParser().get_doctest(example, {}, "drivers", None, 0)
        results = doctest.DocTestRunner().run(parsed)
    assert results.attempted == 4
    assert results.failed == 0
    assert not instrument.registers.output


def test_a_sine_goes_on_without_a_trigger_until_the_with_statement_ends(instrument: Generator33250A) -> None:
    with Agilent33250A(instrument) as generator:
        generator.sine(frequency_hz=1.5e6, amplitude_vpp=0.4)
        bursts = instrument.emission(no_steps(), PS_PER_S).bursts
        assert bursts.carrier_hz.tolist() == [1.5e6]
        # A 50 ohm source shows twice the voltage where nothing loads it.
        assert bursts.amplitude_vpp.tolist() == pytest.approx([0.8])
        assert int(bursts.end_ps[0]) == PS_PER_S
    assert not instrument.registers.output


@pytest.mark.parametrize("order", [("sine", "burst"), ("burst", "sine")])
def test_sine_and_burst_replace_one_another(instrument: Generator33250A, order: tuple[str, str]) -> None:
    with Agilent33250A(instrument) as generator:
        for task in order:
            if task == "sine":
                generator.sine(2e6, 0.5)
            else:
                generator.configure(BURST)
            generator.verify()
            assert instrument.registers.burst == (task == "burst")
        assert instrument.registers.output == (order[-1] == "sine")


def test_an_exception_inside_leaves_the_output_off(instrument: Generator33250A) -> None:
    def fail() -> None:
        with Agilent33250A(instrument) as generator:
            generator.sine(1e6, 0.5)
            raise RuntimeError("of the script")

    with pytest.raises(RuntimeError, match="of the script"):
        fail()
    assert not instrument.registers.output


def test_nothing_is_sent_to_an_unknown_instrument(scripted) -> None:
    stranger = scripted(replies={"*IDN": "Somebody,34401A,0,1.0"})
    with pytest.raises(InstrumentError, match="34401A"), Agilent33250A(stranger):
        pytest.fail("a stranger was entered")
    assert stranger.commands == ["*IDN?"]
    assert stranger.closed


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_a_sine_beyond_the_model_or_the_wiring_is_refused_with_both_numbers(model) -> None:
    highest_hz = model.sine_hz[1]
    assert mistakes(ContinuousSine(highest_hz, 0.5), model) == []
    (beyond,) = mistakes(ContinuousSine(2 * highest_hz, 0.5), model)
    assert f"frequency_hz = {2 * highest_hz:.10g}" in beyond
    assert f"{highest_hz:.10g}" in beyond
    (swing,) = mistakes(ContinuousSine(1e6, 0.5), model, max_vpp=0.1)
    assert "above max_vpp = 0.1" in swing


def test_a_nan_is_refused() -> None:
    assert len(mistakes(ContinuousSine(math.nan, math.nan))) >= 2
