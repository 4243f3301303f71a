"""Shear field against the twin's, the closed form on the axis, finite differences and a brute-force quadrature."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hpe_rig.medium import QUICK_ERROR, HarmonicMedium, PushForce, TrackedRegion, shear_motion
from hpe_rig.medium.focal_field import focal_displacement
from hpe_rig.medium.shear_field import focal_plane_motion
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
NARROW, WIDE = (0.17e-3, 1.80e-3), (0.34e-3, 3.60e-3)
PLACES = (np.array([0.0]), np.array([0.0, 0.3e-3, 1e-3]), np.array([0.5e-3, 6e-3]), np.array([5e-3, 20e-3]))
MEDIA = ((500.0, 0.0), (500.0, 50.0), (9e3, 0.0), (9e3, 2.0), (500e3, 0.0), (500e3, 50.0))


def displacement(
    mu1: float, mu2: float, width_m: tuple[float, float], lateral_m: np.ndarray, axial_m: float
) -> np.ndarray:
    medium = HarmonicMedium.voigt(mu1, mu2, FREQUENCY_HZ)
    return shear_motion(medium, PushForce(width_m[:1], width_m[1]), TrackedRegion(lateral_m, axial_m)).value


@pytest.mark.parametrize("width_m", [pytest.param(NARROW, marks=pytest.mark.slow), WIDE])
@pytest.mark.parametrize(
    "medium", [pytest.param(each, marks=() if each == MEDIA[1] else pytest.mark.slow) for each in MEDIA]
)
def test_the_field_equals_the_twins_to_1e_9_of_the_peak(
    medium: tuple[float, float], width_m: tuple[float, float]
) -> None:
    specimen = Specimen(shear_modulus_pa=medium[0], shear_viscosity_pa_s=medium[1])
    round_width = (width_m[0], *width_m)
    peak = np.abs(field_transfer(specimen, round_width, np.zeros(1), np.zeros(1), FREQUENCY_HZ))[:, :, 0]
    for lateral_m in PLACES:
        for axial_m in (0.0, 1.5e-3):
            twin = field_transfer(specimen, round_width, lateral_m, np.array([axial_m]), FREQUENCY_HZ)[:, :, 0]
            np.testing.assert_array_less(np.abs(displacement(*medium, width_m, lateral_m, axial_m) - twin) / peak, 1e-9)


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("lateral_m", [0.0, 1e-3, 20e-3])
def test_the_focal_plane_motion_equals_the_full_field_to_1e_5_of_the_peak(
    medium: tuple[float, float], lateral_m: float
) -> None:
    voigt, offset_m = HarmonicMedium.voigt(*medium, FREQUENCY_HZ), np.array([lateral_m])
    full = shear_motion(voigt, PushForce(WIDE[:1], WIDE[1]), TrackedRegion(offset_m))
    peak = np.abs(displacement(*medium, WIDE, np.zeros(1), 0.0))
    slopes = full.by_across * WIDE[0] ** 2, full.by_lateral * WIDE[0]
    value, by_across, by_lateral = focal_plane_motion(voigt, WIDE, WIDE[0] ** 2, WIDE[1] ** 2, offset_m)
    quick = value, by_across * WIDE[0] ** 2, by_lateral * WIDE[0]
    for actual, expected in zip(quick, (full.value, *slopes), strict=True):
        np.testing.assert_array_less(np.abs(actual - expected) / peak, 1.2e-5)


@pytest.mark.parametrize("medium", MEDIA)
def test_the_quick_field_keeps_its_stated_error_off_the_focal_plane(
    medium: tuple[float, float],
) -> None:
    voigt, force = HarmonicMedium.voigt(*medium, FREQUENCY_HZ), PushForce(WIDE[:1], WIDE[1])
    peak = np.abs(displacement(*medium, WIDE, np.zeros(1), 0.0))
    for lateral_m in PLACES:
        full, quick = (
            shear_motion(voigt, force, TrackedRegion(lateral_m, 1.5e-3), quick).value for quick in (False, True)
        )
        np.testing.assert_array_less(np.abs(quick - full) / peak, QUICK_ERROR)


@pytest.mark.parametrize("medium", MEDIA)
def test_the_field_on_the_axis_equals_the_closed_form(medium: tuple[float, float]) -> None:
    # The closed form needs some loss to select outgoing waves.
    mu1, mu2 = medium[0], max(medium[1], 1e-9)
    voigt = HarmonicMedium.voigt(mu1, mu2, FREQUENCY_HZ)
    squares = np.array([WIDE[0] ** 2]), np.array([WIDE[1] ** 2])
    front = WIDE[0] ** 2 * WIDE[1] / np.sqrt(2 * np.pi)
    closed = front * focal_displacement(voigt.shear_k2[None], *squares, 96)[0][0] / voigt.modulus_pa
    np.testing.assert_allclose(displacement(mu1, mu2, WIDE, np.zeros(1), 0.0)[:, 0], closed, rtol=1e-9)


@pytest.mark.parametrize(
    "wavelengths_over_width",
    [0.1, *(pytest.param(each, marks=pytest.mark.slow) for each in (0.3, 1.0, 30.0)), 1000.0],
)
def test_wavelengths_from_a_tenth_to_a_thousand_force_widths(wavelengths_over_width: float) -> None:
    """Against the integral over both wave numbers along the real axis: tolerance 1e-8 of the peak."""
    frequency_hz = 200.0
    speed = frequency_hz * wavelengths_over_width * NARROW[0]
    # Some loss keeps the pole off the real axis of the brute-force quadrature.
    modulus = np.array([1000.0 * speed**2 * (1 + 0.1j)])
    lateral_m = np.array([0.0, 0.4e-3, 1.1e-3])
    force = PushForce(NARROW[:1], NARROW[1])
    field = shear_motion(HarmonicMedium(np.array([frequency_hz]), modulus), force, TrackedRegion(lateral_m))
    expected = brute_force(modulus[0], frequency_hz, NARROW, lateral_m)
    assert np.abs(field.value[0] - expected).max() < 1e-8 * np.abs(expected).max()


def brute_force(
    modulus: complex, frequency_hz: float, width_m: tuple[float, float], lateral_m: np.ndarray
) -> np.ndarray:
    """Return the displacement per body force by Gauss quadrature over real spherical wave numbers."""
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


def test_derivatives_equal_finite_differences() -> None:
    frequency_hz, lateral_m, axial_m = FREQUENCY_HZ, np.array([0.0, 0.5e-3, 2e-3, -3e-3]), 1.2e-3
    modulus, across_m2, along_m2 = 9e3 + 4j * np.pi * frequency_hz, 0.12e-3**2, 0.6e-3**2
    force = PushForce((0.34e-3, 0.9e-3), 3.6e-3, (-4e-3, 0.5e-3), ((0.1, 0.3), (0.8, 0.2)))

    def field(modulus=modulus, across_m2=across_m2, width=1.0, length=1.0, lateral_m=lateral_m, axial_m=axial_m):
        region = TrackedRegion(lateral_m, axial_m, across_m2, along_m2)
        return shear_motion(HarmonicMedium(frequency_hz, modulus), force.scaled(width, length), region)

    exact, step = field(), 1e-5
    peak = np.abs(exact.value).max()

    def compare(up: np.ndarray, down: np.ndarray, derivative: np.ndarray, unit: float) -> None:
        # Central differences: the error is the square of the step plus rounding over the step.
        assert np.abs((up - down) / (2 * step) - derivative * unit).max() < 1e-8 * peak

    compare(
        field(modulus * (1 + step)).value, field(modulus * (1 - step)).value, exact.by_modulus * modulus[:, None], 1
    )
    wider, narrower = (field(across_m2=across_m2 * (1 + sign * step)).value for sign in (1, -1))
    compare(wider, narrower, exact.by_across, across_m2)
    compare(field(width=1 + step).value, field(width=1 - step).value, exact.by_width, 1)
    compare(field(length=1 + step).value, field(length=1 - step).value, exact.by_length, 1)
    shift = 1e-3 * step
    compare(field(lateral_m=lateral_m + shift).value, field(lateral_m=lateral_m - shift).value, exact.by_lateral, 1e-3)
    compare(field(axial_m=axial_m + shift).value, field(axial_m=axial_m - shift).value, exact.by_axial, 1e-3)


def test_one_area_for_each_point_equals_one_point_at_a_time() -> None:
    medium, lateral_m = HarmonicMedium.voigt(9e3, 2.0, FREQUENCY_HZ), np.array([0.0, 1e-3, 4e-3])
    across_m2, force = np.array([0.0, 0.1, 0.3]) * 0.34e-3**2, PushForce(WIDE[:1], WIDE[1])
    together = shear_motion(medium, force, TrackedRegion(lateral_m, 0.0, across_m2)).value
    for point in range(3):
        single = shear_motion(medium, force, TrackedRegion(lateral_m[[point]], 0.0, float(across_m2[point]))).value
        np.testing.assert_allclose(together[:, point], single[:, 0], atol=1e-11 * np.abs(single).max())
