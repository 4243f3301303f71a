"""Codes to volts, offset, gate and window."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing.conditioning import codes_to_volts, hann, remove_offset


def test_full_scale_codes_become_full_scale_volts() -> None:
    volts = codes_to_volts(np.array([[-8192, 0, 8191]], dtype=np.int16), 0.8 / 8192, 0.01)
    np.testing.assert_allclose(volts, [[-0.79, 0.01, 0.8 * 8191 / 8192 + 0.01]], rtol=1e-15)


def test_offset_goes_and_the_resting_echo_stays() -> None:
    echo = np.cos(np.arange(40) * 2 * np.pi / 8)
    np.testing.assert_allclose(remove_offset(np.tile(echo + 0.3, (7, 1))), np.tile(echo, (7, 1)), atol=1e-14)


@pytest.mark.parametrize("count", [2, 3, 99, 130])
def test_hann_window_is_symmetric_with_mean_one_half(count: int) -> None:
    window = hann(count)
    np.testing.assert_allclose(window, window[::-1], atol=1e-15)
    assert window.mean() == pytest.approx(0.5, abs=1e-15)
