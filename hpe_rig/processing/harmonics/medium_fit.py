"""Harmonic fit with a prior of media: all harmonics of the bursts at once, in closed form or by a Kalman filter.

    d = A x + background + noise,    Cov x = P = (k s)² F F'
    x^ = K d,                        K = P A' (A P A' + R)^-1
    Cov(x^ - x) = K R K' + mean over members of (I - K A) x_m x_m' (I - K A)'

R = sigma² I is the noise, s the scale of the evidence, k = PRIOR_WIDENING. The first term is noise, the second aliasing
and shrinkage: x_m are the members of the ensemble, each with its own scale and posterior probability. With A F = U
diag(l) V' (projected_prior.py) and z = U'd,

    x^ = F V diag(g) z,    g = (k s)² l / (sigma² + (k s)² l²)         shrinkage h = g l

Derivation: docs/explanation/medium-prior.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import (
    AliasingCauses,
    FitQuality,
    HarmonicFit,
    MediumPosterior,
    difference_noise_moments,
    fit_from_state,
    step_covariance,
)
from hpe_rig.processing.harmonics.kalman_filter import filter_constant, innovation_correlation
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.prior_evidence import Evidence, evidence_of
from hpe_rig.processing.harmonics.projected_prior import ProjectedPrior, project_prior
from hpe_rig.processing.motion.displacement import Motion

PRIOR_WIDENING = 3.0
"""k: scale of the prior over that of the evidence. A wide prior leaves the weights to the data if s is inaccurate."""
DIFFUSE_STD = 1e5
"""Standard deviation of a background state over the noise of a pulse, for the Kalman filter: a diffuse prior."""
DRIFT_VARIANCE_RATIO = 4.0
"""Residual variances larger than this, relative to the step noise, count as drift instead of noise of the steps."""
MIN_RELATIVE_MOTION = 0.5
"""Smallest motion, relative to the rms motion of the probable members, that a relative change is divided by."""


@dataclass(frozen=True, slots=True)
class MediumFit:
    """Fit of the wanted harmonics with its two error covariances and the evidence.

    ``noise_m2`` and ``aliasing_m2`` (..., 2 * frequency, 2 * frequency) add up to ``fit.state_covariance``.
    ``shrinkage`` (..., rank): fraction of the data along each observed direction that the estimate uses.
    ``coordinates`` (..., rank): the estimated motion along V of the projected prior.
    """

    fit: HarmonicFit
    noise_m2: FloatArray
    aliasing_m2: FloatArray
    evidence: Evidence
    shrinkage: FloatArray
    coordinates: FloatArray


def medium_fit(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    prior: MediumPrior,
    *,
    background_order: int = 0,
) -> MediumFit:
    """Return amplitudes and phases of the wanted harmonics with the prior of media, in closed form.

    The prior is that of the motion (all harmonics of the bursts) that media can have. Every valid pulse has the same
    weight: the variances estimated from single echoes are too inaccurate for weights, and they exclude trigger jitter.
    The noise therefore comes from the residual of the fit; for a displacement that is a sum of noisy steps it is white
    noise plus a random walk. Raises ``ValueError`` for frequencies that are no harmonics of the bursts and for too few
    pulses.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    projected = project_prior(prior, motion.time_s, motion.valid, frequency_hz, background_order)
    data = projected.without_background(motion.displacement_m[..., motion.valid])
    # The sampled motions of the prior are U diag(l) V': ``left_vectors`` is U and ``value`` is l, the singular values.
    # ``along`` (..., rank): the data along each column of U.
    along = data @ projected.left_vectors
    evidence = evidence_of(projected, data, along)
    # The gain leads from the data to coordinates along V, and ``wanted_rows`` from there to the wanted states.
    # Shrinkage is the fraction of the data along each column of U that the fit attributes to the motion.
    gain = _gain(projected, evidence)
    weights = projected.wanted_rows * gain[..., None, :]
    shrinkage = gain * projected.value
    noise_m2 = evidence.total_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2))
    degrees = evidence.degrees_of_freedom
    if motion.step_noise_ratio is not None:
        residual = data - (shrinkage * along) @ projected.left_vectors.T
        step_noise_ratio = np.asarray(motion.step_noise_ratio)
        noise_m2, degrees = _step_noise(projected, evidence, weights, shrinkage, residual, step_noise_ratio)
    aliasing_m2, member_errors = _aliasing(projected, weights, evidence)
    coordinates = gain * along
    state = coordinates @ projected.wanted_rows.T
    quality = FitQuality(np.sqrt(evidence.variance_m2), degrees, len(projected.left_vectors))
    fit = fit_from_state(frequency_hz, state, noise_m2 + aliasing_m2, quality, aliasing_m2)
    causes = AliasingCauses(aliasing_m2, member_phasors_m(evidence, member_errors))
    fit = replace(fit, aliasing_causes=causes, medium=medium_posterior(prior, evidence, fit, member_errors))
    return MediumFit(
        fit=fit,
        noise_m2=noise_m2,
        aliasing_m2=aliasing_m2,
        evidence=evidence,
        shrinkage=shrinkage,
        coordinates=coordinates,
    )


def _step_noise(
    projected: ProjectedPrior,
    evidence: Evidence,
    weights: FloatArray,
    shrinkage: FloatArray,
    residual: FloatArray,
    step_noise_ratio: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return noise covariance (..., state, state) and degrees of freedom (...) of the fit to a sum of noisy steps.

    ``weights`` (..., state, rank): from the data along the observed directions to the states. ``shrinkage``
    (..., rank): fraction of these data that the fit uses. ``residual`` (..., pulse). Each step adds
    ``step_noise_ratio`` times the variance of one pulse's white noise to all later pulses.
    """
    white = weights @ np.swapaxes(weights, -1, -2)
    # The background is removed whole, each observed direction by its shrinkage.
    columns = np.hstack([projected.background, projected.left_vectors])
    background_shrinkage = np.ones((*shrinkage.shape[:-1], projected.background.shape[1]))
    all_shrinkage = np.concatenate([background_shrinkage, shrinkage], axis=-1)
    expected_energy, degrees = difference_noise_moments(columns, all_shrinkage, step_noise_ratio)
    pulse_weights = weights @ projected.left_vectors.T
    pulse_m2, step_noise_m2 = step_covariance(residual, step_noise_ratio, pulse_weights, expected_energy)
    # Differences between pulses do not contain slow drift such as creep: a residual far above the step noise counts.
    # A random walk of n steps, minus its mean, has n / 6 times the variance of a step.
    explained_m2 = pulse_m2 * (1 + step_noise_ratio * len(projected.left_vectors) / 6)
    drifts = evidence.variance_m2 > DRIFT_VARIANCE_RATIO * explained_m2
    model_error_m2 = (evidence.total_m2 - evidence.variance_m2)[..., None, None] * white
    residual_noise_m2 = evidence.total_m2[..., None, None] * white
    return step_noise_m2 + np.where(drifts[..., None, None], residual_noise_m2, model_error_m2), degrees


def fit_residual(
    motion: Motion, frequencies_hz: FloatArray | Sequence[float], prior: MediumPrior, *, background_order: int = 0
) -> FloatArray:
    """Return the displacement minus background and the motion that ``medium_fit`` fits, m (..., valid pulse)."""
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    shrinkage = medium_fit(motion, frequency_hz, prior, background_order=background_order).shrinkage
    projected = project_prior(prior, motion.time_s, motion.valid, frequency_hz, background_order)
    data = projected.without_background(motion.displacement_m[..., motion.valid])
    return np.asarray(data - (shrinkage * (data @ projected.left_vectors)) @ projected.left_vectors.T)


def driven_phasors_m(
    prior: MediumPrior, projected: ProjectedPrior, prior_fit: MediumFit
) -> tuple[FloatArray, ComplexArray]:
    """Return frequency (harmonic,) and phasor (..., harmonic), m, of all harmonics of the bursts in ``prior_fit``.

    ``projected``: the ``prior`` at the pulses of the fit. Independent deviations of the wanted harmonics from the
    ensemble's span are not included.
    """
    directions = prior_fit.coordinates @ projected.right_vectors[:, : len(prior.root)] @ prior.root.T
    states = directions @ prior.states(range(prior.frequency_hz.size)).T
    return prior.frequency_hz, np.asarray(states[..., ::2] + 1j * states[..., 1::2])


def posterior_of_states(
    motion: Motion, prior_fit: MediumFit, prior: MediumPrior, directions: FloatArray, background_order: int
) -> tuple[FloatArray, AliasingCauses, FloatArray]:
    """Return mean and covariance of further states of the motion, given the data of ``motion``.

    ``prior_fit`` is the fit of that motion. ``directions`` (state, direction): the states as a linear function of the
    prior's directions, the real and imaginary parts of a medium's response. The third value (..., member, state): true
    minus estimated states of every member of the ensemble, each scaled to a motion of 1 m rms.
    """
    evidence = prior_fit.evidence
    projected = project_prior(prior, motion.time_s, motion.valid, prior_fit.fit.frequency_hz, background_order)
    # Independent deviations of the wanted harmonics are no directions of the prior: these states do not contain them.
    # As in ``medium_fit``: gain from the data along U to coordinates along V, ``rows`` from there to the states.
    rows = directions @ prior.root @ projected.right_vectors[:, : len(prior.root)].T
    deviation = np.zeros((len(projected.deviation), len(directions)))
    deviation[: prior.deviation.size] = prior.deviation[:, None] * directions.T
    gain = _gain(projected, evidence)
    weights = rows * gain[..., None, :]
    noise_m2 = evidence.total_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2))
    of_states = replace(projected, wanted_members=prior.members @ directions.T, wanted_deviation=deviation)
    aliasing_m2, member_errors = _aliasing(of_states, weights, evidence)
    data = projected.without_background(motion.displacement_m[..., motion.valid])
    causes = AliasingCauses(noise_m2 + aliasing_m2, member_phasors_m(evidence, member_errors), noise_m2)
    return (gain * (data @ projected.left_vectors)) @ rows.T, causes, member_errors


def _gain(projected: ProjectedPrior, evidence: Evidence) -> FloatArray:
    """Return g (..., rank), from data along U to coordinates along V."""
    prior_m2 = (PRIOR_WIDENING * evidence.scale_m[..., None]) ** 2
    return np.asarray(prior_m2 * projected.value / (evidence.total_m2[..., None] + prior_m2 * projected.value**2))


def _aliasing(projected: ProjectedPrior, weights: FloatArray, evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (..., state, state) of the error that the fit makes without noise: aliasing and shrinkage.

    ``weights`` (..., state, rank): the fit, from the data along the observed directions to the states. The second value
    (..., member, state) is (I - K A) x_m, true minus fitted states of every medium of the ensemble, scaled to 1 m rms.
    """
    transposed = np.swapaxes(weights, -1, -2)
    member_errors = projected.wanted_members - projected.members @ transposed
    deviation_errors = projected.wanted_deviation - projected.deviation @ transposed
    # Deviations are as large as the data suggest. Those from the ensemble's span, all but the last rows, are at least
    # those of the prior: media between the members deviate as much.
    factor = np.repeat(evidence.deviation_factor[..., None], len(projected.deviation), axis=-1)
    factor[..., : -len(projected.wanted_rows)] = factor[..., : -len(projected.wanted_rows)].clip(min=1)
    deviation_errors = factor[..., None] * deviation_errors
    # Members with their posterior probability and their own scale; deviations with the scale of the ensemble.
    member_weights = (evidence.probability * evidence.member_scale_m2)[..., None]
    members_m2 = np.swapaxes(member_errors, -1, -2) @ (member_weights * member_errors)
    deviations_m2 = np.swapaxes(deviation_errors, -1, -2) @ deviation_errors
    return members_m2 + evidence.scale_m[..., None, None] ** 2 * deviations_m2, member_errors


def member_phasors_m(evidence: Evidence, member_errors: FloatArray) -> ComplexArray:
    """Return the error (..., member, frequency) in each medium, m, times the root of the medium's probability.

    ``member_errors`` (..., member, state): in-phase and quadrature, for a motion of 1 m rms.
    """
    root = np.sqrt(evidence.probability * evidence.member_scale_m2)[..., None]
    return np.asarray(root * (member_errors[..., ::2] + 1j * member_errors[..., 1::2]))


def medium_kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    prior: MediumPrior,
    *,
    background_order: int = 0,
) -> MediumFit:
    """Return the fit with a prior of media by a Kalman filter, which adds the correlation of its innovations.

    The filter estimates coordinates a of the motion x = F a, with F the factor of the prior; their initial covariance
    is (k s)² I, with s the rms motion and k = PRIOR_WIDENING. Scale s and noise are first estimated by the fit in
    closed form, ``medium_fit``, which has the same result.
    """
    closed_form = medium_fit(motion, frequencies_hz, prior, background_order=background_order)
    frequency_hz, evidence = closed_form.fit.frequency_hz, closed_form.evidence
    projected = project_prior(prior, motion.time_s, motion.valid, frequency_hz, background_order)
    scales_m, noises_m = evidence.scale_m.reshape(-1), np.sqrt(evidence.total_m2.reshape(-1))
    data = motion.displacement_m[..., motion.valid]
    states, innovations = [], []
    for displacement_m, scale_m, noise_m in zip(
        data.reshape(-1, data.shape[-1]), scales_m.tolist(), noises_m.tolist(), strict=True
    ):
        # In units of the noise, with columns scaled by the initial standard deviations.
        prior_std = PRIOR_WIDENING * scale_m / noise_m
        matrix = np.hstack([prior_std * projected.factor[projected.repeats], DIFFUSE_STD * projected.background])
        filtered = filter_constant(matrix, displacement_m / noise_m, 1.0, innovations=True)
        coordinates = filtered.state[: projected.wanted_factor.shape[1]]
        states.append(PRIOR_WIDENING * scale_m * projected.wanted_factor @ coordinates)
        innovations.append(filtered.innovations * noise_m)
    correlation = innovation_correlation(np.reshape(innovations, data.shape), projected.background.shape[1])
    quality = replace(closed_form.fit.quality, innovation_correlation=correlation)
    state = np.reshape(states, (*data.shape[:-1], -1))
    fit = fit_from_state(frequency_hz, state, closed_form.fit.state_covariance, quality, closed_form.aliasing_m2)
    fit = replace(fit, aliasing_causes=closed_form.fit.aliasing_causes, medium=closed_form.fit.medium)
    return replace(closed_form, fit=fit)


def medium_posterior(
    prior: MediumPrior, evidence: Evidence, fit: HarmonicFit, member_errors: FloatArray
) -> MediumPosterior:
    """Return the posterior of the medium: moments over the ensemble with the members' posterior probability.

    They are the ratio of peak to tracked motion, its covariance, its dependence on speckle, and its covariance with the
    aliasing error. ``fit``: frequencies and phasors. ``member_errors`` (..., member, 2 * frequency): true minus
    estimated states of every member, scaled to 1 m rms.
    """
    indices, probability = list(prior.harmonic_indices(fit.frequency_hz)), evidence.probability
    log_ratio = np.log(prior.peak_over_tracked[:, indices])
    member_power_m2 = evidence.member_scale_m2[..., None] * prior.amplitude_m[:, indices] ** 2
    # The lower bound avoids 0/0 if nothing moves.
    mean_power_m2 = np.maximum(np.einsum("...m,...mf->...f", probability, member_power_m2), np.finfo(np.float64).tiny)
    relative_power = member_power_m2 / mean_power_m2[..., None, :]
    bounded = [bounded_steepness(effect[:, indices], relative_power) for effect in prior.steepness]
    # Speckle changes the beam's area and offset independently.
    steepness2 = sum(_real_imaginary(effect) ** 2 for effect in bounded)
    mean_log_ratio = probability @ log_ratio
    ratio_error = np.asarray(log_ratio - mean_log_ratio[..., None, :], np.complex128)
    ratio_deviation = _real_imaginary(ratio_error)
    # Aliasing error of each member relative to the fitted phasor; zero amplitudes have no relative error.
    phasor_m = fit.amplitude_m * np.exp(1j * fit.phase_rad)
    errors = member_errors[..., ::2] + 1j * member_errors[..., 1::2]
    divisor_m = np.where(phasor_m == 0, np.inf, phasor_m)[..., None, :]
    relative_errors = _real_imaginary(np.asarray(errors / divisor_m, np.complex128))
    error_weights = probability * np.sqrt(evidence.member_scale_m2)
    # Sums over members m weighted by their probability; f: frequency, i and j: amplitude and phase.
    root = np.sqrt(probability)[..., None]
    return MediumPosterior(
        significance=evidence.significance,
        peak_over_tracked=np.exp(mean_log_ratio),
        peak_covariance=np.einsum("...m,...mfi,...mfj->...fij", probability, ratio_deviation, ratio_deviation),
        steepness=np.sqrt(np.einsum("...m,...mfi->...fi", probability, steepness2)),
        shared=np.einsum("...m,...mfi,...mfi->...fi", error_weights, relative_errors, ratio_deviation),
        ratio_errors=root * ratio_error,
        steepness_terms=np.concatenate([root * effect for effect in bounded], axis=-2),
    )


def bounded_steepness(steepness: ComplexArray, power: FloatArray) -> ComplexArray:
    """Return the relative change of each member's motion, bounded where a member hardly moves.

    ``power`` (..., member, frequency): square of a member's motion over the mean square. Off the axis of the push, two
    waves can cancel at a frequency. The change is then small, but its ratio to the motion has no bound; it is
    therefore taken relative to at least ``MIN_RELATIVE_MOTION`` of the members' rms motion.
    """
    return np.asarray(steepness * np.minimum(1.0, np.sqrt(power) / MIN_RELATIVE_MOTION))


def _real_imaginary(values: ComplexArray) -> FloatArray:
    """Return real and imaginary parts along a new last axis."""
    return np.stack([values.real, values.imag], axis=-1)
