"""Displacement to amplitude and phase: recovery, agreement of the estimators, truth of covariances, refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri

from hpe_rig.processing import (
    HarmonicFit,
    Motion,
    kalman,
    least_squares,
    velocity_to_harmonics,
)
from hpe_rig.processing.harmonics import model as model_module
from hpe_rig.processing.harmonics.harmonic_fit import difference_noise_moments
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.harmonics.velocity_chain import LIKELIHOOD_GAIN, _residual_spectrum, velocity_noise
from hpe_rig.processing.motion.displacement import Velocity
from hpe_rig.result import PHASE_VARIANCE_LIMIT
from hpe_rig.result.interval import coverage_factor

FloatArray = NDArray[np.float64]

HARMONICS = [100.0 * n for n in range(1, 11)]
AMPLITUDES = np.array([900.0, 700, 520, 400, 310, 240, 190, 150, 110, 80]) * 1e-9
PHASES = np.linspace(-3, 3, 10)


def _motion(displacement_m: FloatArray, time_s: FloatArray, valid: NDArray[np.bool_] | None = None) -> Motion:
    flags = np.ones(time_s.size, dtype=bool) if valid is None else valid
    return Motion(time_s, np.where(flags, displacement_m, np.nan), np.zeros_like(displacement_m), flags)


def _sum_of_sines(time_s: FloatArray) -> FloatArray:
    return np.asarray(np.sin(2 * np.pi * np.outer(time_s, HARMONICS) + PHASES) @ AMPLITUDES)


def _velocity(displacement_m: FloatArray, rate_hz: float, valid: NDArray[np.bool_] | None = None) -> Velocity:
    count = displacement_m.shape[-1] - 1
    flags = np.ones(count, dtype=bool) if valid is None else valid
    velocity = np.where(flags, np.diff(displacement_m) * rate_hz, np.nan)
    return Velocity((np.arange(count) + 0.5) / rate_hz, np.full(count, 1 / rate_hz), velocity, flags)


@pytest.mark.parametrize("estimator", [least_squares, kalman])
def test_ten_harmonics_and_a_constant_are_recovered_at_once(estimator: object) -> None:
    assert callable(estimator)
    time_s = np.arange(400) / 4000
    fit: HarmonicFit = estimator(_motion(_sum_of_sines(time_s) + 5e-6, time_s), HARMONICS)
    # least squares is exact; the Kalman filter's prior of 1e10 pulls by 1e-10 of the constant and a rounding of 1e-7
    np.testing.assert_allclose(fit.amplitude_m, AMPLITUDES, rtol=1e-6)
    np.testing.assert_allclose(fit.phase_rad, PHASES, atol=1e-6)
    assert fit.state[2 * len(HARMONICS)] == pytest.approx(5e-6, rel=1e-9, abs=0)


def test_times_with_an_offset_of_1e5_s_lose_no_phase() -> None:
    time_s = 1e5 + np.arange(400) / 4096
    since_s = time_s - 1e5
    # 1e5 s is a whole number of periods of every multiple of 100 Hz and of 0.25 Hz
    fit = least_squares(_motion(3e-7 * np.sin(2 * np.pi * 733.25 * since_s + 0.7), time_s), [733.25])
    assert fit.phase_rad[0] == pytest.approx(0.7, abs=1e-10)


def test_kalman_without_process_noise_equals_least_squares_with_gaps() -> None:
    generator = np.random.default_rng(1)
    time_s = np.arange(300) / 4000
    valid = generator.random(300) > 0.2
    motion = _motion(_sum_of_sines(time_s) + 1e-8 * generator.standard_normal((5, 300)), time_s, valid)
    batch, recursive = least_squares(motion, HARMONICS), kalman(motion, HARMONICS)
    # the prior, 1e10 times the noise variance, pulls states by 1e-10; rounding of Potter's form adds as much
    np.testing.assert_allclose(recursive.state, batch.state, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(recursive.covariance, batch.covariance, rtol=1e-5, atol=1e-30)
    assert recursive.quality.pulses == int(valid.sum())


def test_kalman_with_process_noise_follows_an_amplitude_that_steps() -> None:
    time_s = np.arange(2000) / 4000
    amplitude = np.where(np.arange(2000) < 1000, 1e-6, 4e-7)
    noise = 1e-8 * np.random.default_rng(2).standard_normal(2000)
    motion = _motion(amplitude * np.sin(2 * np.pi * 200 * time_s) + noise, time_s)
    followed, averaged = kalman(motion, [200.0], process_noise=1e-3), kalman(motion, [200.0])
    assert followed.amplitude_m[0] == pytest.approx(4e-7, rel=0.05)
    assert averaged.amplitude_m[0] == pytest.approx(7e-7, rel=0.05)


@pytest.mark.parametrize("prior", [1e-15, 1e15])
def test_kalman_covariance_stays_positive_for_any_prior(prior: float) -> None:
    time_s = np.arange(500) / 4000
    noise = np.random.default_rng(3).standard_normal(500)
    fit = kalman(_motion(noise, time_s), [200.0, 400.0], prior=prior)
    assert (np.linalg.eigvalsh(fit.state_covariance) > 0).all()


def test_stated_covariance_of_least_squares_is_true() -> None:
    time_s = np.arange(100) / 4000
    generator = np.random.default_rng(5)
    truth = 1e-6 * np.sin(2 * np.pi * 200 * time_s + 1.1)
    fit = least_squares(_motion(truth + 1e-7 * generator.standard_normal((20000, 100)), time_s), [200.0, 400.0])
    assert fit.quality.degrees_of_freedom == 95
    # 20000 draws: a variance of 1 is known to sqrt(2/20000) = 0.01; three sigma
    for error, variance in (
        (fit.amplitude_m[:, 0] - 1e-6, fit.covariance[:, 0, 0, 0]),
        (fit.phase_rad[:, 0] - 1.1, fit.covariance[:, 0, 1, 1]),
    ):
        assert np.mean(error**2 / variance) == pytest.approx(1, abs=0.03)


def _white(noise: FloatArray, time_s: FloatArray) -> HarmonicFit:
    return least_squares(_motion(noise, time_s), [700.0])


def _filtered(noise: FloatArray, time_s: FloatArray) -> HarmonicFit:
    return kalman(_motion(noise, time_s), [700.0])


def _steps(noise: FloatArray, time_s: FloatArray) -> HarmonicFit:
    return least_squares(replace(_motion(noise, time_s), step_noise_ratio=np.zeros(len(noise))), [700.0])


def _walk(noise: FloatArray, time_s: FloatArray) -> HarmonicFit:
    walks = np.cumsum(np.sqrt(3) * np.random.default_rng(8).standard_normal(noise.shape), axis=1)
    return least_squares(
        replace(_motion(noise + 1e-8 * walks, time_s), step_noise_ratio=np.full(len(noise), 3.0)), [700.0]
    )


def _chain(noise: FloatArray, time_s: FloatArray) -> HarmonicFit:
    return velocity_to_harmonics(_velocity(noise, 4000), [700.0])


@pytest.mark.parametrize("fit", [_white, _filtered, _steps, _walk, _chain])
@pytest.mark.parametrize(
    "pulses",
    [
        6,
        pytest.param(8, marks=pytest.mark.slow),
        pytest.param(12, marks=pytest.mark.slow),
        30,
        pytest.param(100, marks=pytest.mark.slow),
    ],
)
def test_intervals_of_few_pulses_hold_the_truth_as_often_as_those_of_many(
    fit: Callable[[FloatArray, FloatArray], HarmonicFit], pulses: int
) -> None:
    """Quadratures of noise alone: 20000 trials of two know 95 % to 0.15 %, three sigma.

    Where the variance is not that of independent squares, Student's distribution matches two of its moments: to a
    percentage point.
    """
    time_s = np.arange(pulses) / 4000
    found = fit(1e-8 * np.random.default_rng(pulses).standard_normal((20000, pulses)), time_s)
    factor = coverage_factor(float(np.ravel(found.quality.degrees_of_freedom)[0]))
    u = np.sqrt(np.diagonal(found.state_covariance, axis1=-2, axis2=-1)[:, :2])
    exact = fit in (_white, _filtered)
    within = np.abs(found.state[:, :2]) < factor * u
    assert within.mean() == pytest.approx(0.95, abs=0.005 if exact else 0.015)


@pytest.mark.parametrize("valid", [np.ones(40, bool), np.arange(40) % 7 != 3])
def test_degrees_of_freedom_of_differences_are_nearly_those_of_the_dense_covariance(valid: NDArray[np.bool_]) -> None:
    """(tr A)^2 / tr A^2 by dense matrices: of the changes of a fit's residual, and of velocities with gaps."""
    time_s, generator = np.arange(valid.size) / 4000, np.random.default_rng(3)
    model = linear_model(time_s, valid, np.array([300.0, 700.0]), background_order=1)
    columns, taken = model.matrix @ model.root, generator.uniform(0.2, 1.0, model.root.shape[1])
    changes = np.diff(np.eye(len(columns)), axis=0)
    left = changes @ (np.eye(len(columns)) - columns @ np.diag(taken) @ columns.T)
    covariance = left @ left.T
    energy, freedom = difference_noise_moments(columns, taken, np.array(0.0))
    assert energy == pytest.approx(np.trace(covariance), rel=1e-12)
    # the smooth columns are left out of tr A^2: to 3 % on 40 pulses
    assert freedom == pytest.approx(np.trace(covariance) ** 2 / np.sum(covariance**2), rel=0.03)
    walk = np.tril(np.ones(2 * (len(columns),)), -1)
    energy, _ = difference_noise_moments(columns, taken, np.array(0.3))
    assert energy == pytest.approx(np.trace(covariance) + 0.3 * np.sum((left @ walk) ** 2), rel=1e-12)
    velocity = Velocity(time_s[:-1], np.diff(time_s), np.where(valid, 1.0, np.nan)[:-1], valid[:-1])
    fitted = linear_model(velocity.time_s, velocity.valid, np.array([300.0]))
    own = np.diff(np.eye(valid.size), axis=0)[velocity.valid]
    q = fitted.matrix @ fitted.root
    off = (np.eye(len(q)) - q @ q.T) @ own
    found = velocity_noise(velocity, fitted, np.array([300.0]), 1 / 4000)[2]
    # gaps take neighbours from the intervals: 1/3 of the variance is then up to a tenth too little
    assert found == pytest.approx(np.trace(off @ off.T) ** 2 / np.sum((off @ off.T) ** 2), rel=0.1)


def test_no_motion_and_no_noise_give_finite_covariances() -> None:
    time_s = np.arange(100) / 4000
    still = least_squares(_motion(np.zeros(100), time_s), [200.0])
    assert np.isfinite(still.covariance).all()
    noisy = least_squares(_motion(1e-9 * np.random.default_rng(6).standard_normal(100), time_s), [200.0])
    assert 0 < noisy.covariance[0, 1, 1] <= PHASE_VARIANCE_LIMIT
    assert (np.linalg.eigvalsh(noisy.covariance) >= 0).all()


@pytest.mark.parametrize("frequency_hz", [120.0, 200.0, 213.7, 800.0, 1333.3, 1900.0])
def test_velocity_chain_removes_gain_delay_and_90_degrees_exactly(frequency_hz: float) -> None:
    time_s = np.arange(101) / 4000
    displacement = 1e-6 * np.sin(2 * np.pi * frequency_hz * time_s - 2.0) + 3e-6
    fit = velocity_to_harmonics(_velocity(displacement, 4000), [frequency_hz])
    # exact but for the prior of the Kalman filter, 1e-10, and rounding of the differences
    assert fit.amplitude_m[0] == pytest.approx(1e-6, rel=1e-7, abs=0)
    assert fit.phase_rad[0] == pytest.approx(-2.0, abs=1e-7)


def test_interval_noise_has_a_false_alarm_rate_of_one_percent() -> None:
    """Twice the gain in log-likelihood is chi-square of one degree of freedom (Wilks)."""
    assert pytest.approx(chdtri(1, 0.01), rel=0.01) == 2 * LIKELIHOOD_GAIN


def test_bins_next_to_a_wanted_frequency_are_excluded_from_the_noise() -> None:
    """The fit has taken up what was in them: of 49 bins between 0 and half the rate two, of 105 Hz in bins of 10 Hz."""
    still = Velocity(np.arange(100) * 1e-3, np.full(100, 1e-3), np.zeros(100), np.ones(100, bool))
    power, shape = _residual_spectrum(np.zeros(100), still, np.array([105.0]), 1e-3)
    assert power.size == shape.size == 47


def test_the_velocity_chain_equals_the_papers_times_two_for_complete_cycles() -> None:
    time_s = np.arange(101) / 4000
    displacement = 1e-6 * np.sin(2 * np.pi * 200 * time_s + 0.5) + 1e-7 * np.sin(2 * np.pi * 600 * time_s)
    velocity = _velocity(displacement, 4000)
    windowed = velocity.velocity_m_per_s / (2 * np.pi * 200) * np.sin(np.pi * (np.arange(100) + 0.5) / 100) ** 2
    columns = np.exp(-2j * np.pi * 200 * velocity.time_s)
    papers_m = 2 * abs(windowed @ columns) * 2 / 100
    fit = velocity_to_harmonics(velocity, [200.0])
    assert fit.amplitude_m[0] * np.sinc(200 / 4000) == pytest.approx(papers_m, rel=1e-7, abs=0)


def test_velocity_chain_separates_ten_harmonics_with_gaps() -> None:
    time_s = np.arange(401) / 4000
    valid = np.random.default_rng(7).random(400) > 0.1
    fit = velocity_to_harmonics(_velocity(_sum_of_sines(time_s), 4000, valid), HARMONICS)
    np.testing.assert_allclose(fit.amplitude_m, AMPLITUDES, rtol=1e-7)
    np.testing.assert_allclose(fit.phase_rad, PHASES, atol=1e-7)


@pytest.mark.parametrize("gaps", [False, True])
def test_velocity_chain_leaves_nothing_of_a_background_far_larger_than_the_motion(gaps: bool) -> None:
    time_s = np.arange(1001) / 4000
    valid = np.random.default_rng(7).random(1000) > (0.1 if gaps else 0.0)
    # heart beat and breathing, 11 mm within the train
    background = 5e-3 * np.sin(2 * np.pi * 1.2 * time_s) + 20e-3 * np.sin(2 * np.pi * 0.25 * time_s)
    velocity = _velocity(background + 1e-7 * np.sin(2 * np.pi * 200 * time_s + 0.3), 4000, valid)
    fit = velocity_to_harmonics(velocity, [200.0], background_order=16)
    # without its polynomial the band-pass passes 0.2 nm of it; differences of millimetres are rounded to 1e-14 m
    np.testing.assert_allclose(fit.state, 1e-7 * np.array([np.cos(0.3), np.sin(0.3)]), atol=1e-14)


@pytest.mark.parametrize("background_order", [0, 6])
@pytest.mark.parametrize("gaps", [False, True])
def test_stated_covariance_of_the_velocity_chain_is_true(gaps: bool, background_order: int) -> None:
    time_s = np.arange(101) / 4000
    generator = np.random.default_rng(8)
    valid = generator.random(100) > (0.2 if gaps else 0.0)
    truth = 1e-6 * np.sin(2 * np.pi * 200 * time_s + 1.1)
    noisy = truth + 1e-7 * generator.standard_normal((3000, 101))
    fit = velocity_to_harmonics(_velocity(noisy, 4000, valid), [200.0], background_order=background_order)
    # variance known to sqrt(2/3000) = 0.026; the noise estimate from about 100 differences (80 with gaps) has a
    # relative variance of 3/100, so the mean of its inverse is 1.03 to 1.04, and 1 % false alarms lower it by 0.01
    for error, variance in (
        (fit.amplitude_m[:, 0] - 1e-6, fit.covariance[:, 0, 0, 0]),
        (fit.phase_rad[:, 0] - 1.1, fit.covariance[:, 0, 1, 1]),
    ):
        assert np.mean(error**2 / variance) == pytest.approx(1.03, abs=0.09)


def test_velocity_noise_that_does_not_cancel_is_estimated_and_stated() -> None:
    time_s = np.arange(101) / 4000
    generator = np.random.default_rng(9)
    velocity = _velocity(1e-6 * np.sin(2 * np.pi * 200 * time_s) + np.zeros((1000, 1)), 4000)
    noisy = velocity.velocity_m_per_s + 1e-4 * generator.standard_normal((1000, 100))
    fit = velocity_to_harmonics(Velocity(velocity.time_s, velocity.interval_s, noisy, velocity.valid), [200.0])
    error = fit.amplitude_m[:, 0] - 1e-6
    # taken as differenced pulse noise, the variance would be stated 14 times too small
    assert np.mean(error**2 / fit.covariance[:, 0, 0, 0]) == pytest.approx(1.05, abs=0.2)


@pytest.mark.parametrize(
    ("frequencies_hz", "pulses", "message"),
    [
        ([], 100, "no vibration frequency"),
        ([0.0], 100, "above zero"),
        ([float("nan")], 100, "finite"),
        ([200.0, 200.0], 100, "twice"),
        ([2000.0], 100, "half the pulse rate of 4000 Hz"),
        ([200.0, 400.0], 5, "5 valid pulses cannot give 5 unknowns"),
        ([200.0, 200.1], 100, "cannot be resolved"),
        ([0.5], 100, "cannot be resolved"),
    ],
)
def test_frequencies_that_the_pulses_do_not_resolve_are_refused_with_the_reason(
    frequencies_hz: list[float], pulses: int, message: str
) -> None:
    time_s = np.arange(pulses) / 4000
    motion = _motion(np.sin(time_s), time_s)
    for estimator in (least_squares, kalman):
        with pytest.raises(ValueError, match=message):
            estimator(motion, frequencies_hz)


def test_uneven_pulses_are_refused_by_the_velocity_chain() -> None:
    velocity = _velocity(np.zeros(101), 4000)
    interval_s = velocity.interval_s.copy()
    interval_s[50] *= 1.5
    uneven = Velocity(velocity.time_s, interval_s, velocity.velocity_m_per_s, velocity.valid)
    with pytest.raises(ValueError, match="coherent"):
        velocity_to_harmonics(uneven, [200.0])


def test_a_train_too_short_for_the_band_pass_is_refused_by_the_velocity_chain() -> None:
    """Fifteen intervals of 3.75 ms have a line at 267 Hz and one at 533 Hz, none within 100 Hz of 400 Hz."""
    with pytest.raises(ValueError, match=r"400 Hz.*at least 0\.01 s"):
        velocity_to_harmonics(_velocity(np.zeros(16), 4000), [200.0, 400.0, 600.0])


def test_further_harmonics_up_to_half_the_pulse_rate_are_not_in_the_residual() -> None:
    time_s = np.arange(400) / 2000
    displacement = _sum_of_sines(time_s)  # its tenth harmonic is half the pulse rate: an alternating sign
    alone = least_squares(_motion(displacement, time_s), HARMONICS[:3])
    along = least_squares(_motion(displacement, time_s), HARMONICS[:3], also_hz=HARMONICS)
    np.testing.assert_array_equal(along.frequency_hz, HARMONICS[:3])
    np.testing.assert_allclose(along.amplitude_m, AMPLITUDES[:3], rtol=1e-9)
    np.testing.assert_allclose(along.phase_rad, PHASES[:3], atol=1e-9)
    assert along.state.shape == (7,)
    # what is left is rounding, against the rms of all that was not asked for
    assert along.quality.residual_rms_m < 1e-9 * alone.quality.residual_rms_m


def test_harmonics_above_half_the_pulse_rate_are_resolved_when_the_pulses_shift_from_period_to_period() -> None:
    harmonics = 100.0 * np.arange(1, 61)
    amplitudes = 1e-6 / np.arange(1, 61)
    for rate_hz, bound in ((3990.0, 1e-9), (4000.0, np.inf)):
        time_s = np.arange(600) / rate_hz
        displacement = np.sin(2 * np.pi * np.outer(time_s, harmonics) + 0.3) @ amplitudes
        fit = least_squares(_motion(displacement, time_s), HARMONICS, also_hz=harmonics)
        error = np.abs(fit.amplitude_m / amplitudes[:10] - 1).max()
        # 399 instants a burst period against 40: in the one case rounding is left, in the other all that aliases
        assert error < bound
        if rate_hz == 4000.0:
            assert error > 0.05


def test_further_frequencies_are_omitted_when_the_pulses_do_not_resolve_them() -> None:
    time_s = np.arange(600) / 3990.0
    valid = time_s % 0.01 > 1e-3  # a tenth of every period is never seen
    fit = least_squares(
        _motion(np.sin(2 * np.pi * 200 * time_s), time_s, valid), HARMONICS, also_hz=100.0 * np.arange(1, 100)
    )
    # 99 frequencies would have a condition of 1e9 and more here; those kept cost the wanted ones no accuracy
    np.testing.assert_allclose(fit.amplitude_m[1], 1.0, rtol=1e-9)
    assert np.sqrt(fit.covariance[1, 0, 0]) < 1e-9


@pytest.mark.parametrize("driven", [0, 40, 68])
def test_accumulated_steps_count_every_state_that_is_fitted(driven: int) -> None:
    """Mean squares of 20 wanted quadratures over their stated variance; other frequencies take up to 69 states along.

    Over 4000 trials each is known to 2.2 %, the worst of twenty to about three of that, all together to a fourth.
    """
    generator, walk, trials = np.random.default_rng(driven), 0.5, 4000
    time_s = np.arange(160) / 16e3
    noise = 1e-9 * generator.standard_normal((trials, 160))
    noise += np.cumsum(np.sqrt(walk) * 1e-9 * generator.standard_normal((trials, 160)), axis=1)
    motion = Motion(
        time_s, noise, np.full(noise.shape, 1e-18), np.ones(160, dtype=bool), step_noise_ratio=np.full(trials, walk)
    )
    driven_hz = 100.0 * np.arange(11, 11 + driven)
    fit = least_squares(motion, HARMONICS, also_hz=driven_hz)
    stated = np.diagonal(fit.state_covariance, axis1=-2, axis2=-1)[:, :20]
    # of means, not the mean of the ratio, which few degrees of freedom would raise
    assert np.mean(fit.state[:, :20] ** 2, axis=0) / stated.mean(axis=0) == pytest.approx(np.ones(20), abs=0.08)
    assert np.mean(fit.state[:, :20] ** 2) / stated.mean() == pytest.approx(1, abs=0.03)


def test_one_pulse_more_than_states_states_an_uncertainty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "MAX_CONDITION", np.inf)
    time_s = np.arange(22) / 4e3
    walk = np.full(500, 0.2)
    noise = np.random.default_rng(1).standard_normal((500, 22)) * 1e-9
    noise += np.cumsum(np.random.default_rng(2).standard_normal((500, 22)) * np.sqrt(0.2) * 1e-9, axis=1)
    motion = Motion(time_s, noise, np.full(noise.shape, 1e-18), np.ones(22, dtype=bool), step_noise_ratio=walk)
    fit = least_squares(motion, 190.0 * np.arange(1, 11))
    stated = np.diagonal(fit.state_covariance, axis1=-2, axis2=-1)[:, :20]
    assert np.isfinite(stated).all()
    # chi-square of one degree of freedom: its mean over 500 is known to 6 %, three of these; the state's as well
    assert np.mean(fit.state[:, :20] ** 2 / stated.mean(axis=0)) == pytest.approx(1, abs=0.4)


@pytest.mark.parametrize("shift_s", [131e-6, 1e-3, 3.3e-3, 10e-3])
@pytest.mark.parametrize("estimator", [least_squares, kalman])
def test_no_amplitude_depends_on_time_zero(estimator: Callable[..., HarmonicFit], shift_s: float) -> None:
    """Pulses with gaps resolve only some of 60 driven frequencies; which ones must not depend on time zero.

    The fit is linear, so that a shift of time changes phases by exactly 2 pi f t and leaves rounding otherwise.
    """
    generator = np.random.default_rng(5)
    time_s = np.arange(798) / 3990.0
    valid = time_s % 0.01 > 1e-3
    driven_hz = 100.0 * np.arange(1, 61)
    wave = np.sin(2 * np.pi * np.outer(time_s, driven_hz) + 0.3) @ (1e-6 / np.arange(1, 61))
    displacement_m = wave + 1e-8 * generator.standard_normal(798)
    before, after = (
        estimator(_motion(displacement_m, time_s + shift, valid), HARMONICS[:8], also_hz=driven_hz, background_order=1)
        for shift in (0.0, shift_s)
    )
    assert after.state.shape == before.state.shape
    np.testing.assert_allclose(after.amplitude_m, before.amplitude_m, rtol=1e-6)
    turned = np.exp(1j * (before.phase_rad - after.phase_rad - 2 * np.pi * np.array(HARMONICS[:8]) * shift_s))
    np.testing.assert_allclose(turned, 1.0, atol=1e-6)
