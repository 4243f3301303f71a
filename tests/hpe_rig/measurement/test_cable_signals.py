"""Signals in noisy records with finite edges: which instrument's, when, and of which polarity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import read_bench
from hpe_rig.measurement.cable_signals import (
    BURSTS,
    PRE_TRIGGER_SAMPLES,
    PULSE_WIDTHS_S,
    RECORD_SAMPLES,
    SAMPLE_RATE_HZ,
    arrival,
    capture_of,
    command_pulse,
    tasks,
)

BENCH = read_bench().bench
TIME_S = (np.arange(RECORD_SAMPLES) - PRE_TRIGGER_SAMPLES) / SAMPLE_RATE_HZ
EDGE_S = 12e-9
RANGE_V = 4.0


def edge(time_s: FloatArray) -> FloatArray:
    """Return a linear edge from 0 to 1 with its middle at time 0."""
    return np.clip(time_s / EDGE_S + 0.5, 0.0, 1.0)


def waveform(role: str, time_s: FloatArray) -> FloatArray:
    if role in BURSTS:
        carrier_hz, cycles = BURSTS[role]
        inside = (time_s >= 0) & (time_s < cycles / carrier_hz)
        return np.where(inside, np.sin(2 * np.pi * carrier_hz * time_s), 0.0)
    width_s = PULSE_WIDTHS_S.get(role, 1.0)
    return edge(time_s) - edge(time_s - width_s)


def records(role: str, delay_s: float, sign: float, rng: np.random.Generator) -> FloatArray:
    """Return 32 records of a signal of 2.5 V with 0.02 V noise, triggered at any phase of the sample clock."""
    phases_s = rng.uniform(0.0, 1 / SAMPLE_RATE_HZ, 32)
    volts = [sign * 2.5 * waveform(role, TIME_S - delay_s - phase_s) for phase_s in phases_s]
    return np.array(volts) + rng.normal(0.0, 0.02, (32, RECORD_SAMPLES))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("role", [*PULSE_WIDTHS_S, *BURSTS, "digitizer"])
def test_a_signal_is_recognised_with_time_and_polarity(role: str, sign: float) -> None:
    errors = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        delay_s = rng.uniform(-500e-9, 500e-9)
        signal = arrival(records(role, delay_s, sign, rng), RANGE_V)
        assert signal is not None
        assert (signal.role, signal.inverted) == (role, sign < 0)
        assert 0 < signal.u_s < 3e-9
        errors.append((signal.time_s - delay_s) / signal.u_s)
    # The phases have a mean of half a sample, which the difference of two places cancels.
    assert np.std(errors) < 1.5


@pytest.mark.parametrize("role", BURSTS)
@pytest.mark.parametrize("samples", [0.0, 0.25, 0.5, 0.75])
def test_a_burst_is_timed_to_a_tenth_of_a_sample(role: str, samples: float) -> None:
    delay_s = (20 + samples) / SAMPLE_RATE_HZ
    signal = arrival(2.5 * waveform(role, TIME_S - delay_s)[None], RANGE_V)
    assert signal is not None
    assert signal.time_s == pytest.approx(delay_s, abs=0.1 / SAMPLE_RATE_HZ)


def test_an_edge_synchronous_with_the_sample_clock_has_the_uncertainty_of_rounding() -> None:
    signal = arrival(np.tile(2.5 * waveform("master", TIME_S), (32, 1)), RANGE_V)
    assert signal is not None
    # The standard deviation of a uniform distribution over a sample.
    assert signal.u_s == pytest.approx(1 / SAMPLE_RATE_HZ / np.sqrt(12), rel=1e-6)


def test_the_difference_of_two_places_is_the_delay_of_the_cable() -> None:
    for role in ("master", "toneburst"):
        rng, normalised = np.random.default_rng(1), []
        for _ in range(12):
            near, far = (arrival(records(role, delay_s, 1.0, rng), RANGE_V) for delay_s in (20e-9, 43e-9))
            assert near is not None
            assert far is not None
            normalised.append((far.time_s - near.time_s - 23e-9) / np.hypot(near.u_s, far.u_s))
        assert np.mean(np.abs(normalised) < 2) > 0.8


@pytest.mark.parametrize(
    "volts",
    [
        np.zeros((4, RECORD_SAMPLES)),
        np.full((4, RECORD_SAMPLES), 1.3),
        np.random.default_rng(1).normal(0.0, 1.0, (4, RECORD_SAMPLES)),
        np.tile(np.sin(2 * np.pi * 1e6 * TIME_S), (4, 1)),
        np.tile(0.1 * waveform("master", TIME_S), (4, 1)),
        np.zeros((0, RECORD_SAMPLES)),
    ],
    ids=["nothing", "a constant", "noise", "a continuous sine", "a weak pulse", "no record"],
)
def test_no_instrument_is_recognised_in_anything_else(volts: FloatArray) -> None:
    assert arrival(volts, RANGE_V) is None


def test_a_pulse_between_those_of_two_instruments_is_not_mistaken_for_either() -> None:
    """A pulse of 1.45 us is neither the master's of 1 us nor the burst train's of 2 us."""
    volts = np.tile(edge(TIME_S) - edge(TIME_S - 1.45e-6), (4, 1))
    assert arrival(volts, RANGE_V) is None


def test_outputs_stay_within_the_limits_of_the_bench_file() -> None:
    pulser = BENCH.generators.tracking_pulser.model_copy(update={"max_vpp": 0.05})
    master = BENCH.generators.master.model_copy(update={"max_vpp": 4.5})
    generators = BENCH.generators.model_copy(update={"tracking_pulser": pulser, "master": master})
    bench = BENCH.model_copy(update={"generators": generators})
    programmed = tasks(bench)
    assert programmed["tracking_pulser"] == replace(tasks(BENCH)["tracking_pulser"], amplitude_vpp=0.05)
    assert command_pulse(bench).high_v == 4.5
    assert capture_of("tracking_pulser", bench, 1).input_range_v == 0.1
