"""The push's intensity as a sum of Gaussians: near the bowl's own, and the field under it by a plain quadrature."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j0

from sim_backend.motion import field_transfer, focus_transfer, force_shape, frequency_response, shear_modulus
from sim_backend.settings import SimulationSettings, Specimen, Transducer
from sim_backend.transducer import GaussianSum, bowl_pressure, push_intensity, wave_number

APERTURE = SimulationSettings.model_validate(
    {"beams": {"field": "aperture"}, "specimen": {"shear_modulus_pa": 4e3, "shear_viscosity_pa_s": 1.0}}
)
SPECIMEN = APERTURE.specimen or Specimen()
FREQUENCY_HZ = np.array([100.0, 400.0, 1000.0])


def bowl_intensity(lateral_m: NDArray[np.float64], axial_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bowl's intensity over the focus', (axial, lateral)."""
    k = wave_number(SPECIMEN.resonance_hz, 1540.0, SPECIMEN.attenuation_db_per_cm_mhz)
    focus = bowl_pressure(Transducer(), k, np.zeros(1), np.zeros(1))[0, 0]
    return np.abs(bowl_pressure(Transducer(), k, lateral_m, axial_m) / focus) ** 2


def under(spectrum: NDArray[np.complex128], across: NDArray[np.float64], along: NDArray[np.float64], point):
    """Return the displacement of a force of this spectrum (along, across) by the trapezoidal rule, (frequency,)."""
    lateral_m, axial_m = point
    s = 2j * np.pi * FREQUENCY_HZ
    k2 = across**2 + along[:, None] ** 2
    weight = np.gradient(across) * across * j0(across * lateral_m) * across**2 / k2
    wave = spectrum * weight * np.exp(1j * along * axial_m)[:, None] * (along[1] - along[0]) / (2 * np.pi) ** 2
    moduli = shear_modulus(SPECIMEN, s)
    return np.array([(wave / (mu * k2 + 1000.0 * each**2)).sum() for mu, each in zip(moduli, s, strict=True)])


def test_the_sum_of_gaussians_is_near_the_bowls_intensity() -> None:
    lateral_m, axial_m = np.linspace(0, 3e-3, 61), np.linspace(-12e-3, 12e-3, 49)
    r, z = (each.ravel() for each in np.meshgrid(lateral_m, axial_m))
    error = push_intensity(APERTURE).at(r, z).reshape(49, 61) - bowl_intensity(lateral_m, axial_m)
    assert np.abs(error).max() < 0.025
    assert np.sqrt((error**2 * lateral_m).sum() / (bowl_intensity(lateral_m, axial_m) ** 2 * lateral_m).sum()) < 0.05


def test_one_gaussian_of_a_sum_is_the_closed_form() -> None:
    width_m = (0.34e-3, 0.34e-3, 3.6e-3)
    alone = GaussianSum(width_m[:1], width_m[2], (0.0,), ((1.0,),))
    result, closed = (focus_transfer(SPECIMEN, each, FREQUENCY_HZ) for each in (alone, width_m))
    assert np.abs(result / closed - 1).max() < 1e-9
    assert np.array_equal(closed, frequency_response(SPECIMEN, width_m, FREQUENCY_HZ))


@pytest.mark.parametrize(
    "point",
    [
        (0.4e-3, -1.5e-3),
        pytest.param((0.0, 0.0), marks=pytest.mark.slow),
        pytest.param((2e-3, 1e-3), marks=pytest.mark.slow),
    ],
)
def test_the_field_under_a_sum_is_that_of_a_plain_quadrature(point: tuple[float, float]) -> None:
    force = GaussianSum((0.3e-3, 0.9e-3), 2.0e-3, (-3e-3, 1e-3), ((0.7, 0.1), (0.5, -0.2)))
    across, along = np.linspace(0, 18e3, 2001)[1:], np.linspace(-3e3, 3e3, 801)
    spectrum = np.zeros((len(along), len(across)), np.complex128)
    for centre, shares in zip(force.centre_m, force.amplitude, strict=True):
        for width, share in zip(force.lateral_width_m, shares, strict=True):
            volume = (2 * np.pi) ** 1.5 * width**2 * force.axial_width_m
            along_it = np.exp(-0.5 * (along * force.axial_width_m) ** 2 - 1j * along * centre)
            spectrum += share * volume * np.outer(along_it, np.exp(-0.5 * (across * width) ** 2))
    result = field_transfer(SPECIMEN, force, np.array([point[0]]), np.array([point[1]]), FREQUENCY_HZ)[:, 0, 0]
    focus = np.abs(field_transfer(SPECIMEN, force, np.zeros(1), np.zeros(1), FREQUENCY_HZ)[:, 0, 0])
    assert (np.abs(result - under(spectrum, across, along, point)) < 1e-3 * focus).all()


@pytest.mark.slow
@pytest.mark.parametrize("point", [(0.0, 0.0), (0.3e-3, 1.0e-3), (3.0e-3, 0.0)])
def test_the_displacement_under_it_is_that_of_the_intensity_itself(point: tuple[float, float]) -> None:
    """By a Hankel and a Fourier transform of the tabulated intensity, as far along the beam as the sum follows it."""
    step_m, reach_m, edge_m = 0.1e-3, 16.85e-3, 3.18e-3
    axial_m = np.arange(-169, 170) * step_m
    lateral_m = (np.arange(480) + 0.5) * 0.02e-3
    inside = np.clip((reach_m - np.abs(axial_m)) / edge_m, 0, 1)
    force = bowl_intensity(lateral_m, axial_m) * (inside**2 * (3 - 2 * inside))[:, None]
    across = np.concatenate([np.geomspace(0.5, 400, 200), np.linspace(402, 18e3, 4000)])
    hankel = 2 * np.pi * 0.02e-3 * (force * lateral_m) @ j0(np.outer(lateral_m, across))
    along = np.linspace(-4.5e3, 4.5e3, 1501)
    spectrum = step_m * np.exp(-1j * np.outer(along, axial_m)) @ hankel
    shape = force_shape(APERTURE)
    result = field_transfer(SPECIMEN, shape, np.array([point[0]]), np.array([point[1]]), FREQUENCY_HZ)[:, 0, 0]
    focus = np.abs(focus_transfer(SPECIMEN, shape, FREQUENCY_HZ))
    # 1e-3 of the fit, and as much of this quadrature.
    assert (np.abs(result - under(spectrum, across, along, point)) < 3e-3 * focus).all()
