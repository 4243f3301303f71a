"""Amplitude and phase of a noisy phasor: their uncertainty, also where the amplitude may be nothing but noise.

The phase of an amplitude A that stands far out of its noise has the standard deviation u(A) / A. That of an amplitude
which is noise alone is even over the circle, while u(A) / A would state less than a radian. Between the two decides
how much likelier the data are with a motion than without one,

    likelihood ratio = exp(A^2 / 2 noise^2) / 10,

a tenth because an amplitude is not known in advance: over four decades, even in its logarithm, about one part in ten
lies where the data would have it.

Nor is the amplitude's own error normal there. Noise alone has an amplitude, of the Rayleigh distribution: 68.27 % of
them, one standard deviation, lie below 1.515 times the noise of a quadrature, not below once that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase about which nothing is known, rad^2."""
PRIOR_ODDS = 0.1
"""Weight of the likelihood at the amplitude found, over that of no motion."""
RAYLEIGH_SQUARE = 2.2957
"""Square of the amplitude below which 68.27 % of noise alone lies, -2 ln(0.3173), over the variance of a quadrature."""
DETECTED = 3.0
"""Amplitude over the standard deviation of a quadrature from which on it counts as found: noise exceeds it in 1.1 %."""


AMPLITUDE_OVER_NOISE = np.arange(0.0, 5.1, 0.5)
PHASE_VARIANCE_RAD2 = np.array(
    [np.pi**2 / 3, 2.131, 1.249, 0.6825, 0.368, 0.2097, 0.1318, 0.0911, 0.0674, 0.0521, 0.0418]
)
"""Variance of the phase of a phasor in noise, by its true amplitude over a quadrature's standard deviation."""


def phase_variance_rad2(
    amplitude_m: FloatArray | float, across_m2: FloatArray | float, noise_m2: FloatArray | float
) -> FloatArray:
    """Return the variance of the phase of phasors whose error across themselves has the variance ``across_m2``.

    ``noise_m2`` is the part of it that is there without motion: noise, without what a motion makes wrong of itself. All
    of one shape, or scalars.
    """
    power = np.maximum(np.square(amplitude_m), np.finfo(np.float64).tiny)
    return _or_nothing(np.minimum(across_m2 / power, PHASE_VARIANCE_LIMIT), power, noise_m2)


def phase_variance_at_rad2(amplitude_m: FloatArray, noise_m2: FloatArray, across_m2: FloatArray) -> FloatArray:
    """Return the variance of the phase of phasors whose amplitude is known besides, as ``amplitude_m``.

    ``noise_m2`` is the variance of that by noise, ``across_m2`` that of the phasors across themselves. All of one
    shape.
    """
    tiny = np.finfo(np.float64).tiny
    ratio = amplitude_m / np.sqrt(np.maximum(across_m2, tiny))
    near = np.interp(ratio, AMPLITUDE_OVER_NOISE, PHASE_VARIANCE_RAD2)
    far = 1 / np.maximum(ratio, AMPLITUDE_OVER_NOISE[-1]) ** 2
    return _or_nothing(np.where(ratio < AMPLITUDE_OVER_NOISE[-1], near, far), amplitude_m**2, noise_m2)


def rectified_variance_m2(amplitude_m: FloatArray | float, noise_m2: FloatArray | float) -> FloatArray:
    """Return the variance that an amplitude in noise has beyond that of a quadrature, ``noise_m2``.

    It makes the interval about noise alone hold zero as often as it says, as likely as there is no motion; from
    ``DETECTED`` on it is none.
    """
    square = np.square(amplitude_m) / np.maximum(noise_m2, np.finfo(np.float64).tiny)
    least = _nothing(DETECTED**2)
    share = np.maximum(_nothing(square) - least, 0.0) / (1 - least)
    return np.asarray(share * (RAYLEIGH_SQUARE - 1) * noise_m2)


def _or_nothing(variance: FloatArray | float, power: FloatArray | float, noise_m2: FloatArray | float) -> FloatArray:
    """Return ``variance`` or that of an unknown phase, as likely as there is a motion of ``power`` or none."""
    nothing = _nothing(power / np.maximum(noise_m2, np.finfo(np.float64).tiny))
    return np.asarray(nothing * PHASE_VARIANCE_LIMIT + (1 - nothing) * variance)


def _nothing(square: FloatArray | float) -> FloatArray:
    """Return how likely it is that there is no motion, by the amplitude's ``square`` over its noise's."""
    # exp(700) is nearly the largest number there is
    return np.asarray(1 / (1 + PRIOR_ODDS * np.exp(np.minimum(np.asarray(square) / 2, 700.0))))
