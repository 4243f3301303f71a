"""95 % interval: the half width about an estimate within which the true value lies with 95 % probability.

    u^2 = sum_i u_i^2                   combined standard uncertainty
    nu  = u^4 / sum_i (u_i^4 / nu_i)    effective degrees of freedom (Welch-Satterthwaite)
    U   = t(nu) u                       half width, t the 97.5 % quantile of Student's distribution

u_i is the standard uncertainty of source i, nu_i its degrees of freedom: those of the fit's residual for noise,
infinite for every source that is not estimated from the scatter of the data (type B).

Source: Guide to the expression of uncertainty in measurement (GUM), annex G, G.4.1 and G.6.4.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from statistics import NormalDist

UPPER_PROBABILITY = 0.975
"""Quantile at the upper end of a symmetrical 95 % interval."""
MIN_DEGREES_OF_FREEDOM = 1.0
"""Fewer degrees of freedom count as one, where t is 12.7: a prior of media can leave a fraction of one."""


def coverage_factor(degrees_of_freedom: float = math.inf) -> float:
    """Return t: half width of the 95 % interval over the standard uncertainty; 1.96 for infinite degrees of freedom."""
    if math.isinf(degrees_of_freedom):
        return NormalDist().inv_cdf(UPPER_PROBABILITY)
    # SciPy is loaded here because many programs read results without computing one.
    from scipy.special import stdtrit

    return float(stdtrit(max(degrees_of_freedom, MIN_DEGREES_OF_FREEDOM), UPPER_PROBABILITY))


def student_widening(degrees_of_freedom: float) -> float:
    """Return t(nu) / t(infinity), the factor on a limit in standard uncertainties if u has few degrees of freedom."""
    return coverage_factor(degrees_of_freedom) / coverage_factor()


def effective_degrees_of_freedom(sources: Iterable[tuple[float, float]]) -> float:
    """Return nu of the sum of independent errors, each given as (standard uncertainty, degrees of freedom)."""
    pairs = [(u, nu) for u, nu in sources if u > 0]
    combined = math.hypot(*(u for u, _ in pairs))
    if not math.isfinite(combined):
        return math.inf
    inverse = sum((u / combined) ** 4 / nu for u, nu in pairs)
    return 1 / inverse if inverse > 0 else math.inf


def interval_95(sources: Iterable[tuple[float, float]]) -> float:
    """Return U of the sum of independent errors, each given as (standard uncertainty, degrees of freedom)."""
    pairs = list(sources)
    return coverage_factor(effective_degrees_of_freedom(pairs)) * math.hypot(*(u for u, _ in pairs))


def phase_interval_95_rad(sources: Iterable[tuple[float, float]]) -> float:
    """Return ``interval_95`` of a phase, at most pi: an interval of half width pi is the whole circle."""
    return min(interval_95(sources), math.pi)
