"""Bounds and correlations against the reference's figures and independent sums."""

from __future__ import annotations

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest

from hpe_rig.prediction.bounds import echo_bound, echo_correlation, harmonic_bound, speckle_delay_bound
from hpe_rig.processing.model import harmonic_columns


def test_delay_bound_gives_the_references_figures() -> None:
    # theory.md 3: 9 MHz, B 0.4, T 1.299 us, rho 0.99998, 20 dB: 0.815 ns; B 0.065, 40 dB: 0.222 ns
    assert speckle_delay_bound(9e6, 1.299e-6, 0.4, 0.99998, 10.0) == pytest.approx(0.815e-9, rel=2e-3, abs=0)
    assert speckle_delay_bound(9e6, 1.299e-6, 0.065, 0.99998, 100.0) == pytest.approx(0.222e-9, rel=5e-3, abs=0)


def test_delay_bound_equals_the_integral_it_comes_from() -> None:
    f, window, b, rho, snr = 9e6, 5.2e-6, 0.4, 0.999, 100.0
    coherence = (rho / (1 + 1 / snr**2)) ** 2
    band = np.linspace(f * (1 - b / 2), f * (1 + b / 2), 20001)
    weight = np.trapezoid((2 * np.pi * band) ** 2, band) * coherence / (1 - coherence)
    assert speckle_delay_bound(f, window, b, rho, snr) == pytest.approx(1 / np.sqrt(2 * window * weight), rel=1e-6)


@pytest.mark.parametrize(("displacement_m", "expected"), [(1e-6, 0.99998011), (10e-6, 0.998015), (50e-6, 0.9525)])
def test_echo_correlation_gives_the_references_figures(displacement_m: float, expected: float) -> None:
    assert abs(echo_correlation(displacement_m, 2.19, 9e6, 1540.0)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("displacement_m", [1e-13, 1e-9, 1e-6, 1e-4, 1e-3])
def test_echo_correlation_equals_the_average_over_the_beam(displacement_m: float) -> None:
    mpmath.mp.dps = 30
    theta = 4 * mpmath.pi * mpmath.mpf(9e6) / 1540 * mpmath.mpf(displacement_m)
    a = 2 * mpmath.mpf(2.19) ** 2
    # with s = u/u0 the weight I^2 is a s^(a - 1): cut where its phase has turned through a cycle
    cuts = [mpmath.mpf(k) / 40 for k in range(41)]
    exact = mpmath.quad(lambda s: a * s ** (a - 1) * mpmath.expj(theta * s), cuts)
    assert complex(echo_correlation(displacement_m, 2.19, 9e6, 1540.0)) == pytest.approx(complex(exact), abs=1e-11)


def test_bound_of_the_scenes_own_echoes_is_the_harmonic_bound_for_a_pure_carrier() -> None:
    sample_s, time_s = np.arange(1300) / 100e6, np.arange(100) / 4000
    echo = np.cos(2 * np.pi * 9e6 * sample_s + 0.3)
    columns = harmonic_columns(time_s, np.array([200.0]))
    covariance = echo_bound(echo, 100e6, np.sqrt(0.5) / 10, columns, 1540.0)
    amplitude_m, _ = harmonic_bound(1e-6, 1300, 100, 100.0, 9e6, 1540.0)
    # a quintic spline's derivative at 11 samples a period, and 117 whole cycles
    assert np.sqrt(covariance[0, 0]) == pytest.approx(amplitude_m, rel=2e-3, abs=0)
    assert covariance[0, 1] == pytest.approx(0, abs=1e-3 * covariance[0, 0])
