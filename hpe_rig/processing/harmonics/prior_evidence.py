"""Evidence of a displacement under a prior of media: scale of the motion, noise, and probability of each member.

z = U'd are the coefficients of the data for the patterns U of the prior at the pulses (projected_prior.py). z_i is
normal with the variance

    sigma² p_i,    p_i = 1 + r² (l_i² + h e²),    r = s / sigma

s: rms motion, sigma²: noise variance of a pulse, e: MODEL_ERROR, h: hidden variance factor. For a given r the sigma² of
largest evidence has a closed form, so only r is scanned:

    -2 log evidence = n log sigma² + sum_i log p_i,    n sigma² = sum_i z_i² / p_i + |residual|²
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.projected_prior import ProjectedPrior

MODEL_ERROR = 1e-3
"""Error of the model at an instant of the burst period, relative to the rms motion: of the ensemble, and of speckle and
receiver. Pulses at the same instant share it."""
MIN_MEMBERS = 15.0
"""Smallest effective number of members behind the mean error: the ensemble has no more where the data narrow it
down."""
DEVIATION_FACTORS = np.geomspace(1 / 3, 10.0, 30)
"""Possible deviations of a medium from the ensemble, relative to those that the prior states.

For a wanted harmonic they are 1 % (a homogeneous medium) to 30 % (a wall that reflects a third). The prior probability
of each is proportional to one over the factor g. As their logarithms are evenly spaced, the density is that of 1/g²."""
LOG_SCALES = np.arange(0.0, 9.0, 0.1) * np.log(10)
"""Natural logarithms of the scanned r, relative to the r whose strongest pattern equals the noise of a pulse."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Scale and noise of the data under the prior (...), a test of the prior, and the probability of each member.

    ``scale_m``: rms displacement s. ``noise_m2``: noise variance of a pulse, from the residual, with
    ``degrees_of_freedom``. ``total_noise_m2``: with the model error that the residual does not contain added, as if
    independent between pulses. ``significance``: probability that a medium of the ensemble gives data as improbable as
    these. ``probability`` (..., member): of each medium given the data, of sum 1. ``member_scale_m2`` (..., member):
    mean square displacement if the medium is this one. ``deviation_factor`` (...): rms deviation of the medium from
    the ensemble, over that of the prior.
    """

    scale_m: FloatArray
    noise_m2: FloatArray
    total_noise_m2: FloatArray
    degrees_of_freedom: FloatArray
    significance: FloatArray
    probability: FloatArray
    member_scale_m2: FloatArray
    deviation_factor: FloatArray


def evidence_of(projected: ProjectedPrior, data: FloatArray, coefficients: FloatArray) -> Evidence:
    """Return scale and noise of the motion, a test of the prior, and the probability of every medium of its ensemble.

    ``data`` (..., valid pulse): displacement without background. ``coefficients`` (..., pattern): of the data, for
    the patterns of displacement that the prior expects.
    """
    from scipy.special import fdtrc

    patterns, count = projected.pattern_sd.size, data.shape[-1] - projected.background.shape[1]
    unexplained_m2 = np.einsum("...i,...i->...", data, data) - np.einsum("...i,...i->...", coefficients, coefficients)
    # Variance of each coefficient for a motion of 1 m rms: of the prior, and of the hidden model error.
    hidden_variance = projected.hidden_variance_factor * MODEL_ERROR**2
    motion_variance = projected.pattern_sd**2 + hidden_variance
    ratio = _scale_over_noise(projected, coefficients, unexplained_m2, motion_variance, count)[..., None]
    # The noise comes from the residual and its degrees of freedom, which also holds for media outside the ensemble.
    # Fraction of each coefficient's variance that is noise.
    noise_fraction = 1 / (1 + ratio**2 * motion_variance)
    degrees = count - np.sum(1 - noise_fraction, axis=-1)
    residual_m2 = np.sum((coefficients * noise_fraction) ** 2, axis=-1) + unexplained_m2.clip(min=0)
    noise_m2 = np.maximum(residual_m2, np.finfo(np.float64).tiny) / degrees
    scale_m = ratio[..., 0] * np.sqrt(noise_m2)
    # F test: mean square of the coefficients over their expected variance.
    statistic = np.sum(coefficients**2 * noise_fraction, axis=-1) / noise_m2 / patterns
    total_noise_m2 = noise_m2 + hidden_variance * scale_m**2
    probability, member_scale_m2 = _member_probability(projected, coefficients, total_noise_m2)
    return Evidence(
        scale_m=scale_m,
        noise_m2=noise_m2,
        total_noise_m2=total_noise_m2,
        degrees_of_freedom=degrees,
        significance=fdtrc(patterns, degrees, statistic),
        probability=probability,
        member_scale_m2=member_scale_m2,
        deviation_factor=_deviation_factor(projected, coefficients, scale_m, total_noise_m2),
    )


def _deviation_factor(
    projected: ProjectedPrior, coefficients: FloatArray, scale_m: FloatArray, noise_m2: FloatArray
) -> FloatArray:
    """Return the rms deviation (...) of the medium from the ensemble, over that of the prior, estimated from the data.

    Reflections and layers change the harmonics. If deviations are g times those of the prior, the ``coefficients`` z
    (..., pattern) of the data have the covariance

        S + (g² - 1) s² B B',    S = diag(sigma² + s² l²)

    B (pattern, deviation): coefficients of the prior's deviations, l: standard deviation of each pattern, s:
    ``scale_m`` (...), sigma²: ``noise_m2`` (...). With the singular values m and left singular vectors v of s S^-1/2 B:

        -2 log likelihood = sum_i log(1 + (g² - 1) m_i²) - (g² - 1) m_i² / (1 + (g² - 1) m_i²) (v_i' S^-1/2 z)²

    The result is the square root of the posterior mean of g².
    """
    # Square root of S, and s B in units of it, for every train.
    sd_m = np.sqrt(noise_m2[..., None] + (scale_m[..., None] * projected.pattern_sd) ** 2)
    relative_deviation = (scale_m[..., None] / sd_m)[..., None] * projected.deviation_coefficients.T
    vectors, value, _ = np.linalg.svd(relative_deviation, full_matrices=False)
    # v_i' S^-1/2 z, and (g² - 1) m_i² with axes (..., factor g, i).
    component = np.einsum("...ri,...r->...i", vectors, coefficients / sd_m)[..., None, :]
    excess = (DEVIATION_FACTORS[:, None] ** 2 - 1) * value[..., None, :] ** 2
    log_likelihood = -0.5 * np.sum(np.log1p(excess) - excess / (1 + excess) * component**2, axis=-1)
    weight = np.exp(log_likelihood - log_likelihood.max(axis=-1, keepdims=True)) / DEVIATION_FACTORS
    return np.asarray(np.sqrt(weight @ DEVIATION_FACTORS**2 / weight.sum(axis=-1)))


def _scale_over_noise(
    projected: ProjectedPrior,
    coefficients: FloatArray,
    unexplained_m2: FloatArray,
    motion_variance: FloatArray,
    count: int,
) -> FloatArray:
    """Return the most likely ratio r (...) of the rms motion to the noise of a pulse, by a scan of r.

    The ``coefficients`` (..., pattern) of the data have the variances sigma² (1 + r² ``motion_variance``), with sigma²
    the noise. ``unexplained_m2`` (...): energy of the data outside the patterns. ``count``: pulses minus columns of the
    background. For each r the most likely sigma² is a mean.
    """
    log_ratio = LOG_SCALES - np.log(projected.pattern_sd[0])
    # Variance of each coefficient over sigma², (r, pattern).
    variance = 1 + np.exp(2 * log_ratio)[:, None] * motion_variance
    energy_m2 = coefficients**2 @ (1 / variance).T + unexplained_m2[..., None].clip(min=0)
    noise_m2 = np.maximum(energy_m2, np.finfo(np.float64).tiny) / count
    log_likelihood = -(count * np.log(noise_m2) + np.log(variance).sum(axis=1)) / 2
    best = _maximum(log_ratio, log_likelihood)
    # Upper bound: no medium moves more than the member of the ensemble that the pulses observe least.
    limit_m = np.sqrt(np.sum(coefficients**2, axis=-1) / np.sum(projected.member_coefficients**2, axis=1).min())
    best_noise_m2 = np.take_along_axis(noise_m2, np.argmax(log_likelihood, axis=-1)[..., None], axis=-1)[..., 0]
    limit = np.maximum(limit_m / np.sqrt(best_noise_m2), np.exp(log_ratio[0]))
    return np.asarray(np.minimum(np.exp(best), limit))


def _member_probability(
    projected: ProjectedPrior, coefficients: FloatArray, noise_m2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the probability of every medium of the ensemble given the data, and its mean square displacement.

    Both (..., member). ``coefficients`` (..., pattern) of the data, with the noise variance ``noise_m2`` (...). Each
    medium is fitted to them with its best scale; its probability is ~ exp(-misfit / 2 T), with the squared misfit in
    units of the noise. T is the smallest power of two, at least 1, that leaves ``MIN_MEMBERS`` effective members.
    """
    # Best scale of every member: projection of the data onto its motion, which for 1 m rms has this energy.
    member_energy = np.sum(projected.member_coefficients**2, axis=1)
    scale_m = np.maximum(coefficients @ projected.member_coefficients.T, 0.0) / member_energy
    # The fit reduces the squared misfit by scale² energy; only differences between members count.
    misfit = -(scale_m**2) * member_energy / noise_m2[..., None]
    misfit -= misfit.min(axis=-1, keepdims=True)
    # Double T until enough members have a similar weight.
    temperature = np.ones(noise_m2.shape)
    for _ in range(60):
        weight = np.exp(-misfit / 2 / temperature[..., None])
        # Effective number of members (sum w)² / sum w².
        too_few = weight.sum(axis=-1) ** 2 < MIN_MEMBERS * np.sum(weight**2, axis=-1)
        if not too_few.any():
            break
        temperature = np.where(too_few, 2 * temperature, temperature)
    # Mean square of the scale: square of its best value plus the variance of its error.
    mean_square_m2 = scale_m**2 + noise_m2[..., None] / member_energy
    return weight / weight.sum(axis=-1, keepdims=True), mean_square_m2


def _maximum(x: FloatArray, height: FloatArray) -> FloatArray:
    """Return the x of the maximum of ``height`` (..., x), refined by a parabola through its three highest points.

    ``x``: evenly spaced.
    """
    top = np.clip(np.argmax(height, axis=-1), 1, x.size - 2)[..., None]
    before, at, after = (np.take_along_axis(height, top + step, axis=-1)[..., 0] for step in (-1, 0, 1))
    curvature = np.minimum(before - 2 * at + after, -np.finfo(np.float64).tiny)
    return np.asarray(x[top[..., 0]] + np.clip((before - after) / curvature / 2, -1, 1) * (x[1] - x[0]))
