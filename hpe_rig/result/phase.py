"""Uncertainty of amplitude and phase of a noisy phasor, including amplitudes that may be noise alone.

The phase of an amplitude A far above its noise has the standard deviation u(A) / A. The phase of noise alone is uniform
over the circle, with the variance pi² / 3, while u(A) / A would be less than a radian. In between, both cases are
weighted by the probability that there is a motion, from the likelihood ratio

    L = exp(A² / 2 s²) / 10

s² is the noise variance of a quadrature. The factor 1/10 is the prior: an amplitude uniform in its logarithm over four
decades has about this probability density at the estimate.

    P(no motion) = 1 / (1 + L)
    var(phase)   = P(no motion) pi² / 3 + (1 - P(no motion)) u(A)² / A²

The amplitude of noise alone has a Rayleigh distribution: 68.27 % of the amplitudes, one standard deviation, are below
1.515 s, not below s.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import FloatArray

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase that is uniform over the circle, rad²."""
PRIOR_ODDS = 0.1
"""Prior weight of the likelihood at the estimated amplitude relative to that of no motion."""
RAYLEIGH_SQUARE = 2.2957
"""Squared 68.27 % quantile of the amplitude of noise over the variance of a quadrature: -2 ln(0.3173)."""
DETECTED = 3.0
"""Detection limit: amplitude over the standard deviation of its noise, exceeded by noise alone in 1.1 %."""
STRONG = 20.0
"""Minimum of amplitude over the root of both quadratures' variances for the small-angle approximation."""
MIN_VARIANCE_RATIO = 1e-7
"""Lower limit on the variance of either quadrature over that of both, set by the spacing of the angles."""
_STEP = np.linspace(-1.0, 1.0, 513)
_ANGLE_RAD = np.pi * (_STEP - np.sin(2 * np.pi * _STEP) / (2 * np.pi))
"""Nodes of the integral over the phase, denser near 0 and pi."""
_WEIGHT = 1 - np.cos(2 * np.pi * _STEP)
"""Weights of the nodes: the derivative of the angle."""


def phase_variance_rad2(
    amplitude_m: FloatArray | float, across_m2: FloatArray | float, noise_m2: FloatArray | float
) -> FloatArray:
    """Return the phase variance of phasors from the variance ``across_m2`` of their error across themselves.

    ``noise_m2`` is the variance along the phasors without motion: noise, without errors in proportion to the motion.
    All arguments have one shape or are scalars.
    """
    power = np.maximum(np.square(amplitude_m), np.finfo(np.float64).tiny)
    return _over_both_cases(np.minimum(across_m2 / power, PHASE_VARIANCE_LIMIT), power, noise_m2)


def phase_variance_at_rad2(
    amplitude_m: FloatArray, noise_m2: FloatArray, observed_m: FloatArray, covariance_m2: FloatArray
) -> FloatArray:
    """Return the phase variance of phasors with an independent estimate ``amplitude_m`` of their true amplitude.

    ``noise_m2`` is the noise variance of that estimate. The phasors' observed amplitudes are ``observed_m``; their
    errors along and across have the covariance ``covariance_m2`` (..., 2, 2). The variance is the mean square angle
    between the observed and the true phasor; every angle is weighted by its likelihood. All other arguments have one
    shape.
    """
    along, covariance, across = covariance_m2[..., 0, 0], covariance_m2[..., 0, 1], covariance_m2[..., 1, 1]
    tiny = np.finfo(np.float64).tiny
    power, strong = np.maximum(amplitude_m**2, tiny), amplitude_m**2 > STRONG**2 * (along + across)
    # Both variances must be wide enough for the spacing of the nodes.
    var_x, var_y = (variance + MIN_VARIANCE_RATIO * (along + across) for variance in (along, across))
    determinant = np.maximum(var_x * var_y - covariance**2, tiny)
    true = amplitude_m[..., None] * np.exp(1j * _ANGLE_RAD)
    # Error of the observed phasor for each true angle, and its squared Mahalanobis distance.
    x, y = observed_m[..., None] - true.real, -true.imag
    # x' C^-1 x for the 2 x 2 covariance.
    numerator = var_y[..., None] * x**2 - 2 * covariance[..., None] * x * y + var_x[..., None] * y**2
    distance = numerator / determinant[..., None]
    # The smallest distance is subtracted to avoid underflow.
    likelihood = _WEIGHT * np.exp(-(distance - distance.min(axis=-1, keepdims=True)) / 2)
    mean_square = likelihood @ _ANGLE_RAD**2 / likelihood.sum(axis=-1)
    return _over_both_cases(np.where(strong, across / power, mean_square), power, noise_m2)


def rectified_variance_m2(
    amplitude_m: FloatArray | float, along_m2: FloatArray | float, across_m2: FloatArray | float
) -> FloatArray:
    """Return the variance of an amplitude in noise, in addition to the variance ``along_m2`` along its phasor.

    The error across the phasor, of variance ``across_m2``, only increases the amplitude (Rician bias). With this
    variance the interval about an amplitude of noise alone contains zero with its stated probability. The weight is the
    probability of no motion, shifted to vanish from ``DETECTED`` on.
    """
    # The Rician bias matters where the amplitude may be noise alone.
    square = np.square(amplitude_m) / np.maximum(along_m2, np.finfo(np.float64).tiny)
    at_detection = _no_motion_probability(DETECTED**2)
    weight = np.maximum(_no_motion_probability(square) - at_detection, 0.0) / (1 - at_detection)
    return np.asarray(weight * (RAYLEIGH_SQUARE - 1) * across_m2)


def _over_both_cases(
    variance: FloatArray | float, power: FloatArray | float, noise_m2: FloatArray | float
) -> FloatArray:
    """Return the phase variance over both cases: ``variance`` with a motion of ``power``, pi² / 3 without."""
    no_motion = _no_motion_probability(power / np.maximum(noise_m2, np.finfo(np.float64).tiny))
    return np.asarray(no_motion * PHASE_VARIANCE_LIMIT + (1 - no_motion) * variance)


def _no_motion_probability(snr: FloatArray | float) -> FloatArray:
    """Return P(no motion) from A² / s²."""
    # The limit avoids an overflow of exp, at about 709.
    return np.asarray(1 / (1 + PRIOR_ODDS * np.exp(np.minimum(np.asarray(snr) / 2, 700.0))))
