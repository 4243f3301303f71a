"""Edges along cables, and instruments as functions from edges to edges, against plain loops."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from sim_backend.digitizer.board import Arming, BoardSettings, Engine, Latencies, accepted_triggers
from sim_backend.generator.emission import respond
from sim_backend.generator.registers import Registers
from sim_backend.settings import TriggerFaults
from sim_backend.wiring import (
    Bursts,
    Capture,
    Emission,
    SimulatedClock,
    Steps,
    accepted,
    bursts_at_amplifiers,
    cables_of,
    crossings,
    joined_steps,
    near,
    no_bursts,
    no_steps,
    propagate,
    trigger_order,
)

LATENCY_PS = 100_000
FAR_PS = 1 << 60
TRIGGERED = Registers(
    function="PULS",
    output=True,
    burst=True,
    trigger_source="EXT",
    high_v=4.0,
    low_v=0.0,
    frequency_hz=1e6,
    width_s=2e-7,
)
times = st.lists(st.integers(0, 2_000_000_000), max_size=40).map(lambda values: np.array(sorted(values), np.int64))


def ttl(rise_ps, width_ps=1000, high_v=4.0):
    rise_ps = np.asarray(rise_ps, np.int64)
    low, high = np.zeros(rise_ps.size), np.full(rise_ps.size, high_v)
    return joined_steps([Steps(rise_ps, low, high), Steps(rise_ps + width_ps, high, low)])


def rises(steps):
    return crossings(steps, 2.0, True, 10e3).tolist()


@given(times, st.integers(1, 500_000_000), st.none() | st.integers(0, 10))
def test_accepted_triggers_equal_a_plain_loop(trigger_ps, busy_ps, limit):
    expected, idle_from = [], -1
    for index, time_ps in enumerate(trigger_ps.tolist()):
        if time_ps >= idle_from and (limit is None or len(expected) < limit):
            expected.append(index)
            idle_from = time_ps + busy_ps
    assert accepted(trigger_ps, busy_ps, limit).tolist() == expected


# Two bursts in full, which random triggers and ends seldom leave.
@example(np.array([0, 10**9], np.int64), 3, 0, 1e6, 2 * 10**9)
@settings(max_examples=60)
@given(
    times, st.integers(1, 30), st.integers(0, 400), st.sampled_from([1e6, 3e5, 1.7e6]), st.integers(0, 2_000_000_000)
)
def test_pulse_train_equals_a_plain_loop(trigger_ps, cycles, delay_us, frequency_hz, stop_ps):
    programmed = replace(
        TRIGGERED, width_s=1e-7, cycles=float(cycles), delay_s=delay_us * 1e-6, frequency_hz=frequency_hz
    )
    expected, ignored, idle_from = [], 0, -1
    busy_ps = round((delay_us * 1e-6 + cycles / frequency_hz) * 1e12)
    for time_ps in sorted(set(trigger_ps.tolist())):
        if time_ps >= stop_ps:
            continue
        if time_ps < idle_from:
            ignored += 1
            continue
        idle_from = time_ps + busy_ps
        for cycle in range(cycles):
            edge_ps = time_ps + LATENCY_PS + delay_us * 1_000_000 + round(cycle * 1e12 / frequency_hz)
            if edge_ps < stop_ps:
                expected.append(edge_ps)
    off = Registers()
    emission = respond(
        [(0, programmed), (stop_ps, off)], [], ttl(np.unique(trigger_ps), width_ps=1), LATENCY_PS, FAR_PS
    )
    assert rises(emission.steps) == expected
    assert emission.ignored == ignored


@settings(max_examples=60)
@given(
    times, st.integers(128, 4096), st.integers(0, 5000), st.integers(1, 20), st.sampled_from([10_000, 8_000, 1_000_000])
)
def test_records_equal_a_plain_loop(trigger_ps, samples, delay, count, period_ps):
    programmed = BoardSettings(
        sample_rate_hz=1_000_000_000_000 // period_ps,
        engines=(Engine(2, 1, 166), Engine()),
        delay_samples=delay,
        post_samples=samples,
        record_count=count,
    )
    arming = Arming(0, 50_000_000, programmed)
    expected, idle_from = [], 0
    for time_ps in np.unique(trigger_ps).tolist():
        tick_ps = math.ceil(time_ps / period_ps) * period_ps
        if time_ps >= arming.start_ps and tick_ps >= idle_from and len(expected) < count:
            expected.append(tick_ps + 7 + delay * period_ps)
            idle_from = tick_ps + 7 + (delay + samples) * period_ps
    triggers = accepted_triggers(arming, ttl(np.unique(trigger_ps), width_ps=1), Latencies(7, 0))
    assert triggers.first_sample_ps.tolist() == expected


def test_a_stray_trigger_after_the_end_of_a_capture_makes_no_record():
    arming = Arming(0, 0, BoardSettings(engines=(Engine(2, 1, 166), Engine()), record_count=9), stop_ps=2_000_000)
    faults = TriggerFaults(stray_s=(0.5e-6, 5e-6))
    triggers = accepted_triggers(arming, ttl([1_000_000]), Latencies(0, 0), faults)
    assert triggers.tick_ps.tolist() == [1_000_000, 1_500_000]


def test_a_cable_is_a_delay_and_no_cable_is_no_trigger():
    cables = cables_of([("a.output", "b.trigger", 5e-9)], ["a.output"], ["b.trigger", "c.trigger"])
    arrivals = {}

    def listener(role):
        def respond_to(arriving):
            arrivals[role] = arriving
            return Emission(no_steps(), no_bursts())

        return respond_to

    propagate(
        cables, {"c": listener("c"), "b": listener("b"), "a": lambda arriving: Emission(ttl([1000]), no_bursts())}
    )
    assert rises(arrivals["b"]) == [6000]
    assert arrivals["c"].time_ps.size == 0


def test_steps_of_two_cables_into_one_input_are_sorted_by_time():
    cables = cables_of(
        [("a.output", "c.trigger", 9e-9), ("b.output", "c.trigger", 0.0)], ["a.output", "b.output"], ["c.trigger"]
    )
    respond_to = {
        "a": lambda arriving: Emission(ttl([0]), no_bursts()),
        "b": lambda arriving: Emission(ttl([5000]), no_bursts()),
        "c": lambda arriving: Emission(arriving, no_bursts()),
    }
    assert rises(propagate(cables, respond_to)["c"].steps) == [5000, 9000]


def test_a_loop_of_triggers_is_refused():
    ends = ["a.output", "b.output"], ["a.trigger", "b.trigger"]
    cables = cables_of([("a.output", "b.trigger", 0.0), ("b.output", "a.trigger", 0.0)], *ends)
    with pytest.raises(ValueError, match="loop"):
        trigger_order(cables, ("a", "b"))


@pytest.mark.parametrize(
    ("cable", "reason"),
    [
        (("x.output", "b.trigger", 0.0), "no output"),
        (("a.output", "x.trigger", 0.0), "no input"),
        (("a.output", "b.trigger", -1.0), "delay"),
    ],
)
def test_a_cable_that_cannot_exist_is_refused(cable, reason):
    with pytest.raises(ValueError, match=reason):
        cables_of([cable], ["a.output"], ["b.trigger"])


@pytest.mark.parametrize(
    ("open_v", "input_ohm", "edges"), [(2.1, 10e3, 1), (2.0, 10e3, 0), (3.9, 50.0, 0), (4.0, 50.0, 1)]
)
def test_a_level_is_judged_behind_the_sources_50_ohm(open_v, input_ohm, edges):
    assert crossings(ttl([0], high_v=open_v), 2.0, True, input_ohm).size == edges


def test_an_edge_must_start_below_the_level():
    steps = Steps(np.array([1, 2, 3, 4]), np.array([0.0, 2.0, 1.0, 0.5]), np.array([2.0, 0.0, 0.0, 1.0]))
    # A 50 ohm load halves the open-circuit voltage: 1 V reaches the level of 0.5 V.
    assert crossings(steps, 0.5, rising=True, input_ohm=50.0).tolist() == [1, 4]
    assert crossings(steps, 0.5, rising=False, input_ohm=50.0).tolist() == [2, 3]
    # A voltage that starts at the level crosses nothing.
    further = Steps(np.array([1]), np.array([1.0]), np.array([2.0]))
    assert crossings(further, 0.5, rising=True, input_ohm=50.0).tolist() == []


def sine(**changes):
    return replace(
        replace(TRIGGERED, function="SIN", high_v=1.0, low_v=-1.0, frequency_hz=3e6, cycles=600.0), **changes
    )


def test_sine_burst_lasts_its_cycles():
    bursts = respond([(0, sine())], [], ttl([1_000_000]), LATENCY_PS, FAR_PS).bursts
    assert (bursts.onset_ps.tolist(), bursts.end_ps.tolist()) == ([1_100_000], [201_100_000])
    assert (bursts.cycles[0], bursts.carrier_hz[0], bursts.amplitude_vpp[0]) == (600.0, 3e6, 2.0)


def test_output_off_cuts_a_running_burst_and_drops_a_pending_one():
    history = [(0, sine(cycles=300.0)), (50_000_000, Registers())]
    bursts = respond(history, [], ttl([0]), LATENCY_PS, FAR_PS).bursts
    assert bursts.end_ps.tolist() == [50_000_000]
    assert bursts.cycles[0] == pytest.approx(3e6 * 49.9e-6, rel=1e-12)
    history[0] = (0, sine(delay_s=100e-6))
    assert respond(history, [], ttl([0]), LATENCY_PS, FAR_PS).bursts.onset_ps.size == 0


@pytest.mark.parametrize(
    "registers",
    [
        sine(output=False),
        sine(trigger_source="BUS"),
        sine(function="RAMP"),
        sine(burst_mode="GAT"),
    ],
)
def test_unprogrammed_instruments_emit_nothing(registers):
    emission = respond([(0, registers)], [], ttl([0]), LATENCY_PS, FAR_PS)
    assert emission.bursts.onset_ps.size == emission.steps.time_ps.size == 0


def test_falling_slope_triggers_on_the_falling_edge():
    bursts = respond([(0, sine(trigger_slope="NEG"))], [], ttl([0], width_ps=77_000), 0, FAR_PS).bursts
    assert bursts.onset_ps.tolist() == [77_000]


def test_internal_trigger_repeats_and_continuous_output_runs_to_the_horizon():
    repeated = respond([(0, sine(trigger_source="IMM", burst_period_s=1e-3))], [], no_steps(), 0, 3_500_000_000).bursts
    assert repeated.onset_ps.tolist() == [0, 10**9, 2 * 10**9, 3 * 10**9]
    continuous = respond([(5, sine(burst=False))], [], no_steps(), 0, 10**9).bursts
    assert (continuous.onset_ps.tolist(), continuous.end_ps.tolist()) == ([5], [10**9])


def test_pulses_that_would_begin_after_the_output_goes_off_do_not() -> None:
    # 0.5 us from one to the next; the output goes off at 1.2 us, 0.1 us after the trigger.
    history = [(0, replace(TRIGGERED, frequency_hz=2e6, cycles=10.0)), (1_200_000, Registers())]
    emission = respond(history, [], ttl([0, 1_150_000]), LATENCY_PS, FAR_PS)
    assert rises(emission.steps) == [100_000, 600_000, 1_100_000]


def test_a_square_wave_is_high_for_its_duty_cycle_of_each_period() -> None:
    square = replace(TRIGGERED, function="SQU", frequency_hz=2e6, duty_percent=30.0, cycles=2.0)
    steps = respond([(0, square)], [], ttl([0]), LATENCY_PS, FAR_PS).steps
    # 30 % of 0.5 us, twice
    assert rises(steps) == [100_000, 600_000]
    assert crossings(steps, 2.0, False, 10e3).tolist() == [250_000, 750_000]


def test_bursts_within_10_ms_of_a_record_of_any_length_contribute() -> None:
    onset_ps = np.arange(0, 200, 3, dtype=np.int64) * 10**9
    bursts = Bursts(onset_ps, onset_ps + 1000, np.ones(67), np.ones(67), np.ones(67))
    # 50 ms from 60 ms on.
    contributing = near(bursts, Capture(0, 0, np.array([60 * 10**9]), 10**6, 50_000))
    assert contributing.onset_ps.tolist() == [time for time in onset_ps.tolist() if 50 * 10**9 <= time < 120 * 10**9]


@pytest.mark.parametrize("duration_s", [0.0, -1.0])
def test_sleeping_for_no_time_does_not_advance_the_clock(duration_s: float) -> None:
    clock = SimulatedClock()
    assert clock.now_s() == 0.0
    clock.sleep(duration_s)
    assert clock.now_ps == 0
    clock.sleep(1000.0)
    assert clock.now_ps == 10**15


def test_inverted_pulse_has_its_rising_edge_at_the_end():
    inverted = replace(TRIGGERED, polarity="INV")
    emission = respond([(10, inverted)], [], ttl([1_000_000]), 0, FAR_PS)
    # The first rise is the relay: an inverted output idles high.
    assert rises(emission.steps) == [10, 1_200_000]


def test_a_train_of_too_many_pulses_is_refused():
    endless = Registers(function="SQU", output=True, high_v=4.0, low_v=0.0, frequency_hz=80e6)
    with pytest.raises(ValueError, match="more than the twin simulates"):
        respond([(0, endless)], [], no_steps(), 0, 10**12)


def test_drive_voltage_is_that_across_50_ohm():
    emission = respond([(0, sine())], [], ttl([0]), 0, FAR_PS)
    cables = cables_of([("toneburst.output", "transducer.drive", 1e-9)], ["toneburst.output"], ["transducer.drive"])
    arrived = bursts_at_amplifiers(cables, {"toneburst": emission}, ["toneburst"])
    assert (arrived.onset_ps[0], arrived.amplitude_vpp[0]) == (1000, 1.0)
