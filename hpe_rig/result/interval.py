"""Interval about an estimate that holds the truth with a given probability, from standard uncertainty and kurtosis.

Of independent errors of standard deviations u_i and kurtoses k_i the sum has, both exactly,

    u^2 = sum_i u_i^2,      k = 3 + sum_i (u_i / u)^4 (k_i - 3).

Of the symmetrical distributions of Pearson's system one has this u and k, and its quantiles are taken: the density is
(1 + x^2 / a)^-m, a = 2 k / (k - 3) and m = (5 k - 9) / (2 (k - 3)), in units of u. That is Student's distribution of
4 + 6 / (k - 3) degrees of freedom above k = 3, the normal one there, and below it one that ends, the uniform one at
k = 1.8. docs/numbers.md says which errors are not normal.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from statistics import NormalDist

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result.phase import PHASE_VARIANCE_LIMIT

NORMAL = 3.0
"""Kurtosis of a normal distribution."""
UNIFORM = 1.8
"""Kurtosis of a uniform distribution, the least that is taken."""
COVERED = (0.6827, 0.95)
"""Probabilities of the intervals that are stated."""
NEARLY_NORMAL = 0.01
"""Kurtosis off that of a normal distribution up to which intervals are a normal one's, to 1e-3 of themselves."""
LEAST_FREEDOM = 5.0
"""Degrees of freedom from which on Student's distribution has a kurtosis, 9 there, that intervals can be taken by."""
WIDE_AT_LEAST = 1.9912
"""Half width of the interval of 95 % in standard deviations there: its quantile 2.5706 over sqrt(5 / 3)."""
NORMAL_95 = 1.959964
"""The same of a normal distribution."""
PLACES = np.sinh(np.linspace(0.0, 5.0, 2001))
"""Standard deviations at which a density is summed: quantiles are good to 1e-3."""


def by_residual(freedom: FloatArray | float) -> FloatArray:
    """Return the factor on a variance that is known only from a residual of ``freedom`` (...) degrees of freedom.

    An error over such a standard deviation has Student's distribution: the factor is its variance, f / (f - 2)
    (Guide to the expression of uncertainty in measurement, Supplement 1, 6.4.9.4). Below ``LEAST_FREEDOM``, where it
    has no kurtosis or no variance, it is the factor with which the interval of 95 % holds as many, by Wallace's
    quantile (1959): 4 % too wide at 2 degrees of freedom and 38 % at 1, as which less counts.
    """
    many, few = np.maximum(freedom, LEAST_FREEDOM), np.clip(freedom, 1.0, LEAST_FREEDOM)
    exponent = (NORMAL_95 * (8 * few + 3) / (8 * few + 1)) ** 2 / few
    by_interval = few * np.expm1(exponent) / WIDE_AT_LEAST**2
    return np.asarray(np.where(np.less(freedom, LEAST_FREEDOM), by_interval, 1 + 2 / (many - 2)))


def residual_kurtosis(freedom: float) -> float:
    """Return the kurtosis of an error whose variance is known only from a residual: with it intervals are Student's."""
    return NORMAL + 6 / (max(freedom, LEAST_FREEDOM) - 4)


def half_widths(uncertainty: float, kurtosis: float = NORMAL) -> tuple[float, float]:
    """Return how far the intervals of 68 and 95 % reach to either side of an estimate, in units of ``uncertainty``."""
    narrow, wide = (uncertainty * coverage_factor(kurtosis, probability) for probability in COVERED)
    return narrow, wide


def phase_half_widths(uncertainty_rad: float, kurtosis: float = NORMAL) -> tuple[float, float]:
    """Return ``half_widths`` of a phase: half a turn to either side is the whole circle."""
    narrow, wide = half_widths(uncertainty_rad, kurtosis)
    return min(narrow, math.pi), min(wide, math.pi)


def coverage_factor(kurtosis: float, probability: float) -> float:
    """Return the half width of the interval that holds the truth with ``probability``, in standard uncertainties."""
    return _coverage_factor(round(kurtosis, 2), probability)


@functools.lru_cache(maxsize=4096)
def _coverage_factor(kurtosis: float, probability: float) -> float:
    excess = max(kurtosis, UNIFORM) - NORMAL
    # also where it is not known
    if not abs(excess) > NEARLY_NORMAL:
        return NormalDist().inv_cdf((1 + probability) / 2)
    # By a sum, not by SciPy, which many a result is made without.
    base = np.maximum(1 + PLACES**2 * (excess / (2 * (excess + NORMAL))), 0.0)
    exponent = -(5 * excess + 6) / (2 * excess)
    density = np.where(base > 0, np.where(base > 0, base, 1.0) ** exponent, 0.0)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) * np.diff(PLACES))])
    return float(np.interp(probability, below / below[-1], PLACES))


def combined_kurtosis(uncertainty: float, parts: Iterable[tuple[float, float]]) -> float:
    """Return the kurtosis of an error of ``uncertainty``, of independent ``parts`` (standard uncertainty, kurtosis)."""
    if not 0 < uncertainty < np.inf:
        return NORMAL
    return NORMAL + sum((part / uncertainty) ** 4 * (kurtosis - NORMAL) for part, kurtosis in parts)


def phase_kurtosis(variance_rad2: float) -> float:
    """Return the kurtosis of the phase of what may be noise alone.

    Even over the circle as often as its variance has it; a normal error's where that has larger errors as often.
    """
    return min(NORMAL, UNIFORM * PHASE_VARIANCE_LIMIT / variance_rad2) if variance_rad2 > 0 else NORMAL
