"""Maps of displacement and velocity that another program has estimated; wrong units and settings are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.result import BadPixel
from hpe_rig.scene import SettingsError

RATE_HZ, F_HZ, STEP_M, PITCH_M = 10e3, 200.0, 0.2e-3, 0.3e-3
TIME_S = np.arange(100) / RATE_HZ
SETTINGS: dict[str, Any] = {
    "axes": "line,sample,pulse",
    "pulse_rate_hz": RATE_HZ,
    "depth_step_m": STEP_M,
    "first_sample_depth_m": 5e-3,
    "line_pitch_m": PITCH_M,
}


def shear_wave_m() -> NDArray[np.complex128]:
    """Return the phasors (line, depth) of a shear wave of 2 m/s that leaves the lateral position 0, decaying."""
    lateral_m = (np.arange(7) - 3) * PITCH_M
    depth_m = 5e-3 + STEP_M * np.arange(5)
    amplitude_m = 2e-6 * np.exp(-np.abs(lateral_m) / 1e-3)[:, None] * np.exp(-(((depth_m - 5.4e-3) / 1e-3) ** 2))
    return np.asarray(amplitude_m * np.exp(-2j * np.pi * F_HZ * np.abs(lateral_m)[:, None] / 2.0))


def displacement_m() -> NDArray[np.float64]:
    return np.asarray((shear_wave_m()[..., None] * np.exp(2j * np.pi * F_HZ * TIME_S)).imag + 3e-6 * TIME_S)


def velocity_m_per_s() -> NDArray[np.float64]:
    omega = 2 * np.pi * F_HZ
    return np.asarray((1j * omega * shear_wave_m()[..., None] * np.exp(1j * omega * TIME_S)).imag + 3e-6)


@pytest.fixture
def scene(scene_of_gate: Callable[[float, float, float], Path]) -> Path:
    return scene_of_gate(5e-3, 1e-3, F_HZ)


@pytest.mark.parametrize(
    ("quantity", "values"),
    [
        ("displacement_m", displacement_m()),
        ("displacement_um", displacement_m() * 1e6),
        ("displacement_nm", np.rint(displacement_m() * 1e12).astype(np.int32) / 1e3),
        ("velocity_m_per_s", velocity_m_per_s()),
        ("velocity_mm_per_s", velocity_m_per_s() * 1e3),
    ],
)
def test_every_pixel_has_the_phasor_of_the_shear_wave(quantity: str, values: NDArray[Any], scene: Path) -> None:
    motion_map = hpe.map_motion(values, scene, quantity=quantity, **SETTINGS)
    phasors = motion_map.amplitude_m[..., 0] * np.exp(1j * motion_map.phase_rad[..., 0])
    np.testing.assert_allclose(phasors, shear_wave_m(), atol=1e-12)
    np.testing.assert_allclose(motion_map.velocity_m_per_s, 3e-6, rtol=1e-4)
    np.testing.assert_allclose(motion_map.depth_m, 5e-3 + STEP_M * np.arange(5), rtol=1e-12)
    np.testing.assert_allclose(motion_map.line_m, (np.arange(7) - 3) * PITCH_M, atol=1e-15)


def test_u_of_a_pixel_is_that_of_its_residual(scene: Path) -> None:
    noise_m = 50e-9
    noisy = displacement_m() + noise_m * np.random.default_rng(3).normal(size=displacement_m().shape)
    motion_map = hpe.map_motion(noisy, scene, quantity="displacement_m", **SETTINGS)
    error = (motion_map.amplitude_m[..., 0] - np.abs(shear_wave_m())) / motion_map.amplitude_uncertainty_m[..., 0]
    # 35 pixels: four standard deviations of the estimated standard deviation, 1 / sqrt(2 n) each.
    assert np.std(error) == pytest.approx(1.0, abs=4 / np.sqrt(2 * error.size))
    # s sqrt(2 / N), and up to 8 % more: over two periods a slope has 6 / (2 pi)² = 15 % of the energy of a sine.
    bound_m = noise_m * np.sqrt(2 / TIME_S.size)
    assert bound_m < np.median(motion_map.amplitude_uncertainty_m) < 1.1 * bound_m


@pytest.mark.parametrize("motion", [displacement_m(), displacement_m() + 5e-8 * TIME_S**2 * RATE_HZ])
def test_a_map_and_estimate_motion_give_one_answer(motion: NDArray[Any], scene: Path) -> None:
    pixel = hpe.map_motion(motion[1, 2], scene, quantity="displacement_m", pulse_rate_hz=RATE_HZ)
    estimate = hpe.estimate_motion(motion[1, 2], pulse_rate_hz=RATE_HZ, frequencies_hz=[F_HZ]).shots[0].estimates[0]
    for name in ("amplitude", "amplitude_uncertainty", "phase", "phase_uncertainty"):
        unit = "rad" if "phase" in name else "m"
        assert getattr(pixel, f"{name}_{unit}")[0, 0, 0] == pytest.approx(getattr(estimate, f"{name}_{unit}"), rel=1e-6)
    # Without noise u of the phase is that of the clock: 50 ppm of the phase at half the train, of which the slope takes
    # 5 % over two periods.
    clock_rad = 2 * np.pi * F_HZ * 50e-6 * TIME_S.mean()
    assert pixel.phase_uncertainty_rad[0, 0, 0] > 0.9 * clock_rad


def test_lengths_of_the_summary_have_a_fitting_prefix(scene: Path) -> None:
    values = 1e3 * displacement_m()
    values[0, 0, 3] = np.nan
    text = str(hpe.map_motion(values, scene, quantity="displacement_m", **SETTINGS))
    assert "1 pixel excluded" in text
    assert " mm in the median of the pixels" in text
    assert "median u " in text


def test_a_residual_of_rounding_errors_is_no_length_in_the_summary(scene: Path) -> None:
    assert str(hpe.map_motion(displacement_m(), scene, quantity="displacement_m", **SETTINGS)).endswith(
        "median u below 1 fm"
    )


def test_pixels_without_values_are_marked(scene: Path) -> None:
    values = displacement_m()
    values[0, 0, 3], values[1, 1] = np.nan, 0.0
    motion_map = hpe.map_motion(values, scene, quantity="displacement_m", **SETTINGS)
    assert (motion_map.bad[0, 0], motion_map.bad[1, 1]) == (BadPixel.NOT_FINITE, BadPixel.NO_ECHO)
    assert np.isnan(motion_map.amplitude_m[motion_map.bad > 0]).all()
    assert int((motion_map.bad == 0).sum()) == motion_map.bad.size - 2


def test_one_series_per_line_needs_no_depth(scene: Path) -> None:
    values, settings = displacement_m()[:, 2], {"axes": "line,pulse", "pulse_rate_hz": RATE_HZ}
    motion_map = hpe.map_motion(values, scene, quantity="displacement_m", **settings)
    np.testing.assert_allclose(motion_map.amplitude_m[:, 0, 0], np.abs(shear_wave_m()[:, 2]), rtol=1e-9)
    alone = hpe.map_motion(values[0], scene, quantity="displacement_m", pulse_rate_hz=RATE_HZ)
    np.testing.assert_array_equal(alone.amplitude_m[0, 0], motion_map.amplitude_m[0, 0])


def refusals() -> list[tuple[dict[str, Any], NDArray[Any], str]]:
    good, motion = SETTINGS | {"quantity": "displacement_m"}, displacement_m()
    without_step = {key: value for key, value in good.items() if key != "depth_step_m"}
    return [
        (good, motion * 1e6, "changes by up to 4 m within the train, tissue by at most 0.03 m"),
        (good | {"quantity": "velocity_m_per_s"}, motion * 1e9, "quantity=velocity_um_per_s of a map"),
        (good | {"quantity": "displacement"}, motion, "quantity"),
        (good | {"scale_v": 1.0}, motion, "scale_v: echoes have it"),
        (good | {"demodulation_hz": 0.0}, motion, "demodulation_hz: echoes have it"),
        (good | {"sample_rate_hz": 4e6}, motion, "sample_rate_hz and depth_step_m exclude each other"),
        (good, motion * 1j, "the values are complex"),
        (without_step, motion, "depth_step_m: the distance of the samples in depth is not stated"),
        ({key: value for key, value in good.items() if key != "quantity"}, motion, "depth_step_m belongs to a motion"),
        (good | {"axes": "line,sample,iq"}, motion, "axes lacks pulse, such as"),
        (good | {"pulse_rate_hz": 300.0}, motion, "pulse rate"),
    ]


@pytest.mark.parametrize(("settings", "values", "message"), refusals())
def test_contradictions_are_refused(settings: dict[str, Any], values: Any, message: str, scene: Path) -> None:
    with pytest.raises(SettingsError) as error:
        hpe.map_motion(values, scene, **settings)
    assert message in str(error.value)


def test_estimators_and_run_files_need_echoes(scene: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "u.npy", displacement_m() * 1e6)
    options = ["--set", "quantity=displacement_um", "--set", "axes=line,sample,pulse", "--set", "pulse_rate_hz=10e3"]
    command = [str(tmp_path / "u.npy"), "--scene", str(scene), *options, "--set", "depth_step_m=0.2e-3"]
    done = CliRunner().invoke(app, ["map", *command])
    assert done.exit_code == 0, done.output
    assert "the displacement changes by up to 4 um within the train" in done.output
    assert "35 of 35 pixels estimated" in done.output
    imported = CliRunner().invoke(app, ["import", *command])
    assert (imported.exit_code, "a run file holds echoes" in imported.output) == (2, True)
    scene.write_text(scene.read_text() + 'estimator = "kasai"\n')
    refused = CliRunner().invoke(app, ["map", *command])
    assert refused.exit_code == 2
    assert "'kasai' estimates motion from echoes, and the recording holds a displacement" in refused.output
