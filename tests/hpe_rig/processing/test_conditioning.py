"""Codes to volts, offset, gate and window."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing.conditioning import codes_to_volts, gate_slice, hann, remove_offset


def test_full_scale_codes_become_full_scale_volts() -> None:
    volts = codes_to_volts(np.array([[-8192, 0, 8191]], dtype=np.int16), 0.8 / 8192, 0.01)
    np.testing.assert_allclose(volts, [[-0.79, 0.01, 0.8 * 8191 / 8192 + 0.01]], rtol=1e-15)


def test_one_millimetre_at_100_mhz_is_130_samples_around_the_depth() -> None:
    gate = gate_slice(85e-6, 1024, 100e6, 70e-3, 1e-3, 1540.0)
    assert gate.stop - gate.start == 130
    middle_s = 85e-6 + (gate.start + gate.stop) / 2 / 100e6
    assert middle_s == pytest.approx(2 * 70e-3 / 1540, abs=1 / 100e6)


@pytest.mark.parametrize("record_start_s", [91e-6, 80e-6])
def test_a_gate_outside_its_record_is_refused_with_both_numbers(record_start_s: float) -> None:
    with pytest.raises(ValueError, match=r"samples -?\d+ to \d+ of a record of 512"):
        gate_slice(record_start_s, 512, 100e6, 70e-3, 1e-3, 1540.0)


def test_offset_goes_and_the_resting_echo_stays() -> None:
    echo = np.cos(np.arange(40) * 2 * np.pi / 8)
    np.testing.assert_allclose(remove_offset(np.tile(echo + 0.3, (7, 1))), np.tile(echo, (7, 1)), atol=1e-14)


@pytest.mark.parametrize("count", [2, 3, 99, 130])
def test_hann_window_is_symmetric_with_mean_one_half(count: int) -> None:
    window = hann(count)
    np.testing.assert_allclose(window, window[::-1], atol=1e-15)
    assert window.mean() == pytest.approx(0.5, abs=1e-15)
