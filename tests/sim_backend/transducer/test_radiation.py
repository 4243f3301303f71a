"""The bowl's field against O'Neil's closed form, the focal plane's jinc and a direct Rayleigh integral."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

from sim_backend.settings import Transducer
from sim_backend.transducer import apodisation, bowl_pressure, wave_number

PAPER = Transducer()


def on_axis(transducer: Transducer, k: complex, axial_m: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return O'Neil's pressure on the axis over rho c u0, (point,): waves from the bowl's middle and from its rim."""
    focal_m, radius_m = transducer.focal_length_m, transducer.diameter_m / 2
    depth_m = focal_m - np.sqrt(focal_m**2 - radius_m**2)
    middle_m = focal_m + axial_m
    rim_m = np.hypot(middle_m - depth_m, radius_m)
    return np.asarray((np.exp(-1j * k * middle_m) - np.exp(-1j * k * rim_m)) / (1 - middle_m / focal_m))


def rayleigh(transducer: Transducer, k: complex, lateral_m: float, axial_m: float) -> complex:
    """Return the Rayleigh integral over the bowl by a product rule over its two angles, over rho c u0."""
    node, weight = np.polynomial.legendre.leggauss(300)
    focal_m = transducer.focal_length_m
    cosine = 1 - (1 - np.sqrt(1 - transducer.half_aperture**2)) * (node + 1) / 2
    sine, turn = np.sqrt(1 - cosine**2), (np.arange(300) + 0.5) * 2 * np.pi / 300
    lateral = np.hypot(focal_m * np.outer(sine, np.cos(turn)) - lateral_m, focal_m * np.outer(sine, np.sin(turn)))
    distance_m = np.hypot(lateral, (focal_m * cosine + axial_m)[:, None])
    share = weight * (1 - np.sqrt(1 - transducer.half_aperture**2)) / 2
    share = share * apodisation(transducer, sine / transducer.half_aperture)
    return complex(1j * k * focal_m**2 / 300 * (share @ (np.exp(-1j * k * distance_m) / distance_m)).sum())


@pytest.mark.parametrize("frequency_hz", [3.0e6, 9.0e6])
@pytest.mark.parametrize("attenuation", [0.0, 0.5])
def test_the_axis_is_oneils_closed_form(frequency_hz: float, attenuation: float) -> None:
    k = wave_number(frequency_hz, 1540.0, attenuation)
    axial_m = np.linspace(-15e-3, 14.3e-3, 40)
    expected = on_axis(PAPER, k, axial_m)
    pressure_of_bowl = bowl_pressure(PAPER, k, np.zeros(1), axial_m)[:, 0]
    assert np.abs(pressure_of_bowl - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize(
    "kind", ["hann", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("uniform", "parabolic"))]
)
def test_off_the_axis_it_is_the_rayleigh_integral(kind: str) -> None:
    transducer = Transducer.model_validate({"apodisation": kind})
    k = wave_number(9.0e6, 1540.0, 0.5)
    focus = abs(bowl_pressure(transducer, k, np.zeros(1), np.zeros(1))[0, 0])
    for lateral_m, axial_m in ((0.1e-3, 0.0), (1.0e-3, 2.0e-3), (3.0e-3, -8.0e-3)):
        pressure_of_bowl = bowl_pressure(transducer, k, np.array([lateral_m]), np.array([axial_m]))[0, 0]
        assert abs(pressure_of_bowl - rayleigh(transducer, k, lateral_m, axial_m)) < 1e-11 * focus


def test_the_focal_plane_of_a_narrow_bowl_is_the_jinc() -> None:
    # The jinc leaves out the obliquity of the waves: an error in proportion to the half aperture squared.
    errors = []
    for half_aperture in (8e-3, 4e-3):
        narrow = Transducer(diameter_m=2 * half_aperture * 0.1, focal_length_m=0.1)
        k = 2 * np.pi * 20 / (half_aperture**2 * 0.1)
        point = np.linspace(0.3, 4.0, 12)
        pressure_of_bowl = bowl_pressure(
            narrow, complex(k), np.array([0.0, *point / (k * half_aperture)]), np.zeros(1)
        )[0]
        errors.append(np.abs(np.abs(pressure_of_bowl[1:] / pressure_of_bowl[0]) - np.abs(2 * j1(point) / point)).max())
    assert errors[1] < 1e-6
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.01)


def test_a_point_as_far_as_the_bowl_is_refused() -> None:
    with pytest.raises(ValueError, match="focal length"):
        bowl_pressure(PAPER, wave_number(3e6, 1540.0), np.zeros(1), np.array([-69e-3]))
