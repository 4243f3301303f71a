"""Maps: true motion within its uncertainty in every pixel; bad pixels are marked and do not affect others."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.processing import MapSettings, map_pixels
from hpe_rig.processing.maps import kernels, motion_map
from hpe_rig.result import BadPixel
from hpe_rig.scene import SettingsError

RATE_HZ, CARRIER_HZ, SPEED = 40e6, 5e6, 1540.0
TIME_S = np.arange(60) / 4000.0
AMPLITUDE_M, PHASE_RAD, VELOCITY_M_PER_S = 1e-6, 0.7, 20e-6


def displacement_m() -> NDArray[np.float64]:
    return np.asarray(AMPLITUDE_M * np.sin(2 * np.pi * 200.0 * TIME_S + PHASE_RAD) + VELOCITY_M_PER_S * TIME_S)


def lines(count: int, snr_db: float, seed: int, demodulated: bool = False) -> NDArray[Any]:
    """Return echoes (line, pulse, sample) of speckle that moves as a whole, delayed frequency by frequency."""
    rng, samples = np.random.default_rng(seed), 3200
    rate_hz = np.fft.fftfreq(samples, 1 / RATE_HZ)
    weight = np.where(rate_hz > 0, np.exp(-(((rate_hz - CARRIER_HZ) / (0.3 * CARRIER_HZ)) ** 2)), 0.0)
    spectrum = weight * (rng.normal(size=(count, 1, samples)) + 1j * rng.normal(size=(count, 1, samples)))
    echo = np.fft.ifft(spectrum * np.exp(-4j * np.pi * rate_hz * displacement_m()[:, None] / SPEED))
    echo /= np.sqrt(np.mean(echo.real**2))
    echo = echo + 10 ** (-snr_db / 20) * (rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape))
    if demodulated:
        return np.asarray(echo * np.exp(-2j * np.pi * CARRIER_HZ * np.arange(samples) / RATE_HZ))[..., ::4]
    return np.asarray(echo.real)


@pytest.mark.parametrize(
    ("demodulated", "gate", "snr_db"),
    [
        (False, 16, 30.0),
        pytest.param(False, 32, 70.0, marks=pytest.mark.slow),
        pytest.param(True, 1, 40.0, marks=pytest.mark.slow),
        (True, 4, 30.0),
    ],
)
def test_the_true_motion_is_within_the_uncertainty_of_pixels(demodulated: bool, gate: int, snr_db: float) -> None:
    samples = lines(4, snr_db, 11, demodulated)
    settings = MapSettings(RATE_HZ / 4 if demodulated else RATE_HZ, CARRIER_HZ, gate, SPEED, 0.0)
    result = map_pixels(samples, TIME_S, [200.0, 400.0], settings)
    good = result.bad == 0
    assert good.mean() > 0.97
    errors = {
        "amplitude": (result.amplitude_m[..., 0] - AMPLITUDE_M) / result.amplitude_uncertainty_m[..., 0],
        "phase": (result.phase_rad[..., 0] - PHASE_RAD) / result.phase_uncertainty_rad[..., 0],
        "velocity": (result.velocity_m_per_s - VELOCITY_M_PER_S) / result.velocity_uncertainty_m_per_s,
    }
    for name, error in errors.items():
        # 68.3 % of 400 independent pixels or more, ± four standard deviations of that count.
        within = np.abs(error[good]) < 1
        assert within.mean() == pytest.approx(0.683, abs=4 * np.sqrt(0.683 * 0.317 / 400)), name


@pytest.mark.parametrize(("gate", "is_gaussian", "length"), [(1, False, 100.0), (4, True, 100.0), (1, True, 1000.0)])
def test_intervals_hold_for_echoes_that_decorrelate(gate: int, is_gaussian: bool, length: float) -> None:
    """Echoes that are renewed at random (exponential correlation) and that cross the beam (Gaussian)."""
    rng, shape = np.random.default_rng(15), (8, TIME_S.size, 256)
    lag = np.abs(np.subtract.outer(np.arange(TIME_S.size), np.arange(TIME_S.size))) / length
    values, vectors = np.linalg.eigh(np.exp(-(lag**2) / 2 if is_gaussian else -lag))
    root = vectors * np.sqrt(np.maximum(values, 0))
    rate_hz = np.fft.fftfreq(shape[2], 4 / RATE_HZ)
    weight = np.exp(-((rate_hz / (0.3 * CARRIER_HZ)) ** 2))
    spectrum = np.fft.fft(root @ (rng.normal(size=shape) + 1j * rng.normal(size=shape))) * weight
    echo = np.fft.ifft(spectrum * np.exp(-4j * np.pi * (rate_hz + CARRIER_HZ) * displacement_m()[:, None] / SPEED))
    echo = echo + 0.01 * np.std(echo) / np.sqrt(2) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    settings = MapSettings(RATE_HZ / 4, CARRIER_HZ, gate, SPEED, 0.0, 0.0, CARRIER_HZ)
    result = map_pixels(echo, TIME_S, [200.0], settings)
    good = result.bad == 0
    assert good.mean() > 0.9
    errors = {
        "amplitude": (result.amplitude_m[..., 0] - AMPLITUDE_M) / result.amplitude_uncertainty_m[..., 0],
        "phase": np.angle(np.exp(1j * (result.phase_rad[..., 0] - PHASE_RAD))) / result.phase_uncertainty_rad[..., 0],
        "velocity": (result.velocity_m_per_s - VELOCITY_M_PER_S) / result.velocity_uncertainty_m_per_s,
    }
    for name, error in errors.items():
        # 95 % of 200 independent pixels or more, less four standard deviations of that count; residual noise alone
        # gives 2 to 20 % for the velocity.
        assert np.mean(np.abs(error[good]) < 2) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 200), name


def test_a_gate_longer_than_a_record_is_refused() -> None:
    settings = MapSettings(RATE_HZ, CARRIER_HZ, 401, SPEED)
    with pytest.raises(ValueError, match="a gate of 401 samples is longer than a record"):
        map_pixels(np.ones((1, 60, 400)), TIME_S, [200.0], settings)


def test_bad_pixels_are_marked_and_do_not_affect_the_others() -> None:
    samples, settings = lines(3, 30.0, 12), MapSettings(RATE_HZ, CARRIER_HZ, 16, SPEED)
    complete = map_pixels(samples, TIME_S, [200.0], settings)
    samples[1] = 0.0
    samples[2] = np.random.default_rng(1).normal(size=samples.shape[1:])
    samples[0, 7, 1600] = np.nan
    calls: list[tuple[int, int]] = []
    result = map_pixels(samples, TIME_S, [200.0], settings, progress=lambda done, of: calls.append((done, of)))
    assert (result.bad[1] == BadPixel.NO_ECHO).all()
    assert (result.bad[2] == BadPixel.NOISE).mean() > 0.99
    assert np.flatnonzero(result.bad[0]).tolist() == [100]
    assert result.bad[0, 100] == BadPixel.NOT_FINITE
    assert np.isnan(result.amplitude_m[result.bad > 0]).all()
    # Far from the missing sample of one pulse, only the tails of the filter change the pixels.
    far = np.abs(np.arange(200) - 100) > 20
    error = result.amplitude_m[0, far, 0] - complete.amplitude_m[0, far, 0]
    assert np.abs(error).max() < 0.1 * float(np.median(complete.amplitude_uncertainty_m[0, :, 0]))
    assert calls[-1] == (3, 3)


def test_progress_counts_finished_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_map, "BATCH_BYTES", 1)
    calls: list[tuple[int, int]] = []
    settings = MapSettings(RATE_HZ, CARRIER_HZ, 16, SPEED)
    map_pixels(lines(3, 30.0, 12), TIME_S, [200.0], settings, progress=lambda done, of: calls.append((done, of)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_motion_of_wavelengths_is_followed() -> None:
    # 0.4 mm/s along with the vibration: half a wavelength over the train, as in a dragging hand.
    samples = np.exp(-4j * np.pi * CARRIER_HZ * (displacement_m() + 0.4e-2 * TIME_S) / SPEED)[None, :, None]
    depths = samples * np.ones((1, 1, 8)) * np.exp(0j)
    result = map_pixels(depths, TIME_S, [200.0], MapSettings(10e6, CARRIER_HZ, 1, SPEED, 0.0, 0.0, CARRIER_HZ))
    assert result.velocity_m_per_s[0] == pytest.approx(np.full(8, VELOCITY_M_PER_S + 0.4e-2), rel=1e-4)
    assert result.amplitude_m[0, :, 0] == pytest.approx(np.full(8, AMPLITUDE_M), rel=1e-3)


def frame() -> NDArray[Any]:
    """Return I and Q (line, pulse, sample) with a drag of a wavelength, a pixel without echo and a line of noise."""
    samples = lines(3, 30.0, 14, demodulated=True)
    samples[0] *= np.exp(-4j * np.pi * CARRIER_HZ * (0.4e-2 * TIME_S) / SPEED)[:, None]
    samples[1, :, 40] = 0
    samples[2] = np.random.default_rng(2).normal(size=samples.shape[1:])
    return samples.astype(np.complex64)


def test_the_compiled_kernels_differ_from_numpy_by_rounding_only(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    settings = MapSettings(RATE_HZ / 4, CARRIER_HZ, 1, SPEED)
    monkeypatch.setattr(motion_map, "COMPILED_SAMPLES", 0)
    compiled = map_pixels(frame(), TIME_S, [200.0, 400.0], settings)
    monkeypatch.setattr(motion_map, "COMPILED_SAMPLES", np.inf)
    monkeypatch.delitem(sys.modules, "numba")
    plain = map_pixels(frame(), TIME_S, [200.0, 400.0], settings)
    assert (compiled.bad == plain.bad).all()
    assert set(np.unique(plain.bad)) == {0, BadPixel.NOISE, BadPixel.NO_ECHO}
    # Phases of up to 2 pi a turn in single precision, 24.5 um a radian: 1e-6 rad are 0.02 nm.
    for name in ("amplitude_m", "amplitude_uncertainty_m"):
        np.testing.assert_allclose(getattr(compiled, name), getattr(plain, name), rtol=2e-5, atol=5e-11)
    for name in ("phase_rad", "phase_uncertainty_rad"):
        around = np.angle(np.exp(1j * (getattr(compiled, name) - getattr(plain, name))))[plain.bad == 0]
        signal = plain.amplitude_m[plain.bad == 0]
        assert (np.abs(around) * signal < 1e-10).all(), name
    np.testing.assert_allclose(compiled.velocity_m_per_s, plain.velocity_m_per_s, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("scale", [1.0, *(pytest.param(scale, marks=pytest.mark.slow) for scale in (1e-24, 1e24))])
@pytest.mark.parametrize("compiled", [False, True])
def test_phases_equal_those_in_double_precision(compiled: bool, scale: float) -> None:
    pytest.importorskip("numba")
    echo = np.ascontiguousarray(frame()[:2].transpose(0, 2, 1)) * np.float32(scale)
    exact = np.unwrap(np.angle(echo.astype(complex)), axis=-1)
    exact -= exact[..., :1]
    phase = (importlib.import_module("hpe_rig.processing.maps.kernels_numba") if compiled else kernels).unwrapped(echo)
    unambiguous = np.abs(np.diff(exact, axis=-1)).max(axis=-1) < 3
    # Two roundings of up to 2 turns, 6e-8 of 12.6 each, and those of the product and the arctangent.
    assert np.abs(phase - exact)[unambiguous].max() < 3e-6


def test_echoes_too_small_for_single_precision_count_as_no_echo() -> None:
    settings = MapSettings(RATE_HZ / 4, CARRIER_HZ, 1, SPEED)
    result = map_pixels(frame()[:2, :, :100] * np.float32(1e-22), TIME_S, [200.0], settings)
    # squares of 1e-44, which single precision resolves to 1e-45
    assert (result.bad == BadPixel.NO_ECHO).all()
    assert np.isnan(result.amplitude_m).all()


SCENE = """
title = "A scan"
[tracking]
[acquisition]
gate_depth_m = 10e-3
gate_length_m = 0.308e-3
[processing]
frequencies_hz = [200.0]
"""


def test_a_recording_becomes_a_dataset_and_a_figure(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    np.savez(tmp_path / "scan.npz", rf=lines(3, 30.0, 13).astype(np.float32), fs=RATE_HZ, prf=4e3, fc=CARRIER_HZ)
    result = hpe.map_motion(tmp_path / "scan.npz", scene, axes="line,pulse,sample", line_pitch_m=0.3e-3)
    dataset = result.to_xarray()
    assert dataset.sizes == {"line": 3, "depth": 200, "frequency": 1}
    assert float(dataset.amplitude_m.sel(frequency=200.0).median()) == pytest.approx(AMPLITUDE_M, rel=0.05)
    assert dataset.amplitude_m.attrs["units"] == "m"
    # the middle of each gate, there and back
    gate_m = SPEED / 2 * 16 / RATE_HZ
    np.testing.assert_allclose(dataset.depth, (np.arange(200) + 0.5) * gate_m, rtol=1e-12)
    assert "SHA-256" in dataset.attrs["source"]
    assert "600 of 600 pixels estimated" in str(result)
    assert result.figure().axes[0].get_ylabel() == "depth / mm"
    # Without positions, lines count from 1.
    unplaced = replace(result, line_m=np.arange(3.0), lines_are_placed=False).figure().axes[0]
    assert (unplaced.get_xlabel(), unplaced.get_xlim()) == ("line", (0.5, 3.5))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"carrier_hz": 30e6}, "carrier"),
        ({"axes": "shot,pulse,sample"}, "a map needs one shot"),
        ({"lines": "9"}, "3 lines"),
    ],
)
def test_an_impossible_map_is_refused(settings: dict[str, Any], words: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    stated = {"axes": "line,pulse,sample", "sample_rate_hz": RATE_HZ, "pulse_rate_hz": 4e3, "carrier_hz": CARRIER_HZ}
    with pytest.raises(SettingsError, match=words):
        hpe.map_motion(np.ones((3, 60, 400)), scene, **(stated | settings))
