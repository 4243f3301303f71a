"""Motion without tonebursts, subtracted: a hum of fixed phase is removed, one of random phase is covered by u."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.budget import ErrorSources, estimates_of
from hpe_rig.processing.control import control_motions
from hpe_rig.processing.harmonics.harmonic_fit import least_squares
from hpe_rig.processing.motion.displacement import Motion

TIME_S = np.arange(200) / 3990.0
FREQUENCY_HZ = [100.0, 200.0]
NOISE_M = 10e-9
TRIALS = 200
VIBRATION = np.array([900e-9j, 400e-9])
"""A exp(j phase) of the motion due to tonebursts at both frequencies."""


def motion(phasors_m: ComplexArray, generator: np.random.Generator) -> Motion:
    """Return the displacement of sinusoids A sin(2 pi f t + phase) in white noise."""
    turns = np.exp(2j * np.pi * np.outer(TIME_S, FREQUENCY_HZ))
    displacement_m = (turns @ phasors_m).imag + NOISE_M * generator.standard_normal(TIME_S.size)
    return Motion(TIME_S, displacement_m, np.full(TIME_S.size, NOISE_M**2), np.ones(TIME_S.size, bool))


def hum(amplitude_m: float, phase_rad: float) -> ComplexArray:
    """Return the complex amplitudes of a hum at the first frequency."""
    return np.array([amplitude_m * np.exp(1j * phase_rad), 0.0])


def trials_of(controls: int, random_phase: bool) -> tuple[FloatArray, FloatArray]:
    """Return mean squared error over u² (frequency,), and the part of 95 % intervals that hold the amplitude.

    Both over ``TRIALS`` shots less one of ``controls`` controls, with a hum of 60 nm in each.
    """
    generator, squares, held = np.random.default_rng(3), [], []
    for _ in range(TRIALS):
        shot_rad, *phases_rad = (
            generator.uniform(0, 2 * np.pi, controls + 1) if random_phase else [1.0] * (controls + 1)
        )
        fits = [least_squares(motion(hum(60e-9, phase), generator), FREQUENCY_HZ) for phase in phases_rad]
        control = control_motions(dict(enumerate(fits)))[0]
        shot = motion(VIBRATION + hum(60e-9, shot_rad), generator)
        less_control = replace(shot, displacement_m=shot.displacement_m - control.displacement_m(TIME_S))
        fit = least_squares(less_control, FREQUENCY_HZ)
        error_m = fit.state[0:4:2] + 1j * fit.state[1:4:2] - VIBRATION
        total_m2 = np.diag(control.with_error(fit).state_covariance)[:4].reshape(2, 2).sum(axis=1)
        squares.append([np.abs(error_m) ** 2, total_m2])
        sources = ErrorSources(sound_speed_uncertainty=0.0, control=control)
        held.append(
            [
                abs(estimate.tracked_amplitude_m - abs(true)) < estimate.interval_95_m
                for estimate, true in zip(estimates_of(fit, sources), VIBRATION, strict=True)
            ]
        )
    error_m2, total_m2 = np.mean(squares, axis=0)
    return error_m2 / total_m2, np.mean(held, axis=0)


def test_a_hum_of_fixed_phase_is_removed() -> None:
    ratio, held = trials_of(4, random_phase=False)
    # Of a variance estimated as 0 or more the mean is above 0: u is some 10 % too large. A mean square of two
    # quadratures has a relative deviation of 1 / sqrt(TRIALS) = 0.07.
    assert np.all((ratio > 0.6) & (ratio < 1.2))
    assert np.all(held > 0.95 - 3 * np.sqrt(0.95 * 0.05 / TRIALS))


def test_the_error_of_a_control_is_in_amplitude_and_phase_where_a_weak_phase_is_at_most_unknown() -> None:
    generator = np.random.default_rng(5)
    control = control_motions({0: least_squares(motion(hum(300e-9, 1.0), generator), FREQUENCY_HZ)})[0]
    fit = least_squares(motion(np.array([900e-9j, 1e-9]), generator), FREQUENCY_HZ)
    added = np.diagonal(control.with_error(fit).covariance - fit.covariance, axis1=1, axis2=2)
    # A single control has a random phase: 2 s² is the square of the hum, to 0.7 % (noise of 1 nm in 300 nm).
    assert added[0] == pytest.approx([300e-9**2, (300 / 900) ** 2], rel=0.05)
    weak = replace(fit, amplitude_m=np.full(2, 1e-9))
    added = np.diagonal(control.with_error(weak).covariance - weak.covariance, axis1=1, axis2=2)
    # A phase anywhere in the circle has a variance of pi²/3.
    assert added[0, 1] == pytest.approx(np.pi**2 / 3)


@pytest.mark.parametrize("controls", [pytest.param(1, marks=pytest.mark.slow), 4])
def test_a_hum_of_random_phase_is_covered(controls: int) -> None:
    ratio, held = trials_of(controls, random_phase=True)
    assert ratio[0] == pytest.approx(1.0, abs=3 / np.sqrt(TRIALS))
    assert np.all(held > 0.95 - 3 * np.sqrt(0.95 * 0.05 / TRIALS))
