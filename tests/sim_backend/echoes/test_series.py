"""The series in the motion against the exact sum."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.exact_sums import blocks, running_sum
from sim_backend.echoes.pulse import gaussian_pulse, hann_pulse, rectangular_burst
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.echoes.series import MAX_ANGLE_RAD, MAX_TERMS, ScattererRows, series, series_terms
from sim_backend.settings import Beams, Scatterers

SOUND_SPEED = 1540.0
GATE_S = (np.arange(130) - 64.5) * 1e-8
CYCLE = np.sin(2 * np.pi * np.arange(41) / 20)
PULSES = [hann_pulse(9.0e6, 0.065), hann_pulse(9.0e6, 0.75), gaussian_pulse(9.0e6, 0.4), rectangular_burst(9e6, 1.4e-6)]


def scene(seed=0):
    field = draw_field(Scatterers(), Beams(), np.random.default_rng(seed))
    return depth_delay_s(field, "two_way", SOUND_SPEED), field.tracking_weight, field.motion_weight


def rms_error(ours, expected):
    return np.sqrt(np.mean((ours - expected) ** 2) / np.mean(expected**2))


@pytest.mark.parametrize("pulse", [PULSES[0], *(pytest.param(pulse, marks=pytest.mark.slow) for pulse in PULSES[1:])])
def test_series_meets_the_tolerance_for_any_ends_of_the_pulse(pulse):
    for seed, amplitude_m in enumerate([1e-15, 1e-8, 1e-7, 1e-6, 1e-5]):
        tau, weight, g = scene(seed)
        motion = EchoDelays(tau, g[None], 2 / SOUND_SPEED * amplitude_m * CYCLE[:, None])
        exact = running_sum(motion.delay_s(), weight, pulse, GATE_S)
        for tolerance in (1e-3, 1e-6, 1e-10, 1e-13):
            assert rms_error(synthesise(motion, weight, pulse, GATE_S, tolerance, "series").echo, exact) < tolerance


def test_series_of_too_large_a_motion_is_refused_with_both_numbers():
    tau, weight, g = scene()
    motion = EchoDelays(tau, g[None], 2 / SOUND_SPEED * 1e-3 * CYCLE[:, None])
    with pytest.raises(ValueError, match=r"'series' cannot serve because .*too large"):
        synthesise(motion, weight, PULSES[0], GATE_S, 1e-6, "series")
    rows = ScattererRows(np.zeros(len(tau), dtype=np.int64), tau, weight, g[None], motion.amplitude_s[None])
    with pytest.raises(ValueError, match=f"series holds up to {MAX_ANGLE_RAD} rad"):
        series(rows, PULSES[0], GATE_S, 1e-6, np.empty((1, len(CYCLE), len(GATE_S))))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-1e-6, 1e-6), st.floats(0.01, 1.0), st.floats(-1.0, 1.0)), min_size=1, max_size=8),
    st.floats(0.02, 2.0),
    st.floats(0.0, 19e-9),
    st.integers(1, 60),
)
def test_series_equals_the_exact_sum_for_any_few_scatterers(scatterers, bandwidth, reach_s, samples):
    tau, weight, g = (np.array(column) for column in zip(*sorted(scatterers), strict=True))
    time_s, pulse = (np.arange(samples) - 7) * 1e-8, hann_pulse(9.0e6, bandwidth)
    motion = EchoDelays(tau, g[None], reach_s * CYCLE[:20, None])
    ours = synthesise(motion, weight, pulse, time_s, 1e-13, "series").echo
    exact = running_sum(motion.delay_s(), weight, pulse, time_s)
    # Absolute, against the strongest echo these scatterers can make: 1e-13 asked, 3 rad of series cost a digit.
    assert np.abs(ours - exact).max() <= 3e-12 * weight.sum()


def test_travelling_wave_of_one_frequency_is_two_shapes_and_needs_no_exact_sum():
    tau, weight, g = scene(3)
    # A shear wave along x is a phase per scatterer; here along depth, 3 mm long.
    field_m = 1e-6 * g * np.exp(-2j * np.pi * tau * SOUND_SPEED / 2 / 3e-3)
    time_s = np.arange(60) / 4000.0
    angle = 2 * np.pi * 200.0 * time_s
    amplitude_s = 2 / SOUND_SPEED * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    motion = EchoDelays(tau, np.stack([field_m.real, field_m.imag]), amplitude_s)
    displacement_m = (field_m * np.exp(2j * np.pi * 200.0 * time_s)[:, None]).real
    assert motion.delay_s() == pytest.approx(tau + 2 * displacement_m / SOUND_SPEED, abs=1e-20)
    synthesis = synthesise(motion, weight, PULSES[0], GATE_S, 1e-8)
    assert synthesis.method == "series"
    assert rms_error(synthesis.echo, running_sum(motion.delay_s(), weight, PULSES[0], GATE_S)) < 1e-8


def test_an_offset_of_the_motion_costs_no_terms():
    tau, weight, g = scene(4)
    shifted_s = 2 / SOUND_SPEED * (1e-4 + 1e-6 * CYCLE[:, None])
    synthesis = synthesise(EchoDelays(tau, g[None], shifted_s), weight, PULSES[0], GATE_S, 1e-9)
    centred = synthesise(EchoDelays(tau, g[None], shifted_s - shifted_s.mean()), weight, PULSES[0], GATE_S, 1e-9)
    assert (synthesis.method, synthesis.terms) == ("series", centred.terms)
    exact = running_sum(tau + shifted_s @ g[None], weight, PULSES[0], GATE_S)
    assert rms_error(synthesis.echo, exact) < 1e-9


def test_scatterers_in_any_order_give_the_same_echoes():
    tau, weight, g = scene(5)
    shuffled = np.random.default_rng(0).permutation(len(tau))
    amplitude_s = 2e-6 / SOUND_SPEED * CYCLE[:, None]
    sorted_echo = synthesise(EchoDelays(tau, g[None], amplitude_s), weight, PULSES[0], GATE_S, 1e-13).echo
    ours = synthesise(
        EchoDelays(tau[shuffled], g[None, shuffled], amplitude_s), weight[shuffled], PULSES[0], GATE_S, 1e-13
    )
    # The order of summation differs: rounding alone.
    assert rms_error(ours.echo, sorted_echo) < 1e-13


def test_terms_left_out_add_up_to_less_than_the_tolerance():
    for angle in (0.01, 0.5, 3.0):
        for tolerance in (1e-3, 1e-12):
            tail = [angle**order / math.factorial(order) for order in range(len(series_terms((angle,), tolerance)), 80)]
            assert sum(tail) < tolerance


def test_terms_of_equal_shapes_fill_a_triangle_and_of_a_weak_shape_a_strip():
    # Terms of 0.1^|a| / a!, above a quarter of the tolerance.
    assert series_terms((0.1, 0.1), 0.008) == ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))
    assert series_terms((0.1, 1e-3), 0.002) == ((0, 0), (0, 1), (1, 0), (2, 0))


def test_terms_have_no_gaps_and_none_repeats():
    for angles in [(3.0,), (0.5, 0.2, 1e-3), (2.0, 0.9), (0.1,) * 5]:
        terms = series_terms(angles, 1e-6)
        assert len(set(terms)) == len(terms)
        assert list(map(sum, terms)) == sorted(map(sum, terms))
        for powers in terms:
            lower = [
                tuple(power - (place == axis) for place, power in enumerate(powers)) for axis in range(len(powers))
            ]
            assert all(min(one) < 0 or one in terms for one in lower)


def test_too_many_terms_and_too_large_a_motion_have_no_series():
    assert series_terms((MAX_ANGLE_RAD + 0.1,), 1e-3) is None
    assert len(series_terms((0.1,) * 6, 1e-6)) <= MAX_TERMS
    assert series_terms((0.1,) * 10, 1e-10) is None


@pytest.mark.parametrize("shapes", [4, 10, 40])
def test_motion_of_many_shapes_meets_the_tolerance_by_the_faster_method(shapes):
    """40 shapes and 6 orders would be 1.2 million monomials."""
    tau, weight, g = scene(6)
    rng = np.random.default_rng(6)
    shape = g * rng.standard_normal((shapes, len(g))) / np.sqrt(shapes)
    motion = EchoDelays(tau, shape, 2e-7 / SOUND_SPEED * rng.standard_normal((30, shapes)))
    exact = running_sum(motion.delay_s(), weight, PULSES[0], GATE_S)
    for tolerance in (1e-3, 1e-10):
        assert rms_error(synthesise(motion, weight, PULSES[0], GATE_S, tolerance).echo, exact) < tolerance
    with pytest.raises(ValueError, match="too many shapes"):
        synthesise(
            EchoDelays(tau, np.repeat(shape, 10, axis=0), np.repeat(motion.amplitude_s, 10, axis=1)),
            weight,
            PULSES[0],
            GATE_S,
            1e-10,
            "series",
        )


def test_samples_that_many_ends_cross_are_corrected_in_bounded_memory():
    """5000 scatterers whose ends cross up to 150 samples each are a million pairs, 50 bytes each and more."""
    rng = np.random.default_rng(7)
    tau, weight, g = np.sort(rng.uniform(-1.5e-6, 1.5e-6, 5000)), rng.standard_normal(5000), rng.random(5000)
    time_s = (np.arange(2600) - 1300) / 2e9
    motion = EchoDelays(tau, g[None], 6e-5 / SOUND_SPEED * np.array([[-1.0], [1.0]]))
    tracemalloc.start()
    synthesis = synthesise(motion, weight, PULSES[0], time_s, 1e-8, "series")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 40e6
    assert rms_error(synthesis.echo, running_sum(motion.delay_s(), weight, PULSES[0], time_s)) < 1e-8


def test_blocks_cover_the_gate_without_overlap_and_are_no_longer_than_the_pulse():
    for pulse in PULSES:
        slices = blocks(GATE_S, pulse)
        assert [part.start for part in slices[1:]] == [part.stop for part in slices[:-1]]
        assert (slices[0].start, slices[-1].stop) == (0, 130)
        assert all(np.ptp(GATE_S[part]) <= pulse.end_s - pulse.start_s for part in slices)
