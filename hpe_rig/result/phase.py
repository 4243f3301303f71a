"""Phase of a noisy phasor: its uncertainty, also where the amplitude may be nothing but noise.

The phase of an amplitude A that stands far out of its noise has the standard deviation u(A) / A. That of an amplitude
which is noise alone is even over the circle, while u(A) / A would state less than a radian. Between the two decides
how much likelier the data are with a motion than without one,

    likelihood ratio = exp(A^2 / 2 noise^2) / 10,

a tenth because an amplitude is not known in advance: over four decades, even in its logarithm, about one part in ten
lies where the data would have it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase about which nothing is known, rad^2."""
PRIOR_ODDS = 0.1
"""Weight of the likelihood at the amplitude found, over that of no motion."""


def phase_variance_rad2(
    amplitude_m: FloatArray | float, across_m2: FloatArray | float, noise_m2: FloatArray | float
) -> FloatArray:
    """Return the variance of the phase of phasors whose error across themselves has the variance ``across_m2``.

    ``noise_m2`` is the part of it that is there without motion: noise, without what a motion makes wrong of itself. All
    of one shape, or scalars.
    """
    tiny = np.finfo(np.float64).tiny
    power = np.maximum(np.square(amplitude_m), tiny)
    known = np.minimum(across_m2 / power, PHASE_VARIANCE_LIMIT)
    # exp(700) is nearly the largest number there is
    likelihood_ratio = PRIOR_ODDS * np.exp(np.minimum(power / np.maximum(noise_m2, tiny) / 2, 700.0))
    nothing = 1 / (1 + likelihood_ratio)
    return np.asarray(nothing * PHASE_VARIANCE_LIMIT + (1 - nothing) * known)
