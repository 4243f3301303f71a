"""Evidence of a displacement under a prior of media: scale of the motion, noise, and probability of each member.

z = U'd are the data along the projected prior (projected_prior.py), z_i normal with the variance

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
"""Natural logarithms of the scanned r, relative to the r whose strongest direction equals the noise of a pulse."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Scale and noise of the data under the prior (...), a test of the prior, and the probability of each member.

    ``scale_m``: rms displacement s. ``variance_m2``: noise of a pulse. ``total_m2``: noise plus the hidden model error,
    as if independent between pulses. ``degrees_of_freedom``: of the residual. ``significance``: probability that a
    medium of the ensemble gives data as improbable as these. ``probability`` (..., member), of sum 1.
    ``member_scale_m2`` (..., member): mean square of each member's own scale. ``deviation_factor`` (...): rms
    deviation of the medium from the ensemble, over that of the prior.
    """

    scale_m: FloatArray
    variance_m2: FloatArray
    total_m2: FloatArray
    degrees_of_freedom: FloatArray
    significance: FloatArray
    probability: FloatArray
    member_scale_m2: FloatArray
    deviation_factor: FloatArray


def evidence_of(projected: ProjectedPrior, data: FloatArray, along: FloatArray) -> Evidence:
    """Return scale and noise of the motion, a test of the prior, and the probability of every medium of its ensemble.

    ``data`` (..., valid pulse): displacement without background. ``along`` (..., rank): the data along the directions
    that the prior expects and the pulses observe, with singular values l = ``projected.value``.
    """
    from scipy.special import fdtrc

    count = data.shape[-1] - projected.background.shape[1]
    unexplained_m2 = np.einsum("...i,...i->...", data, data) - np.einsum("...i,...i->...", along, along)
    # Variance of the motion along each direction, for 1 m rms: of the prior, and of the error of its model.
    hidden = projected.hidden_variance_factor * MODEL_ERROR**2
    signal = projected.value**2 + hidden
    ratio = _scale_over_noise(projected, along, unexplained_m2, signal, count)[..., None]
    # The noise comes from the residual and its degrees of freedom, which also holds for media outside the ensemble.
    # Fraction of the variance along each direction that is noise.
    noise_share = 1 / (1 + ratio**2 * signal)
    degrees = count - np.sum(1 - noise_share, axis=-1)
    tiny = np.finfo(np.float64).tiny
    residual_m2 = np.maximum(np.sum((along * noise_share) ** 2, axis=-1) + unexplained_m2.clip(min=0), tiny)
    noise_m2 = residual_m2 / degrees
    scale_m = ratio[..., 0] * np.sqrt(noise_m2)
    # F test: variance along the observed directions over the variance that the prior expects there.
    statistic = np.sum(along**2 * noise_share, axis=-1) / noise_m2 / projected.value.size
    total_m2 = noise_m2 + hidden * scale_m**2
    probability, member_scale_m2 = _member_probability(projected, along, total_m2)
    return Evidence(
        scale_m=scale_m,
        variance_m2=noise_m2,
        total_m2=total_m2,
        degrees_of_freedom=degrees,
        significance=fdtrc(projected.value.size, degrees, statistic),
        probability=probability,
        member_scale_m2=member_scale_m2,
        deviation_factor=_deviation_factor(projected, along, scale_m, total_m2),
    )


def _deviation_factor(
    projected: ProjectedPrior, along: FloatArray, scale_m: FloatArray, noise_m2: FloatArray
) -> FloatArray:
    """Return the rms deviation (...) of the medium from the ensemble, over that of the prior, estimated from the data.

    Reflections and layers change the harmonics. If deviations are g times those of the prior, the data ``along`` U
    (..., rank) have the covariance

        S + (g² - 1) s² B B',    S = diag(sigma² + s² l²)

    B (rank, deviation): the prior's deviations along U; s: ``scale_m`` (...); sigma²: ``noise_m2`` (...). With the
    singular values m and left singular vectors v of s S^-1/2 B, and z the data:

        -2 log likelihood = sum_i log(1 + (g² - 1) m_i²) - (g² - 1) m_i² / (1 + (g² - 1) m_i²) (v_i' S^-1/2 z)²

    The result is the square root of the posterior mean of g².
    """
    # Square root of S, and B in units of it, for every train.
    std_m = np.sqrt(noise_m2[..., None] + (scale_m[..., None] * projected.value) ** 2)
    relative = (scale_m[..., None] / std_m)[..., None] * projected.deviation.T
    vectors, value, _ = np.linalg.svd(relative, full_matrices=False)
    component = np.einsum("...ri,...r->...i", vectors, along / std_m)[..., None, :]
    # Axes (..., factor, singular value).
    excess = (DEVIATION_FACTORS[:, None] ** 2 - 1) * value[..., None, :] ** 2
    log_likelihood = -0.5 * np.sum(np.log1p(excess) - excess / (1 + excess) * component**2, axis=-1)
    weight = np.exp(log_likelihood - log_likelihood.max(axis=-1, keepdims=True)) / DEVIATION_FACTORS
    return np.asarray(np.sqrt(weight @ DEVIATION_FACTORS**2 / weight.sum(axis=-1)))


def _scale_over_noise(
    projected: ProjectedPrior, along: FloatArray, unexplained_m2: FloatArray, signal: FloatArray, count: int
) -> FloatArray:
    """Return the ratio r (...) of rms motion to noise of a pulse that maximises the evidence of the data.

    ``along`` (..., rank): data along the observed directions, of variance sigma² (1 + r² ``signal``).
    ``unexplained_m2`` (...): energy of the data outside them. ``count``: pulses minus columns of the background. For
    each r of a scan, the best sigma² is a mean.
    """
    log_ratio = LOG_SCALES - np.log(projected.value[0])
    power = 1 + np.exp(2 * log_ratio)[:, None] * signal  # variance along each direction over sigma², (r, rank)
    floor_m2 = np.finfo(np.float64).tiny
    # For each r the most likely sigma², and the logarithm of the evidence with it.
    variance_m2 = np.maximum(along**2 @ (1 / power).T + unexplained_m2[..., None].clip(min=0), floor_m2) / count
    evidence = -(count * np.log(variance_m2) + np.log(power).sum(axis=1)) / 2
    best = _maximum(log_ratio, evidence)
    # Upper bound: no medium moves more than the member of the ensemble that the pulses observe least.
    limit_m = np.sqrt(np.sum(along**2, axis=-1) / np.sum(projected.members**2, axis=1).min())
    best_variance_m2 = np.take_along_axis(variance_m2, np.argmax(evidence, axis=-1)[..., None], axis=-1)[..., 0]
    limit = np.maximum(limit_m / np.sqrt(best_variance_m2), np.exp(log_ratio[0]))
    return np.asarray(np.minimum(np.exp(best), limit))


def _member_probability(
    projected: ProjectedPrior, along: FloatArray, variance_m2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the probability, of sum 1, and the mean square scale of every medium of the ensemble, (..., member).

    ``along`` (..., rank): the data along the observed directions, with the noise ``variance_m2`` (...). The probability
    is ~ exp(-distance / 2 T), with distance the squared misfit of a member at its best scale over the noise. T is the
    smallest power of two, at least 1, that leaves ``MIN_MEMBERS`` effective members.
    """
    # Best scale of every member, by projection of the data onto its motion, and the squared misfit left.
    power = np.sum(projected.members**2, axis=1)
    scale_m = np.maximum(along @ projected.members.T, 0.0) / power
    distance = -(scale_m**2) * power / variance_m2[..., None]
    distance -= distance.min(axis=-1, keepdims=True)
    # Double the temperature T until enough members have a similar weight.
    temperature = np.ones(variance_m2.shape)
    for _ in range(60):
        weight = np.exp(-distance / 2 / temperature[..., None])
        # Effective number of members (sum w)² / sum w².
        too_few = weight.sum(axis=-1) ** 2 < MIN_MEMBERS * np.sum(weight**2, axis=-1)
        if not too_few.any():
            break
        temperature = np.where(too_few, 2 * temperature, temperature)
    return weight / weight.sum(axis=-1, keepdims=True), scale_m**2 + variance_m2[..., None] / power


def _maximum(x: FloatArray, height: FloatArray) -> FloatArray:
    """Return the x of the maximum of ``height`` (..., x), refined by a parabola through its three highest points.

    ``x``: evenly spaced.
    """
    top = np.clip(np.argmax(height, axis=-1), 1, x.size - 2)[..., None]
    before, at, after = (np.take_along_axis(height, top + step, axis=-1)[..., 0] for step in (-1, 0, 1))
    curvature = np.minimum(before - 2 * at + after, -np.finfo(np.float64).tiny)
    return np.asarray(x[top[..., 0]] + np.clip((before - after) / curvature / 2, -1, 1) * (x[1] - x[0]))
