"""The Kalman filter: the covariance form as its oracle, background states, innovations, extreme ratios and lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from hpe_rig.processing import Motion, kalman, least_squares
from hpe_rig.processing.harmonics.kalman_filter import filter_states
from hpe_rig.processing.harmonics.model import harmonic_columns, linear_model

FloatArray = NDArray[np.float64]
RATE_HZ = 4000.0


def _motion(
    displacement_m: FloatArray, noise_m: float = 0.0, valid: NDArray[np.bool_] | None = None, start_s: float = 0.0
) -> Motion:
    pulses = displacement_m.shape[-1]
    time_s = start_s + np.arange(pulses) / RATE_HZ
    flags = np.ones(pulses, dtype=bool) if valid is None else valid
    return Motion(time_s, displacement_m, np.full(displacement_m.shape, noise_m**2), flags)


def _wave(pulses: int, amplitude_m: float = 1e-6, frequency_hz: float = 200.0, phase_rad: float = 0.4) -> FloatArray:
    return np.asarray(amplitude_m * np.sin(2 * np.pi * frequency_hz * np.arange(pulses) / RATE_HZ + phase_rad))


def _covariance_form(
    matrix: FloatArray, data: FloatArray, prior: float, change_sd: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return state, covariance and normalised innovations by the textbook recursion of the covariance."""
    state, covariance, innovations = np.zeros(matrix.shape[1]), prior * np.eye(matrix.shape[1]), []
    for k, (row, value) in enumerate(zip(matrix, data, strict=True)):
        if change_sd is not None and k:
            covariance = covariance + np.diag(change_sd[k] ** 2)
        variance = 1 + row @ covariance @ row
        gain = covariance @ row / variance
        innovation = value - row @ state
        state = state + gain * innovation
        covariance = covariance - np.outer(gain, row @ covariance)
        innovations.append(innovation / np.sqrt(variance))
    return state, covariance, np.array(innovations)


def test_potters_form_gives_the_states_covariance_and_innovations_of_the_covariance_form() -> None:
    generator = np.random.default_rng(65)
    columns = harmonic_columns(np.arange(65) / RATE_HZ, np.array([200.0, 730.0]))
    matrix = np.hstack([columns, np.ones((65, 1))])
    data, change_sd = generator.standard_normal((3, 65)), np.zeros((65, 5))
    change_sd[:, :4] = 0.1
    for changes in (None, change_sd):
        filtered = filter_states(matrix, data, np.full(5, 1e2), changes)
        for index in range(3):
            state, covariance, innovations = _covariance_form(matrix, data[index], 1e4, changes)
            # the covariance form loses digits to the prior: 1e4 times 1e-16, some hundred updates
            np.testing.assert_allclose(filtered.state[index], state, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(filtered.root @ filtered.root.T, covariance, rtol=1e-7, atol=1e-9)
            np.testing.assert_allclose(filtered.innovations[index], innovations, atol=1e-8)


@pytest.mark.parametrize("ratio", [1e-15, 1e-8, 1.0, 1e8, 1e15])
@pytest.mark.parametrize("process_noise", [0.0, 1e-6])
def test_covariance_is_symmetric_positive_and_finite_for_any_prior(ratio: float, process_noise: float) -> None:
    data = _wave(300) + 1e-7 * np.random.default_rng(3).standard_normal(300)
    fit = kalman(_motion(data), [200.0, 400.0], prior=ratio, process_noise=process_noise)
    np.testing.assert_array_equal(fit.state_covariance, fit.state_covariance.T)
    eigenvalues = np.linalg.eigvalsh(fit.state_covariance)
    assert (eigenvalues > 0).all()
    assert np.isfinite(fit.covariance).all()


def test_a_huge_prior_gives_least_squares_to_1e9_of_the_noise() -> None:
    motion = _motion(_wave(300) + 3e-6 + 1e-7 * np.random.default_rng(4).standard_normal((4, 300)))
    filtered, fitted = kalman(motion, [200.0, 330.0], prior=1e12), least_squares(motion, [200.0, 330.0])
    # rounding: 1e-16 times the prior's standard deviation, 1e6 times the noise of a pulse
    np.testing.assert_allclose(filtered.state, fitted.state, rtol=1e-9, atol=1e-9 * 1e-7)
    scale = np.sqrt(np.diagonal(fitted.covariance, axis1=-2, axis2=-1))
    scale = scale[..., :, None] * scale[..., None, :]
    np.testing.assert_allclose(filtered.covariance / scale, fitted.covariance / scale, rtol=0, atol=1e-9)
    q, r = np.linalg.qr(linear_model(motion.time_s, motion.valid, np.array([200.0, 330.0])).matrix)
    np.testing.assert_allclose(
        filtered.state, np.linalg.solve(r, q.T @ motion.displacement_m.T).T, rtol=1e-9, atol=1e-9 * 1e-7
    )


@given(turn=st.floats(-3, 3), gain=st.floats(1e-6, 1e3), lift=st.floats(-1e-3, 1e-3), frequency_hz=st.floats(80, 1900))
@settings(max_examples=10, deadline=None)
def test_shift_scale_constant_and_conjugation_turn_the_phasor_as_they_must(
    turn: float, gain: float, lift: float, frequency_hz: float
) -> None:
    time_s = np.arange(301) / RATE_HZ
    data = _wave(301, 1e-6, frequency_hz) + 1e-7 * np.random.default_rng(13).standard_normal(301)
    motion = _motion(data)
    for method in (least_squares, kalman):
        plain = method(motion, [frequency_hz])
        changed = method(
            replace(motion, time_s=time_s + turn * 1e-3, displacement_m=gain * (data + lift)), [frequency_hz]
        )
        mirrored = method(replace(motion, time_s=-time_s[::-1], displacement_m=data[::-1]), [frequency_hz])
        phasor = plain.amplitude_m[0] * np.exp(1j * plain.phase_rad[0])
        late = changed.amplitude_m[0] * np.exp(1j * (changed.phase_rad[0] + 2 * np.pi * frequency_hz * turn * 1e-3))
        # a prior of 1e10 pulls by 1e-10 of the constant, up to 1e-3 m; times known to 1e-16 s
        assert abs(late / gain - phasor) < 1e-9 * abs(phasor) + 1e-12 * abs(lift)
        # sin(-w t + phi) is sin(w t + pi - phi): the phasor at -f is the conjugate one, in the sine's own sign
        back = mirrored.amplitude_m[0] * np.exp(1j * mirrored.phase_rad[0])
        assert abs(back + np.conj(phasor)) < 1e-9 * abs(phasor)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_background_states_take_up_constant_velocity_and_acceleration(order: int) -> None:
    time_s = np.arange(400) / RATE_HZ
    background = [5e-6 + 0 * time_s, 1e-3 * time_s, 0.5 * time_s**2][order]
    fit = kalman(_motion(_wave(400, 1e-7) + background), [200.0], background_order=order)
    # the prior of 1e10 pulls by 1e-10 of the background, 5 mm at most
    assert fit.amplitude_m[0] == pytest.approx(1e-7, rel=1e-4)
    assert fit.phase_rad[0] == pytest.approx(0.4, abs=1e-4)


def test_innovations_correlate_if_the_model_is_incomplete() -> None:
    generator = np.random.default_rng(7)
    good = _motion(_wave(400) + 1e-7 * generator.standard_normal((50, 400)), 1e-7)
    complete = kalman(good, [200.0]).quality.innovation_correlation
    assert complete is not None
    # 50 x 397 degrees of freedom
    assert np.abs(complete[0].mean()) < 3 / np.sqrt(50 * 397)
    assert (np.abs(complete[0]) < complete[1]).all()
    fit = kalman(_motion(good.displacement_m + _wave(400, 5e-7, 300.0), 1e-7), [200.0])
    assert fit.quality.innovation_correlation is not None
    assert (fit.quality.innovation_correlation[0] > 0.5).all()


def test_skipped_pulses_leave_the_filter_as_if_they_had_never_been_there() -> None:
    valid = np.random.default_rng(9).random(400) > 0.3
    data = np.where(valid, _wave(400), np.nan)
    for noise in (0.0, 1e-9):
        fit = kalman(_motion(data, valid=valid), [200.0], process_noise=noise)
        assert fit.amplitude_m[0] == pytest.approx(1e-6, rel=1e-6)
        assert fit.quality.pulses == int(valid.sum())


def test_close_frequencies_are_refused_with_the_condition_or_fitted_with_honest_uncertainty() -> None:
    generator = np.random.default_rng(10)
    time_s = np.arange(800) / RATE_HZ
    truth = 1e-6 * np.sin(2 * np.pi * 200 * time_s + 0.4) + 5e-7 * np.sin(2 * np.pi * 200.1 * time_s - 1)
    motion = _motion(truth + 1e-9 * generator.standard_normal((1000, 800)))
    with pytest.raises(ValueError, match=r"condition \d+"):
        least_squares(motion, [200.0, 200.05])
    fit = least_squares(motion, [200.0, 200.1])
    assert 20 < fit.quality.condition < 100
    known = np.array([np.cos(0.4), np.sin(0.4), 0.5 * np.cos(-1), 0.5 * np.sin(-1)]) * 1e-6
    error = (fit.state[:, :4] - known) / np.sqrt(np.diagonal(fit.state_covariance, axis1=-2, axis2=-1)[:, :4])
    # 1000 draws, the four states strongly correlated: sqrt(2 / 1000), three of these
    np.testing.assert_allclose(np.mean(error**2, axis=0), 1, atol=0.135)


@pytest.mark.parametrize(("points", "cycles"), [(2.5, 40), (5, 1), (5, 1000), (30, 3), (1000, 1), (20, 20), (20, 0.5)])
def test_few_and_many_points_and_cycles_are_recovered(points: float, cycles: float) -> None:
    frequency_hz = RATE_HZ / points
    pulses = round(points * cycles)
    motion = _motion(_wave(pulses, 1e-6, frequency_hz) + 1e-6)
    fit = least_squares(motion, [frequency_hz])
    assert fit.amplitude_m[0] == pytest.approx(1e-6, rel=1e-9)
    # a half cycle looks much like a constant: the condition says so
    assert (fit.quality.condition > 4) == (cycles < 1)


def test_two_points_a_cycle_are_refused_because_one_quadrature_is_not_measured() -> None:
    with pytest.raises(ValueError, match="only one of its two quadratures"):
        least_squares(_motion(_wave(100, 1e-6, 2000.0)), [2000.0])


def test_reversed_time_conjugates_the_phasor() -> None:
    generator = np.random.default_rng(11)
    data = _wave(401, 1e-6, 200.0) + 1e-7 * generator.standard_normal(401)
    forward = least_squares(_motion(data, start_s=-0.05), [200.0])
    backward = least_squares(_motion(data[::-1].copy(), start_s=-0.05), [200.0])
    # A sin(phi - w t) = A sin(w t + pi - phi): in-phase changes sign, quadrature stays
    np.testing.assert_allclose(backward.state[0], -forward.state[0], rtol=1e-9)
    np.testing.assert_allclose(backward.state[1], forward.state[1], rtol=1e-9)


def test_a_constant_added_goes_to_the_background_alone() -> None:
    data = _wave(400) + 1e-8 * np.random.default_rng(12).standard_normal(400)
    plain, lifted = (least_squares(_motion(data + constant), [200.0, 350.0]) for constant in (0.0, 1e-4))
    np.testing.assert_allclose(lifted.amplitude_m, plain.amplitude_m, rtol=1e-9)
    assert lifted.state[4] - plain.state[4] == pytest.approx(1e-4, rel=1e-9, abs=0)
