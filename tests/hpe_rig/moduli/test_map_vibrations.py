"""Moduli from a map of displacement: those of the twin's medium within u; geometry that is unknown is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.medium import law_of
from hpe_rig.moduli import map_vibrations, push_of
from hpe_rig.moduli.problem import Problem
from hpe_rig.scene import SettingsError
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.array([100.0, 200.0, 300.0])
TIME_S = np.arange(250) / 5e3
LATERAL_M = (-2e-3, 1e-3, 3e-3)
TRUTH = {"shear_modulus_pa": 7.25e3, "viscosity_pa_s": 1.0}
NOISE_M = 5e-9
SETTINGS: dict[str, Any] = {
    "quantity": "displacement_m",
    "axes": "line,sample,pulse",
    "pulse_rate_hz": 5e3,
    "line_position_m": LATERAL_M,
    "depth_step_m": 1e-3,
    "first_pulse_s": 0.0,
}


def scene() -> hpe.Scene:
    # One clock: u is that of the noise.
    settings = {"processing.frequencies_hz": FREQUENCY_HZ.tolist(), "processing.frequency_accuracy": 0.0}
    return hpe.load_scene("gelatin-moduli").with_(settings)


def displacement_m() -> NDArray[np.float64]:
    """Return the twin's displacement (line, depth, pulse) in three depths about the focus, the outer ones at rest."""
    push, specimen = push_of([scene()]), Specimen(shear_modulus_pa=7.25e3, shear_viscosity_pa_s=1.0)
    width_m = push.force.across_m[0], push.force.across_m[0], push.force.along_m
    field = field_transfer(specimen, width_m, np.abs(LATERAL_M), np.zeros(1), FREQUENCY_HZ)[:, :, 0]
    phasor_m = field * push.spectrum(FREQUENCY_HZ)[:, None]
    phasor_m *= 800e-9 / np.abs(phasor_m).max()
    focus = np.einsum("fl,ft->lt", phasor_m, np.exp(2j * np.pi * FREQUENCY_HZ[:, None] * TIME_S)).imag
    noise = NOISE_M * np.random.default_rng(2).normal(size=(len(LATERAL_M), 3, TIME_S.size))
    return np.asarray(noise + focus[:, None] * np.array([0.0, 1.0, 0.0])[:, None])


def motion_map(**changes: Any) -> Any:
    first_m = scene().acquisition.gate_depth_m - 1e-3
    return hpe.map_motion(displacement_m(), scene(), **(SETTINGS | {"first_sample_depth_m": first_m} | changes))


def test_the_moduli_of_the_medium_lie_within_u(monkeypatch: pytest.MonkeyPatch) -> None:
    result = hpe.fit_map_moduli(motion_map(), scene(), laws=["voigt"])
    assert [vibration.lateral_m for vibration in result.vibrations] == list(LATERAL_M)
    assert not result.best.excluded
    for name, true in TRUTH.items():
        assert abs(result.best.values[name] - true) < 3 * result.best.uncertainty[name]
        # Noise of 5 nm, speckle and widths of the force known to 5 % leave a few per cent.
        assert result.best.uncertainty[name] < 0.1 * true
    monkeypatch.setattr(map_vibrations, "MAX_LINES", 2)
    vibrations, omitted = map_vibrations.vibrations_of_map(motion_map(), scene())
    assert [vibration.lateral_m for vibration in vibrations] == [LATERAL_M[0], LATERAL_M[-1]]
    assert omitted == ["1 of 3 lines: 2, evenly spread, are fitted"]


def test_the_covariance_of_a_pixel_is_that_of_its_phasor() -> None:
    (vibration, *_), _ = map_vibrations.vibrations_of_map(motion_map(), scene())
    # White noise s in N values gives s sqrt(2 / N) in each quadrature; 5 whole periods or more fit into the train.
    expected_m = NOISE_M * np.sqrt(2 / TIME_S.size)
    np.testing.assert_allclose(np.sqrt(np.diag(vibration.covariance_m2)), expected_m, rtol=0.2)


@pytest.mark.parametrize(
    ("changes", "settings", "message"),
    [
        ({"line_position_m": None}, {}, "the lines of the map have no positions. Try: line_pitch_m"),
        ({"first_sample_depth_m": 0.0}, {}, "lies outside the depths of the map, 0 to 2 mm. Try: beams.focus_depth_m"),
        ({}, {"excitation": None}, "excitation: nothing pushes"),
        ({"line_position_m": (-0.04, 0.03, 0.04)}, {}, "no vibration exceeds its noise: -40 mm: more than 20 mm"),
    ],
)
def test_unknown_geometry_is_refused(changes: dict[str, Any], settings: dict[str, Any], message: str) -> None:
    stated = {key: value for key, value in changes.items() if value is not None}
    dropped = [key for key, value in changes.items() if value is None]
    first_m = scene().acquisition.gate_depth_m - 1e-3
    values = {key: value for key, value in (SETTINGS | {"first_sample_depth_m": first_m}).items() if key not in dropped}
    measured = hpe.map_motion(displacement_m(), scene(), **(values | stated))
    fitted = scene().model_copy(update=settings)
    with pytest.raises(SettingsError) as error:
        hpe.fit_map_moduli(measured, fitted)
    assert message in " ".join(str(error.value).split())


def test_the_clocks_delay_all_lines_alike() -> None:
    """Closed form: the covariance of all data is that of the noise plus s² g g', with g their derivative by a delay."""
    accuracy = 1e-3
    delay_u_s = accuracy * float(TIME_S.mean())
    clocks = scene().with_({"processing.frequency_accuracy": accuracy})
    first_m = scene().acquisition.gate_depth_m - 1e-3
    locked, free = motion_map(), hpe.map_motion(displacement_m(), clocks, **SETTINGS, first_sample_depth_m=first_m)
    # The phases of a pixel have the u of the delay, the covariance of a line for the moduli has not.
    expected_rad = np.hypot(locked.phase_uncertainty_rad, 2 * np.pi * FREQUENCY_HZ * delay_u_s)
    np.testing.assert_allclose(free.phase_uncertainty_rad, expected_rad, rtol=1e-9)
    vibrations, others = (map_vibrations.vibrations_of_map(item, scene())[0] for item in (locked, free))
    for vibration, other in zip(vibrations, others, strict=True):
        np.testing.assert_allclose(other.covariance_m2, vibration.covariance_m2, rtol=1e-6, atol=1e-24)

    push = push_of([scene()])
    problem = Problem.of(vibrations, replace(push, onset_uncertainty_s=0.0), law_of("voigt"))
    unknown = problem.start(problem.law.coordinates(np.array(list(TRUTH.values()))))[0]
    # Derivative of every whitened datum by the delay of the onset and of the clocks, in units of its u.
    delayed_m = [-2j * np.pi * FREQUENCY_HZ * phasor_m for phasor_m in problem.modelled(unknown)]
    pairs = zip(problem.whitening, delayed_m, strict=True)
    slope = np.concatenate([root @ np.stack([y.real, y.imag], axis=-1).ravel() for root, y in pairs])
    slope *= np.hypot(push.onset_uncertainty_s, delay_u_s)
    jacobian = problem.jacobian(unknown)
    inverse = np.eye(len(jacobian))
    inverse[: slope.size, : slope.size] -= np.outer(slope, slope) / (1 + slope @ slope)
    expected = np.linalg.inv(jacobian.T @ inverse @ jacobian)[:2, :2]
    mapped = Problem.of(others, map_vibrations.push_of_map(free, scene(), push.width_uncertainty[0]), law_of("voigt"))
    shared = mapped.coordinate_covariance(mapped.jacobian(mapped.start(unknown[:2])[0]))
    np.testing.assert_allclose(shared, expected, rtol=1e-4)
    assert shared[0, 0] > 1.1 * problem.coordinate_covariance(jacobian)[0, 0]
