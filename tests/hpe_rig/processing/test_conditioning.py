"""Codes to volts, offset, gate and window."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing.conditioning import centred_volts, codes_to_volts, hann


def test_full_scale_codes_become_full_scale_volts() -> None:
    volts = codes_to_volts(np.array([[-8192, 0, 8191]], dtype=np.int16), 0.8 / 8192, 0.01)
    np.testing.assert_allclose(volts, [[-0.79, 0.01, 0.8 * 8191 / 8192 + 0.01]], rtol=1e-15)


def test_offset_goes_and_the_resting_echo_stays() -> None:
    echo = np.array([3000, 0, -3000, 0, 3000, 0, -3000, 0], dtype=np.int16)
    volts = centred_volts(np.tile(echo + np.int16(500), (7, 1)), 1e-4, np.ones(7, dtype=bool))
    # float32: 2^-24 of the largest number that occurs, 0.35 V, twice
    np.testing.assert_allclose(volts, np.tile(echo * 1e-4, (7, 1)), atol=2 * 0.35 * 2**-24)


def test_missing_and_full_scale_records_move_no_other_records_offset() -> None:
    codes = np.tile(np.array([120, -80, 120, -80], dtype=np.int16), (5, 1))
    codes[1] = -32768
    codes[3, 2:] = 8191
    volts = centred_volts(codes, 1e-4, np.array([True, False, True, False, True]))
    np.testing.assert_allclose(volts[[0, 2, 4]], np.tile([1e-2, -1e-2], (3, 2)), rtol=1e-6)
    # without a sound record there is no offset to know
    assert centred_volts(codes, 1e-4, np.zeros(5, dtype=bool))[0, 0] == np.float32(120e-4)


@pytest.mark.parametrize("count", [2, 3, 99, 130])
def test_hann_window_is_symmetric_with_mean_one_half(count: int) -> None:
    window = hann(count)
    np.testing.assert_allclose(window, window[::-1], atol=1e-15)
    assert window.mean() == pytest.approx(0.5, abs=1e-15)
