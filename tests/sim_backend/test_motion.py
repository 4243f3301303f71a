"""Prescribed motion against eq. (1)."""

import numpy as np

from sim_backend.motion import prescribed_motion
from sim_backend.settings import MotionComponent


def test_prescribed_motion_is_the_sum_of_its_sinusoids():
    components = (
        MotionComponent(frequency_hz=200.0, amplitude_m=1e-6, phase_rad=0.3),
        MotionComponent(frequency_hz=300.0, amplitude_m=2e-7),
    )
    time_s = np.array([0.0, 1.25e-3, 5e-3, 0.1])
    expected = 1e-6 * np.sin(400 * np.pi * time_s + 0.3) + 2e-7 * np.sin(600 * np.pi * time_s)
    assert np.array_equal(prescribed_motion(components, time_s), expected)
