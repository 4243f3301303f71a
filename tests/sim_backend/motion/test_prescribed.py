"""Prescribed motion against eq. (1)."""

import mpmath
import numpy as np
import pytest

from sim_backend.motion.prescribed import cycles_at, motion_at
from sim_backend.settings import MotionComponent


def test_prescribed_motion_is_the_sum_of_its_sinusoids():
    components = (
        MotionComponent(frequency_hz=217.3, amplitude_m=1e-6, phase_rad=0.3),
        MotionComponent(frequency_hz=300.0, amplitude_m=2e-7),
    )
    time_ps = np.array([-5_000_000, 0, 1_250_000_001, 99_999_999_999], dtype=np.int64)
    time_s = time_ps / 1e12
    expected = 1e-6 * np.sin(2 * np.pi * 217.3 * time_s + 0.3) + 2e-7 * np.sin(600 * np.pi * time_s)
    assert motion_at(components, time_ps) == pytest.approx(expected, abs=1e-18)


@pytest.mark.parametrize("frequency_hz", [0.1, 1 / 3, 200.0, 217.345678901, 999.9999, 12345.678])
def test_phase_is_right_to_1e_12_rad_after_1e5_seconds(frequency_hz):
    time_ps = np.array([1, 10**12 - 1, 10**17, 10**17 - 1, 99_999_123_456_789_012], dtype=np.int64)
    with mpmath.workdps(40):
        exact = [mpmath.mpf(frequency_hz) * int(t) / 10**12 for t in time_ps]
        error = [
            float(2 * mpmath.pi * abs((mpmath.mpf(float(a)) - b + 0.5) % 1 - 0.5))
            for a, b in zip(cycles_at(frequency_hz, time_ps), exact, strict=True)
        ]
    assert max(error) < 1e-12


@pytest.mark.parametrize("pulses_per_cycle", [2, 3, 100, 10_000])
def test_pulse_rates_from_two_to_ten_thousand_a_cycle_sample_the_same_sinusoid(pulses_per_cycle):
    components = (MotionComponent(frequency_hz=200.0, amplitude_m=1e-6),)
    time_ps = np.arange(3 * pulses_per_cycle, dtype=np.int64) * (5_000_000_000 // pulses_per_cycle)
    expected = 1e-6 * np.sin(2 * np.pi * 200.0 * (time_ps.astype(np.longdouble) / 10**12))
    assert motion_at(components, time_ps) == pytest.approx(expected.astype(float), abs=1e-20)
