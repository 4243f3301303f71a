"""Displacement and velocity of another program: the true motion within u, and one result from both quantities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.processing.stated_motion import fit_stated_motion

RATE_HZ, F_HZ, AMPLITUDE_M, PHASE_RAD, SERIES, NOISE_M = 2000.0, 150.0, 1e-6, 0.4, 300, 30e-9
TIME_S = np.arange(100) / RATE_HZ
OMEGA = 2 * np.pi * F_HZ
SETTINGS: dict[str, Any] = {"pulse_rate_hz": RATE_HZ, "frequencies_hz": [F_HZ, 2 * F_HZ]}


def displacement_m() -> NDArray[np.float64]:
    return np.asarray(AMPLITUDE_M * np.sin(OMEGA * TIME_S + PHASE_RAD))


def velocity_m_per_s() -> NDArray[np.float64]:
    return np.asarray(OMEGA * AMPLITUDE_M * np.cos(OMEGA * TIME_S + PHASE_RAD))


@pytest.mark.parametrize(
    ("quantity", "motion", "noise"),
    [
        ("displacement_m", displacement_m(), NOISE_M),
        pytest.param("velocity_m_per_s", velocity_m_per_s(), NOISE_M * OMEGA, marks=pytest.mark.slow),
    ],
)
def test_two_u_cover_the_true_motion(quantity: Any, motion: NDArray[np.float64], noise: float) -> None:
    series = motion + noise * np.random.default_rng(17).normal(size=(SERIES, motion.size))
    result = hpe.estimate_motion(series, quantity=quantity, frequency_accuracy=0.0, **SETTINGS)
    estimates = [shot.estimates[0] for shot in result.shots]
    # The 97.5 % quantile of Student's t with 94 or 95 degrees of freedom is 1.985.
    amplitude = [abs(item.amplitude_m - AMPLITUDE_M) < 1.985 * item.amplitude_uncertainty_m for item in estimates]
    phase = [abs(item.phase_rad - PHASE_RAD) < 1.985 * item.phase_uncertainty_rad for item in estimates]
    # Four standard deviations of a count with a probability of 95 %.
    tolerance = 4 * np.sqrt(0.95 * 0.05 / SERIES)
    assert np.mean(amplitude) == pytest.approx(0.95, abs=tolerance)
    assert np.mean(phase) == pytest.approx(0.95, abs=tolerance)
    # The residual is that of the displacement, and u is the bound s sqrt(2 / N): 94 degrees of freedom, and a slope
    # that takes up to 1 % of the sine.
    mean_u_m = np.mean([item.amplitude_uncertainty_m for item in estimates])
    assert mean_u_m == pytest.approx(NOISE_M * np.sqrt(2 / motion.size), rel=0.02)
    assert np.mean([shot.residual_m for shot in result.shots]) == pytest.approx(NOISE_M, rel=0.01)


def test_a_velocity_gives_the_result_of_its_displacement() -> None:
    missing = displacement_m()
    missing[[3, 40]] = np.nan
    by_displacement = hpe.estimate_motion(missing, **SETTINGS).shots[0]
    by_velocity = hpe.estimate_motion(velocity_m_per_s(), quantity="velocity_m_per_s", **SETTINGS).shots[0]
    assert (by_displacement.pulses_used, by_displacement.pulses_missing) == (98, 2)
    for shot in (by_displacement, by_velocity):
        # Without noise rounding to doubles remains.
        assert shot.estimates[0].amplitude_m == pytest.approx(AMPLITUDE_M, rel=1e-9)
        assert shot.estimates[0].phase_rad == pytest.approx(PHASE_RAD, abs=1e-9)


def test_missing_values_at_the_ends_leave_the_mean_velocity() -> None:
    valid = np.ones(TIME_S.size, bool)
    valid[:10] = valid[-20:] = False
    motion = displacement_m() + 3e-6 * TIME_S
    _, velocity, _ = fit_stated_motion(motion, valid, TIME_S, [F_HZ], "displacement")
    assert velocity == pytest.approx(3e-6, rel=1e-6)


def test_the_clock_is_part_of_the_phase_uncertainty() -> None:
    shot = hpe.estimate_motion(displacement_m(), frequency_accuracy=1e-4, **SETTINGS).shots[0]
    # A rate error of 1e-4 shifts the phase at the first pulse by 2 pi f times half the train.
    expected_rad = OMEGA * 1e-4 * TIME_S.mean()
    assert shot.estimates[0].phase_uncertainty_rad == pytest.approx(expected_rad, rel=0.02)


@pytest.mark.parametrize(
    ("quantity", "motion", "change"),
    [("displacement_m", displacement_m(), "1.995 m "), ("velocity_m_per_s", velocity_m_per_s(), "1880.2 m/s ")],
)
def test_values_in_micrometres_are_refused(quantity: Any, motion: NDArray[np.float64], change: str) -> None:
    with pytest.raises(ValueError, match=f"changes by up to {change}.* 1e-6 \\* motion"):
        hpe.estimate_motion([motion, 1e6 * motion], quantity=quantity, **SETTINGS)


def test_motion_that_is_not_fitted_is_reported() -> None:
    hum = 100e-9 * np.sin(2 * np.pi * 440.0 * TIME_S)
    noise = 1e-9 * np.random.default_rng(1).normal(size=TIME_S.size)
    derivative = 100e-9 * 2 * np.pi * 440.0 * np.cos(2 * np.pi * 440.0 * TIME_S)
    velocity = velocity_m_per_s() + derivative + noise * OMEGA
    for motion, quantity in ((displacement_m() + hum + noise, "displacement_m"), (velocity, "velocity_m_per_s")):
        warnings = hpe.estimate_motion(motion, quantity=quantity, **SETTINGS).shots[0].warnings
        lines = [warning for warning in warnings if warning.startswith("the residual has a line of ")]
        assert len(lines) == 1
        # In the middle of a bin, 1 nm of noise and the neighbouring harmonics change the amplitude by little.
        assert float(lines[0].split()[6]) == pytest.approx(100.0, rel=0.02)
        assert "at 440 Hz" in lines[0]


@pytest.mark.parametrize(
    ("change", "motion", "error", "message"),
    [
        ({"quantity": "displacement_um"}, displacement_m(), ValueError, "'displacement_m' or 'velocity_m_per_s'"),
        ({"pulse_rate_hz": 0.0}, displacement_m(), ValueError, "a positive rate"),
        ({"frequencies_hz": [1500.0]}, displacement_m(), ValueError, "pulse rate"),
        ({}, displacement_m()[:4], ValueError, "pulses"),
        ({}, displacement_m() * 1j, TypeError, "expected motion as real numbers"),
        ({}, np.zeros((2, 0)), ValueError, "it holds no motion"),
        ({}, np.full(100, np.nan), ValueError, "pulses"),
    ],
)
def test_a_wrong_call_is_refused(change: dict[str, Any], motion: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        hpe.estimate_motion(motion, **(SETTINGS | change))
