"""Force spectrum and acoustic output: closed forms, and the lines about a push beyond linear propagation."""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.prediction import detection_text, focal_distortion, force_spectrum
from hpe_rig.scene import load_scene


def test_force_spectrum_equals_the_fourier_sum_of_the_pulse_train() -> None:
    time_s = (np.arange(100_000) + 0.5) / 100_000 / 100
    force = 3.0 * (time_s < 100e-6)
    harmonic = np.arange(-12, 13)
    direct = [np.mean(force * np.exp(-2j * np.pi * n * 100 * time_s)) for n in harmonic]
    # Midpoint sums of 100000 intervals: relative error (pi n / 1e5)^2 / 6.
    np.testing.assert_allclose(force_spectrum(harmonic, 100.0, 100e-6, 3.0), direct, rtol=1e-7)


def test_force_vanishes_at_multiples_of_the_inverse_burst_length() -> None:
    zeros = np.abs(force_spectrum(np.array([100, 200]), 100.0, 100e-6))
    assert (zeros < 1e-15).all()


def test_distortion_at_the_focus_follows_iec_61949() -> None:
    # 5 MPa of a linear wave in water, 3 MHz, 45 mm across at 70 mm; a -6 dB beam 1.13 mm wide.
    beam_m, pressure_pa = 2 * 0.34e-3 * math.sqrt(2 * math.log(4)), 5e6
    area_ratio = 0.69 * (math.pi * 22.5e-3**2) / (math.pi * (beam_m / 2) ** 2)
    expected = 70e-3 * pressure_pa * 2 * math.pi * 3e6 * 3.5 / (1000 * 1540**3 * math.sqrt(area_ratio))
    intensity = pressure_pa**2 / (2 * 1000 * 1540)
    assert math.isclose(focal_distortion(intensity, 3e6, 70e-3, 45e-3, 0.34e-3, 1540.0), expected, rel_tol=1e-6)
    assert abs(expected - 0.19) < 0.01


def test_a_push_beyond_linear_propagation_is_reported_and_a_weak_one_is_not() -> None:
    strong, weak = (" ".join(detection_text(load_scene(name))) for name in ("bovine-muscle", "limits-muscle"))
    assert "simulated as linear propagation, but the distortion at the focus is 0.63" in strong
    assert "[simulation.propagation]" in strong
    assert "linear propagation" not in weak
