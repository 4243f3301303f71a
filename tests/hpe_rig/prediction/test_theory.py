"""Closed forms against direct sums, limits and the figures found by Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hpe_rig.prediction.bounds import harmonic_bound
from hpe_rig.prediction.text import detection_text
from hpe_rig.prediction.theory import (
    beam_averaging_factor,
    focal_distortion,
    force_spectrum,
    scatterer_density,
)
from hpe_rig.processing import Window
from hpe_rig.scene import load_scene

EXCITATION = (0.17e-3, 0.17e-3, 1.80e-3)
TRACKING = (0.078e-3, 0.078e-3, 0.83e-3)
PULSE_M = 1540 / 2 / (0.065 * 9e6)
DENSITY = scatterer_density(TRACKING, 11)


def test_force_spectrum_equals_the_fourier_sum_of_the_pulse_train() -> None:
    time_s = (np.arange(100_000) + 0.5) / 100_000 / 100
    force = 3.0 * (time_s < 100e-6)
    harmonic = np.arange(-12, 13)
    direct = [np.mean(force * np.exp(-2j * np.pi * n * 100 * time_s)) for n in harmonic]
    # midpoint sums of 100000 intervals: relative error (pi n / 1e5)^2 / 6
    np.testing.assert_allclose(force_spectrum(harmonic, 100.0, 100e-6, 3.0), direct, rtol=1e-7)


def test_force_vanishes_at_multiples_of_the_inverse_burst_length() -> None:
    zeros = np.abs(force_spectrum(np.array([100, 200]), 100.0, 100e-6))
    assert (zeros < 1e-15).all()


def test_lateral_averaging_alone_is_the_closed_form() -> None:
    # an axially uniform motion leaves 2 W^2 / (2 W^2 + 1) with W = 0.17 / 0.078
    two_w2 = 2 * (0.17 / 0.078) ** 2
    factor = beam_averaging_factor((0.17e-3, 0.17e-3, 1e3), TRACKING, 1e-3, PULSE_M)
    assert factor == pytest.approx(two_w2 / (two_w2 + 1), rel=1e-9)
    # 0.9056 is that of W = 2.19
    assert factor == pytest.approx(0.9056, abs=2e-3)


@pytest.mark.parametrize(
    ("window", "expected", "error"), [("none", 0.887, 0.0013), ("hann", 0.892, 0.0018)], ids=["whole", "hann"]
)
def test_beam_averaging_predicts_the_monte_carlo_means(window: Window, expected: float, error: float) -> None:
    factor = beam_averaging_factor(EXCITATION, TRACKING, 1e-3, PULSE_M, gate_window=window, scatterers_per_m3=DENSITY)
    # error: standard error of 2000 draws
    assert factor == pytest.approx(expected, abs=2 * error)


def test_scatterer_density_is_11_in_the_half_amplitude_ellipsoid() -> None:
    cell_m3 = 11 / DENSITY
    assert cell_m3 == pytest.approx(0.0345e-9, rel=2e-3, abs=0)


def test_bound_equals_the_inverse_fisher_information_of_a_sampled_echo() -> None:
    fast_s, slow_s = np.arange(1000) / 100e6, np.arange(100) / 4000
    per_metre = 4 * np.pi * 9e6 / 1540
    echo = np.sin(2 * np.pi * 9e6 * fast_s)[None, :]
    wave = np.stack([np.sin(2 * np.pi * 200 * slow_s), 1e-6 * np.cos(2 * np.pi * 200 * slow_s)])
    # derivative of cos(w t - per_metre u), power 1/2, at small displacement; noise power 1/2 / 100
    derivative = per_metre * (wave[:, :, None] * echo).reshape(2, -1)
    covariance = np.linalg.inv(derivative @ derivative.T / (0.5 / 100))
    amplitude_m, phase_rad = harmonic_bound(1e-6, 1000, 100, 100.0, 9e6, 1540.0)
    assert amplitude_m == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9, abs=0)
    assert phase_rad == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-9, abs=0)


def test_bound_gives_the_reference_figures_for_table_one() -> None:
    amplitude_m, phase_rad = harmonic_bound(1e-6, 130, 100, 1e4, 9e6, 1540.0)
    assert amplitude_m == pytest.approx(1.69e-9, rel=5e-3, abs=0)
    assert np.degrees(phase_rad) == pytest.approx(0.097, abs=1e-3)


def test_distortion_at_the_focus_is_that_of_iec_61949() -> None:
    # 5 MPa of a linear wave in water, 3 MHz, 45 mm across at 70 mm; a -6 dB beam 1.13 mm wide
    beam_m, pressure_pa = 2 * 0.34e-3 * math.sqrt(2 * math.log(4)), 5e6
    area_ratio = 0.69 * (math.pi * 22.5e-3**2) / (math.pi * (beam_m / 2) ** 2)
    expected = 70e-3 * pressure_pa * 2 * math.pi * 3e6 * 3.5 / (1000 * 1540**3 * math.sqrt(area_ratio))
    intensity = pressure_pa**2 / (2 * 1000 * 1540)
    assert focal_distortion(intensity, 3e6, 70e-3, 45e-3, 0.34e-3, 1540.0) == pytest.approx(expected)
    assert expected == pytest.approx(0.19, abs=0.01)


def test_a_push_beyond_linear_propagation_is_said_to_be_one_and_a_weak_one_is_not() -> None:
    strong, weak = (" ".join(detection_text(load_scene(name))) for name in ("bovine-muscle", "limits-muscle"))
    assert "taken to propagate linearly, though its distortion at the focus is 0.63" in strong
    assert "[simulation.propagation]" in strong
    assert "linearly" not in weak
