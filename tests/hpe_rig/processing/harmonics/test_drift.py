"""Drift within a train: false alarms, the values at the first pulse and their u, and a motion that stops halfway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.processing import Motion, least_squares
from hpe_rig.processing.harmonics import drift as drift_module
from hpe_rig.processing.harmonics.drift import DELAY_SD_S, DEVIATION, GROWTH_SD, drift_of, with_drift_uncertainty

FloatArray = NDArray[np.float64]

HZ = 100.0 * np.arange(1.0, 6.0)
PHASORS_M = 1e-6 / np.arange(1.0, 6.0) * np.exp(-0.3j * np.arange(1.0, 6.0))
TIME_S = np.arange(800) / 4000
VALID = TIME_S % 0.01 > 2e-4
PART = (TIME_S - TIME_S[0]) / (TIME_S[-1] - TIME_S[0])
"""Time over the length of the train: 0 at the first pulse, 1 at the last."""


def moving(
    growth: FloatArray | float = 0.0, delay_s: FloatArray | float = 0.0, noise_m: float = 11.9e-9, seed: int = 1
) -> Motion:
    """Return a motion whose delays and logarithms of amplitudes grow linearly: all, or each harmonic's by its own."""
    growths, delays_s = np.broadcast_to(growth, HZ.shape), np.broadcast_to(delay_s, HZ.shape)
    late_s = TIME_S - PART * delays_s[:, None]
    waves = np.exp(growths[:, None] * PART) * (PHASORS_M[:, None] * np.exp(2j * np.pi * HZ[:, None] * late_s)).imag
    noise = noise_m * np.random.default_rng(seed).standard_normal(TIME_S.size)
    return Motion(TIME_S, waves.sum(axis=0) + noise, np.full(TIME_S.size, noise_m**2), VALID)


def test_a_steady_motion_is_called_drifting_as_often_as_stated() -> None:
    probabilities = np.array([drift_of(moving(seed=seed), HZ, max_iterations=1).probability for seed in range(200)])
    for stated in (0.05, 0.2):
        # The bound adds up six tests, nearly independent: the rate is below it by less than its square. 3 binomial sd.
        alarms, sd = np.mean(probabilities < stated), np.sqrt(stated * (1 - stated) / 200)
        assert stated - stated**2 - 3 * sd < alarms < stated + 3 * sd


@pytest.mark.parametrize("pulses", [240, 400])
def test_driven_frequencies_that_the_pulses_cannot_resolve_are_no_drift(pulses: int) -> None:
    """At 3990 Hz harmonics from 2100 Hz alias 10 Hz from the lower ones: 60 ms do not resolve these, 100 ms do."""
    time_s, driven_hz = np.arange(pulses) / 3990, 100.0 * np.arange(1.0, 61.0)
    phasors_m = 1e-6 * np.exp((-0.05 - 1j) * np.arange(60))

    def probabilities(delay_s: float) -> FloatArray:
        late_s = time_s - delay_s * time_s / time_s[-1]
        waves_m = (phasors_m[:, None] * np.exp(2j * np.pi * driven_hz[:, None] * late_s)).imag.sum(axis=0)
        noises_m = 10e-9 * np.random.default_rng(3).standard_normal((10, pulses))
        motions = (Motion(time_s, waves_m + noise_m, np.full(pulses, 1e-16), time_s >= 0) for noise_m in noises_m)
        drifts = (drift_of(motion, HZ, also_hz=driven_hz, max_iterations=1) for motion in motions)
        return np.array([drift.probability for drift in drifts])

    # One of ten steady trials has less than 0.1 % in 1 % of the cases.
    assert np.all(probabilities(0.0) > 1e-3)
    assert np.all(probabilities(80e-6) < 1e-3)


def test_a_common_drift_is_detected_where_no_single_harmonic_shows_it() -> None:
    """20 dB lower echoes: the delay of all harmonics together is five of its sd, that of each at most three."""
    drifts = [drift_of(moving(0.05, 40e-6, noise_m=119e-9, seed=seed), HZ, max_iterations=1) for seed in range(40)]
    together = np.mean([drift.probability < 0.01 for drift in drifts])
    alone = np.mean([drift.harmonic_probability.min() < 0.01 for drift in drifts])
    assert together > alone + 0.3


def test_values_at_the_first_pulse_are_within_their_u(monkeypatch: pytest.MonkeyPatch) -> None:
    """Growths and delays are drawn from the prior, so that NEV is 1, of each value and of all states together."""
    monkeypatch.setattr(drift_module, "RELATIVE_U", 0.0)  # the change is exactly linear
    rng, squares, joint = np.random.default_rng(7), list[float](), list[float]()
    for seed in range(60):
        growth, delay_s = (
            sd * (rng.standard_normal() + DEVIATION * rng.standard_normal(HZ.size)) for sd in (GROWTH_SD, DELAY_SD_S)
        )
        motion = moving(growth, delay_s, seed=seed)
        drift = drift_of(motion, HZ)
        steady = replace(motion, displacement_m=motion.displacement_m - drift.change_m(motion.time_s))
        fit = with_drift_uncertainty(least_squares(steady, HZ), drift)
        amplitude = (fit.amplitude_m - np.abs(PHASORS_M)) / np.sqrt(fit.covariance[:, 0, 0])
        phase = np.angle(np.exp(1j * fit.phase_rad) / PHASORS_M) / np.sqrt(fit.covariance[:, 1, 1])
        squares.append(np.mean([amplitude**2, phase**2]))
        error_m = fit.state[:10] - np.stack([PHASORS_M.real, PHASORS_M.imag], axis=-1).ravel()
        joint.append(error_m @ np.linalg.solve(fit.state_covariance[:10, :10], error_m) / 10)
    for values in (squares, joint):
        assert np.mean(values) == pytest.approx(1.0, abs=3 * np.std(values) / np.sqrt(len(values)))


def test_u_holds_a_warming_that_slows_down() -> None:
    """The temperature grows as log(1 + 2 t / 0.8 s): in 0.2 s the line through it is off by 4 % at its start."""
    law = np.log1p(0.5 * PART) / np.log1p(0.5)
    waves = np.exp(0.1 * law) * (PHASORS_M[:, None] * np.exp(2j * np.pi * HZ[:, None] * (TIME_S - 1e-4 * law))).imag
    motion = replace(moving(), displacement_m=waves.sum(axis=0))
    drift = drift_of(motion, HZ)
    fit = with_drift_uncertainty(
        least_squares(replace(motion, displacement_m=waves.sum(axis=0) - drift.change_m(motion.time_s)), HZ), drift
    )
    phase_errors = np.angle(np.exp(1j * fit.phase_rad) / PHASORS_M) / np.sqrt(fit.covariance[:, 1, 1])
    assert 0.2 < np.abs(phase_errors).max() < 2


def test_a_motion_that_stops_halfway_is_significant_in_every_harmonic() -> None:
    motion = moving()
    halved = replace(motion, displacement_m=np.where(PART < 0.5, 1.0, 0.5) * motion.displacement_m)
    drift = drift_of(halved, HZ, max_iterations=1)
    assert np.all(drift.harmonic_probability < 1e-6)
    # The line through a step of -0.5 has 1.5 times its height, relative to the mean of 0.75.
    assert 2 * drift.log_change.real == pytest.approx(-1.0, rel=0.15)


def test_too_few_pulses_for_a_change_are_refused() -> None:
    motion = Motion(TIME_S[:13], moving().displacement_m[:13], np.ones(13), np.ones(13, bool))
    with pytest.raises(ValueError, match="too few"):
        drift_of(motion, [500.0, 1000.0, 1500.0])
