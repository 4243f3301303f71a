"""Tests of the residual of the fit: whiteness, spectral lines, normality, stationarity, size of the innovations.

Each test states its p-value, the probability of an equal or larger deviation for white noise. A value below
``MIN_P`` is noticed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc, kolmogorov

from hpe_rig.arrays import FloatArray
from hpe_rig.report.views import MotionView
from hpe_rig.result import probability_text

Outcome = Literal["passed", "noticed", "not possible"]

MIN_P = 0.001
MIN_BINS = 12
MIN_PULSES = 30


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Outcome of one test in words; ``meaning`` explains a noticed one."""

    name: str
    verdict: Outcome
    value: str
    meaning: str


def residual_tests(view: MotionView) -> list[ResidualTest]:
    """Return the outcome of every test for the residual of ``view``."""
    outcomes = []
    for name, (test, meaning) in _TESTS.items():
        try:
            p, value = test(view)
            words = probability_text(p)
            relation = words if words.startswith("<") else f"= {words}"
        except ValueError as error:
            outcomes.append(ResidualTest(name, "not possible", str(error), ""))
        else:
            outcomes.append(
                ResidualTest(name, "passed" if p >= MIN_P else "noticed", f"{value}, p {relation}", meaning)
            )
    return outcomes


def periodogram(view: MotionView) -> tuple[FloatArray, FloatArray]:
    """Return frequency and power (bin,) of the residual, without the fitted frequencies and their neighbours.

    Zero and half the pulse rate are excluded too. Missing pulses have zero residual.
    """
    pulse = np.round((view.time_s - view.time_s[0]) * view.pulse_rate_hz).astype(np.int64)
    # Onto the regular grid of pulses, which the Fourier transform needs.
    series = np.zeros(int(pulse[-1]) + 1)
    series[pulse] = view.residual_m
    frequency_hz = np.fft.rfftfreq(series.size, 1 / view.pulse_rate_hz)
    distance_hz = np.abs(frequency_hz[:, None] - view.frequencies_hz).min(axis=1, initial=math.inf)
    # The margin keeps rounding errors from including a neighbouring bin.
    free = distance_hz * series.size / view.pulse_rate_hz > 1 + 1e-6
    free &= (frequency_hz > 0) & (frequency_hz < view.pulse_rate_hz / 2 * (1 - 1e-9))
    return frequency_hz[free], np.abs(np.fft.rfft(series)[free]) ** 2


def whiteness_p(power: FloatArray) -> float:
    """Return the p-value of a periodogram (bin,) under white noise: Bartlett's cumulative periodogram test."""
    # White noise has a uniform power: its cumulative sum is a straight line up to chance.
    cumulative = np.cumsum(power)[:-1] / power.sum()
    uniform = np.arange(1, power.size) / power.size
    return float(kolmogorov(math.sqrt(power.size - 1) * np.max(np.abs(cumulative - uniform))))


def line_p(power: FloatArray) -> float:
    """Return the p-value of a periodogram's (bin,) largest bin under white noise: Fisher's g, first term (a bound)."""
    # Fisher: P(g > x) is about n (1 - x)^(n - 1) for the largest of n bins.
    largest = float(power.max() / power.sum())
    return min(1.0, power.size * (1 - largest) ** (power.size - 1))


def innovation_sum(matrix: FloatArray, data: FloatArray, variance: FloatArray) -> tuple[float, int]:
    """Return the sum of the squared normalised innovations of recursive least squares, and their number.

    An innovation is a pulse minus its prediction from all earlier pulses, over the standard deviation of both. The sum
    equals the weighted sum of squared residuals of the fit to all pulses (Brown, Durbin and Evans 1975). ``matrix``
    (pulse, state), ``data`` and its noise ``variance`` (pulse,). Raises ``ValueError`` if the pulses are too few.
    """
    # Unit noise variance: every row and value is divided by its standard deviation.
    scaled, target = matrix / np.sqrt(variance)[:, None], data / np.sqrt(variance)
    state, _, rank, _ = np.linalg.lstsq(scaled, target, rcond=None)
    count = len(matrix) - int(rank)
    if count < MIN_BINS:
        raise ValueError(f"{len(matrix)} pulses are too few for {matrix.shape[1]} unknowns")
    return float(np.sum((target - scaled @ state) ** 2)), count


def _whiteness(view: MotionView) -> tuple[float, str]:
    _, power = _checked_size(periodogram(view))
    return whiteness_p(power), f"cumulative periodogram of {power.size} bins"


def _line(view: MotionView) -> tuple[float, str]:
    frequency_hz, power = _checked_size(periodogram(view))
    amplitude_m = 2 * math.sqrt(power.max()) / view.residual_m.size
    return line_p(power), f"largest at {frequency_hz[np.argmax(power)]:.4g} Hz, {amplitude_m * 1e9:.3g} nm"


def _checked_size(spectrum: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    if spectrum[1].size < MIN_BINS:
        raise ValueError(f"{spectrum[1].size} frequencies outside the fit, {MIN_BINS} needed")
    return spectrum


def _normality(view: MotionView) -> tuple[float, str]:
    residual = view.residual_m
    if residual.size < MIN_PULSES or not residual.std() > 0:
        raise ValueError(f"{residual.size} pulses of {residual.std() * 1e9:.3g} nm rms")
    normalised = (residual - residual.mean()) / residual.std()
    skewness, kurtosis = float(np.mean(normalised**3)), float(np.mean(normalised**4)) - 3
    # Jarque and Bera: n / 6 (S² + K² / 4) has a chi-square distribution of two degrees of freedom: P = exp(-x / 2).
    p = math.exp(-residual.size / 12 * (skewness**2 + kurtosis**2 / 4))
    return p, f"skewness {skewness:+.2f}, excess kurtosis {kurtosis:+.2f}"


def _stationarity(view: MotionView) -> tuple[float, str]:
    first, second = np.array_split(view.residual_m, 2)
    if first.size < MIN_PULSES // 2 or not min(first.std(), second.std()) > 0:
        raise ValueError(f"{view.residual_m.size} pulses")
    log_ratio = math.log(float(np.mean(second**2) / np.mean(first**2)))
    # The logarithm of a sample variance of n values has the variance 2 / n.
    distance = abs(log_ratio) / math.sqrt(2 / first.size + 2 / second.size)
    return math.erfc(distance / math.sqrt(2)), f"rms {first.std() * 1e9:.3g} nm, then {second.std() * 1e9:.3g} nm"


def _innovation(view: MotionView) -> tuple[float, str]:
    if not (view.noise_m2 > 0).all():
        raise ValueError("the echoes have no measurable noise")
    total, count = innovation_sum(view.matrix, view.displacement_m, view.noise_m2)
    # One-sided: echoes that change shape with the motion scatter more than their noise, which is no fault.
    return float(chdtrc(count, total)), f"mean square {total / count:.3f} of {count}, expected at most 1"


_TESTS: dict[str, tuple[Callable[[MotionView], tuple[float, str]], str]] = {
    "white residual": (_whiteness, "the stated uncertainties assume white noise"),
    "no spectral line": (_line, "a line would be motion at a frequency outside the fit"),
    "normal residual": (_normality, "outliers indicate spikes, clipped or disturbed pulses"),
    "steady noise": (_stationarity, "a change of the noise indicates a changing echo"),
    "innovations": (
        _innovation,
        "above 1: jitter or motion beyond the noise of the echoes; below 1: echoes change shape",
    ),
}
"""Tests by name, and the meaning of a noticed one. A test returns p and its value, or raises ``ValueError``."""
