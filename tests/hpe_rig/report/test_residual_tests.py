"""Tests of the residual and of sweeps' lines, against plain forms and against noise whose law is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.report.residual_tests import innovation_sum, line_p, periodogram, residual_tests, whiteness_p
from hpe_rig.report.sweep import fit_line, make_sweep
from hpe_rig.report.views import MotionView
from hpe_rig.result import Estimate, ShotResult

RATE_HZ = 4000.0
PULSES = 400


def view(residual_m: np.ndarray, noise_m: float = 10e-9) -> MotionView:
    time_s = np.arange(residual_m.size) / RATE_HZ
    angle = 2 * np.pi * 200 * time_s
    matrix = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    fitted_m = matrix @ np.linalg.lstsq(matrix, residual_m, rcond=None)[0]
    return MotionView(
        time_s=time_s,
        displacement_m=residual_m,
        fitted_m=fitted_m,
        noise_m2=np.full(residual_m.size, noise_m**2),
        matrix=matrix,
        frequencies_hz=np.array([200.0]),
        pulse_rate_hz=RATE_HZ,
    )


@pytest.mark.parametrize(
    "p_value",
    [
        pytest.param(lambda noise, power: whiteness_p(power), id="whiteness"),
        pytest.param(lambda noise, power: line_p(power), id="line"),
    ],
)
def test_p_values_of_white_noise_fall_below_a_twentieth_as_often_as_that(
    p_value: Callable[[np.ndarray, np.ndarray], float],
) -> None:
    generator, draws = np.random.default_rng(5), 600
    below = 0
    for _ in range(draws):
        noise = generator.standard_normal(PULSES)
        power = np.abs(np.fft.rfft(noise)[1:-1]) ** 2
        below += p_value(noise, power) < 0.05
    # Four standard deviations of a binomial count; asymptotic laws err to the safe side by up to a third.
    spread = 4 * math.sqrt(draws * 0.05 * 0.95)
    assert 0.65 * draws * 0.05 - spread < below < draws * 0.05 + spread


def test_a_line_a_drift_and_spikes_are_each_noticed_by_their_test() -> None:
    generator = np.random.default_rng(6)
    noise = 10e-9 * generator.standard_normal(PULSES)
    time_s = np.arange(PULSES) / RATE_HZ
    spikes = noise.copy()
    spikes[::40] += 100e-9
    cases = {
        "no spectral line": noise + 8e-9 * np.sin(2 * np.pi * 710 * time_s),
        "white residual": np.convolve(noise, np.ones(4) / 2, mode="same"),
        "normal residual": spikes,
        "steady noise": noise * np.where(time_s < time_s[PULSES // 2], 1.0, 1.6),
        "innovations": 1.3 * noise,
    }
    assert {check.verdict for check in residual_tests(view(noise))} == {"passed"}
    for name, residual_m in cases.items():
        verdicts = {check.name: check.verdict for check in residual_tests(view(residual_m))}
        assert verdicts[name] == "noticed", name


def test_the_periodogram_leaves_out_what_was_fitted_and_keeps_parseval() -> None:
    noise = np.random.default_rng(7).standard_normal(PULSES)
    seen = view(noise)
    frequency_hz, power = periodogram(seen)
    assert np.abs(frequency_hz - 200.0).min() > 1.5 * RATE_HZ / PULSES
    whole = np.abs(np.fft.rfft(seen.residual_m)) ** 2
    fitted = whole[np.abs(np.fft.rfftfreq(PULSES, 1 / RATE_HZ) - 200.0) < 1.5 * RATE_HZ / PULSES]
    # every bin is either free, next to the fitted frequency, zero, or half the pulse rate
    assert power.sum() + fitted.sum() + whole[0] + whole[-1] == pytest.approx(whole.sum(), rel=1e-12)


def test_the_sum_of_innovations_is_that_of_refitting_all_earlier_pulses_each_time() -> None:
    generator = np.random.default_rng(8)
    seen = view(generator.standard_normal(60))
    variance = generator.uniform(0.5, 2.0, 60)
    plain = []
    for k in range(3, 60):
        weight = 1 / np.sqrt(variance[:k])
        x, y = seen.matrix[:k] * weight[:, None], seen.displacement_m[:k] * weight
        state = np.linalg.lstsq(x, y, rcond=None)[0]
        spread = variance[k] + seen.matrix[k] @ np.linalg.inv(x.T @ x) @ seen.matrix[k]
        plain.append((seen.displacement_m[k] - seen.matrix[k] @ state) / math.sqrt(spread))
    total, count = innovation_sum(seen.matrix, seen.displacement_m, variance)
    assert count == len(plain)
    assert total == pytest.approx(np.sum(np.square(plain)), rel=1e-6)


def test_too_few_pulses_are_said_to_be_too_few() -> None:
    checks = residual_tests(view(np.random.default_rng(9).standard_normal(12) * 1e-9))
    assert {check.verdict for check in checks} == {"not possible"}
    assert all(check.value for check in checks)


def test_a_line_equals_numpys_polynomial_fit_with_its_covariance() -> None:
    generator = np.random.default_rng(10)
    x = np.repeat([0.1, 0.4, 0.7, 1.0], 3)
    y = 3.0 * x + 0.2 + 0.1 * generator.standard_normal(x.size)
    line = fit_line(x, y)
    assert line is not None
    (slope, intercept), covariance = np.polyfit(x, y, 1, cov=True)
    assert (line.slope, line.intercept) == pytest.approx((slope, intercept), rel=1e-10)
    # numpy scales by the degrees of freedom, as here
    assert (line.slope_u, line.intercept_u) == pytest.approx(tuple(np.sqrt(np.diag(covariance))), rel=1e-10)
    assert line.r_squared == pytest.approx(np.corrcoef(x, y)[0, 1] ** 2, rel=1e-10)


def test_one_value_of_x_has_no_line() -> None:
    assert fit_line(np.ones(3), np.arange(3.0)) is None


def test_a_line_is_fitted_over_the_force_and_not_over_places() -> None:
    forces = make_sweep([_shot(index, 0.0, force=force) for index, force in enumerate((0.5, 1.0))])
    places = make_sweep([replace(_shot(index, 0.0), lateral_offset_m=index * 1e-3) for index in range(2)])
    assert forces is not None
    assert places is not None
    assert forces.is_linear
    assert forces.curves[0].line is not None
    assert not places.is_linear
    assert places.curves[0].line is None


def test_forces_that_differ_in_the_fifth_digit_are_separate_curves_over_an_axis_of_the_sweep() -> None:
    cases = [(force, rate_hz) for force in (0.18181, 0.18182) for rate_hz in (3e3, 4e3)]
    shots = [replace(_shot(i, 0.0, force), swept={"rate": rate_hz}) for i, (force, rate_hz) in enumerate(cases)]
    sweep = make_sweep(shots)
    assert sweep is not None
    assert [curve.group for curve in sweep.curves] == ["F = 0.18181 F_0", "F = 0.18182 F_0"]
    assert [curve.x.tolist() for curve in sweep.curves] == [[3e3, 4e3]] * 2


def test_phases_on_both_sides_of_half_a_turn_have_their_mean_there() -> None:
    shots = [_shot(index, phase_rad) for index, phase_rad in enumerate((math.pi - 0.1, -math.pi + 0.1))]
    sweep = make_sweep([_shot(2, 0.0, force=0.5), *shots])
    assert sweep is not None
    (curve,) = sweep.curves
    assert abs(curve.phase_rad[1]) == pytest.approx(math.pi)
    assert curve.phase_sd_rad[1] == pytest.approx(0.1 * math.sqrt(2))


def _shot(index: int, phase_rad: float, force: float = 1.0) -> ShotResult:
    estimate = Estimate(100.0, 1e-7, 1e-9, phase_rad, 0.01, None, None, None, None)
    return ShotResult(index, index, 1e-4, force, 100, 0, 1e-9, (estimate,), ())
