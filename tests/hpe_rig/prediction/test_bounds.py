"""The bound of a scene's own echoes against the narrow-band one."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.prediction.bounds import echo_bound
from hpe_rig.processing.harmonics.model import harmonic_columns


def test_the_bound_of_a_pure_carrier_is_the_narrow_band_one() -> None:
    sample_s, time_s = np.arange(1300) / 100e6, np.arange(100) / 4000
    echo = np.cos(2 * np.pi * 9e6 * sample_s + 0.3)
    columns = harmonic_columns(time_s, np.array([200.0]))
    covariance = echo_bound(echo, 100e6, np.sqrt(0.5) / 10, columns, 1540.0)
    # Phase variance 1 / (samples SNR) of one echo, 2 / pulses of it in each quadrature.
    amplitude_m = 1540.0 / (4 * np.pi * 9e6) * np.sqrt(2 / (100 * 1300 * 100.0))
    # A quintic spline's derivative at 11 samples a period, and 117 whole cycles
    assert np.sqrt(covariance[0, 0]) == pytest.approx(amplitude_m, rel=2e-3, abs=0)
    assert covariance[0, 1] == pytest.approx(0, abs=1e-3 * covariance[0, 0])
