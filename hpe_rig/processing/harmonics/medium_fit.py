"""Harmonic fit with a prior of media: all harmonics of the bursts at once, in closed form or by a Kalman filter.

    d = A x + background + noise,    Cov x = P = (k s)² F F'
    x^ = K d,                        K = P A' (A P A' + R)^-1
    Cov(x^ - x) = K R K' + mean over members of (I - K A) x_m x_m' (I - K A)'

R = sigma² I is the noise, s the scale of the evidence, k = PRIOR_WIDENING. The first term is noise, the second aliasing
and shrinkage: x_m are the members of the ensemble, each with its own scale and posterior probability. With the patterns
U of A F = U diag(l) V' (projected_prior.py) and the coefficients z = U'd of the data,

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
    real_imaginary,
    step_covariance,
)
from hpe_rig.processing.harmonics.kalman_filter import filter_states, innovation_correlation
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.prior_evidence import Evidence, evidence_of
from hpe_rig.processing.harmonics.projected_prior import ProjectedPrior, project_prior
from hpe_rig.processing.motion.displacement import Motion

PRIOR_WIDENING = 3.0
"""k: scale of the prior over that of the evidence. A wide prior leaves the weights to the data if s is inaccurate."""
DIFFUSE_STD = 1e6
"""Standard deviation of a background state over the noise of a pulse, for the Kalman filter: a diffuse prior."""
DRIFT_VARIANCE_RATIO = 4.0
"""Residual variances larger than this, relative to the noise of the steps, count as drift."""
MIN_RELATIVE_MOTION = 0.5
"""Smallest motion, relative to the rms motion of the probable members, that a relative change is divided by."""


@dataclass(frozen=True, slots=True)
class MediumFit:
    """Fit of the wanted harmonics, with the evidence and the motion in the prior's patterns.

    ``projected``: the prior as patterns of displacement that the pulses can observe. ``shrinkage`` (..., pattern):
    fraction of each pattern in the data that the fit attributes to the motion. ``coordinates`` (..., pattern): the
    fitted motion in prior standard deviations of each pattern.
    """

    fit: HarmonicFit
    evidence: Evidence
    projected: ProjectedPrior
    shrinkage: FloatArray
    coordinates: FloatArray

    def residual_m(self, motion: Motion) -> FloatArray:
        """Return the displacement of ``motion`` (..., valid pulse) minus background and fitted motion, m."""
        data = self.projected.without_background(motion.displacement_m[..., motion.valid])
        return self.projected.residual(data, self.shrinkage)


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
    coefficients = data @ projected.patterns
    evidence = evidence_of(projected, data, coefficients)
    gain = _gain(projected, evidence)
    shrinkage = gain * projected.pattern_sd
    # W: from the coefficients of the data to the wanted states.
    weights = projected.wanted_per_pattern * gain[..., None, :]
    noise_m2 = evidence.total_noise_m2[..., None, None] * _squares(weights)
    degrees = evidence.degrees_of_freedom
    if motion.step_noise_ratio is not None:
        residual, step_noise_ratio = projected.residual(data, shrinkage), np.asarray(motion.step_noise_ratio)
        noise_m2, degrees = _step_noise(projected, evidence, weights, shrinkage, residual, step_noise_ratio)
    aliasing_m2, influences_m = _aliasing(projected, projected.sample_states, weights, evidence)
    coordinates = gain * coefficients
    state = coordinates @ projected.wanted_per_pattern.T
    quality = FitQuality(np.sqrt(evidence.noise_m2), degrees, len(projected.patterns))
    fit = fit_from_state(frequency_hz, state, noise_m2 + aliasing_m2, quality, aliasing_m2)
    causes = AliasingCauses(aliasing_m2, influences_m)
    fit = replace(fit, aliasing_causes=causes, medium=medium_posterior(prior, evidence, fit, influences_m))
    return MediumFit(fit, evidence, projected, shrinkage, coordinates)


def _step_noise(
    projected: ProjectedPrior,
    evidence: Evidence,
    weights: FloatArray,
    shrinkage: FloatArray,
    residual: FloatArray,
    step_noise_ratio: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return noise covariance (..., state, state) and degrees of freedom (...) for a sum of noisy phase steps.

    The noise of such a displacement is white noise plus a random walk: each step from pulse to pulse adds
    ``step_noise_ratio`` times the white variance to all later pulses. ``weights`` (..., state, pattern): from the
    coefficients of the data to the states. ``shrinkage`` (..., pattern): fraction of each pattern in the data that the
    fit takes up; the remainder is in its ``residual`` (..., pulse).
    """
    # The fit removes the background entirely, and of each pattern the fraction ``shrinkage``.
    columns = np.hstack([projected.background, projected.patterns])
    background_shrinkage = np.ones((*shrinkage.shape[:-1], projected.background.shape[1]))
    all_shrinkage = np.concatenate([background_shrinkage, shrinkage], axis=-1)
    expected_energy, degrees = difference_noise_moments(columns, all_shrinkage, step_noise_ratio)
    pulse_weights = weights @ projected.patterns.T
    white_m2, covariance_m2 = step_covariance(residual, step_noise_ratio, pulse_weights, expected_energy)
    # The steps do not contain slow drift such as creep: then the larger variance of the residual counts as well. A
    # random walk of n steps, minus its mean, has n / 6 times the variance of a step.
    explained_m2 = white_m2 * (1 + step_noise_ratio * len(projected.patterns) / 6)
    has_drift = evidence.noise_m2 > DRIFT_VARIANCE_RATIO * explained_m2
    # The total exceeds the noise by the model error that the residual does not contain, which is added in any case.
    added_m2 = np.where(has_drift, evidence.total_noise_m2, evidence.total_noise_m2 - evidence.noise_m2)
    return covariance_m2 + added_m2[..., None, None] * _squares(weights), degrees


def driven_phasors_m(prior: MediumPrior, fit: MediumFit) -> tuple[FloatArray, ComplexArray]:
    """Return frequency (harmonic,) and phasor (..., harmonic), m, of all harmonics of the bursts in ``fit``.

    The phasors are combinations of the motions of the ensemble's media. The deviations of single wanted harmonics from
    such combinations, which the fit allows, are not included.
    """
    responses = fit.coordinates @ fit.projected.response_per_pattern.T
    states = responses @ prior.states_of_response(range(prior.frequency_hz.size)).T
    return prior.frequency_hz, np.asarray(states[..., ::2] + 1j * states[..., 1::2])


def posterior_of_states(
    prior_fit: MediumFit, prior: MediumPrior, from_response: FloatArray
) -> tuple[FloatArray, AliasingCauses]:
    """Return the posterior of in-phase and quadrature values, *states*, that ``prior_fit`` did not fit itself.

    They are linear in the medium's response to the bursts, as the aliasing error of another fit is. ``from_response``
    (state, response component) is this linear function. The data are those of ``prior_fit``. Returns the mean of the
    states, (..., state), m, and their covariance by cause: noise and unknown medium.
    """
    evidence, projected = prior_fit.evidence, prior_fit.projected
    states_per_pattern = from_response @ projected.response_per_pattern
    weights = states_per_pattern * _gain(projected, evidence)[..., None, :]
    # A deviation of a wanted harmonic alone (last samples) is in the data, but does not change the response.
    sample_states = np.zeros((len(projected.sample_coefficients), len(from_response)))
    sample_states[: len(prior.sample_responses)] = prior.sample_responses @ from_response.T
    noise_m2 = evidence.total_noise_m2[..., None, None] * _squares(weights)
    aliasing_m2, influences_m = _aliasing(projected, sample_states, weights, evidence)
    causes = AliasingCauses(noise_m2 + aliasing_m2, influences_m, noise_m2)
    return prior_fit.coordinates @ states_per_pattern.T, causes


def _gain(projected: ProjectedPrior, evidence: Evidence) -> FloatArray:
    """Return g = (k s)² l / (sigma² + (k s)² l²), (..., pattern), the filter factor h of Tikhonov over l.

    It converts a coefficient of the data to the motion in prior standard deviations. s, sigma²: scale and noise of the
    ``evidence``; l: standard deviation of the pattern; k = PRIOR_WIDENING.
    """
    prior_m2 = (PRIOR_WIDENING * evidence.scale_m[..., None]) ** 2
    noise_m2 = evidence.total_noise_m2[..., None]
    return np.asarray(prior_m2 * projected.pattern_sd / (noise_m2 + prior_m2 * projected.pattern_sd**2))


def _squares(weights: FloatArray) -> FloatArray:
    """Return W W' of ``weights`` (..., state, pattern)."""
    return np.asarray(weights @ np.swapaxes(weights, -1, -2))


def _aliasing(
    projected: ProjectedPrior, sample_states: FloatArray, weights: FloatArray, evidence: Evidence
) -> tuple[FloatArray, ComplexArray]:
    """Return the covariance (..., state, state) of the error that a fit makes without noise: aliasing and shrinkage.

    It is the sum over the sample motions of the prior of w_i e_i e_i', with e_i = x_i - W z_i. x_i: ``sample_states``
    (sample, state), z_i: their coefficients of the patterns, W: ``weights`` (..., state, pattern) of the fit, w_i: mean
    square of the motion. The second value has the influences of the medium: see ``influences_m``.
    """
    errors = sample_states - projected.sample_coefficients @ np.swapaxes(weights, -1, -2)
    # Deviations are as large as the data suggest. Those of the response, all but the last samples, are at least those
    # of the prior: media between the members deviate as much.
    wanted = len(projected.wanted_per_pattern)
    factor = np.repeat(evidence.deviation_factor[..., None], len(projected.deviation_coefficients), axis=-1)
    factor[..., :-wanted] = factor[..., :-wanted].clip(min=1)
    # Members with their posterior probability and their own scale; deviations with the scale of the ensemble.
    deviations_m2 = (factor * evidence.scale_m[..., None]) ** 2
    return error_covariance(errors, evidence, deviations_m2), influences_m(evidence, errors)


def error_covariance(errors: FloatArray, evidence: Evidence, deviations_m2: FloatArray) -> FloatArray:
    """Return the covariance (..., state, state) of an error that depends on the medium.

    ``errors`` (..., sample, state): in each sample motion of the prior, for 1 m rms. The mean squares of the motions:
    p s² for the media of the ensemble, with their posterior probability p and their scale s, and ``deviations_m2``
    (..., deviation) for the deviations from it, which are the last samples.
    """
    mean_square_m2 = np.concatenate([evidence.probability * evidence.member_scale_m2, deviations_m2], axis=-1)
    return np.asarray(np.swapaxes(errors, -1, -2) @ (mean_square_m2[..., None] * errors))


def influences_m(evidence: Evidence, errors: FloatArray) -> ComplexArray:
    """Return the influences (..., member, frequency), m, of the unknown medium on the fitted phasors.

    An influence is the complex error of a phasor in one medium of the ensemble times the square root of the medium's
    probability. The sum of squares over the media is the variance due to the unknown medium. ``errors`` (..., sample,
    state): errors in phase and in quadrature for a motion of 1 m rms, scaled here to the measured motion; the samples
    begin with the media.
    """
    # Not summed: beam averaging depends on the same media, so its error is correlated medium by medium.
    root_m = np.sqrt(evidence.probability * evidence.member_scale_m2)[..., None]
    member_errors = errors[..., : root_m.shape[-2], :]
    return np.asarray(root_m * (member_errors[..., ::2] + 1j * member_errors[..., 1::2]))


def medium_kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    prior: MediumPrior,
    *,
    background_order: int = 0,
) -> MediumFit:
    """Return the fit of ``medium_fit``, with the correlation of the Kalman filter's innovations as a check.

    The states are constant over the train, so the filter's final estimate equals ``medium_fit``; only the innovations
    come from the filter. States are the coefficients of the background and of the patterns. Those of patterns have
    variance (k s l)²: k = PRIOR_WIDENING, s the rms displacement, l the standard deviation for 1 m rms.
    """
    closed_form = medium_fit(motion, frequencies_hz, prior, background_order=background_order)
    evidence, projected = closed_form.evidence, closed_form.projected
    data = motion.displacement_m[..., motion.valid]
    noise_m = np.sqrt(evidence.total_noise_m2)
    # In units of the noise.
    patterns_sd = (PRIOR_WIDENING * evidence.scale_m / noise_m)[..., None] * projected.pattern_sd
    background_sd = np.full((*noise_m.shape, projected.background.shape[1]), DIFFUSE_STD)
    initial_sd = np.concatenate([patterns_sd, background_sd], axis=-1)
    matrix = np.hstack([projected.patterns, projected.background])
    innovations = filter_states(matrix, data / noise_m[..., None], initial_sd).innovations
    correlation = innovation_correlation(innovations, projected.background.shape[1])
    quality = replace(closed_form.fit.quality, innovation_correlation=correlation)
    return replace(closed_form, fit=replace(closed_form.fit, quality=quality))


def medium_posterior(
    prior: MediumPrior, evidence: Evidence, fit: HarmonicFit, aliasing_influences_m: ComplexArray
) -> MediumPosterior:
    """Return the posterior of the medium, given its motion: ratio of peak to tracked motion, dependence on speckle.

    Means and influences over the ensemble, each medium with its posterior probability. ``fit``: frequencies and
    phasors. ``aliasing_influences_m`` (..., member, frequency): influences of the medium on these phasors.
    """
    indices, probability = list(prior.harmonic_indices(fit.frequency_hz)), evidence.probability
    root = np.sqrt(probability)[..., None]
    # Logarithm of the ratio of peak to tracked motion in each medium, minus its mean: relative amplitude and phase.
    log_ratio = np.log(prior.peak_over_tracked[:, indices])
    mean_log_ratio = probability @ log_ratio
    ratio_influences = np.asarray(root * (log_ratio - mean_log_ratio[..., None, :]), np.complex128)
    # Relative change of the motion with area and offset of the tracking beam, bounded where a medium hardly moves.
    power_m2 = evidence.member_scale_m2[..., None] * prior.amplitude_m[:, indices] ** 2
    # The lower bound avoids 0/0 if nothing moves.
    mean_power_m2 = np.maximum(np.einsum("...m,...mf->...f", probability, power_m2), np.finfo(np.float64).tiny)
    relative_power = power_m2 / mean_power_m2[..., None, :]
    effects = [bounded_steepness(effect[:, indices], relative_power) for effect in prior.steepness]
    # Aliasing error relative to the fitted phasor; zero amplitudes have no relative error.
    phasor_m = fit.amplitude_m * np.exp(1j * fit.phase_rad)
    divisor_m = np.where(phasor_m == 0, np.inf, phasor_m)[..., None, :]
    relative_aliasing = np.asarray(aliasing_influences_m / divisor_m, np.complex128)
    return MediumPosterior(
        significance=evidence.significance,
        peak_over_tracked=np.exp(mean_log_ratio),
        aliasing_covariance=np.sum(real_imaginary(relative_aliasing) * real_imaginary(ratio_influences), axis=-3),
        ratio_influences=ratio_influences,
        steepness_influences=np.concatenate([root * effect for effect in effects], axis=-2),
    )


def bounded_steepness(steepness: ComplexArray, power: FloatArray) -> ComplexArray:
    """Return the relative change of each member's motion, bounded where a member hardly moves.

    ``power`` (..., member, frequency): square of a member's motion over the mean square. Off the axis of the push, two
    waves can cancel at a frequency. The change is then small, but its ratio to the motion has no bound; it is
    therefore taken relative to at least ``MIN_RELATIVE_MOTION`` of the members' rms motion.
    """
    return np.asarray(steepness * np.minimum(1.0, np.sqrt(power) / MIN_RELATIVE_MOTION))
