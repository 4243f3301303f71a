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
    step_covariance,
)
from hpe_rig.processing.harmonics.kalman_filter import filter_states, innovation_correlation
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.prior_evidence import Evidence, evidence_of
from hpe_rig.processing.harmonics.projected_prior import ProjectedPrior, project_prior
from hpe_rig.processing.motion.displacement import Motion

PRIOR_WIDENING = 3.0
"""k: scale of the prior over that of the evidence. A wide prior leaves the weights to the data if s is inaccurate."""
DIFFUSE_STD = 1e5
"""Standard deviation of a background state over the noise of a pulse, for the Kalman filter: a diffuse prior."""
DRIFT_VARIANCE_RATIO = 4.0
"""Residual variances larger than this, relative to the noise of the steps, count as drift."""
MIN_RELATIVE_MOTION = 0.5
"""Smallest motion, relative to the rms motion of the probable members, that a relative change is divided by."""


@dataclass(frozen=True, slots=True)
class MediumFit:
    """Fit of the wanted harmonics with its two error covariances and the evidence.

    ``noise_m2`` and ``aliasing_m2`` (..., 2 * frequency, 2 * frequency) add up to ``fit.state_covariance``.
    ``projected``: the prior as patterns of displacement that the pulses can observe. ``shrinkage`` (..., pattern):
    fraction of each pattern in the data that the fit attributes to the motion. ``coordinates`` (..., pattern): the
    fitted motion in prior standard deviations of each pattern.
    """

    fit: HarmonicFit
    noise_m2: FloatArray
    aliasing_m2: FloatArray
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
    # The gain leads from the coefficients of the data to the coordinates of the motion, ``wanted_per_pattern`` from
    # there to the wanted states, and ``weights`` directly from the coefficients to these.
    gain = _gain(projected, evidence)
    weights = projected.wanted_per_pattern * gain[..., None, :]
    shrinkage = gain * projected.pattern_sd
    noise_m2 = evidence.total_noise_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2))
    degrees = evidence.degrees_of_freedom
    if motion.step_noise_ratio is not None:
        residual, step_noise_ratio = projected.residual(data, shrinkage), np.asarray(motion.step_noise_ratio)
        noise_m2, degrees = _step_noise(projected, evidence, weights, shrinkage, residual, step_noise_ratio)
    aliasing_m2, member_errors = _aliasing(projected, weights, evidence)
    coordinates = gain * coefficients
    state = coordinates @ projected.wanted_per_pattern.T
    quality = FitQuality(np.sqrt(evidence.noise_m2), degrees, len(projected.patterns))
    fit = fit_from_state(frequency_hz, state, noise_m2 + aliasing_m2, quality, aliasing_m2)
    causes = AliasingCauses(aliasing_m2, media_influences_m(evidence, member_errors))
    fit = replace(fit, aliasing_causes=causes, medium=medium_posterior(prior, evidence, fit, member_errors))
    return MediumFit(
        fit=fit,
        noise_m2=noise_m2,
        aliasing_m2=aliasing_m2,
        evidence=evidence,
        projected=projected,
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
    """Return noise covariance (..., state, state) and degrees of freedom (...) for a displacement that adds up steps.

    Its noise is white noise plus a random walk: each phase step adds ``step_noise_ratio`` times the white variance to
    all later pulses. ``weights`` (..., state, pattern): from the coefficients of the data to the states. ``shrinkage``
    (..., pattern): fraction of each pattern that the fit has removed from its ``residual`` (..., pulse).
    """
    # The fit removes the background whole, each pattern by its shrinkage.
    columns = np.hstack([projected.background, projected.patterns])
    background_shrinkage = np.ones((*shrinkage.shape[:-1], projected.background.shape[1]))
    all_shrinkage = np.concatenate([background_shrinkage, shrinkage], axis=-1)
    expected_energy, degrees = difference_noise_moments(columns, all_shrinkage, step_noise_ratio)
    pulse_weights = weights @ projected.patterns.T
    white_m2, covariance_m2 = step_covariance(residual, step_noise_ratio, pulse_weights, expected_energy)
    # The steps do not contain slow drift such as creep: then the larger variance of the residual counts as well. A
    # random walk of n steps, minus its mean, has n / 6 times the variance of a step.
    explained_m2 = white_m2 * (1 + step_noise_ratio * len(projected.patterns) / 6)
    drifts = evidence.noise_m2 > DRIFT_VARIANCE_RATIO * explained_m2
    added_m2 = np.where(drifts, evidence.total_noise_m2, evidence.total_noise_m2 - evidence.noise_m2)
    return covariance_m2 + added_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2)), degrees


def driven_phasors_m(prior: MediumPrior, fit: MediumFit) -> tuple[FloatArray, ComplexArray]:
    """Return frequency (harmonic,) and phasor (..., harmonic), m, of all harmonics of the bursts in ``fit``.

    Independent deviations of the wanted harmonics from the ensemble's span are not included.
    """
    responses = fit.coordinates @ _coordinates_of_response(prior, fit) @ prior.response_root.T
    states = responses @ prior.states_of_response(range(prior.frequency_hz.size)).T
    return prior.frequency_hz, np.asarray(states[..., ::2] + 1j * states[..., 1::2])


def _coordinates_of_response(prior: MediumPrior, fit: MediumFit) -> FloatArray:
    """Return V' (pattern, coordinate) without the coordinates that are deviations of wanted harmonics."""
    return fit.projected.pattern_coordinates[:, : len(prior.response_root)]


def posterior_of_states(
    prior_fit: MediumFit, prior: MediumPrior, from_response: FloatArray
) -> tuple[FloatArray, AliasingCauses, FloatArray]:
    """Return the posterior of in-phase and quadrature values, *states*, that ``prior_fit`` did not fit itself.

    They are linear in the medium's response to the bursts, as the aliasing error of another fit is. ``from_response``
    (state, response component) is this linear function. The data are those of ``prior_fit``. Returns:

    * the mean of the states, (..., state), m;
    * their covariance by cause: noise and unknown medium;
    * their error without noise in every medium of the ensemble, (..., member, state): true minus estimated states, for
      a motion of 1 m rms.
    """
    evidence, projected = prior_fit.evidence, prior_fit.projected
    # As in ``medium_fit``: the fit has the coordinates of the motion in each pattern, a displacement of the prior at
    # the pulses. ``response_root`` converts coordinates to the medium's response, ``from_response`` that to the states.
    states_per_pattern = from_response @ prior.response_root @ _coordinates_of_response(prior, prior_fit).T
    weights = states_per_pattern * _gain(projected, evidence)[..., None, :]
    # The medium's response deviates from the ensemble (first rows), and the states with it. A wanted harmonic also
    # deviates alone (last rows), which changes only the data: these rows stay 0.
    deviation_states = np.zeros((len(projected.deviation_coefficients), len(from_response)))
    deviation_states[: prior.response_deviation.size] = prior.response_deviation[:, None] * from_response.T
    member_states = prior.member_responses @ from_response.T
    of_states = replace(projected, member_states=member_states, deviation_states=deviation_states)
    noise_m2 = evidence.total_noise_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2))
    aliasing_m2, member_errors = _aliasing(of_states, weights, evidence)
    causes = AliasingCauses(noise_m2 + aliasing_m2, media_influences_m(evidence, member_errors), noise_m2)
    return prior_fit.coordinates @ states_per_pattern.T, causes, member_errors


def _gain(projected: ProjectedPrior, evidence: Evidence) -> FloatArray:
    """Return g (..., pattern): from a coefficient of the data to the motion in prior standard deviations."""
    prior_m2 = (PRIOR_WIDENING * evidence.scale_m[..., None]) ** 2
    noise_m2 = evidence.total_noise_m2[..., None]
    return np.asarray(prior_m2 * projected.pattern_sd / (noise_m2 + prior_m2 * projected.pattern_sd**2))


def _aliasing(projected: ProjectedPrior, weights: FloatArray, evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (..., state, state) of the error that the fit makes without noise: aliasing and shrinkage.

    ``weights`` (..., state, pattern): the fit, from the coefficients of the data to the states. The second value (...,
    member, state): true minus fitted states of every medium of the ensemble, scaled to 1 m rms.
    """
    transposed = np.swapaxes(weights, -1, -2)
    member_errors = projected.member_states - projected.member_coefficients @ transposed
    deviation_errors = projected.deviation_states - projected.deviation_coefficients @ transposed
    # Deviations are as large as the data suggest. Those of the response, all but the last rows, are at least those of
    # the prior: media between the members deviate as much.
    factor = np.repeat(evidence.deviation_factor[..., None], len(projected.deviation_coefficients), axis=-1)
    of_response = slice(0, -len(projected.wanted_per_pattern))
    factor[..., of_response] = factor[..., of_response].clip(min=1)
    deviation_errors = factor[..., None] * deviation_errors
    # Members with their posterior probability and their own scale; deviations with the scale of the ensemble.
    member_weights = (evidence.probability * evidence.member_scale_m2)[..., None]
    members_m2 = np.swapaxes(member_errors, -1, -2) @ (member_weights * member_errors)
    deviations_m2 = np.swapaxes(deviation_errors, -1, -2) @ deviation_errors
    return members_m2 + evidence.scale_m[..., None, None] ** 2 * deviations_m2, member_errors


def media_influences_m(evidence: Evidence, member_errors: FloatArray) -> ComplexArray:
    """Return the influences (..., member, frequency), m, of the unknown medium on the fitted phasors.

    An influence is the complex error of a phasor in one medium of the ensemble times the square root of the medium's
    probability. The sum of squares over the media is the variance due to the unknown medium. ``member_errors`` (...,
    member, state): errors in phase and in quadrature for a motion of 1 m rms, scaled here to the measured motion.
    """
    # Not summed: beam averaging depends on the same media, so its error is correlated medium by medium.
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

    The filter estimates coordinates a of the motion x = F a, with F the root of the prior's covariance; their initial
    covariance is (k s)² I, with s the rms motion and k = PRIOR_WIDENING. Scale s and noise are first estimated by the
    fit in closed form, ``medium_fit``, which has the same result.
    """
    closed_form = medium_fit(motion, frequencies_hz, prior, background_order=background_order)
    frequency_hz, evidence, projected = closed_form.fit.frequency_hz, closed_form.evidence, closed_form.projected
    scales_m, noises_m = evidence.scale_m.reshape(-1), np.sqrt(evidence.total_noise_m2.reshape(-1))
    data = motion.displacement_m[..., motion.valid]
    states, innovations = [], []
    for displacement_m, scale_m, noise_m in zip(
        data.reshape(-1, data.shape[-1]), scales_m.tolist(), noises_m.tolist(), strict=True
    ):
        # In units of the noise, with columns scaled by the initial standard deviations.
        prior_sd = PRIOR_WIDENING * scale_m / noise_m
        matrix = np.hstack([prior_sd * projected.factor[projected.repeats], DIFFUSE_STD * projected.background])
        filtered = filter_states(matrix, displacement_m / noise_m, 1.0)
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
    """Return the posterior of the medium, given its motion: ratio of peak to tracked motion, dependence on speckle.

    Means and covariances over the ensemble, each medium with its posterior probability. ``fit``: frequencies and
    phasors. ``member_errors`` (..., member, 2 * frequency): error of the fit without noise in every medium (aliasing
    and shrinkage), true minus fitted in-phase and quadrature values, for a motion of 1 m rms.
    """
    indices, probability = list(prior.harmonic_indices(fit.frequency_hz)), evidence.probability
    # Logarithm of the ratio of peak to tracked motion in each medium, minus its mean: relative amplitude and phase.
    log_ratio = np.log(prior.peak_over_tracked[:, indices])
    mean_log_ratio = probability @ log_ratio
    ratio_error = np.asarray(log_ratio - mean_log_ratio[..., None, :], np.complex128)
    ratio_errors = _real_imaginary(ratio_error)
    # Relative change of the motion with area and offset of the tracking beam, bounded where a medium hardly moves.
    power_m2 = evidence.member_scale_m2[..., None] * prior.amplitude_m[:, indices] ** 2
    # The lower bound avoids 0/0 if nothing moves.
    mean_power_m2 = np.maximum(np.einsum("...m,...mf->...f", probability, power_m2), np.finfo(np.float64).tiny)
    relative_power = power_m2 / mean_power_m2[..., None, :]
    effects = [bounded_steepness(effect[:, indices], relative_power) for effect in prior.steepness]
    # Speckle changes the beam's area and offset independently.
    steepness2 = sum(_real_imaginary(effect) ** 2 for effect in effects)
    # Aliasing error of each medium relative to the fitted phasor; zero amplitudes have no relative error.
    phasor_m = fit.amplitude_m * np.exp(1j * fit.phase_rad)
    errors = member_errors[..., ::2] + 1j * member_errors[..., 1::2]
    divisor_m = np.where(phasor_m == 0, np.inf, phasor_m)[..., None, :]
    aliasing_errors = _real_imaginary(np.asarray(errors / divisor_m, np.complex128))
    aliasing_weights = probability * np.sqrt(evidence.member_scale_m2)
    # Sums over media m weighted by their probability; f: frequency, i and j: amplitude and phase.
    root = np.sqrt(probability)[..., None]
    return MediumPosterior(
        significance=evidence.significance,
        peak_over_tracked=np.exp(mean_log_ratio),
        peak_covariance=np.einsum("...m,...mfi,...mfj->...fij", probability, ratio_errors, ratio_errors),
        steepness=np.sqrt(np.einsum("...m,...mfi->...fi", probability, steepness2)),
        aliasing_covariance=np.einsum("...m,...mfi,...mfi->...fi", aliasing_weights, aliasing_errors, ratio_errors),
        ratio_influences=root * ratio_error,
        steepness_influences=np.concatenate([root * effect for effect in effects], axis=-2),
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
