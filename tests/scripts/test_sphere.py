"""Calibration scene: the vibration of the sphere equals the closed form, and the fit returns the true moduli."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import result_of
from sphere import fit_sphere, sphere_phasors

from hpe_rig.scene import load_scene


def test_without_noise_the_fit_returns_the_moduli_of_the_gelatin() -> None:
    low_noise = {"simulation.receiver.snr_db": 80.0, "simulation.instruments.trigger_jitter_s": 0.0}
    changes = {"excitation.burst_count": 10, "sphere": None}
    scene = load_scene("steel-sphere").with_(low_noise | changes)
    result = result_of(scene)
    estimates = result.shots[0].estimates
    true_m = np.array([estimate.true_amplitude_m for estimate in estimates], float)
    # Tolerance: harmonics above 10 kHz are omitted; the table of the step response is accurate to 1e-6.
    assert np.abs(sphere_phasors(scene, 7250.0, 1.0, sampled=False)) == pytest.approx(true_m, rel=3e-5)
    fit = fit_sphere(scene, result)
    assert fit.mu1_pa == pytest.approx(7250.0, rel=2e-3)
    assert fit.mu2_pa_s == pytest.approx(1.0, rel=1e-2)


def test_a_scene_without_a_sphere_is_refused() -> None:
    with pytest.raises(ValueError, match="the scene has no sphere"):
        sphere_phasors(load_scene("gelatin-8"), 7250.0, 1.0)
