"""Prescribed motion of the focus, eq. (1) and (13)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import MotionComponent

Floats = NDArray[np.float64]


def prescribed_motion(components: Sequence[MotionComponent], time_s: Floats) -> Floats:
    """Return the sum of sinusoids D sin(2 pi f t + phi) at ``time_s`` (time,) after the master trigger, m."""
    displacement_m = np.zeros(time_s.shape)
    for component in components:
        phase_rad = 2 * np.pi * component.frequency_hz * time_s + component.phase_rad
        displacement_m += component.amplitude_m * np.sin(phase_rad)
    return displacement_m
