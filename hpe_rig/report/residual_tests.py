"""Tests of what is left after the fit: is it white, is there a line in it, is it normal, is it as large as expected?

Each test states its p-value: how often pure white noise would look at least as odd. Below ``LEAST_P`` it is noticed.
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

Outcome = Literal["passed", "noticed", "not possible"]

LEAST_P = 0.001
LEAST_BINS = 12


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """What one test of the residual found, in words."""

    name: str
    verdict: Outcome
    found: str
    meaning: str


def residual_tests(view: MotionView) -> list[ResidualTest]:
    """Return what every test says about the residual of ``view``."""
    out = []
    for name, (test, meaning) in _TESTS.items():
        try:
            p, found = test(view)
        except ValueError as error:
            out.append(ResidualTest(name, "not possible", str(error), ""))
        else:
            out.append(ResidualTest(name, "passed" if p >= LEAST_P else "noticed", f"{found}, p = {p:.2g}", meaning))
    return out


def periodogram(view: MotionView) -> tuple[FloatArray, FloatArray]:
    """Return frequency and power (bin,) of the residual at the bins that the fit has left alone.

    Missing pulses count as zero residual; zero, half the pulse rate and the fitted frequencies' neighbours are left
    out.
    """
    place = np.round((view.time_s - view.time_s[0]) * view.pulse_rate_hz).astype(np.int64)
    series = np.zeros(int(place[-1]) + 1)
    series[place] = view.residual_m
    frequency_hz = np.fft.rfftfreq(series.size, 1 / view.pulse_rate_hz)
    distance_hz = np.abs(frequency_hz[:, None] - view.frequencies_hz).min(axis=1, initial=math.inf)
    # a rounding error must not decide whether a neighbouring bin counts as fitted
    free = distance_hz * series.size / view.pulse_rate_hz > 1 + 1e-6
    free &= (frequency_hz > 0) & (frequency_hz < view.pulse_rate_hz / 2 * (1 - 1e-9))
    return frequency_hz[free], np.abs(np.fft.rfft(series)[free]) ** 2


def whiteness_p(power: FloatArray) -> float:
    """Return the p-value of a periodogram (bin,) under white noise: Bartlett's cumulative periodogram test."""
    cumulated = np.cumsum(power)[:-1] / power.sum()
    even = np.arange(1, power.size) / power.size
    return float(kolmogorov(math.sqrt(power.size - 1) * np.max(np.abs(cumulated - even))))


def line_p(power: FloatArray) -> float:
    """Return the p-value of a periodogram's (bin,) largest bin under white noise: Fisher's g, first term (a bound)."""
    share = float(power.max() / power.sum())
    return min(1.0, power.size * (1 - share) ** (power.size - 1))


def innovations(matrix: FloatArray, data: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the normalised innovations (pulse - start,) of recursive least squares; unit variance if all is as said.

    ``matrix`` (pulse, state), ``data`` and its noise ``variance`` (pulse,). The first pulses, just enough for a start,
    give no innovation. Raises ``ValueError`` where no start can be found. Source: recursive residuals of Brown,
    Durbin and Evans.
    """
    start = _start(matrix)
    scaled, target = matrix / np.sqrt(variance)[:, None], data / np.sqrt(variance)
    covariance = np.linalg.inv(scaled[:start].T @ scaled[:start])
    state = covariance @ (scaled[:start].T @ target[:start])
    found = np.empty(len(matrix) - start)
    for place, (row, value) in enumerate(zip(scaled[start:], target[start:], strict=True)):
        gain = covariance @ row
        spread = 1 + row @ gain
        innovation = value - row @ state
        found[place] = innovation / math.sqrt(spread)
        state = state + gain * (innovation / spread)
        covariance = covariance - np.outer(gain, gain) / spread
    return found


def _start(matrix: FloatArray) -> int:
    start: int = 2 * matrix.shape[1]
    while start < len(matrix) - LEAST_BINS:
        if np.linalg.cond(matrix[:start]) < 1e3:
            return start
        start *= 2
    raise ValueError(f"{len(matrix)} pulses are too few to start from: {matrix.shape[1]} numbers are unknown")


def _whiteness(view: MotionView) -> tuple[float, str]:
    _, power = _enough(periodogram(view))
    return whiteness_p(power), f"cumulative periodogram of {power.size} bins"


def _line(view: MotionView) -> tuple[float, str]:
    frequency_hz, power = _enough(periodogram(view))
    amplitude_m = 2 * math.sqrt(power.max()) / view.residual_m.size
    return line_p(power), f"largest at {frequency_hz[np.argmax(power)]:.4g} Hz, {amplitude_m * 1e9:.3g} nm"


def _enough(spectrum: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    if spectrum[1].size < LEAST_BINS:
        raise ValueError(f"{spectrum[1].size} free frequencies, {LEAST_BINS} needed")
    return spectrum


def _normality(view: MotionView) -> tuple[float, str]:
    residual = view.residual_m
    if residual.size < 30 or not residual.std() > 0:
        raise ValueError(f"{residual.size} pulses of {residual.std() * 1e9:.3g} nm rms")
    normalised = (residual - residual.mean()) / residual.std()
    skewness, kurtosis = float(np.mean(normalised**3)), float(np.mean(normalised**4)) - 3
    # Jarque and Bera: n / 6 (S^2 + K^2 / 4) is chi-square of two degrees of freedom, whose tail is an exponential
    p = math.exp(-residual.size / 12 * (skewness**2 + kurtosis**2 / 4))
    return p, f"skewness {skewness:+.2f}, excess kurtosis {kurtosis:+.2f}"


def _steady(view: MotionView) -> tuple[float, str]:
    first, second = np.array_split(view.residual_m, 2)
    if first.size < 15 or not min(first.std(), second.std()) > 0:
        raise ValueError(f"{view.residual_m.size} pulses")
    log_ratio = math.log(float(np.mean(second**2) / np.mean(first**2)))
    distance = abs(log_ratio) / math.sqrt(2 / first.size + 2 / second.size)
    return math.erfc(distance / math.sqrt(2)), f"rms {first.std() * 1e9:.3g} nm, then {second.std() * 1e9:.3g} nm"


def _innovation(view: MotionView) -> tuple[float, str]:
    if not (view.noise_m2 > 0).all():
        raise ValueError("the echoes show no noise of their own")
    squares = innovations(view.matrix, view.displacement_m, view.noise_m2) ** 2
    # one-sided: echoes that change shape with the motion show more scatter than their noise, and that is no fault
    p = float(chdtrc(squares.size, float(squares.sum())))
    return p, f"mean square {squares.mean():.3f} of {squares.size}, at most 1 expected"


_TESTS: dict[str, tuple[Callable[[MotionView], tuple[float, str]], str]] = {
    "white residual": (_whiteness, "the stated uncertainties take the noise as white"),
    "no line left": (_line, "a line would be motion at a frequency that was not fitted"),
    "normal residual": (_normality, "outliers would be spikes, clipped or disturbed pulses"),
    "steady noise": (_steady, "noise that changes points at a changing echo"),
    "innovations": (
        _innovation,
        "above 1: jitter or motion that the echoes' own noise does not explain; below: echoes change shape",
    ),
}
"""Tests by name, with what a noticed one means; each returns p and what it found, or raises why it is not possible."""
