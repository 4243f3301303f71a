"""Errors of one shot's complex values: intervals of ratios between harmonics hold the truth."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing import Motion, estimates_of, least_squares
from hpe_rig.processing.budget import ErrorSources
from hpe_rig.processing.control import ControlMotion
from hpe_rig.processing.error_influences import error_influences
from hpe_rig.result import Covariance, ShotResult
from hpe_rig.result.covariance import covariance_of

FREQUENCY_HZ = np.array([100.0, 200.0, 300.0])
TRUE_M = 1e-6 * np.array([1.0, 0.7j, -0.4 - 0.3j])
NOISE_M = 1e-8
DRAWS = 100


def covariance_of_draw(rng: np.random.Generator) -> Covariance:
    """Return the covariance of a fit to pulses in 60 % of each period, whose columns are strongly correlated."""
    time_s = np.concatenate([np.linspace(0, 6e-3, 9) + period * 10e-3 for period in range(2)])
    motion_m = np.exp(2j * np.pi * np.outer(time_s, FREQUENCY_HZ)) @ TRUE_M
    motion = Motion(
        time_s=time_s,
        displacement_m=motion_m.imag + NOISE_M * rng.standard_normal(time_s.size),
        variance_m2=np.full(time_s.size, NOISE_M**2),
        valid=np.ones(time_s.size, bool),
    )
    fit = least_squares(motion, FREQUENCY_HZ)
    sources = ErrorSources(sound_speed_uncertainty=0.005)
    estimates = estimates_of(fit, sources)
    shot = ShotResult(
        index=0,
        repeat=0,
        burst_length_s=None,
        force_fraction=None,
        pulses_used=time_s.size,
        pulses_missing=0,
        residual_m=NOISE_M,
        estimates=estimates,
        warnings=(),
        influences=error_influences(fit, estimates, (None,) * FREQUENCY_HZ.size, False, sources),
    )
    return covariance_of([[shot]])


def test_intervals_of_ratios_between_harmonics_hold_the_truth() -> None:
    """95 % +- three standard deviations of a binomial count of 100 draws, 2.2 % each; 11 degrees of freedom."""
    rng, held, independent = np.random.default_rng(1), [], []
    for _ in range(DRAWS):
        covariance = covariance_of_draw(rng)
        y = covariance.phasor_m[0]
        for other in (1, 2):
            weights = np.zeros((1, FREQUENCY_HZ.size), np.complex128)
            weights[0, [0, other]] = -1 / y[0], 1 / y[other]
            error = np.log(y[other] / y[0] / (TRUE_M[other] / TRUE_M[0]))
            stated = covariance.combined(weights)
            held.append(np.abs([error.real, error.imag]) < stated.interval_95)
            # As if the harmonics were independent, as amplitudes with their u alone suggest.
            alone = [covariance.combined(weights * (np.arange(3) == index)).covariance for index in (0, other)]
            independent.append(np.sqrt(np.diag(sum(alone))) / stated.uncertainty)
    by_ratio = np.reshape(held, (DRAWS, 4)).mean(axis=0)
    assert by_ratio == pytest.approx(0.95, abs=3 * np.sqrt(0.95 * 0.05 / DRAWS))
    # Sums of variances would be wrong by far.
    assert np.abs(np.log(np.reshape(independent, (DRAWS, 4)).mean(axis=0))).max() > 0.3


def test_every_error_has_the_degrees_of_freedom_of_its_scatter() -> None:
    """A variance of which half is noise with 11 degrees of freedom has 11 / 0.5^2 (Welch-Satterthwaite)."""
    time_s = np.arange(60) / 1990
    motion_m = (np.exp(2j * np.pi * np.outer(time_s, FREQUENCY_HZ)) @ TRUE_M).imag
    rng = np.random.default_rng(2)
    fit, control = (
        least_squares(
            Motion(time_s, size * motion_m + NOISE_M * rng.standard_normal(60), np.ones(60), np.ones(60, bool)),
            FREQUENCY_HZ,
        )
        for size in (1.0, 0.1)
    )
    sources = ErrorSources(
        control=ControlMotion(control, np.full(3, NOISE_M**2), 2.0),
        time_base_m=1j * NOISE_M * FREQUENCY_HZ / 100,
        time_base_freedom=11 / 0.5**2,
        time_base_clock_fraction=0.5,
    )
    errors = error_influences(fit, estimates_of(fit, sources), (None,) * 3, False, sources)
    of_shot = {error.source: error.degrees_of_freedom for error in errors if error.common_to == "shot"}
    residual_freedom = 60 - 7  # pulses - unknowns
    of_sources = {"noise": residual_freedom, "control": residual_freedom, "control scatter": 2, "time base": 11}
    assert of_shot == {**of_sources, "trigger jitter": np.inf}
