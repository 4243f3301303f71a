"""Intervals by standard uncertainty and kurtosis: closed forms, and what they hold of errors of other shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri, stdtrit

from hpe_rig.processing import fourth_moment
from hpe_rig.result import Component, Estimate
from hpe_rig.result.interval import COVERED, combined_kurtosis, coverage_factor, half_widths, phase_half_widths


@pytest.mark.parametrize("probability", COVERED)
def test_factors_are_those_of_the_distribution_that_has_the_kurtosis(probability: float) -> None:
    # here, as below: loaded by the process that runs this, not by every one that collects the tests
    from scipy.stats import semicircular

    upper = (1 + probability) / 2
    assert coverage_factor(3.0, probability) == pytest.approx(ndtri(upper), rel=1e-9)
    assert coverage_factor(1.8, probability) == pytest.approx(probability * math.sqrt(3), rel=1e-3)
    # a semicircle has a kurtosis of 2, Student's distribution one of 3 + 6 / (freedom - 4)
    assert coverage_factor(2.0, probability) == pytest.approx(semicircular.ppf(upper) * 2, rel=1e-3)
    for freedom in (4.5, 5.0, 8.0, 30.0):
        expected = stdtrit(freedom, upper) * math.sqrt((freedom - 2) / freedom)
        assert coverage_factor(3 + 6 / (freedom - 4), probability) == pytest.approx(expected, rel=1e-3)


def test_an_unknown_kurtosis_is_that_of_a_normal_error_and_two_points_no_less_than_even() -> None:
    assert coverage_factor(math.nan, 0.95) == coverage_factor(3.0, 0.95)
    assert coverage_factor(1.0, 0.95) == coverage_factor(1.8, 0.95)


@pytest.mark.parametrize("name", ["laplace", "logistic", "triang", "norm", "uniform", "cosine"])
def test_errors_of_other_shapes_are_held_to_a_few_percent(name: str) -> None:
    """No two numbers are a distribution: a Laplacian's 68 % interval is the worst, and holds 71 %."""
    from scipy import stats

    shape = getattr(stats, name)(*((0.5,) if name == "triang" else ()))
    mean, variance, _, excess = (float(each) for each in shape.stats("mvsk"))
    for probability in COVERED:
        reach = coverage_factor(3 + excess, probability) * math.sqrt(variance)
        assert shape.cdf(mean + reach) - shape.cdf(mean - reach) == pytest.approx(probability, abs=0.035)


def test_kurtoses_of_independent_errors_add_as_their_fourth_moments() -> None:
    generator = np.random.default_rng(1)
    u, draws = (1.0, 0.6, 0.8), 100_000
    errors = [
        u[0] * generator.standard_normal(draws),
        u[1] * generator.laplace(size=draws) / math.sqrt(2),
        u[2] * generator.uniform(-math.sqrt(3), math.sqrt(3), draws),
    ]
    together = np.sum(errors, axis=0)
    expected = combined_kurtosis(math.hypot(*u), zip(u, (3.0, 6.0, 1.8), strict=True))
    # the kurtosis of n nearly normal errors repeats to sqrt(24 / n)
    assert np.mean(together**4) / np.mean(together**2) ** 2 == pytest.approx(expected, abs=4 * math.sqrt(24 / draws))
    assert combined_kurtosis(math.inf, [(math.inf, 9.0)]) == 3.0
    assert combined_kurtosis(0.0, [(0.0, 9.0)]) == 3.0


def test_an_estimate_states_the_intervals_of_its_budget() -> None:
    budget = (Component("noise", 3e-9, 0.03), Component("speckle", 4e-9, 0.0, 9.0, 9.0))
    found = Estimate(100.0, 1e-6, 3e-9, 0.1, 0.03, components=budget)
    kurtosis = 3 + (4 / 5) ** 4 * 6
    assert (found.interval_68_m, found.interval_95_m) == half_widths(5e-9, kurtosis)
    assert found.interval_68_m < 0.95 * 5e-9
    assert found.interval_95_rad == pytest.approx(1.95996 * 0.03, rel=1e-5)


def test_no_phase_is_further_off_than_half_a_turn() -> None:
    unknown = Component("noise", 1e-9, math.pi / math.sqrt(3), 3.0, 1.8)
    found = Estimate(100.0, 1e-9, 1e-9, 0.1, 1.8, components=(unknown, Component("quantisation", 1e-9, 1.8)))
    assert found.headline.phase_uncertainty_rad * 1.64 > math.pi
    assert found.interval_95_rad == math.pi
    assert phase_half_widths(math.inf) == (math.pi, math.pi)
    # noise alone: even over the circle
    found = Estimate(100.0, 1e-9, 1e-9, 0.1, 1.8, components=(unknown,))
    assert found.interval_95_rad == pytest.approx(0.95 * math.pi, rel=1e-3)


def test_the_kurtosis_over_members_is_that_of_their_shares() -> None:
    share, values = np.array([0.25, 0.5, 0.25]), np.array([-1.0, 0.0, 1.0])[:, None, None] * np.ones((1, 2, 2))
    # of 1 a quarter of the time on either side: 0.5 / 0.25
    assert fourth_moment(share, values) == pytest.approx(np.full((2, 2), 2.0))
    assert fourth_moment(share, np.zeros((3, 1, 2))) == pytest.approx(np.ones((1, 2)))
