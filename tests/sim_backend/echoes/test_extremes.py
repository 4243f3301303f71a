"""Stiff and extreme scenes: each with its bound, against the direct sum or 30 digits."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.exact_sums import direct_sum, running_sum
from sim_backend.echoes.pulse import Pulse, gaussian_pulse, hann_pulse
from sim_backend.echoes.scatterers import depth_delay_s, draw_field, field_at
from sim_backend.settings import Beams, Scatterers

SOUND_SPEED = 1540.0
GATE_S = (np.arange(130) - 64.5) * 1e-8
CYCLE = np.sin(2 * np.pi * np.arange(21) / 20)
HANN = hann_pulse(9.0e6, 0.065)
STEP = Pulse(0.0, 1e-6, (9.0e6,), (1.0,))


def scene(seed=0, beams=None):
    field = draw_field(Scatterers(), beams or Beams(), np.random.default_rng(seed))
    return depth_delay_s(field, "two_way", SOUND_SPEED), field.tracking_weight, field.motion_weight


def moving(tau, g, amplitude_m, cycle=CYCLE):
    return EchoDelays(tau, g[None], 2 / SOUND_SPEED * amplitude_m * cycle[:, None])


def resting(tau):
    """Two echoes of scatterers that stand still."""
    return EchoDelays(tau, np.ones((1, len(tau))), np.zeros((2, 1)))


def rms_error(ours, expected):
    return np.sqrt(np.mean((ours - expected) ** 2) / np.mean(expected**2))


def hann_to_30_digits(time_s, delay_s, bandwidth=0.065):
    """Eq. (9) times the carrier at the doubles given, evaluated with 30 digits."""
    with mpmath.workdps(30):
        t, w = mpmath.mpf(float(time_s)) - delay_s, 2 * mpmath.pi * 9_000_000
        if abs(t) >= 1 / (2 * mpmath.mpf(bandwidth) * 9_000_000):
            return 0.0
        return float((1 + mpmath.cos(bandwidth * w * t)) / 2 * mpmath.cos(w * t))


@pytest.mark.parametrize("amplitude_m", 10.0 ** np.arange(-15, -2))
def test_every_displacement_from_a_femtometre_to_a_millimetre_meets_the_default_tolerance(amplitude_m):
    tau, weight, g = scene(1)
    motion = moving(tau, g, amplitude_m)
    synthesis = synthesise(motion, weight, HANN, GATE_S)
    assert rms_error(synthesis.echo, running_sum(motion.delay_s(), weight, HANN, GATE_S)) < 1e-6


def test_a_femtometre_agrees_with_30_digits():
    """d r / d u = 2 w / c = 7e4 per m: a fm changes the echo by 7e-11, rounding by 1e-15."""
    motion = moving(np.array([1e-7]), np.ones(1), 1e-15, np.array([-1.0, 1.0]))
    change = np.diff(synthesise(motion, np.ones(1), HANN, GATE_S, 1e-14).echo, axis=0)[0]
    delay = [mpmath.mpf(1e-7) + sign * 2 * mpmath.mpf(1e-15) / 1540 for sign in (-1, 1)]
    with mpmath.workdps(30):
        expected = np.array([hann_to_30_digits(t, delay[1]) - hann_to_30_digits(t, delay[0]) for t in GATE_S])
    assert np.abs(change - expected).max() < 1e-14


def direct_at(delay_s, weight, time_s):
    """The direct sum at a few times, each over the scatterers (ascending in delay) whose support can hold it."""
    out = np.empty((len(delay_s), len(time_s)))
    for position, at_s in enumerate(time_s):
        near = (delay_s.min(axis=0) <= at_s - HANN.start_s + 1e-9) & (delay_s.max(axis=0) >= at_s - HANN.end_s - 1e-9)
        out[:, position] = direct_sum(delay_s[:, near], weight[near], HANN, time_s[[position]])[:, 0]
    return out


@pytest.mark.parametrize("make", [hann_pulse, pytest.param(gaussian_pulse, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "bandwidth", [0.001, *(pytest.param(each, marks=pytest.mark.slow) for each in (0.01, 0.1, 1.0)), 2.0]
)
def test_every_bandwidth_from_a_thousandth_to_two(make, bandwidth):
    tau, weight, g = (part[::4] for part in scene(2))
    pulse, motion = make(9.0e6, bandwidth), moving(tau, g, 1e-6, CYCLE[:3])
    gate_s = GATE_S if bandwidth < 1 else np.arange(-100, 100) * 2e-9
    exact = direct_sum(motion.delay_s(), weight, pulse, gate_s)
    # Phases reach 2 pi 9 MHz * 55 us = 3000 rad at the narrowest: eps times that.
    assert rms_error(running_sum(motion.delay_s(), weight, pulse, gate_s), exact) < 1e-12
    assert rms_error(synthesise(motion, weight, pulse, gate_s, 1e-9).echo, exact) < 1e-9


def test_no_scatterers_are_silent_and_one_is_the_pulse_to_30_digits():
    nothing = synthesise(moving(np.zeros(0), np.zeros(0), 1e-6), np.zeros(0), HANN, GATE_S)
    assert nothing.echo.shape == (21, 130)
    assert not nothing.echo.any()
    one = synthesise(resting(np.array([3.3e-8])), np.ones(1), HANN, GATE_S)
    expected = [hann_to_30_digits(time_s, mpmath.mpf(3.3e-8)) for time_s in GATE_S]
    assert np.abs(one.echo[0] - expected).max() < 1e-13


@pytest.mark.slow
def test_a_million_scatterers_by_series_running_sum_and_direct_sum():
    rng = np.random.default_rng(4)
    tau, weight, g = np.sort(rng.uniform(-3e-6, 3e-6, 1_000_000)), rng.standard_normal(1_000_000), rng.random(1_000_000)
    motion = moving(tau, g, 1e-6, CYCLE[:2])
    exact = running_sum(motion.delay_s(), weight, HANN, GATE_S)
    assert rms_error(synthesise(motion, weight, HANN, GATE_S, 1e-13, "series").echo, exact) < 1e-12
    some = GATE_S[[0, 64]]
    plain = direct_sum(motion.delay_s()[:1], weight, HANN, some)
    assert np.abs(exact[0, [0, 64]] - plain).max() < 1e-12 * np.sqrt(np.mean(exact**2))


def test_all_scatterers_at_one_point_are_one_of_their_summed_weight():
    weight = np.random.default_rng(5).random(1000)
    motion = moving(np.full(1000, 1.2e-7), np.full(1000, 0.8), 1e-6)
    ours = synthesise(motion, weight, HANN, GATE_S, 1e-12)
    one = direct_sum(motion.delay_s()[:, :1], weight[:1] / weight[0] * weight.sum(), HANN, GATE_S)
    assert rms_error(ours.echo, one) < 1e-12


def test_the_direct_sum_gives_a_support_end_on_a_sample_to_the_start_too():
    time_s = np.arange(-8, 120) * 2.0**-27
    echo = direct_sum(time_s[[[8]]], np.ones(1), Pulse(0.0, 2.0**-21, (9.0e6,), (1.0,)), time_s)[0]
    assert (np.flatnonzero(echo)[0], np.flatnonzero(echo)[-1]) == (8, 71)


@pytest.mark.parametrize("method", ["running_sum", "series"])
def test_a_support_end_exactly_on_a_sample_belongs_to_the_start_and_not_to_the_end(method):
    time_s = np.arange(-8, 120) * 2.0**-27
    motion = EchoDelays(np.array([time_s[8], time_s[20]]), np.ones((1, 2)), np.zeros((2, 1)))
    pulse = Pulse(0.0, 2.0**-21, (9.0e6,), (1.0,))
    echo = synthesise(motion, np.array([1.0, 0.0]), pulse, time_s, 1e-9, method).echo[0]
    assert (echo[:8] == 0.0).all()
    assert echo[8] == pytest.approx(1.0, abs=1e-14)
    assert echo[8 + 63] != 0.0
    assert (echo[8 + 64 :] == 0.0).all()


def test_a_support_end_that_moves_onto_a_sample_steps_there():
    step_s = 2.0**-27
    time_s = np.arange(100) * step_s
    motion = EchoDelays(
        np.array([10.5 * step_s]), np.ones((1, 1)), np.array([[-0.5], [-0.5 - 2e-9], [0.0], [0.5]]) * step_s
    )
    echo = synthesise(motion, np.ones(1), STEP, time_s, 1e-12, "series").echo
    exact = running_sum(motion.delay_s(), np.ones(1), STEP, time_s)
    assert (np.argmax(echo != 0.0, axis=1)).tolist() == [10, 10, 11, 11]
    assert np.abs(echo - exact).max() < 1e-12


@pytest.mark.parametrize("samples", [1, 100_000])
def test_gates_of_one_sample_and_of_a_hundred_thousand(samples):
    rng = np.random.default_rng(6)
    time_s = (np.arange(samples) - samples // 2) * 1e-8
    tau = np.sort(rng.uniform(time_s[0] - 1e-6, time_s[-1] + 1e-6, max(500, samples // 5)))
    weight, g = rng.standard_normal(len(tau)), rng.random(len(tau))
    motion = moving(tau, g, 1e-6, CYCLE[:4])
    synthesis = synthesise(motion, weight, HANN, time_s, 1e-9)
    some = np.unique(np.linspace(0, samples - 1, 40).astype(int))
    assert rms_error(synthesis.echo[:, some], direct_at(motion.delay_s(), weight, time_s[some])) < 1e-9


def test_running_sum_does_not_cancel_however_long_the_gate():
    """Error against the direct sum, gate and scatterers growing 64 times: plain prefix sums pass 1e-12, blocks stay."""
    errors, plain = [], []
    for samples in (1_000, 8_000, 64_000):
        rng = np.random.default_rng(7)
        time_s = np.arange(samples) * 1e-8
        tau = np.sort(rng.uniform(time_s[0], time_s[-1], 10 * samples))
        weight = 1.0 + 1e3 * (tau < time_s[samples // 4])
        some = np.arange(samples // 2, samples, samples // 20)
        exact = direct_at(tau[None], weight, time_s[some])[0]
        scale = np.sqrt(np.mean(exact**2))
        errors.append(np.abs(running_sum(tau[None], weight, HANN, time_s)[0, some] - exact).max() / scale)
        plain.append(np.abs(prefix_sum(tau, weight, HANN, time_s)[some] - exact).max() / scale)
    assert max(errors) < 1e-12
    assert errors[-1] < 10 * errors[0]
    assert plain[-1] > 1e-12


def prefix_sum(tau, weight, pulse, time_s):
    """One running sum over the whole gate, adding at a support's start and subtracting at its end."""
    total = np.zeros(len(time_s))
    enter, leave = (np.searchsorted(time_s, tau + edge) for edge in (pulse.start_s, pulse.end_s))
    for hz, amplitude in zip(pulse.frequency_hz, pulse.amplitude, strict=True):
        value = weight * np.exp(-2j * np.pi * hz * tau)
        change = np.zeros(len(time_s) + 1, dtype=complex)
        np.add.at(change, enter, value)
        np.subtract.at(change, leave, value)
        total += (amplitude * np.exp(2j * np.pi * hz * time_s) * np.cumsum(change)[:-1]).real
    return total


def test_gate_far_from_the_focus_holds_tiny_weights_to_the_same_relative_error():
    """Weights below 1e-300 underflow in products; their echo is then 0 or right, never NaN."""
    tau, weight, g = scene(8)
    for scale in (1e-100, 1e-280, 1e-308):
        motion = moving(tau, g, 1e-6)
        with np.errstate(under="ignore"):
            synthesis = synthesise(motion, weight * scale, HANN, GATE_S, 1e-8)
        exact = running_sum(motion.delay_s(), weight, HANN, GATE_S)
        assert np.isfinite(synthesis.echo).all()
        # Subnormal numbers keep fewer digits: at 1e-308 a weight of 1e-6 has two.
        assert rms_error(synthesis.echo / scale, exact) < (1e-8 if scale > 1e-300 else 1e-3)
    silent = synthesise(moving(tau, g, 1e-6), weight, HANN, GATE_S + 1e-3)
    assert not silent.echo.any()


@pytest.mark.parametrize(("depth_m", "bound"), [(25e-3, 1e-8), (30e-3, 1e-8), (31.5e-3, 1e-3), (34e-3, 0.0)])
def test_gate_centimetres_from_the_focus_is_right_until_the_weights_of_eq_8_underflow(depth_m, bound):
    """exp(-z^2 / 2 T_z^2) is 1e-197 at 25 mm, 1e-284 at 30, subnormal (few digits) at 31.5 and 0 at 34."""
    rng = np.random.default_rng(12)
    position = rng.uniform(-0.5, 0.5, (300, 3)) * np.array([1e-4, 1e-4, 1e-3]) + np.array([0.0, 0.0, depth_m])
    field = field_at(position, Beams())
    tau, gate_s = depth_delay_s(field, "two_way", SOUND_SPEED), GATE_S + 2 * depth_m / SOUND_SPEED
    motion = moving(tau, np.ones(300), 1e-6)
    synthesis = synthesise(motion, field.tracking_weight, HANN, gate_s, 1e-8).echo
    exact = direct_sum(motion.delay_s(), field.tracking_weight, HANN, gate_s)
    # Scaled up, or the squares of the comparison underflow themselves.
    scale = np.abs(exact).max()
    assert (scale == 0.0) == (bound == 0.0)
    assert scale == 0.0 or rms_error(synthesis / scale, exact / scale) < bound
    assert scale > 0.0 or not synthesis.any()


@pytest.mark.parametrize("ratio", [1e-3, 1e-1, 2.19, 10.0, 1e3, np.inf])
def test_beam_ratios_from_a_thousandth_to_infinite(ratio):
    beams = Beams(width_ratio=(ratio, ratio, ratio))
    tau, weight, g = scene(9, beams)
    motion = moving(tau, g, 1e-6)
    synthesis = synthesise(motion, weight, HANN, GATE_S, 1e-9)
    assert rms_error(synthesis.echo, running_sum(motion.delay_s(), weight, HANN, GATE_S)) < 1e-9
    if np.isinf(ratio):
        assert (g == 1.0).all()
    if ratio == 1e-3:
        assert g.max() < 1e-3


def test_omitted_scatterers_stay_within_the_tolerance_even_if_the_strong_ones_cancel():
    """Two strong scatterers half a wavelength apart all but cancel: the rms the bound hoped for is not there."""
    rng = np.random.default_rng(11)
    # The same position with opposite weights: what is left is the weak ones alone.
    tau = np.concatenate([[1e-7, 1e-7], rng.uniform(-1e-6, 1e-6, 500)])
    weight = np.concatenate([[1.0, -1.0], 1e-12 * rng.standard_normal(500)])
    order = np.argsort(tau, kind="stable")
    motion = moving(tau[order], np.full(502, 0.5), 1e-7)
    synthesis = synthesise(motion, weight[order], HANN, GATE_S, 1e-6, "running_sum")
    assert synthesis.scatterers == 502
    usual = synthesise(moving(*scene()[::2], 1e-6), scene()[1], HANN, GATE_S, 1e-3)
    assert usual.scatterers < 600


@pytest.mark.parametrize("strength", [1e-6, 1.0, 1e6])
def test_scatterers_left_out_of_a_nearly_cancelling_scene_are_included_again(strength):
    """Two of weight 1 leave 1e-9 of each other; the 500 left out are up to 1e-4 of that, a hundred tolerances."""
    rng = np.random.default_rng(13)
    tau = np.concatenate([[1e-7, 1e-7], np.sort(rng.uniform(1e-7, 1e-6, 500))])
    weight = np.concatenate([[1.0, -1.0 + 1e-9], 2e-16 * rng.standard_normal(500)])
    pulse = replace(HANN, amplitude=tuple(strength * amplitude for amplitude in HANN.amplitude))
    synthesis = synthesise(resting(tau), weight, pulse, GATE_S, 1e-6)
    assert synthesis.scatterers == 502


@pytest.mark.parametrize("method", [None, "series"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize(("share", "rest"), [(1.0, 1e-6), (0.999, 1e-6), (0.999, 1e-9), (0.5, 1e-6), (0.0, 1e-3)])
def test_moving_scatterers_that_nearly_cancel_keep_the_tolerance_of_their_sum(method, tolerance, share, rest):
    """Two in one position, of weights 1 and -1 but for a rest, that move by 0.1 nm and by a share of that."""
    amplitude_s = 2 * 1e-10 / 1540 * np.sin(np.arange(400))[:, None]
    delays = EchoDelays(np.zeros(2), np.array([[1.0, share]]), amplitude_s)
    weight = np.array([1.0, -1.0 + rest])
    synthesis = synthesise(delays, weight, HANN, GATE_S, tolerance, method)
    exact = running_sum(delays.delay_s(), weight, HANN, GATE_S)
    size = np.sqrt(np.mean(exact**2))
    # Either sum rounds to some 1e-16 of the two before they cancel.
    assert np.sqrt(np.mean((synthesis.echo - exact) ** 2)) <= tolerance * size + 3e-15
