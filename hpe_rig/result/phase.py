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

from hpe_rig.arrays import FloatArray

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase about which nothing is known, rad^2."""
PRIOR_ODDS = 0.1
"""Weight of the likelihood at the amplitude found, over that of no motion."""
RAYLEIGH_SQUARE = 2.2957
"""Square of the amplitude below which 68.27 % of noise alone lies, -2 ln(0.3173), over the variance of a quadrature."""
DETECTED = 3.0
"""Amplitude over the standard deviation of its noise from which on it counts as found: noise exceeds it in 1.1 %."""
STRONG = 20.0
"""Amplitude over the root of both quadratures' variances from which on the phase's error is across the phasor alone."""
LEAST_ACROSS = 1e-7
"""Variance along the thin axis of noise, at least, over that of both quadratures."""
_STEP = np.linspace(-1.0, 1.0, 513)
_ANGLE_RAD = np.pi * (_STEP - np.sin(2 * np.pi * _STEP) / (2 * np.pi))
"""Angles between which a phasor's phase is summed up: close about 0 and about half a turn."""
_WEIGHT = 1 - np.cos(2 * np.pi * _STEP)


def phase_variance_rad2(
    amplitude_m: FloatArray | float, across_m2: FloatArray | float, noise_m2: FloatArray | float
) -> FloatArray:
    """Return the variance of the phase of phasors whose error across themselves has the variance ``across_m2``.

    ``noise_m2`` is the variance, along the phasors, of what is there without motion: noise, without what a motion makes
    wrong of itself. All of one shape, or scalars.
    """
    power = np.maximum(np.square(amplitude_m), np.finfo(np.float64).tiny)
    return _or_nothing(np.minimum(across_m2 / power, PHASE_VARIANCE_LIMIT), power, noise_m2)


def phase_variance_at_rad2(
    amplitude_m: FloatArray, noise_m2: FloatArray, found_m: FloatArray, covariance_m2: FloatArray
) -> FloatArray:
    """Return the variance of the phase of phasors whose amplitude is known besides, as ``amplitude_m``.

    ``noise_m2`` is the variance of that by noise. The phasors' own amplitudes are ``found_m`` and their errors have the
    covariance ``covariance_m2`` (..., 2, 2) along and across them: the mean square of the angle to a true phasor that
    may point anywhere, as likely as it then lies from what was found. All others of one shape.
    """
    along, shared, across = covariance_m2[..., 0, 0], covariance_m2[..., 0, 1], covariance_m2[..., 1, 1]
    tiny = np.finfo(np.float64).tiny
    power, strong = np.maximum(amplitude_m**2, tiny), amplitude_m**2 > STRONG**2 * (along + across)
    # no thinner than the angles are close
    wide, deep = (each + LEAST_ACROSS * (along + across) for each in (along, across))
    whole = np.maximum(wide * deep - shared**2, tiny)
    true = amplitude_m[..., None] * np.exp(1j * _ANGLE_RAD)
    x, y = found_m[..., None] - true.real, -true.imag
    square = deep[..., None] * x**2 - 2 * shared[..., None] * x * y + wide[..., None] * y**2
    distance = square / whole[..., None]
    likely = _WEIGHT * np.exp(-(distance - distance.min(axis=-1, keepdims=True)) / 2)
    near = likely @ _ANGLE_RAD**2 / likely.sum(axis=-1)
    return _or_nothing(np.where(strong, across / power, near), power, noise_m2)


def rectified_variance_m2(
    amplitude_m: FloatArray | float, along_m2: FloatArray | float, across_m2: FloatArray | float
) -> FloatArray:
    """Return the variance that an amplitude in noise has beyond that along its phasor, ``along_m2``.

    What lies across, of variance ``across_m2``, makes an amplitude larger, never smaller. The interval about noise
    alone then holds zero as often as it says; it counts as likely as there is no motion, from ``DETECTED`` on not.
    """
    square = np.square(amplitude_m) / np.maximum(along_m2, np.finfo(np.float64).tiny)
    least = _nothing(DETECTED**2)
    share = np.maximum(_nothing(square) - least, 0.0) / (1 - least)
    return np.asarray(share * (RAYLEIGH_SQUARE - 1) * across_m2)


def _or_nothing(variance: FloatArray | float, power: FloatArray | float, noise_m2: FloatArray | float) -> FloatArray:
    """Return ``variance`` or that of an unknown phase, as likely as there is a motion of ``power`` or none."""
    nothing = _nothing(power / np.maximum(noise_m2, np.finfo(np.float64).tiny))
    return np.asarray(nothing * PHASE_VARIANCE_LIMIT + (1 - nothing) * variance)


def _nothing(square: FloatArray | float) -> FloatArray:
    """Return how likely it is that there is no motion, by the amplitude's ``square`` over its noise's."""
    # exp(700) is nearly the largest number there is
    return np.asarray(1 / (1 + PRIOR_ODDS * np.exp(np.minimum(np.asarray(square) / 2, 700.0))))
