"""The uncertainty of amplitude and phase of a phasor in noise, also where there is nothing but noise."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.result.phase import (
    PHASE_VARIANCE_LIMIT,
    phase_variance_at_rad2,
    phase_variance_rad2,
    rectified_variance_m2,
)

TRIALS = 40_000


def squared_ratio(amplitude: float | np.ndarray) -> np.ndarray:
    """Return (error / u)^2 of the phases of phasors of ``amplitude``, phase 0, in noise of 1 a quadrature."""
    quadratures = np.random.default_rng(4).standard_normal((2, TRIALS))
    found = amplitude + quadratures[0] + 1j * quadratures[1]
    return np.asarray(np.angle(found) ** 2 / phase_variance_rad2(np.abs(found), 1.0, 1.0))


@pytest.mark.parametrize("amplitude", [5.0, 8.0, 30.0])
def test_far_out_of_noise_it_is_noise_over_amplitude(amplitude: float) -> None:
    assert phase_variance_rad2(amplitude, 1.0, 1.0) == pytest.approx(amplitude**-2, rel=4e-3)
    # The first order in noise over amplitude leaves 4 % at 5; three standard deviations of a mean of squares.
    assert np.mean(squared_ratio(amplitude)) == pytest.approx(1, abs=0.04 + 3 * np.sqrt(2 / TRIALS))


@pytest.mark.parametrize("amplitude", [0.0, 0.1, 0.3])
def test_of_noise_alone_it_is_nearly_that_of_an_unknown_phase(amplitude: float) -> None:
    assert phase_variance_rad2(1.0, 1.0, 1.0) == pytest.approx(PHASE_VARIANCE_LIMIT, rel=0.2)
    # Noise over amplitude alone would have 6.6 there.
    assert 1.0 < np.mean(squared_ratio(amplitude)) < 1.7


def test_over_amplitudes_of_any_decade_it_is_true_on_the_mean() -> None:
    decades = np.random.default_rng(5).uniform(-2, 2, TRIALS)
    assert 0.8 < np.mean(squared_ratio(10**decades)) < 1.25


def test_what_a_motion_makes_wrong_of_itself_is_no_sign_that_there_is_none() -> None:
    assert phase_variance_rad2(10.0, 36.0, 1.0) == pytest.approx(0.36)
    assert phase_variance_rad2(0.0, 0.0, 0.0) <= PHASE_VARIANCE_LIMIT


@pytest.mark.parametrize(
    "across", [pytest.param(1.0, marks=pytest.mark.slow), 0.3, pytest.param(0.03, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "amplitude",
    [
        0.1,
        *(pytest.param(each, marks=pytest.mark.slow) for each in (0.5, 1.0)),
        1.7,
        *(pytest.param(each, marks=pytest.mark.slow) for each in (3.0, 7.0)),
        40.0,
    ],
)
def test_a_phase_whose_amplitude_is_known_is_as_uncertain_as_noise_of_any_shape_leaves_it(
    amplitude: float, across: float
) -> None:
    # Noise of 1 along the real axis and of ``across`` along the other, of a motion that points anywhere.
    generator = np.random.default_rng(6)
    quadratures, turn_rad = generator.standard_normal((2, TRIALS // 8)), generator.uniform(-np.pi, np.pi, TRIALS // 8)
    found = amplitude * np.exp(1j * turn_rad) + quadratures[0] + 1j * across * quadratures[1]
    sin, cos = np.sin(np.angle(found)), np.cos(np.angle(found))
    shared = (across**2 - 1) * sin * cos
    covariance = np.array([[cos**2 + across**2 * sin**2, shared], [shared, sin**2 + across**2 * cos**2]])
    known = np.full(found.size, amplitude)
    stated = phase_variance_at_rad2(known, 1e-6 * known**2, np.abs(found), np.moveaxis(covariance, -1, 0))
    error = np.angle(found * np.exp(-1j * turn_rad))
    # The mean of error^2 / u^2 is 1 whatever u^2 is, if it is the mean square given what is found: its own error by
    # chance comes from the kurtosis of a phase, at most that of a half turn now and then.
    ratio = error**2 / stated
    assert np.mean(ratio) == pytest.approx(1, abs=4 * np.std(ratio) / np.sqrt(ratio.size) + 0.005)


def test_a_known_amplitude_that_is_noise_itself_says_nothing_of_a_phase() -> None:
    one = np.ones(1)
    drowned = phase_variance_at_rad2(one, one, one, 0.01 * np.eye(2)[None])
    assert drowned[0] == pytest.approx(phase_variance_rad2(1.0, 0.01, 1.0), rel=0.01)


@pytest.mark.parametrize("amplitude", [0.0, 0.2, 0.5, 1.0, 2.0, 3.0, 6.0])
def test_the_interval_of_a_weak_amplitude_holds_it_as_often_as_it_says_or_more_often(amplitude: float) -> None:
    quadratures = np.random.default_rng(7).standard_normal((2, TRIALS))
    found = np.abs(amplitude + quadratures[0] + 1j * quadratures[1])
    error = (found - amplitude) / np.sqrt(1 + rectified_variance_m2(found, 1.0, 1.0))
    # One sigma of a quadrature would hold 39 and 85 % of noise alone, and have a mean square of 2.
    assert 0.62 < np.mean(np.abs(error) < 1) < 0.83
    assert 0.93 < np.mean(np.abs(error) < 1.96) < 0.975
    assert 0.65 < np.mean(error**2) < 1.3


def test_an_amplitude_that_counts_as_found_has_the_uncertainty_of_its_noise() -> None:
    assert rectified_variance_m2(np.array([3.0, 4.0, 1e100]), 1.0, 1.0) == pytest.approx(0)
    assert rectified_variance_m2(0.0, 0.0, 0.0) == 0
    assert rectified_variance_m2(0.0, 4.0, 4.0) == pytest.approx(4 * 1.2957, rel=0.12)
