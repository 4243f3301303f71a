"""The echo of moving scatterers: every evaluation against the double sum as written."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.exact_sums import direct_sum, running_sum
from sim_backend.echoes.many_draws import drawn_echoes
from sim_backend.echoes.pulse import Pulse, attenuated, hann_pulse, rectangular_burst, waveform
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.settings import Beams, Scatterers, SimulationSettings

SOUND_SPEED = 1540.0
GATE_S = (np.arange(130) - 64.5) * 1e-8
CYCLE = np.sin(2 * np.pi * np.arange(101) / 20)


def scene(seed=0, axial_delay="two_way"):
    field = draw_field(Scatterers(), Beams(), np.random.default_rng(seed))
    return depth_delay_s(field, axial_delay, SOUND_SPEED), field.tracking_weight, field.motion_weight


def delays(tau, motion_weight, displacement_m):
    return tau + 2 * np.outer(displacement_m, motion_weight) / SOUND_SPEED


def rms_error(ours, expected):
    return np.sqrt(np.mean((ours - expected) ** 2) / np.mean(expected**2))


def peak_error(ours, expected):
    return np.abs(ours - expected).max() / np.abs(expected).max()


def test_hann_pulse_is_eq_9_times_the_carrier():
    pulse = hann_pulse(9.0e6, 0.065)
    time_s = np.linspace(-1e-6, 1e-6, 4001)
    window = 0.5 + 0.5 * np.cos(0.065 * 2 * np.pi * 9.0e6 * time_s)
    expected = np.where(np.abs(time_s) <= 0.5 / (0.065 * 9.0e6), window * np.cos(2 * np.pi * 9.0e6 * time_s), 0.0)
    assert waveform(pulse, time_s) == pytest.approx(expected, abs=1e-13)
    assert pulse.end_s - pulse.start_s == pytest.approx(1.709e-6, rel=1e-3)


def test_rectangular_burst_is_a_sine_while_it_lasts():
    pulse = rectangular_burst(3.0e6, 1e-6)
    time_s = np.array([-1e-9, 0.0, 0.25 / 3.0e6, 0.9e-6, 1.001e-6])
    assert waveform(pulse, time_s) == pytest.approx([0.0, 0.0, 1.0, np.sin(2 * np.pi * 3.0e6 * 0.9e-6), 0.0], abs=1e-14)


@pytest.mark.parametrize("axial_delay", ["two_way", "none"])
@pytest.mark.parametrize(
    "pulse",
    [
        hann_pulse(9.0e6, 0.065),
        pytest.param(hann_pulse(9.0e6, 0.75), marks=pytest.mark.slow),
        rectangular_burst(3.0e6, 1e-6),
    ],
)
def test_running_sum_equals_direct_sum(pulse, axial_delay):
    tau, weight, motion_weight = scene(1, axial_delay)
    delay_s = delays(tau, motion_weight, 1e-6 * CYCLE[:10])
    gate_s = GATE_S if axial_delay == "two_way" else np.arange(-100, 101) * 1e-8 + 3e-10
    # Rounding: phases below 300 rad, eps 2e-16 each, some 1000 terms added at random.
    assert peak_error(running_sum(delay_s, weight, pulse, gate_s), direct_sum(delay_s, weight, pulse, gate_s)) < 1e-12


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-3e-6, 3e-6), st.floats(0.0, 1.0)), min_size=1, max_size=12),
    st.floats(0.02, 2.0),
    st.integers(1, 60),
)
def test_running_sum_equals_direct_sum_for_any_few_scatterers(scatterers, bandwidth, samples):
    tau, weight = (np.array(column) for column in zip(*scatterers, strict=True))
    time_s = (np.arange(samples) - 7) * 1e-8
    pulse = hann_pulse(9.0e6, bandwidth)
    ours = running_sum(tau[None], weight, pulse, time_s)
    # Absolute, against the strongest echo these scatterers can make.
    assert np.abs(ours - direct_sum(tau[None], weight, pulse, time_s)).max() <= 1e-12 * max(weight.sum(), 1e-300)


def test_running_sum_over_many_echoes_equals_each_alone():
    tau, weight, motion_weight = scene(2)
    delay_s = delays(tau, motion_weight, 1e-6 * np.sin(np.arange(700)))
    together = running_sum(delay_s, weight, hann_pulse(9.0e6, 0.065), GATE_S)
    for echo in (0, 328, 329, 330, 699):
        alone = running_sum(delay_s[echo : echo + 1], weight, hann_pulse(9.0e6, 0.065), GATE_S)
        assert np.array_equal(together[echo], alone[0])


def test_moved_scatterer_echoes_later_by_the_two_way_delay():
    pulse = hann_pulse(9.0e6, 0.065)
    delays = EchoDelays.of_motion(np.array([2e-7]), np.array([0.5]), np.array([3e-6]), SOUND_SPEED)
    ours = synthesise(delays, np.array([0.7]), pulse, GATE_S).echo
    expected = 0.7 * waveform(pulse, GATE_S - 2e-7 - 2 * 0.5 * 3e-6 / SOUND_SPEED)
    assert ours[0] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    "bandwidth",
    [
        0.065,
        pytest.param(0.4, marks=pytest.mark.slow),
        pytest.param(0.75, marks=pytest.mark.slow),
        pytest.param(2.0, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("axial_delay", ["two_way", "none"])
def test_echoes_meet_their_tolerance(bandwidth, axial_delay):
    pulse = hann_pulse(9.0e6, bandwidth)
    for seed, amplitude_m in enumerate([1e-15, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4]):
        tau, weight, motion_weight = scene(seed, axial_delay)
        motion = EchoDelays.of_motion(tau, motion_weight, amplitude_m * CYCLE[:20], SOUND_SPEED)
        exact = running_sum(motion.delay_s(), weight, pulse, GATE_S)
        for tolerance in (1e-3, 1e-6, 1e-9):
            assert rms_error(synthesise(motion, weight, pulse, GATE_S, tolerance).echo, exact) < tolerance


def test_tolerance_zero_gives_the_exact_sum():
    tau, weight, motion_weight = scene(4)
    pulse = hann_pulse(9.0e6, 0.065)
    motion = EchoDelays.of_motion(tau, motion_weight, 1e-6 * CYCLE, SOUND_SPEED)
    ours = synthesise(motion, weight, pulse, GATE_S, 0.0).echo
    exact = running_sum(delays(tau, motion_weight, 1e-6 * CYCLE), weight, pulse, GATE_S)
    # The two differ in the order in which 2 A g / c is rounded.
    assert peak_error(ours, exact) < 1e-13


@pytest.mark.parametrize("bandwidth", [0.065, 0.3, 0.75])
def test_pulses_whose_ends_step_by_attenuation_meet_the_tolerance(bandwidth):
    """126 dB at the carrier, and steps at the ends: what counts is their size against the weakened pulse's."""
    whole = hann_pulse(9.0e6, bandwidth)
    pulse = attenuated(whole, [14e-6 * hz for hz in whole.frequency_hz])
    tau, weight, g = (part[::5] for part in scene(3))
    motion = EchoDelays(tau, g[None], 2e-5 / SOUND_SPEED * np.sin(2 * np.pi * np.arange(200)[:, None] / 20.3))
    exact = running_sum(motion.delay_s(), weight, pulse, GATE_S)
    for tolerance in (1e-2, 1e-4, 1e-6):
        assert rms_error(synthesise(motion, weight, pulse, GATE_S, tolerance).echo, exact) < tolerance


def test_shift_moves_the_sample_times_of_each_echo():
    tau, weight, motion_weight = scene(5)
    pulse, shift_s = hann_pulse(9.0e6, 0.065), np.array([0.0, 3.3e-9, -7e-9])
    displacement_m = np.array([0.0, 1e-6, -1e-6])
    motion = EchoDelays.of_motion(tau, motion_weight, displacement_m, SOUND_SPEED).shifted(shift_s)
    ours, exact = (synthesise(motion, weight, pulse, GATE_S, tolerance).echo for tolerance in (1e-13, 0.0))
    for echo in range(3):
        # The two differ in the order in which shift and motion are rounded.
        assert peak_error(ours[echo], exact[echo]) < 1e-12
        delay_s = delays(tau, motion_weight, displacement_m[echo : echo + 1])
        assert peak_error(ours[echo], direct_sum(delay_s, weight, pulse, GATE_S + shift_s[echo])[0]) < 1e-12


def test_echoes_without_scatterers_or_echoes_are_empty_sums():
    nothing, pulse = np.zeros(0), hann_pulse(9.0e6, 0.065)
    without_scatterers = EchoDelays.of_motion(nothing, nothing, np.zeros(3), SOUND_SPEED)
    assert (synthesise(without_scatterers, nothing, pulse, GATE_S).echo == np.zeros((3, 130))).all()
    without_echoes = EchoDelays.of_motion(np.zeros(1), np.ones(1), nothing, SOUND_SPEED)
    assert synthesise(without_echoes, np.ones(1), pulse, GATE_S).echo.shape == (0, 130)


def test_scatterers_that_cannot_reach_the_gate_add_exactly_nothing():
    tau = np.array([-5e-6, 5e-6])
    motion = EchoDelays.of_motion(tau, np.ones(2), np.zeros(2), SOUND_SPEED)
    ours = synthesise(motion, np.ones(2), hann_pulse(9.0e6, 0.065), GATE_S).echo
    assert (ours == 0.0).all()


def test_a_pulse_may_be_any_sum_of_exponentials():
    pulse = Pulse(-2e-7, 3e-7, (5.0e6, 9.0e6), (0.3 + 0.1j, -0.2j))
    tau, weight, _ = scene(6)
    ours = running_sum(tau[None], weight, pulse, GATE_S)
    assert peak_error(ours, direct_sum(tau[None], weight, pulse, GATE_S)) < 1e-12


def test_mean_echo_power_is_density_times_the_integral_of_squared_weight_and_pulse():
    """E r^2 = n int I^2 dx dy dz <p^2>-average over depth: closed form where the box is wide against beam and pulse."""
    draws, centre_s, pulse = 1500, GATE_S[[64]], hann_pulse(9.0e6, 0.065)
    draws_of_echoes = drawn_echoes(SimulationSettings(), np.zeros(1), pulse, centre_s, np.random.default_rng(7), draws)
    power = np.square(np.concatenate(list(draws_of_echoes))).mean()
    density = 1593 / 5e-9
    tx, ty, tz = Beams().tracking_width_m
    z = np.linspace(-2.5e-3, 2.5e-3, 200_001)
    axial = np.sum(np.exp(-(z**2) / tz**2) * waveform(pulse, centre_s - 2 * z / SOUND_SPEED) ** 2) * (z[1] - z[0])
    expected = density * np.pi * tx * ty * axial
    # Power of speckle at one instant is chi-square with one degree of freedom: relative sd sqrt(2 / draws); 4 of them.
    assert power == pytest.approx(expected, rel=4 * np.sqrt(2 / draws))
