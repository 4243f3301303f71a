"""Codes to volts, offset, gate and window."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig import measure
from hpe_rig.plan import select
from hpe_rig.processing.echo import conditioning, gate as gate_module, spectrum
from hpe_rig.processing.echo.conditioning import CodedVolts, code_statistics, hann
from hpe_rig.processing.motion import phase_shift
from hpe_rig.processing.motion.phase_shift import coherent
from hpe_rig.processing.shot_tracking import margin_needed, shot_echoes
from hpe_rig.scene import load_scene


def _volts(codes: NDArray[np.int16], usable: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return ``codes`` (pulse, sample) of 0.1 mV as volts without offset."""
    records = SimpleNamespace(shape=codes.shape, margin=(0, 0), volts_per_code=1e-4, block=lambda pulses: codes[pulses])
    return CodedVolts(records, slice(0, len(codes)), usable, code_statistics(codes))[...]  # type: ignore[arg-type]


def test_the_offset_is_removed_and_the_resting_echo_kept() -> None:
    echo = np.array([3000, 0, -3000, 0, 3000, 0, -3000, 0], dtype=np.int16)
    volts = _volts(np.tile(echo + np.int16(500), (7, 1)), np.ones(7, dtype=bool))
    # float32: 2^-24 of the largest number that occurs, 0.35 V, twice
    np.testing.assert_allclose(volts, np.tile(echo * 1e-4, (7, 1)), atol=2 * 0.35 * 2**-24)


def test_missing_and_full_scale_records_do_not_affect_the_offset() -> None:
    codes = np.tile(np.array([120, -80, 120, -80], dtype=np.int16), (5, 1))
    codes[1] = -32768
    codes[3, 2:] = 8191
    volts = _volts(codes, np.array([True, False, True, False, True]))
    np.testing.assert_allclose(volts[[0, 2, 4]], np.tile([1e-2, -1e-2], (3, 2)), rtol=1e-6)
    # without a usable record no offset is removed
    assert _volts(codes, np.zeros(5, dtype=bool))[0, 0] == np.float32(120e-4)


@pytest.mark.parametrize("count", [2, 3, 99, 130])
def test_hann_window_is_symmetric_with_mean_one_half(count: int) -> None:
    window = hann(count)
    np.testing.assert_allclose(window, window[::-1], atol=1e-15)
    assert window.mean() == pytest.approx(0.5, abs=1e-15)


def test_volts_in_blocks_give_the_same_motion_as_volts_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = measure(load_scene("table-1").with_({"processing.window_start_s": 2e-3}), path=tmp_path / "run.h5")
    shot, records = run.plan.shots[0], run.stored.records
    gate, margin = shot.gate, margin_needed(run.scene, shot)
    checked: list[np.ndarray] = []
    held = records.gated_or_stored(0, gate, margin)
    blocked = records.gated_or_stored(0, gate, margin, max_samples=0, visit=lambda codes: checked.append(codes.copy()))
    gated = records.gated(0, gate)
    np.testing.assert_array_equal(np.concatenate(checked), gated.codes)
    of_codes, of_blocks = (conditioning.code_statistics(gated.codes), conditioning.gate_statistics(blocked))
    for name in ("lowest", "highest", "mean", "mean_square"):
        np.testing.assert_allclose(getattr(of_codes, name), getattr(of_blocks, name), rtol=1e-6)
    assert not hasattr(blocked, "codes")
    selection = select(run.scene, shot)
    expected = coherent(shot_echoes(run.scene, shot, held, selection))
    for module in (conditioning, gate_module):
        monkeypatch.setattr(module, "BLOCK_SAMPLES", 7 * held.shape[1])
    monkeypatch.setattr(phase_shift, "STEP_CHUNK", 5)
    monkeypatch.setattr(phase_shift, "ALIGNED_CHUNK", 6)
    echoes = shot_echoes(run.scene, shot, blocked, selection)
    assert len(list(echoes.blocks(echoes.gate))) == -(-echoes.valid.size // 7)
    np.testing.assert_allclose(echoes.energy, shot_echoes(run.scene, shot, held, selection).energy, rtol=1e-5)
    np.testing.assert_allclose(echoes.gate_volts, shot_echoes(run.scene, shot, held, selection).gate_volts, atol=1e-7)
    shot_blocks = coherent(echoes)
    # single precision of the spectra: 6e-8 of an echo's phase
    np.testing.assert_allclose(shot_blocks.displacement_m, expected.displacement_m, rtol=0, atol=5e-12)
    np.testing.assert_allclose(shot_blocks.variance_m2, expected.variance_m2, rtol=1e-3)
    assert spectrum.band_spectrum(echoes)[0].dtype == np.complex64


def test_codes_of_a_long_shot_in_the_file_equal_those_in_memory(tmp_path: Path) -> None:
    run = measure(load_scene("table-1").with_({"tracking.pulse_count": 300}), path=tmp_path / "run.h5")
    gate, margin = run.plan.shots[0].gate, margin_needed(run.scene, run.plan.shots[0])
    expected = run.stored.records.gated_or_stored(0, gate, margin).block(slice(None))
    stored = run.stored.records.gated_or_stored(0, gate, margin, max_samples=0)
    for pulses in (slice(None), slice(3, 17), slice(290, 400), slice(5, 5)):
        np.testing.assert_array_equal(stored.block(pulses), expected[pulses])


def test_spectra_in_a_temporary_file_give_the_same_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"tracking.pulse_count": 400, "processing.window_start_s": 2e-3}
    run = measure(load_scene("table-1").with_(settings), path=tmp_path / "run.h5")
    shot = run.plan.shots[0]
    records = run.stored.records.gated_or_stored(0, shot.gate, margin_needed(run.scene, shot), max_samples=0)
    echoes = shot_echoes(run.scene, shot, records, select(run.scene, shot))
    # invalid pulses in every block of volts
    echoes = echoes.without(np.arange(echoes.valid.size) % 7 == 3)
    at_once = coherent(echoes)
    for module in (conditioning, gate_module):
        monkeypatch.setattr(module, "BLOCK_SAMPLES", 50 * records.shape[1])
    expected = coherent(echoes)
    # volts and products have single precision: rounding depends on the number of pulses multiplied together
    rounding = np.sqrt(records.shape[1]) * np.finfo(np.float32).eps
    one_radian_m = run.scene.acquisition.sound_speed_m_per_s / (4 * np.pi * echoes.carrier_hz)
    np.testing.assert_allclose(expected.displacement_m, at_once.displacement_m, rtol=0, atol=rounding * one_radian_m)
    monkeypatch.setattr(phase_shift, "ALIGNED_CHUNK", 64)
    monkeypatch.setattr(spectrum, "MAX_MEMORY_BYTES", 0)
    assert isinstance(spectrum.band_spectrum(echoes)[0], np.memmap)
    in_file = coherent(echoes)
    np.testing.assert_allclose(in_file.displacement_m, expected.displacement_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(in_file.variance_m2, expected.variance_m2, rtol=1e-9)
    assert float(in_file.largest_step) == pytest.approx(float(expected.largest_step), rel=1e-12)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
def test_a_full_temporary_disk_falls_back_to_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spectrum, "MAX_MEMORY_BYTES", 0)
    monkeypatch.setattr(tempfile, "TemporaryFile", partial(Path("/dev/full").open, "r+b", buffering=0))
    buffer = spectrum.spectrum_buffer((3, 5), np.dtype(np.complex64))
    assert type(buffer) is np.ndarray
    assert buffer.shape == (3, 5)
