"""Shear wave speed and Voigt moduli against the reference's figures and their own stated uncertainties."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.moduli.shear_speed import fit_voigt, shear_speed, voigt_speed
from hpe_rig.result import Estimate

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)


@pytest.mark.parametrize(
    ("elasticity_pa", "speeds"),
    [
        (4.0e3, (2.018, 2.072, 2.262, 3.113)),
        (7.25e3, (2.700, 2.723, 2.809, 3.306)),
        (13.5e3, (3.677, 3.686, 3.721, 3.952)),
    ],
)
def test_voigt_speeds_are_the_references(elasticity_pa: float, speeds: tuple[float, ...]) -> None:
    found = voigt_speed(np.array([100.0, 200.0, 400.0, 1000.0]), elasticity_pa, 1.0)
    np.testing.assert_allclose(found, speeds, atol=6e-4)
    omega = 2 * np.pi * 400.0
    wavenumber = omega * np.sqrt(1000.0 / (elasticity_pa + 1j * omega))
    assert voigt_speed(400.0, elasticity_pa, 1.0) == pytest.approx(omega / wavenumber.real, rel=1e-12)


def test_two_places_give_the_references_uncertainty() -> None:
    phase = np.array([[0.0], [-2 * np.pi * 200 * 4e-3 / 2.0]])
    # the phase falls by 2.5 rad in 4 mm; 1 degree each: 0.020 m/s
    speed, uncertainty = shear_speed([0.0, 4e-3], [200.0], phase, np.full((2, 1), np.radians(1.0)))
    assert speed[0] == pytest.approx(2.0, rel=1e-12)
    assert uncertainty[0] == pytest.approx(0.020, rel=0.03)


@pytest.mark.parametrize("draws", [60, pytest.param(600, marks=pytest.mark.slow)])
def test_the_stated_uncertainty_of_the_speed_is_true_and_the_moduli_have_no_bias(draws: int) -> None:
    generator = np.random.default_rng(1)
    places = np.array([1e-3, 2e-3, 3e-3, 4e-3])
    speed = voigt_speed(FREQUENCY_HZ, 4.0e3, 1.0)
    clean = -2 * np.pi * FREQUENCY_HZ * places[:, None] / speed + 0.5
    sigma = np.full(clean.shape, np.radians(2.0))
    speeds, moduli = [], []
    for _ in range(draws):
        noisy = np.angle(np.exp(1j * (clean + sigma * generator.standard_normal(clean.shape))))
        measured, uncertainty = shear_speed(places, FREQUENCY_HZ, noisy, sigma)
        fit = fit_voigt(FREQUENCY_HZ, measured, uncertainty)
        speeds.append((measured - speed) / uncertainty)
        moduli.append((fit.elasticity_pa, fit.viscosity_pa_s))
    # A variance of 1 from n figures is known to sqrt(2 / n): ten speeds a draw; three of these.
    assert np.mean(np.square(speeds)) == pytest.approx(1, abs=3 * np.sqrt(2 / (10 * draws)))
    # The mean moduli are within three of their standard errors of the truth.
    error = np.mean(moduli, axis=0) - [4.0e3, 1.0]
    assert np.all(np.abs(error) < 3 * np.std(moduli, axis=0) / np.sqrt(draws))


def _run(place_m: float, speed: np.ndarray) -> tuple[Estimate, ...]:
    phase = np.angle(np.exp(-2j * np.pi * FREQUENCY_HZ * place_m / speed))
    figures = zip(FREQUENCY_HZ.tolist(), phase.tolist(), strict=True)
    return tuple(Estimate(f, 1e-7, 1e-9, angle, 0.01, None, None, None, None) for f, angle in figures)


def test_order_of_places_does_not_matter_and_noise_free_phases_are_exact() -> None:
    places = np.array([3e-3, 1e-3, 2e-3])
    speed = voigt_speed(FREQUENCY_HZ, 7.25e3, 1.0)
    phase = -2 * np.pi * FREQUENCY_HZ * places[:, None] / speed
    measured, uncertainty = shear_speed(places, FREQUENCY_HZ, phase, np.zeros(phase.shape))
    np.testing.assert_allclose(measured, speed, rtol=1e-12)
    fit = fit_voigt(FREQUENCY_HZ, measured, uncertainty)
    assert fit.elasticity_pa == pytest.approx(7.25e3, rel=1e-6)
    assert fit.viscosity_pa_s == pytest.approx(1.0, rel=1e-6)


def test_data_without_a_speed_are_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="two different"):
        shear_speed([1e-3, 1e-3], [100.0], np.zeros((2, 1)), np.ones((2, 1)))
    with pytest.raises(ValueError, match="does not fall"):
        shear_speed([1e-3, 2e-3], [100.0], np.array([[0.0], [0.3]]), np.ones((2, 1)))
    one = shear_speed([0.0, 1e-3], [100.0], np.array([[0.0], [-0.3]]), np.ones((2, 1)))
    with pytest.raises(ValueError, match="at least two"):
        fit_voigt(np.array([100.0]), *one)
