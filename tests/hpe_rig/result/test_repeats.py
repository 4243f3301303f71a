"""Means over repeats: as certain as stated, tested by chi-square, and never the luckiest shot."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.result import Component, Estimate, ShotResult
from hpe_rig.result.phase import phase_variance_rad2
from hpe_rig.result.repeats import SIGNIFICANCE, RepeatMean, repeat_means

AMPLITUDE_M, PHASE_RAD = 1e-7, 3.1
NOISE_M, SPECKLE_M, NOISE_RAD, SPECKLE_RAD = 2e-9, 1e-9, 0.02, 0.01


def shot(index: int, error_m: float, error_rad: float, force: float = 1.0) -> ShotResult:
    budget = (Component("noise", NOISE_M, NOISE_RAD), Component("speckle", SPECKLE_M, SPECKLE_RAD))
    phase_rad = math.remainder(PHASE_RAD + error_rad, 2 * math.pi)
    estimate = Estimate(100.0, AMPLITUDE_M + error_m, NOISE_M, phase_rad, NOISE_RAD, components=budget)
    return ShotResult(index, index, 1e-4, force, 100, 0, 1e-9, (estimate,), ())


def repeats(generator: np.random.Generator, count: int, scatter: float = 1.0) -> list[ShotResult]:
    """Draw ``count`` repeats of one place: noise in each, speckle common to all."""
    common = generator.standard_normal(2) * (SPECKLE_M, SPECKLE_RAD)
    each = common + generator.standard_normal((count, 2)) * (NOISE_M * scatter, NOISE_RAD * scatter)
    return [shot(index, *errors) for index, errors in enumerate(each.tolist())]


def mean_of(shots: list[ShotResult]) -> RepeatMean:
    (mean,) = repeat_means(shots)
    return mean


def test_the_mean_is_as_uncertain_as_noise_over_repeats_and_speckle_in_full() -> None:
    mean = mean_of([shot(0, NOISE_M, 0.01), shot(1, -NOISE_M, -0.01)])
    assert mean.shots == (1, 2)
    assert mean.amplitude_m == pytest.approx(AMPLITUDE_M, rel=1e-3)
    assert mean.amplitude_uncertainty_m == pytest.approx(math.hypot(NOISE_M / math.sqrt(2), SPECKLE_M))
    assert mean.phase_uncertainty_rad == pytest.approx(math.hypot(NOISE_RAD / math.sqrt(2), SPECKLE_RAD))
    # About the half turn a plain mean of the phases would be 0.
    assert mean.phase_rad == pytest.approx(PHASE_RAD, abs=1e-3)
    assert (mean.chi_square, mean.degrees_of_freedom) == (pytest.approx(2 + 2 * 0.25), 2)


def test_means_are_off_by_as_much_as_they_state_and_chi_square_is_noticed_as_often_as_it_should() -> None:
    trials = 400
    generator = np.random.default_rng(5)
    means = [mean_of(repeats(generator, 5)) for _ in range(trials)]
    ratio = [(mean.amplitude_m - AMPLITUDE_M) / mean.amplitude_uncertainty_m for mean in means]
    turned = [math.remainder(mean.phase_rad - PHASE_RAD, 2 * math.pi) / mean.phase_uncertainty_rad for mean in means]
    # The mean of n squares of normal errors has the standard deviation sqrt(2 / n).
    assert np.mean(np.square(ratio)) == pytest.approx(1, abs=4 * math.sqrt(2 / trials))
    assert np.mean(np.square(turned)) == pytest.approx(1, abs=4 * math.sqrt(2 / trials))
    alarms = sum(not mean.agrees for mean in means)
    assert alarms == pytest.approx(SIGNIFICANCE * trials, abs=4 * math.sqrt(SIGNIFICANCE * trials))
    assert np.mean([mean.chi_square for mean in means]) == pytest.approx(8, abs=4 * math.sqrt(16 / trials))


def test_repeats_that_scatter_more_than_stated_disagree_and_state_their_scatter() -> None:
    mean = mean_of(repeats(np.random.default_rng(1), 6, scatter=8.0))
    assert not mean.agrees
    assert mean.probability < SIGNIFICANCE
    assert mean.amplitude_uncertainty_m == pytest.approx(math.hypot(mean.amplitude_sd_m / math.sqrt(6), SPECKLE_M))


def test_only_complete_shots_of_equal_settings_are_repeats() -> None:
    assert repeat_means([shot(0, 0, 0), shot(1, 0, 0, force=0.5), shot(2, 0, 0, force=0.25)]) == ()
    stopped = replace(shot(2, 0, 0), complete=False)
    (mean,) = repeat_means([shot(0, 0, 0), shot(1, 0, 0), stopped, shot(3, 0, 0, force=0.5)])
    assert mean.shots == (1, 2)


@pytest.mark.parametrize(
    "amplitude", [0.0, pytest.param(1.0, marks=pytest.mark.slow), pytest.param(6.0, marks=pytest.mark.slow)]
)
def test_the_phase_of_the_mean_of_weak_repeats_is_as_uncertain_as_stated(amplitude: float) -> None:
    generator, trials = np.random.default_rng(9), 200
    ratio = []
    for each in (amplitude + generator.standard_normal((trials, 5, 2)) @ np.array([1, 1j])).tolist():
        shots = []
        for index, phasor in enumerate(each):
            u_rad = math.sqrt(phase_variance_rad2(abs(phasor), 1.0, 1.0))
            estimate = Estimate(
                100.0, abs(phasor), 1.0, cmath.phase(phasor), u_rad, components=(Component("noise", 1.0, u_rad),)
            )
            shots.append(ShotResult(index, index, 1e-4, 1.0, 100, 0, 1.0, (estimate,), ()))
        mean = mean_of(shots)
        ratio.append(mean.phase_rad / mean.phase_uncertainty_rad)
    # On noise alone the mean of five would state a fifth of the variance of each, and be off by five times that.
    assert 0.4 < np.mean(np.square(ratio)) < 1.7


def test_the_phase_interval_of_a_mean_that_may_be_noise_is_at_most_the_circle() -> None:
    budget = (Component("noise", NOISE_M, math.pi / math.sqrt(3)),)
    shots = [
        replace(shot(index, 0.0, 0.0), estimates=(Estimate(100.0, NOISE_M, NOISE_M, angle, 1.8, components=budget),))
        for index, angle in enumerate((0.0, 1.5, 3.0, -1.5))
    ]
    mean = mean_of(shots)
    assert mean.phase_uncertainty_rad > 1.4
    assert 2.7 < mean.interval_95_rad <= math.pi


@pytest.mark.parametrize(
    ("freedom", "trials"), [(3, 300), *(pytest.param(freedom, 3000, marks=pytest.mark.slow) for freedom in (3, 12))]
)
def test_repeats_of_few_pulses_pool_their_noise(freedom: int, trials: int) -> None:
    """Each u has ``freedom`` degrees of freedom; of means 95 % are within the interval, to 3 sd."""
    random, within = np.random.default_rng(freedom), []
    for _ in range(trials):
        shots = []
        for index in range(5):
            u_m = 1e-9 * math.sqrt(random.chisquare(freedom) / freedom)
            amplitude_m, phase_rad = 1e-6 + 1e-9 * random.standard_normal(), 1e-3 * random.standard_normal()
            estimate = Estimate(100.0, amplitude_m, u_m, phase_rad, u_m / 1e-6, noise_freedom=float(freedom))
            shots.append(ShotResult(index, index, 1e-4, 1.0, 100, 0, 1e-9, (estimate,), ()))
        mean = mean_of(shots)
        errors = np.abs([mean.amplitude_m - 1e-6, mean.phase_rad])
        within.append(errors < (mean.interval_95_m, mean.interval_95_rad))
    assert np.mean(within, axis=0) == pytest.approx(0.95, abs=3 * math.sqrt(0.95 * 0.05 / trials))
