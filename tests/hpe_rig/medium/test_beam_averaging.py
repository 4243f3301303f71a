"""Tracked over peak displacement: closed forms against quadratures, Monte Carlo means and the twin's field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.medium import (
    BeamWidths,
    HarmonicMedium,
    TrackingGate,
    beam_averaging_factor,
    scatterer_density,
    tracked_motion,
)
from hpe_rig.medium.beam_averaging import off_axis_motion
from hpe_rig.prediction.beam_averaging import axial_offset_factor, obliquity_factor
from sim_backend.motion.field import field_transfer
from sim_backend.settings import SimulationSettings, Specimen
from sim_backend.transducer import pulse_echo_beam

FORCE_M = (0.17e-3, 0.17e-3, 1.80e-3)
TRACKING_M = (0.078e-3, 0.078e-3, 0.83e-3)
GATE_M, PULSE_M = 1.0e-3, 1540 / 2 / (0.065 * 9e6)
DENSITY = scatterer_density(TRACKING_M, 11)
FREQUENCY_HZ = np.array([100.0, 200.0, 400.0, 1000.0])


def test_an_endless_column_is_tracked_as_in_the_theory_notes() -> None:
    """0.34 mm in 4 kPa gelatin, T = 0.155 mm; half a unit of the printed digits."""
    column_m, tracking_m = (0.34e-3, 0.34e-3, 0.5), (0.155e-3, 0.155e-3, 1.0)
    motion = tracked_motion(HarmonicMedium.voigt(4e3, 1.0, FREQUENCY_HZ), BeamWidths(column_m, tracking_m, 0.0))
    ratio = motion[0] / motion[1]
    assert np.abs(ratio) == pytest.approx([0.984, 0.980, 0.973, 0.955], abs=6e-4)
    assert np.degrees(np.angle(ratio[[0, 3]])) == pytest.approx([-0.6, -1.6], abs=0.05)


@pytest.mark.parametrize(("modulus_pa", "viscosity_pa_s"), [(4e3, 1.0), (13.5e3, 2.0)])
def test_averaging_equals_the_quadrature_over_the_twins_field(modulus_pa: float, viscosity_pa_s: float) -> None:
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    depth_m = 0.3e-3
    node, weight = np.polynomial.legendre.leggauss(16)
    across_m, along_m = 4 * TRACKING_M[0] * (node + 1) / 2, 5 * depth_m * node
    across = weight * across_m * np.exp(-((across_m / TRACKING_M[0]) ** 2))
    along = weight * np.exp(-((along_m / depth_m) ** 2) / 2)
    field = field_transfer(specimen, FORCE_M, across_m, np.abs(along_m), FREQUENCY_HZ)
    peak = field_transfer(specimen, FORCE_M, np.zeros(1), np.zeros(1), FREQUENCY_HZ)[:, 0, 0]
    expected = np.einsum("fra,r,a->f", field, across, along) / across.sum() / along.sum() / peak
    medium = HarmonicMedium.voigt(modulus_pa, viscosity_pa_s, FREQUENCY_HZ)
    motion = tracked_motion(medium, BeamWidths(FORCE_M, TRACKING_M, depth_m))
    # The stated error of the field's own quadrature.
    assert np.abs(motion[0] / motion[1] - expected).max() < 2e-6


def test_speckle_off_the_axis_changes_area_and_offset_of_the_beam_as_two_effects() -> None:
    medium, lateral_m, step = HarmonicMedium.voigt(9e3, 2.0, FREQUENCY_HZ), 3.5e-3, 1e-3

    def tracked(area: float, offset: float) -> NDArray[np.complex128]:
        """Return the tracked motion with changes of the logarithm of the area, and of the offset over the radius."""
        width_m = TRACKING_M[0] * np.sqrt(1 + area)
        radius_m = np.sqrt(BeamWidths(FORCE_M, TRACKING_M, 0.3e-3).tracking_variance_m2)
        beams = BeamWidths(FORCE_M, (width_m, width_m, TRACKING_M[2]), 0.3e-3)
        return np.asarray(off_axis_motion(medium, beams, np.array([lateral_m + offset * radius_m]))[0][:, 0])

    steepness = off_axis_motion(medium, BeamWidths(FORCE_M, TRACKING_M, 0.3e-3), np.array([lateral_m]))[2][..., 0]
    by_area = (tracked(step, 0.0) - tracked(-step, 0.0)) / (2 * step)
    by_offset = (tracked(0.0, step) - tracked(0.0, -step)) / (2 * step)
    # Central differences have an error of the square of the step.
    assert np.abs(steepness - [by_area, by_offset]).max() < 1e-4 * np.abs(steepness).max()
    # The phase of the motion falls with the offset; ratios of frequencies depend on the signs of both effects.
    relative = steepness / tracked(0.0, 0.0)
    assert relative[1, -1].imag < relative[1, 0].imag < 0


@pytest.mark.parametrize("lateral_m", [0.0, 0.02e-3, 0.3e-3])
def test_random_echoes_change_log_area_and_relative_offset_by_the_same_standard_deviation(lateral_m: float) -> None:
    # The mean over N random points of the beam's echo energy has the standard deviation sd(u) / sqrt(N).
    # On the axis the area alone matters, next to it both effects, farther off mostly the offset.
    node, node_weight = np.polynomial.hermite_e.hermegauss(7)
    weight = np.outer(node_weight, node_weight).ravel() / node_weight.sum() ** 2
    x_m, y_m = (TRACKING_M[0] / np.sqrt(2) * grid for grid in np.meshgrid(node, node))
    distance_m, index = np.unique(np.hypot(lateral_m + x_m, y_m).ravel().round(12), return_inverse=True)
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    motion = field_transfer(specimen, FORCE_M, distance_m, np.zeros(1), FREQUENCY_HZ)[:, index, 0]
    relative = motion / (motion @ weight)[:, None] - 1
    medium = HarmonicMedium.voigt(9e3, 2.0, FREQUENCY_HZ)
    tracked, _, steepness = tracked_motion(medium, BeamWidths(FORCE_M, TRACKING_M, 0.0, lateral_offset_m=lateral_m))
    for component in (np.real, np.imag):
        predicted = np.linalg.norm(component(steepness / tracked), axis=0)
        # Linear in both effects: the second order of the beam's variance over the force's, 0.1, is left out.
        np.testing.assert_allclose(predicted, np.sqrt(component(relative) ** 2 @ weight), rtol=0.1**2)


def test_a_gaussian_of_the_scaled_width_has_the_same_averaging() -> None:
    beams = BeamWidths(FORCE_M, TRACKING_M, TrackingGate(TRACKING_M, GATE_M, PULSE_M).depth_sd_m())
    for averaging in (0.3, 0.9, 0.955, 0.984):
        scaled = replace(beams, force_width_m=tuple(np.multiply(FORCE_M, beams.width_scale(averaging)).tolist()))
        assert scaled.gaussian_averaging() == pytest.approx(averaging, rel=1e-9)
    assert beams.width_scale(1.0) > 100


def test_lateral_averaging_alone_has_a_closed_form() -> None:
    # A motion uniform along the axis has the ratio 2 W^2 / (2 W^2 + 1) with W = 0.17 / 0.078.
    two_w2 = 2 * (0.17 / 0.078) ** 2
    factor = beam_averaging_factor((0.17e-3, 0.17e-3, 1e3), TrackingGate(TRACKING_M, GATE_M, PULSE_M))
    assert factor == pytest.approx(two_w2 / (two_w2 + 1), rel=1e-9)
    # 0.9056 is printed for W = 2.19.
    assert factor == pytest.approx(0.9056, abs=2e-3)


@pytest.mark.parametrize(("hann_window", "expected", "error"), [(False, 0.887, 0.0013), (True, 0.892, 0.0018)])
def test_beam_averaging_predicts_the_monte_carlo_means(hann_window: bool, expected: float, error: float) -> None:
    factor = beam_averaging_factor(FORCE_M, TrackingGate(TRACKING_M, GATE_M, PULSE_M, hann_window), DENSITY)
    # error: standard error of 2000 draws.
    assert factor == pytest.approx(expected, abs=2 * error)


def test_scatterer_density_is_11_in_the_half_amplitude_ellipsoid() -> None:
    assert pytest.approx(0.0345e-9, rel=2e-3, abs=0) == 11 / DENSITY


@pytest.mark.parametrize(("offset_m", "uncertainty_m"), [(0.0, 0.35e-3), (1.0e-3, 0.35e-3), (1.8e-3, 1e-3)])
def test_a_gate_off_the_focus_has_a_known_factor_and_spread(offset_m: float, uncertainty_m: float) -> None:
    width_m, draws = 1.8e-3, 200_000
    factor, spread = axial_offset_factor(offset_m, uncertainty_m, width_m)
    depth_m = offset_m + uncertainty_m * np.random.default_rng(0).standard_normal(draws)
    motion = np.exp(-(depth_m**2) / (2 * width_m**2))
    assert factor == pytest.approx(np.exp(-(offset_m**2) / (2 * width_m**2)))
    square = (motion / factor - 1) ** 2
    assert spread**2 == pytest.approx(square.mean(), abs=4 * square.std() / np.sqrt(draws))


def drawn_echoes(gate_m: float, draws: int = 4000) -> tuple[NDArray[np.complex128], float]:
    """Return echoes (draw, instant) of speckle in a gate at the focus, and the distance of instants in depth, m."""
    random, fine_m = np.random.default_rng(2), 0.01e-3
    position_m, instant_m = (np.arange(-half, half, fine_m) for half in ((gate_m + PULSE_M) / 2, gate_m / 2))
    strength = random.standard_normal((draws, position_m.size)) + 1j * random.standard_normal((draws, position_m.size))
    strength = strength * np.exp(-(position_m**2) / (2 * TRACKING_M[2] ** 2))
    distance_m = instant_m[:, None] - position_m
    pulse = np.where(np.abs(distance_m) < PULSE_M / 2, np.cos(np.pi * distance_m / PULSE_M) ** 2, 0.0).T
    return strength @ pulse, fine_m


@pytest.mark.parametrize("gate_m", [0.5e-3, 1e-3, 2e-3])
def test_the_spread_of_the_echo_frequency_equals_that_of_random_echoes(gate_m: float) -> None:
    per_m = 4 * np.pi * 9e6 / 1540.0
    echo, fine_m = drawn_echoes(gate_m)
    # The phase between neighbouring instants, weighted by energy.
    step = np.imag(np.sum(np.conj(echo[:, :-1]) * echo[:, 1:], axis=1)) / fine_m
    mean_per_m = step / np.sum(np.abs(echo) ** 2, axis=1)
    predicted = TrackingGate(TRACKING_M, gate_m, PULSE_M).carrier_spread(per_m)
    # 4000 draws of nearly normal numbers: 1 / sqrt(8000) = 1.1 %; three of these, and 1 % for the steps of the sums.
    assert mean_per_m.std() / per_m == pytest.approx(predicted, rel=0.044)


@pytest.mark.parametrize("diameter_m", [30e-3, 45e-3])
def test_obliquity_equals_that_of_the_twins_aperture(diameter_m: float) -> None:
    settings = SimulationSettings.model_validate(
        {"beams": {"field": "aperture", "transducer": {"diameter_m": diameter_m}}}
    )
    lateral_m = np.linspace(0, 0.6e-3, 300)
    amplitude, sensitivity = pulse_echo_beam(settings, (9.0e6,), 0.6e-3, 0.1e-3).at(lateral_m, np.zeros(300))
    energy = np.abs(amplitude[0]) ** 2 * lateral_m
    expected = (sensitivity * energy).sum() / energy.sum()
    assert obliquity_factor(diameter_m, 70e-3) == pytest.approx(expected, abs=2e-4)
