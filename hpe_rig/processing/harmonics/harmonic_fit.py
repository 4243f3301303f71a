"""Amplitude and phase of each harmonic from a displacement, with covariance; least squares.

    d = H x + noise          H of harmonics/model.py, x the states: (A cos phase, A sin phase) of each frequency, ...
    x^ = (H'H)^-1 H'd        Cov x^ = s² (H'H)^-1,   s² = |d - H x^|² / nu,   nu = pulses - states

The model is linear in x: all frequencies and the background are estimated in one step. ``fit_from_state`` converts
states of any linear estimator to amplitude and phase. Uncertainties: docs/explanation/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.result import PHASE_VARIANCE_LIMIT, phase_variance_at_rad2, phase_variance_rad2, rectified_variance_m2

InnovationCorrelation = tuple[FloatArray, float]
"""Correlation (...) of a Kalman filter's innovations (measured minus predicted displacement) at a lag of one pulse.

It is 0 for a complete model. The second value is four of its standard deviations."""


@dataclass(frozen=True, slots=True)
class MediumPosterior:
    """Posterior of the medium, given the motion, from a fit with a prior of media.

    ``significance`` (...): probability that a medium of the ensemble gives data as improbable as these.
    ``peak_over_tracked``, complex (..., frequency): peak displacement over tracked displacement.
    ``aliasing_covariance`` (..., frequency, 2): covariance of the errors of ``peak_over_tracked`` and of aliasing, as
    both depend on the medium; in relative amplitude and in phase.

    Influences of the medium, complex, for each member of the ensemble times the root of its probability:
    ``ratio_influences`` (..., member, frequency), deviation of the logarithm of ``peak_over_tracked`` from its mean;
    ``steepness_influences`` (..., effect and member, frequency), relative change of the tracked motion with the
    logarithm of the tracking beam's area (first all members) and with its offset.
    """

    significance: FloatArray
    peak_over_tracked: ComplexArray
    aliasing_covariance: FloatArray
    ratio_influences: ComplexArray
    steepness_influences: ComplexArray

    @property
    def peak_covariance(self) -> FloatArray:
        """Covariance (..., frequency, 2, 2) of the relative amplitude and the phase of ``peak_over_tracked``."""
        errors = real_imaginary(self.ratio_influences)
        return np.asarray(np.einsum("...mfi,...mfj->...fij", errors, errors))

    @property
    def steepness(self) -> FloatArray:
        """Root mean square change (..., frequency, 2) of the tracked motion with beam area and offset."""
        return np.asarray(np.sqrt(np.sum(real_imaginary(self.steepness_influences) ** 2, axis=-3)))


@dataclass(frozen=True, slots=True)
class AliasingCauses:
    """Aliasing error of a fit by its causes, with the covariance between all frequencies.

    ``total_m2`` (..., state, state): covariance of the whole error. ``media_influences_m``, complex (..., member,
    frequency): error in each medium of the ensemble, times the root of the medium's probability. ``noise_m2``, as
    ``total_m2``: of the noise in a correction for aliasing, 0 without one.
    """

    total_m2: FloatArray
    media_influences_m: ComplexArray
    noise_m2: FloatArray | float = 0.0

    @property
    def deviation_m2(self) -> FloatArray:
        """Covariance (..., state, state) of the error from deviations of the medium from the ensemble.

        It is the total minus the part of the ensemble and, after a correction, minus that of its noise.
        """
        influences = real_imaginary(self.media_influences_m)
        influences = influences.reshape(*influences.shape[:-2], -1)
        return np.asarray(self.total_m2 - self.noise_m2 - np.swapaxes(influences, -1, -2) @ influences)


@dataclass(frozen=True, slots=True)
class FitQuality:
    """How well the pulses determine a fit.

    ``residual_rms_m`` (...): displacement noise of one pulse. ``degrees_of_freedom`` (...) of that residual.
    ``pulses``: number of pulses used. ``condition``: condition number of the model, 1 at best.
    ``innovation_correlation``: of a Kalman filter.
    """

    residual_rms_m: FloatArray
    degrees_of_freedom: FloatArray | float
    pulses: int
    condition: float = np.nan
    innovation_correlation: InnovationCorrelation | None = None


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Amplitude and phase of each frequency, with covariance.

    ``frequency_hz`` (frequency,); ``amplitude_m`` and ``phase_rad`` (..., frequency), phase in (-pi, pi].
    ``covariance`` (..., frequency, 2, 2) of (amplitude, phase), from standard uncertainties.
    ``rician_bias_m2`` (..., frequency): added variance of an amplitude that may be noise alone.
    ``state`` (..., state) and ``state_covariance`` (..., state, state): in-phase and quadrature states, m and m².

    With a prior of media: ``aliasing`` (..., frequency, 2, 2) is the part of ``covariance`` from unresolved harmonics
    and shrinkage, ``aliasing_causes`` that of ``state_covariance``, and ``medium`` the posterior of the medium.
    ``aliasing_corrected``, of a fit that has no prior itself: the same fit minus the expected aliasing.
    ``drift_m2`` (..., state, state): the part of ``state_covariance`` from a drift within the train that was removed.
    """

    frequency_hz: FloatArray
    amplitude_m: FloatArray
    phase_rad: FloatArray
    covariance: FloatArray
    rician_bias_m2: FloatArray
    state: FloatArray
    state_covariance: FloatArray
    quality: FitQuality
    aliasing: FloatArray | None = None
    aliasing_causes: AliasingCauses | None = None
    medium: MediumPosterior | None = None
    aliasing_corrected: HarmonicFit | None = None
    drift_m2: FloatArray | None = None


def real_imaginary(values: ComplexArray) -> FloatArray:
    """Return real and imaginary parts along a new last axis."""
    return np.stack([values.real, values.imag], axis=-1)


def least_squares(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
) -> HarmonicFit:
    """Return all amplitudes and phases of a displacement from one least-squares fit, with covariance from the residual.

    ``also_hz``: further driven frequencies, fitted to keep them out of the residual, but not returned; half the pulse
    rate may be among them. ``background_order``: of the fitted polynomial. Every valid pulse has the same weight. The
    noise is assumed white; for a displacement that is a sum of noisy steps, white plus a random walk. Raises
    ``ValueError`` if the pulses cannot resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
    wanted_states = model.wanted_states
    pulses, states = model.matrix.shape
    state, residual = model.solve(motion.displacement_m[..., motion.valid])
    degrees: FloatArray | float = float(pulses - states)
    variance = np.einsum("...i,...i->...", residual, residual) / (pulses - states)
    # model.root is R^-1, with H'H = R'R of the model's matrix H: for unit noise the covariance is R^-1 R^-1'.
    if motion.step_noise_ratio is not None:
        orthonormal, step_noise_ratio = model.matrix @ model.root, np.asarray(motion.step_noise_ratio)
        expected_energy, degrees = difference_noise_moments(orthonormal, np.ones(states), step_noise_ratio)
        # The fitted states are ``weights`` @ displacement.
        weights = model.root[wanted_states] @ orthonormal.T
        variance, covariance = step_covariance(residual, step_noise_ratio, weights, expected_energy)
    else:
        covariance = variance[..., None, None] * (model.root[wanted_states] @ model.root[wanted_states].T)
    quality = FitQuality(
        residual_rms_m=np.sqrt(variance), degrees_of_freedom=degrees, pulses=pulses, condition=model.condition
    )
    return fit_from_state(frequency_hz, state[..., wanted_states], covariance, quality)


def difference_noise_moments(
    columns: FloatArray, shrinkage: FloatArray, step_noise_ratio: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the expected energy (...) of a residual's pulse-to-pulse differences, and their degrees of freedom.

    They are needed to estimate the noise of a displacement that is a sum of noisy steps: white noise plus a random
    walk, with r = ``step_noise_ratio`` (...) times the white variance in every step. The energy is relative to the
    white variance of one pulse. The residual is that of a fit which has removed the fraction h = ``shrinkage`` (...,
    column) of each of the orthonormal ``columns`` Q (pulse, column) in the displacement; 1 for least squares. With D
    the difference of neighbours, L the running sum (D L = 1), n differences and g = h (2 - h),

        E = W + r |D (1 - Q h Q') L|²,    W = |D (1 - Q h Q')|² = 2 n - sum g |D q|²
        nu = W / 2 (2 + r)² / ((2 + r)² + 2)

    nu is (tr A)² / tr A² (Satterthwaite, 1946) of the covariance A of the differences: 2 + r on its diagonal, -1 beside
    it. The columns of the fit hardly change it: by 2 % for one harmonic in six pulses.
    """
    # D Q, L'Q and |D q|² of each column.
    differences = np.diff(columns, axis=0)
    sums_after = np.cumsum(columns[:0:-1], axis=0)[::-1]
    white = 2 * len(differences) - (shrinkage * (2 - shrinkage)) @ np.einsum("ij,ij->j", differences, differences)
    # |D (1 - Q h Q') L|², expanded with D L = 1.
    overlap = np.einsum("ij,ij->j", sums_after, differences)
    products = (differences.T @ differences) * (sums_after.T @ sums_after)
    walk = len(differences) - 2 * shrinkage @ overlap
    walk = walk + np.einsum("...i,ij,...j->...", shrinkage, products, shrinkage)
    step_square = (2 + step_noise_ratio) ** 2
    degrees = white / 2 * step_square / (step_square + 2)
    return np.asarray(white + step_noise_ratio * walk), np.asarray(degrees)


def step_covariance(
    residual: FloatArray, step_noise_ratio: FloatArray, weights: FloatArray, expected_energy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the white-noise variance (...) of one pulse, and the covariance (..., row, row) of the fitted states.

    The states are ``weights`` (..., row, pulse) @ displacement. The displacement has white noise and a random walk; the
    variance of a step is ``step_noise_ratio`` (...) times the white variance. The white variance is estimated from the
    ``residual`` (..., pulse): the energy (sum of squares) of its pulse-to-pulse differences, over ``expected_energy``
    (...), the energy expected for a white variance of 1 (``difference_noise_moments``).
    """
    differences = np.diff(residual, axis=-1)
    variance = np.einsum("...i,...i->...", differences, differences) / expected_energy
    # A step shifts all later pulses: its weight is the sum of their weights, cumulated from the last pulse backwards.
    # So the steps are in reverse order, which does not change the sum over steps below.
    step_weights = np.cumsum(weights[..., :0:-1], axis=-1)
    # Covariance for unit variance: sum over pulses, or over steps, of the products of their weights.
    white, random_walk = (rows @ np.swapaxes(rows, -1, -2) for rows in (weights, step_weights))
    return variance, np.asarray(variance[..., None, None] * (white + step_noise_ratio[..., None, None] * random_walk))


def fit_from_state(
    frequency_hz: FloatArray,
    state: FloatArray,
    state_covariance: FloatArray,
    quality: FitQuality,
    aliasing_m2: FloatArray | None = None,
) -> HarmonicFit:
    """Return amplitude and phase with covariance from the fitted in-phase and quadrature states.

    ``state`` (..., state): A cos(phase) and A sin(phase) of each frequency; further entries may follow.
    ``state_covariance`` (..., state, state). ``aliasing_m2``: the part of it that is aliasing.
    """
    states = 2 * frequency_hz.size
    in_phase, quadrature = state[..., 0:states:2], state[..., 1:states:2]
    amplitude = np.hypot(in_phase, quadrature)
    phase = np.arctan2(quadrature, in_phase)
    # Covariances (..., frequency, 2, 2) of the errors along and across each phasor.
    total = _along_phasor(state_covariance, phase)
    aliasing = np.zeros_like(total) if aliasing_m2 is None else _along_phasor(aliasing_m2, phase)
    # An amplitude may be noise alone, but not aliasing alone, which grows with the motion: the Rician bias and the
    # phase variance of a weak amplitude therefore depend on noise only.
    noise = total - aliasing
    phase_variance = phase_variance_rad2(amplitude, total[..., 1, 1], _conditional_variance(noise))
    to_polar = _polar_factors(total, phase_variance)
    rician_bias_m2 = rectified_variance_m2(amplitude, _conditional_variance(noise), np.maximum(noise[..., 1, 1], 0.0))
    return HarmonicFit(
        frequency_hz=frequency_hz,
        amplitude_m=amplitude,
        phase_rad=phase,
        covariance=np.asarray(total * to_polar),
        rician_bias_m2=rician_bias_m2,
        state=state,
        state_covariance=state_covariance,
        quality=quality,
        aliasing=None if aliasing_m2 is None else np.asarray(aliasing * to_polar),
    )


def corrected_by(fit: HarmonicFit, correction_m: FloatArray) -> HarmonicFit:
    """Return ``fit`` with ``correction_m`` added to its in-phase and quadrature values; covariance unchanged.

    ``correction_m`` (..., 2 * frequency), m: in-phase and quadrature of the first frequency, then of the next.
    Amplitudes and phases are computed anew from the corrected values.
    """
    state = fit.state.copy()
    state[..., : 2 * fit.frequency_hz.size] += correction_m
    return fit_from_state(fit.frequency_hz, state, fit.state_covariance, fit.quality)


def with_aliasing(
    fit: HarmonicFit, causes: AliasingCauses, prior_fit: HarmonicFit, medium: MediumPosterior
) -> HarmonicFit:
    """Return ``fit`` with the covariance of its aliasing error, ``causes``, added.

    Aliasing error: harmonics above half the pulse rate that ``fit`` attributes to the wanted ones. It can be as large
    as the amplitudes of ``fit``, so the phase uncertainty is computed for the amplitudes of ``prior_fit`` instead: a
    fit of the same motion with a prior of media for all harmonics. ``medium``: posterior of the medium, attached to the
    result.
    """
    wanted_states, aliasing_m2 = slice(2 * fit.frequency_hz.size), causes.total_m2
    total_m2 = fit.state_covariance.copy()
    total_m2[..., wanted_states, wanted_states] += aliasing_m2
    total, aliasing = (_along_phasor(covariance, fit.phase_rad) for covariance in (total_m2, aliasing_m2))
    # Only noise can look like a motion where there is none. The uncertainty from the prior grows with the motion.
    prior_uncertainty_m2 = 0.0 if prior_fit.aliasing is None else prior_fit.aliasing[..., 0, 0]
    phase_variance = phase_variance_at_rad2(
        prior_fit.amplitude_m,
        noise_m2=prior_fit.covariance[..., 0, 0] - prior_uncertainty_m2,
        observed_m=fit.amplitude_m,
        covariance_m2=total,
    )
    to_polar = _polar_factors(total, phase_variance)
    return replace(
        fit,
        covariance=total * to_polar,
        state_covariance=total_m2,
        aliasing=aliasing * to_polar,
        aliasing_causes=causes,
        medium=medium,
    )


def polar_covariance(state_covariance: FloatArray, fit: HarmonicFit) -> FloatArray:
    """Return the covariance (..., frequency, 2, 2) of amplitude and phase for small errors of the states of ``fit``.

    ``state_covariance`` (..., state, state): of in-phase and quadrature.
    """
    along_phasor = _along_phasor(state_covariance, fit.phase_rad)
    # The error across the phasor over the amplitude is the phase error, at most that of an unknown phase.
    smallest_m = np.sqrt(np.maximum(along_phasor[..., 1, 1], 0.0) / PHASE_VARIANCE_LIMIT)
    divisor_m = np.maximum(fit.amplitude_m, smallest_m).clip(min=np.finfo(np.float64).tiny)
    scale = np.stack([np.ones_like(divisor_m), divisor_m], axis=-1)
    return np.asarray(along_phasor / (scale[..., :, None] * scale[..., None, :]))


def with_state_error(fit: HarmonicFit, error_m2: FloatArray) -> HarmonicFit:
    """Return ``fit`` with the covariance ``error_m2`` (state, state) of a further error of its states added.

    The states are in-phase and quadrature values of all wanted frequencies; those of the background may follow.
    """
    state_covariance, size = fit.state_covariance.copy(), len(error_m2)
    state_covariance[:size, :size] += error_m2
    return replace(fit, covariance=fit.covariance + polar_covariance(error_m2, fit), state_covariance=state_covariance)


def _along_phasor(state_covariance: FloatArray, phase: FloatArray) -> FloatArray:
    """Return the covariance (..., frequency, 2, 2) of each harmonic's errors along and across its phasor.

    ``state_covariance`` (..., state, state): of in-phase and quadrature. ``phase`` (..., frequency): rotates each pair.
    """
    frequencies = phase.shape[-1]
    rotation = np.empty((*phase.shape, 2, 2))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(phase)
    rotation[..., 0, 1] = np.sin(phase)
    rotation[..., 1, 0] = -rotation[..., 0, 1]
    # The 2 x 2 block of each frequency's pair of states, rotated to its phasor.
    pairs = np.arange(2 * frequencies).reshape(frequencies, 2)
    blocks = state_covariance[..., pairs[:, :, None], pairs[:, None, :]]
    rotated = rotation @ blocks @ np.swapaxes(rotation, -1, -2)
    # Symmetrised: rounding leaves the off-diagonal elements unequal.
    return np.asarray((rotated + np.swapaxes(rotated, -1, -2)) / 2)


def _conditional_variance(covariance: FloatArray) -> FloatArray:
    """Return the variance (...) along a phasor given no error across it: s11 - s12² / s22 = 1 / (inverse)11."""
    across = np.maximum(covariance[..., 1, 1], np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(covariance[..., 0, 0] - covariance[..., 0, 1] ** 2 / across, 0.0))


def _polar_factors(along_phasor: FloatArray, phase_variance_rad2: FloatArray) -> FloatArray:
    """Return the factors that turn a covariance of errors along and across a phasor into one of amplitude and phase.

    All (..., frequency, 2, 2), multiplied element by element. The error along the phasor is the amplitude error. The
    error across it is multiplied by k rad/m, so that its variance becomes ``phase_variance_rad2`` (..., frequency).
    """
    across, tiny = along_phasor[..., 1, 1], np.finfo(np.float64).tiny
    radians_per_metre = np.sqrt(np.where(across > tiny, phase_variance_rad2, 0.0) / np.maximum(across, tiny))
    diagonal = np.stack([np.ones_like(radians_per_metre), radians_per_metre], axis=-1)
    return np.asarray(diagonal[..., :, None] * diagonal[..., None, :])
