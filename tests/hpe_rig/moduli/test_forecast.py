"""Forecast of the moduli: the bound that ``check`` prints is what the fit of such a run then states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.measurement import prepare
from hpe_rig.moduli.forecast import ModuliForecast, moduli_forecast, moduli_text
from hpe_rig.moduli.scene_geometry import with_shared_noise

SHORT = {"excitation.burst_count": 15, "processing.window_start_s": 50e-3}


def forecast(values: dict[str, object]) -> ModuliForecast:
    setup = prepare(hpe.load_scene("gelatin-moduli").with_({**SHORT, **values}), None)
    return moduli_forecast(setup.scene.scene, setup.plan)


def test_the_forecast_equals_the_uncertainty_of_the_fit_and_depths_do_not_reduce_common_noise(tmp_path: Path) -> None:
    values = {**SHORT, "sweep.lateral_offset_m": [1e-3, 3e-3]}
    run = hpe.measure(hpe.load_scene("gelatin-moduli").with_(values), path=tmp_path / "run.h5")
    found = hpe.fit_moduli(run, laws=["voigt"])
    fit, expected = found.best, forecast(values)
    assert expected.values == pytest.approx((7.25e3, 1.0))
    # one run's own phasors and speckle turn the bound by some percent
    np.testing.assert_allclose(expected.uncertainty, list(fit.uncertainty.values()), rtol=0.15)
    # Noise that all depths of a record have in common does not average out over depths.
    one_gate = found.vibrations[0]
    shared = with_shared_noise([one_gate] * 3, 0.5)
    np.testing.assert_allclose(shared[1].covariance_m2, 2 * one_gate.covariance_m2)


def test_more_offsets_and_better_known_ones_reduce_the_uncertainty() -> None:
    two = forecast({"sweep.lateral_offset_m": [1e-3, 3e-3]})
    five = forecast({})
    known = forecast({"tracking.offset_uncertainty_m": 1e-6})
    assert two.uncertainty[0] > five.uncertainty[0] > known.uncertainty[0]
    noisy = forecast({"processing.expected_snr_db": 10.0})
    repeated = forecast({"processing.expected_snr_db": 10.0, "acquisition.repeats": 10})
    assert noisy.uncertainty[1] > repeated.uncertainty[1] > five.uncertainty[1]


@pytest.mark.slow
def test_depths_reduce_the_uncertainty_as_forecast(tmp_path: Path) -> None:
    values = {**SHORT, "sweep.lateral_offset_m": [1e-3, 3e-3], "processing.gate_profile_step_m": 1e-3}
    run = hpe.measure(hpe.load_scene("gelatin-moduli").with_(values), path=tmp_path / "run.h5")
    fit = hpe.fit_moduli(run, laws=["voigt"]).best
    expected, one = forecast(values), forecast({"sweep.lateral_offset_m": [1e-3, 3e-3]})
    assert "from 2 lateral offsets, 6 gates" in str(expected)
    assert expected.uncertainty[0] < 0.8 * one.uncertainty[0]
    np.testing.assert_allclose(expected.uncertainty, list(fit.uncertainty.values()), rtol=0.2)


def test_the_declared_medium_precedes_the_twins_and_a_typical_one() -> None:
    declared = forecast({"medium": {"shear_modulus_pa": 4e3, "shear_viscosity_pa_s": 0.5}})
    assert declared.values == pytest.approx((4e3, 0.5))
    assert declared.medium_source == "the declared medium"
    typical = forecast({"simulation.specimen.field": "gaussian"})
    assert typical.values == (9e3, 2.0)
    assert "a typical medium of 9 kPa and 2 Pa s" in str(typical)


def test_check_prints_the_forecast_for_several_offsets_or_the_reason_against_it() -> None:
    line = [line for line in str(hpe.check("gelatin-moduli")).splitlines() if line.startswith("moduli")]
    assert len(line) == 1
    assert "from 5 lateral offsets" in line[0]
    setup = prepare(hpe.load_scene("gelatin-moduli").with_({"simulation.receiver.snr_db": 80.0}), None)
    one_offset = setup.scene.scene.with_({"sweep.lateral_offset_m": [1e-3]})
    assert list(moduli_text(one_offset, setup.plan)) == []
    flat = setup.scene.scene.with_(
        {"beams.excitation_width_m": [0.34e-3, 0.2e-3, 3.6e-3], "simulation.specimen.field": "gaussian"}
    )
    assert list(moduli_text(flat, setup.plan)) == ["moduli: no forecast, a force of 0.00034 m by 0.0002 m is not round"]


def test_a_scene_with_motion_below_the_noise_is_refused() -> None:
    with pytest.raises(ValueError, match="too few harmonics"):
        forecast({"simulation.specimen.force_density_n_per_m3": 1e3})
