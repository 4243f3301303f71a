"""Shear field against the twin's own, the closed form on the axis, finite differences and a quadrature of its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hpe_rig.medium.ensemble import displacement
from hpe_rig.medium.push_force import PushForce
from hpe_rig.medium.shear_field import QUICK_ERROR, focal_motion, shear_motion
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
NARROW, WIDE = (0.17e-3, 1.80e-3), (0.34e-3, 3.60e-3)
PLACES = (np.array([0.0]), np.array([0.0, 0.3e-3, 1e-3]), np.array([0.5e-3, 6e-3]), np.array([5e-3, 20e-3]))
MEDIA = ((500.0, 0.0), (500.0, 50.0), (9e3, 0.0), (9e3, 2.0), (500e3, 0.0), (500e3, 50.0))


def ours(mu1: float, mu2: float, width_m: tuple[float, float], lateral_m: np.ndarray, axial_m: float) -> np.ndarray:
    modulus = mu1 + 2j * np.pi * FREQUENCY_HZ * mu2
    force = PushForce(width_m[:1], width_m[1])
    return shear_motion(modulus, FREQUENCY_HZ, 1000.0, force, 0.0, 0.0, lateral_m, axial_m).value


@pytest.mark.parametrize("width_m", [pytest.param(NARROW, marks=pytest.mark.slow), WIDE])
@pytest.mark.parametrize("medium", MEDIA)
def test_the_field_is_the_twins_to_1e_9_of_the_peak(medium: tuple[float, float], width_m: tuple[float, float]) -> None:
    specimen = Specimen(shear_modulus_pa=medium[0], shear_viscosity_pa_s=medium[1])
    round_width = (width_m[0], *width_m)
    peak = np.abs(field_transfer(specimen, round_width, np.zeros(1), np.zeros(1), FREQUENCY_HZ))[:, :, 0]
    for lateral_m in PLACES:
        for axial_m in (0.0, 1.5e-3):
            twin = field_transfer(specimen, round_width, lateral_m, np.array([axial_m]), FREQUENCY_HZ)[:, :, 0]
            np.testing.assert_array_less(np.abs(ours(*medium, width_m, lateral_m, axial_m) - twin) / peak, 1e-9)


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("lateral_m", [0.0, 1e-3, 20e-3])
def test_the_quick_field_is_the_full_one_to_1e_5_of_the_peak(medium: tuple[float, float], lateral_m: float) -> None:
    modulus = medium[0] + 2j * np.pi * FREQUENCY_HZ * medium[1]
    there, place = (modulus, FREQUENCY_HZ, 1000.0), np.array([lateral_m])
    full = shear_motion(*there, PushForce(WIDE[:1], WIDE[1]), 0.0, 0.0, place)
    peak = np.abs(ours(*medium, WIDE, np.zeros(1), 0.0))
    slopes = full.by_across * WIDE[0] ** 2, full.by_lateral * WIDE[0]
    value, by_across, by_lateral = focal_motion(*there, WIDE, WIDE[0] ** 2, WIDE[1] ** 2, place)
    quick = value, by_across * WIDE[0] ** 2, by_lateral * WIDE[0]
    for found, expected in zip(quick, (full.value, *slopes), strict=True):
        np.testing.assert_array_less(np.abs(found - expected) / peak, 1.2e-5)


@pytest.mark.parametrize("medium", MEDIA)
def test_the_quick_field_of_a_fit_is_as_good_as_it_says_before_and_behind_the_focus(
    medium: tuple[float, float],
) -> None:
    modulus, force = medium[0] + 2j * np.pi * FREQUENCY_HZ * medium[1], PushForce(WIDE[:1], WIDE[1])
    peak = np.abs(ours(*medium, WIDE, np.zeros(1), 0.0))
    for lateral_m in PLACES:
        full, quick = (
            shear_motion(modulus, FREQUENCY_HZ, 1000.0, force, 0.0, 0.0, lateral_m, 1.5e-3, quick).value
            for quick in (False, True)
        )
        np.testing.assert_array_less(np.abs(quick - full) / peak, QUICK_ERROR)


@pytest.mark.parametrize("medium", MEDIA)
def test_on_the_axis_it_is_the_closed_form_of_the_prior(medium: tuple[float, float]) -> None:
    # the closed form tells waves that come from those that go by a loss, were it ever so small
    mu1, mu2 = medium[0], max(medium[1], 1e-9)
    modulus = mu1 + 2j * np.pi * FREQUENCY_HZ * mu2
    shear_k2 = 1000.0 * (2 * np.pi * FREQUENCY_HZ) ** 2 / modulus
    squares = np.array([WIDE[0] ** 2]), np.array([WIDE[1] ** 2])
    front = WIDE[0] ** 2 * WIDE[1] / np.sqrt(2 * np.pi)
    closed = front * displacement(shear_k2[None], *squares, 96)[0] / modulus
    np.testing.assert_allclose(ours(mu1, mu2, WIDE, np.zeros(1), 0.0)[:, 0], closed, rtol=1e-9)


@pytest.mark.parametrize("wavelengths_over_width", [0.1, 0.3, 1.0, 30.0, 1000.0])
def test_waves_from_a_tenth_of_the_force_to_a_thousand_of_it(wavelengths_over_width: float) -> None:
    """Against the same integral over both wave numbers on a path of its own, by brute force: tolerance 1e-8 of peak."""
    frequency_hz = 200.0
    speed = frequency_hz * wavelengths_over_width * NARROW[0]
    # a little loss, so that the plain quadrature along its own path has no pole on it
    modulus = np.array([1000.0 * speed**2 * (1 + 0.1j)])
    lateral_m = np.array([0.0, 0.4e-3, 1.1e-3])
    force = PushForce(NARROW[:1], NARROW[1])
    found = shear_motion(modulus, np.array([frequency_hz]), 1000.0, force, 0.0, 0.0, lateral_m)
    expected = brute_force(modulus[0], frequency_hz, NARROW, lateral_m)
    assert np.abs(found.value[0] - expected).max() < 1e-8 * np.abs(expected).max()


def brute_force(
    modulus: complex, frequency_hz: float, width_m: tuple[float, float], lateral_m: np.ndarray
) -> np.ndarray:
    """Return the displacement per body force by Gauss quadrature in spherical wave numbers, real all along."""
    from scipy.special import j0

    q2 = 1000.0 * (2 * np.pi * frequency_hz) ** 2 / modulus
    m, m_weight = np.polynomial.legendre.leggauss(1200)
    m, m_weight = (m + 1) / 2, m_weight / 2
    last, pole = 9.0 / width_m[0], abs(np.sqrt(q2))
    edges = np.unique(np.concatenate([pole * np.linspace(0, 2.0, 41), np.geomspace(2 * pole, max(last, 3 * pole), 40)]))
    node, weight = np.polynomial.legendre.leggauss(20)
    total = np.zeros(lateral_m.size, np.complex128)
    for low, high in pairwise(edges):
        k = (low + high) / 2 + (high - low) / 2 * node
        a = (width_m[0] ** 2 * (1 - m**2) + width_m[1] ** 2 * m**2) / 2
        radial = (k**2 / (k**2 - q2) * (high - low) / 2 * weight)[:, None] * np.exp(-np.outer(k**2, a))
        waves = j0(k[:, None, None] * np.sqrt(1 - m**2)[None, :, None] * lateral_m)
        total += np.einsum("km,m,kmr->r", radial, m_weight * (1 - m**2), waves, optimize=True)
    return width_m[0] ** 2 * width_m[1] / np.sqrt(2 * np.pi) / modulus * 2 * total


def test_derivatives_are_those_of_finite_differences() -> None:
    frequency_hz, lateral_m, axial_m = FREQUENCY_HZ, np.array([0.0, 0.5e-3, 2e-3, -3e-3]), 1.2e-3
    modulus, seen, along = 9e3 + 4j * np.pi * frequency_hz, 0.12e-3**2, 0.6e-3**2
    force = PushForce((0.34e-3, 0.9e-3), 3.6e-3, (-4e-3, 0.5e-3), ((0.1, 0.3), (0.8, 0.2)))

    def value(modulus=modulus, seen=seen, wide=1.0, deep=1.0, lateral_m=lateral_m, axial_m=axial_m):
        own = force.scaled(wide, deep)
        return shear_motion(modulus, frequency_hz, 1000.0, own, seen, along, lateral_m, axial_m)

    found, step = value(), 1e-5
    peak = np.abs(found.value).max()

    def compare(up: np.ndarray, down: np.ndarray, derivative: np.ndarray, unit: float) -> None:
        # central differences: a step of 1e-5 leaves about its square and the rounding over it
        assert np.abs((up - down) / (2 * step) - derivative * unit).max() < 1e-8 * peak

    compare(
        value(modulus * (1 + step)).value, value(modulus * (1 - step)).value, found.by_modulus * modulus[:, None], 1
    )
    compare(value(seen=seen * (1 + step)).value, value(seen=seen * (1 - step)).value, found.by_across, seen)
    compare(value(wide=1 + step).value, value(wide=1 - step).value, found.by_width, 1)
    compare(value(deep=1 + step).value, value(deep=1 - step).value, found.by_length, 1)
    shift = 1e-3 * step
    compare(value(lateral_m=lateral_m + shift).value, value(lateral_m=lateral_m - shift).value, found.by_lateral, 1e-3)
    compare(value(axial_m=axial_m + shift).value, value(axial_m=axial_m - shift).value, found.by_axial, 1e-3)


def test_areas_of_their_own_at_every_place_are_those_of_one_at_a_time() -> None:
    modulus, lateral_m = 9e3 + 4j * np.pi * FREQUENCY_HZ, np.array([0.0, 1e-3, 4e-3])
    seen, force = np.array([0.0, 0.1, 0.3]) * 0.34e-3**2, PushForce(WIDE[:1], WIDE[1])
    together = shear_motion(modulus, FREQUENCY_HZ, 1000.0, force, seen, 0.0, lateral_m)
    for place in range(3):
        alone = shear_motion(modulus, FREQUENCY_HZ, 1000.0, force, float(seen[place]), 0.0, lateral_m[[place]])
        np.testing.assert_allclose(together.value[:, place], alone.value[:, 0], atol=1e-11 * np.abs(alone.value).max())
