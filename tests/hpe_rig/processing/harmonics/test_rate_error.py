"""Rate error of the motion's clock: estimated within its uncertainty, and bounds of the phase as in the literature."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import BeamWidths
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, least_squares
from hpe_rig.processing.harmonics.medium_fit import medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_prior
from hpe_rig.processing.harmonics.rate_error import RateError, estimate_rate_error, with_rate_error
from hpe_rig.processing.motion.displacement import Motion

NOISE_M, NONE_HZ = 77e-9, np.zeros(0)
BEAMS = BeamWidths((0.17e-3, 0.17e-3, 1.80e-3), (0.078e-3, 0.078e-3, 0.83e-3), 0.3e-3)
WANTED_HZ = 100.0 * np.arange(1.0, 11.0)


def sampled(phasor_m: ComplexArray, base_hz: float, time_s: FloatArray, error: float, seed: int) -> Motion:
    """Return noisy motion with the multiples of ``base_hz`` (1 + ``error``) at ``time_s``."""
    valid = (time_s % 0.01 > 105e-6) & (time_s % 0.01 < 0.01 - 95e-6)
    angle_rad = 2 * np.pi * base_hz * (1 + error) * np.outer(time_s, np.arange(1, phasor_m.size + 1))
    clean_m = (np.exp(1j * angle_rad) @ phasor_m).imag
    noise_m = np.random.default_rng(seed).normal(0, NOISE_M, time_s.size)
    return Motion(time_s, clean_m + noise_m, np.full(time_s.size, NOISE_M**2), valid)


def phasors(fit: HarmonicFit) -> ComplexArray:
    return np.asarray(fit.amplitude_m * np.exp(1j * fit.phase_rad))


def medium_motion(prior: MediumPrior) -> ComplexArray:
    """Return the phasors of the member of the ensemble with the median amplitude at 1 kHz, scaled to 0.5 um rms."""
    member = np.argsort(prior.amplitude_m[:, 9])[prior.members // 2]
    real, imaginary = np.split(prior.sample_responses[member], 2)
    return np.asarray(0.5e-6 * (prior.node_to_harmonic @ (real + 1j * imaginary)))


@pytest.mark.parametrize("error", [pytest.param(0.0, marks=pytest.mark.slow), 5e-5])
def test_error_and_phases_with_a_prior_of_media_are_within_their_uncertainties(error: float) -> None:
    prior = medium_prior(BEAMS, 100.0, 100e-6)
    truth_m = medium_motion(prior)
    time_s = 0.05 + 131e-6 + np.arange(1596) / 3990.0  # 0.4 s
    scores, phase_scores = [], []
    for seed in range(3):
        motion = sampled(truth_m, 100.0, time_s, error, seed)
        rate = estimate_rate_error(motion, WANTED_HZ, RateError(0.0, 50e-6), also_hz=NONE_HZ, prior=prior)
        scores.append((rate.value - error) / rate.uncertainty)
        fits = [
            medium_fit(with_rate_error(motion, rate.value + sign * rate.uncertainty), WANTED_HZ, prior).fit
            for sign in (0, 1, -1)
        ]
        best, fast, slow = map(phasors, fits)
        u_rad = np.hypot(np.sqrt(fits[0].covariance[:, 1, 1]), ((fast - slow) / 2 / best).imag)
        phase_scores.append(np.angle(best / truth_m[:10]) / u_rad)
    # Mean squares of 3 draws of a standard normal deviate: below 3.78 with 99 % (chi-square).
    assert np.mean(np.square(scores)) < 3.78
    assert np.mean(np.square(phase_scores)) < 3.78


def test_uncertainties_of_frequency_and_phase_are_the_bounds_of_the_literature() -> None:
    """Rife and Boorstyn, 1974: var w = 24 s^2 / (A^2 N T^2), and the variance of a phase at the start is 4 times that
    with a known frequency, for N pulses over a time T."""
    amplitude_m, pulses = 1e-6, 4000
    time_s = np.arange(pulses) / 2000.0
    motion = sampled(np.array([amplitude_m + 0j]), 200.0, time_s, 3e-6, 1)
    rate = estimate_rate_error(motion, np.array([200.0]), RateError(0.0, 1e-3), also_hz=NONE_HZ)
    used = motion.valid.sum()
    bound = math.sqrt(24 / used) * NOISE_M / amplitude_m / 2.0 / (2 * math.pi * 200.0)
    # The residual of 4000 pulses gives the noise within 1.1 % (1 sd); gaps and the finite train 1 %.
    assert rate.uncertainty == pytest.approx(bound, rel=0.05)
    assert abs(rate.value - 3e-6) < 3 * rate.uncertainty
    fits = [
        least_squares(with_rate_error(motion, rate.value + sign * rate.uncertainty), [200.0]) for sign in (0, 1, -1)
    ]
    known_rad2 = float(fits[0].covariance[0, 1, 1])
    clock_rad = float(fits[1].phase_rad[0] - fits[2].phase_rad[0]) / 2
    assert known_rad2 + clock_rad**2 == pytest.approx(4 * known_rad2, rel=0.05)


@pytest.mark.parametrize("error", [-5e-5, 1.3e-4])
def test_a_scan_finds_errors_of_many_turns(error: float) -> None:
    """100 s at 200 Hz and 1.3e-4 are 2.6 turns: without a scan Gauss-Newton stays at a side maximum."""
    time_s = np.arange(50_000) / 500.0
    motion = sampled(np.array([1e-7 + 0j]), 200.0, time_s, error, 2)
    rate = estimate_rate_error(motion, np.array([200.0]), RateError(0.0, 5e-5), also_hz=NONE_HZ)
    assert rate.uncertainty < 2e-7
    assert rate.value == pytest.approx(error, abs=3.5 * rate.uncertainty)


def test_noise_alone_leaves_the_prior() -> None:
    time_s = np.arange(50_000) / 500.0
    motion = sampled(np.array([0j]), 200.0, time_s, 0.0, 3)
    rate = estimate_rate_error(motion, np.array([200.0]), RateError(1e-6, 5e-5), also_hz=NONE_HZ)
    assert rate.uncertainty > 0.5e-5
    exact = RateError(2e-6, 0.0)
    assert estimate_rate_error(motion, np.array([200.0]), exact, also_hz=NONE_HZ) is exact


def test_an_error_beyond_its_prior_is_not_drawn_to_the_mean() -> None:
    time_s = np.arange(4000) / 2000.0
    deviations = []
    for seed in range(10):
        motion = sampled(np.array([1e-6 + 0j]), 200.0, time_s, 6e-5, seed)
        rate = estimate_rate_error(motion, np.array([200.0]), RateError(0.0, 5e-6), also_hz=NONE_HZ)
        deviations.append((rate.value - 6e-5) / rate.uncertainty)
    # The mean of 10 standard normal deviates is within 1 with 99.8 %; drawn to a prior of 5 ppm it would be -5.
    assert abs(np.mean(deviations)) < 1.0
