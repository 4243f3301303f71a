"""95 % intervals of the GUM, annex G: closed forms, and coverage of simulated errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import stdtrit

from hpe_rig.result import Component, Estimate
from hpe_rig.result.interval import (
    coverage_factor,
    effective_degrees_of_freedom,
    interval_95,
    phase_interval_95_rad,
)


def test_the_coverage_factor_is_the_quantile_of_students_distribution() -> None:
    assert coverage_factor() == pytest.approx(1.959964, rel=1e-6)
    # GUM, table G.2
    for nu, factor in ((1, 12.71), (2, 4.30), (5, 2.57), (10, 2.23), (100, 1.984)):
        assert coverage_factor(nu) == pytest.approx(factor, rel=1e-3)


def test_less_than_one_degree_of_freedom_counts_as_one() -> None:
    assert coverage_factor(0.0) == coverage_factor(0.3) == coverage_factor(1.0)


def test_effective_degrees_of_freedom_are_those_of_the_example_in_the_guide() -> None:
    # GUM, H.1.6: end gauge, components in nm with their degrees of freedom, 16 effective ones
    components = [(25.0, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0)]
    assert effective_degrees_of_freedom(components) == pytest.approx(16.7, abs=0.3)


def test_sources_without_scatter_leave_infinite_degrees_of_freedom() -> None:
    assert effective_degrees_of_freedom([(1.0, math.inf), (2.0, math.inf)]) == math.inf
    assert effective_degrees_of_freedom([(0.0, 3.0)]) == math.inf
    assert effective_degrees_of_freedom([(math.inf, 3.0)]) == math.inf
    assert effective_degrees_of_freedom([(1.0, 7.0), (0.0, 1.0)]) == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("u_noise", "nu", "u_speckle"),
    [
        (1.0, 4, 0.0),
        (1.0, 4, 1.0),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((1.0, 8, 0.5), (0.5, 3, 1.0))),
    ],
)
def test_the_interval_holds_the_sum_of_a_scattered_and_a_known_error(u_noise: float, nu: int, u_speckle: float) -> None:
    """Of 20 000 trials 95 % are known to 0.15 %; Welch and Satterthwaite's formula is good to one percent."""
    random, trials = np.random.default_rng(nu), 20_000
    errors = u_noise * random.standard_normal(trials) + u_speckle * random.standard_normal(trials)
    stated = u_noise * np.sqrt(random.chisquare(nu, trials) / nu)
    reach = [interval_95([(u, nu), (u_speckle, math.inf)]) for u in stated.tolist()]
    assert np.mean(np.abs(errors) < reach) == pytest.approx(0.95, abs=0.005 if not u_speckle else 0.015)


def test_an_estimate_states_the_interval_of_its_budget() -> None:
    budget = (Component("noise", 3e-9, 0.03, 6.0), Component("speckle", 4e-9, 0.0))
    estimate = Estimate(100.0, 1e-6, 3e-9, 0.1, 0.03, components=budget)
    # Welch-Satterthwaite: 5^4 / (3^4 / 6)
    assert estimate.interval_95_m == pytest.approx(5e-9 * stdtrit(5**4 / (3**4 / 6), 0.975))
    assert estimate.interval_95_rad == pytest.approx(0.03 * stdtrit(6, 0.975))


def test_the_half_width_of_a_phase_interval_is_at_most_pi() -> None:
    unknown = Component("noise", 1e-9, math.pi / math.sqrt(3))
    estimate = Estimate(100.0, 1e-9, 1e-9, 0.1, 1.8, components=(unknown,))
    assert estimate.interval_95_rad == math.pi
    assert phase_interval_95_rad([(math.inf, math.inf)]) == math.pi
