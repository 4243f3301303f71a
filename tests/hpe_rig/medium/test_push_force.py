"""Force of an aperture: its field against the twin's and O'Neil's closed form, and the motion it drives."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.medium import HarmonicMedium, PushForce, TrackedRegion, aperture_force, scanned_force, shear_motion
from hpe_rig.medium.push_force import bowl_pressure
from hpe_rig.moduli.vibration_model import APERTURE_SHAPE
from sim_backend.motion.field import field_transfer
from sim_backend.settings import SimulationSettings, Specimen, Transducer
from sim_backend.transducer import GaussianSum, bowl_pressure as twins_pressure, push_intensity, wave_number

K = wave_number(3e6, 1540.0, 0.5)
LATERAL_M, AXIAL_M = np.linspace(0, 6e-3, 13), np.linspace(-17e-3, 17e-3, 9)
FREQUENCY_HZ = np.array([100.0, 400.0, 1000.0])
MUSCLE = HarmonicMedium.voigt(9e3, 2.0, FREQUENCY_HZ)
OFFSETS_M = np.array([0.0, 1e-3, 3.5e-3])


def relative_force(force: PushForce, lateral_m: np.ndarray, axial_m: np.ndarray) -> np.ndarray:
    """Return the force relative to that at the focus, (axial, lateral)."""
    along = np.exp(-0.5 * ((axial_m[:, None] - np.array(force.centre_m)) / force.along_m) ** 2)
    across = np.exp(-0.5 * (lateral_m / np.array(force.across_m)[:, None]) ** 2)
    return along @ np.array(force.weights) @ across


@pytest.fixture(scope="module")
def force() -> PushForce:
    return aperture_force(45e-3, 70e-3, 3e6, 1540.0)


def test_bowl_pressure_equals_the_twins_to_1e_10_of_the_focus() -> None:
    own = bowl_pressure(45e-3, 70e-3, K, LATERAL_M, AXIAL_M)
    twins = twins_pressure(Transducer(), K, LATERAL_M, AXIAL_M)
    assert np.abs(own / own[4, 0] - twins / twins[4, 0]).max() < 1e-10


def test_bowl_pressure_on_the_axis_equals_oneils_closed_form() -> None:
    own = bowl_pressure(45e-3, 70e-3, K, np.zeros(1), AXIAL_M)[:, 0]
    edge_m = np.hypot(70e-3 * np.cos(np.arcsin(22.5 / 70)) + AXIAL_M, 22.5e-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        closed = (np.exp(-1j * K * (70e-3 + AXIAL_M)) - np.exp(-1j * K * edge_m)) / AXIAL_M
    away = AXIAL_M != 0
    ratio = closed[away] / own[away]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)


def test_the_sum_of_gaussians_equals_the_intensity_within_the_force(force: PushForce) -> None:
    near_m = np.linspace(-12e-3, 12e-3, 25)
    pressure = twins_pressure(Transducer(), K, LATERAL_M, near_m)
    intensity = np.abs(pressure / pressure[12, 0]) ** 2
    # The sum has no rings of the diffraction pattern.
    assert np.abs(relative_force(force, LATERAL_M, near_m) - intensity).max() < 0.03


@pytest.mark.parametrize(
    ("mu1", "mu2", "offsets_m"),
    [
        (9e3, 2.0, OFFSETS_M[1:]),
        *(
            pytest.param(*each, np.array([0.0, 20e-3]), marks=pytest.mark.slow)
            for each in ((500.0, 0.0), (500e3, 50.0))
        ),
    ],
)
def test_motion_under_the_same_gaussians_equals_the_twins_to_1e_9(
    force: PushForce, mu1: float, mu2: float, offsets_m: np.ndarray
) -> None:
    twin_force = GaussianSum(force.across_m, force.along_m, force.centre_m, force.weights)
    specimen = Specimen(shear_modulus_pa=mu1, shear_viscosity_pa_s=mu2)
    medium = HarmonicMedium.voigt(mu1, mu2, FREQUENCY_HZ)
    twins = field_transfer(specimen, twin_force, offsets_m, np.array([0.0, 1.5e-3]), FREQUENCY_HZ)
    for axial_m, twin in zip((0.0, 1.5e-3), np.moveaxis(twins, -1, 0), strict=True):
        own = shear_motion(medium, force, TrackedRegion(offsets_m, axial_m)).value
        assert (np.abs(own - twin).max(axis=1) < 1e-9 * np.abs(twin).max(axis=1)).all()


def test_motion_equals_the_twins_within_the_uncertainty_of_the_force(force: PushForce) -> None:
    settings = SimulationSettings.model_validate({"beams": {"field": "aperture"}, "specimen": {}})
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    twins = field_transfer(specimen, push_intensity(settings), OFFSETS_M, np.zeros(1), FREQUENCY_HZ)[:, :, 0]
    own = shear_motion(MUSCLE, force, TrackedRegion(OFFSETS_M))
    error = np.abs(own.value / twins - 1)
    # 100 Hz depends on the end of the force, which differs by half a sigma. A Gaussian would be wrong by 10 to 30 %.
    assert error[0].max() < 0.05
    assert error[1:].max() < 0.03
    assert np.all(error[0] < 3 * np.abs(own.by_weight_change["reach"] / own.value)[0])


def test_a_bowl_wider_than_its_sphere_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot focus"):
        aperture_force(0.2, 0.1, 3e6, 1540.0)


@pytest.mark.parametrize(
    ("diameter_m", "frequency_hz"), [(5e-3, 3e6), pytest.param(100e-3, 8e6, marks=pytest.mark.slow), (45e-3, 1e6)]
)
def test_any_aperture_has_a_force_of_1_at_its_focus_that_fades(diameter_m: float, frequency_hz: float) -> None:
    force = aperture_force(diameter_m, 70e-3, frequency_hz, 1540.0)
    assert relative_force(force, np.zeros(1), np.zeros(1))[0, 0] == pytest.approx(1.0, abs=0.05)
    assert abs(relative_force(force, np.zeros(1), np.array([-60e-3, 60e-3]))).max() < 0.02


def test_a_scan_of_the_bowl_gives_the_bowls_force_and_motion(force: PushForce) -> None:
    scanned = scanned_force(lambda r, z: 5e3 * np.abs(bowl_pressure(45e-3, 70e-3, K, r, z)) ** 2, 3e6)
    of_bowl, of_scan = (shear_motion(MUSCLE, each, TrackedRegion(OFFSETS_M)).value for each in (force, scanned))
    # 100 Hz depends on the end of the force, 4.5 sigmas away; the scan's half-intensity length puts it 4 % nearer.
    assert np.abs(of_scan / of_bowl - 1)[0].max() < 0.02
    assert np.abs(of_scan / of_bowl - 1)[1:].max() < APERTURE_SHAPE
    assert [name for name, _ in scanned.weight_changes] == ["reach", "loss"]


def test_a_specimen_attenuates_a_scan() -> None:
    lossless = wave_number(3e6, 1540.0, 1e-9)
    dry, wet = (
        scanned_force(lambda r, z, k=k: np.abs(bowl_pressure(45e-3, 70e-3, k, r, z)) ** 2, 3e6, loss)
        for k, loss in ((lossless, 0.5), (K, 0.0))
    )
    # One beam is attenuated along the paths of its waves, the other along the axis.
    points = np.linspace(0, 1e-3, 5), np.linspace(-8e-3, 8e-3, 9)
    assert np.abs(relative_force(dry, *points) - relative_force(wet, *points)).max() < 0.01


def test_a_scan_without_a_beam_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fall to half"):
        scanned_force(lambda r, z: np.ones((z.size, r.size)), 3e6)
