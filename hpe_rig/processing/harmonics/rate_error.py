"""Rate error e: relative error of the motion's frequencies as timed by the pulses' clock, fitted to a displacement.

    d_k = D(t_k (1 + e)) + noise        D: motion at the nominal frequencies
    e ~ N(mean, std^2)                  from the accuracies of the clocks

All frequencies come from one clock and share e. Gauss-Newton step from the present e, with g = t dD/dt and S the
covariance of the data for this e (noise and prior of D):

    step = (g' S^-1 d + (mean - e) / std^2) u^2,    1 / u^2 = g' S^-1 g + 1 / std^2
    S^-1 = (1 - Q h Q') / sigma^2

Q is an orthonormal basis of the model and h its shrinkage, 1 for least squares. Where the error may shift a phase by
more than ``MAX_TURNS`` over the train, a scan of e comes first: the power of the fit as a function of e.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.medium_fit import driven_phasors_m, medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import background_columns, harmonic_columns, linear_model
from hpe_rig.processing.motion.displacement import Motion

SIGNIFICANT: Final = 3.0
"""Smallest significant error of a rate, in standard uncertainties."""
MAX_TURNS: Final = 0.2
"""Shift of the highest frequency's phase over the train, in turns, up to which Gauss-Newton converges from the mean."""
SCANNED_STDS: Final = 4.0
"""Half width of the scan of e, in standard deviations of its prior."""
SCAN_STEP_TURNS: Final = 0.1
"""Step of the scan, as shift of the highest frequency's phase over the train, in turns."""
SEGMENT_TURNS: Final = 0.05
"""Largest shift of the highest frequency's phase within a segment of the train, in turns."""
MIN_LOG_GAIN: Final = 3.0
"""Gain in log-likelihood, beyond the logarithm of the number of scanned values, that makes a maximum significant."""
MAX_STEPS: Final = 10
"""Largest number of Gauss-Newton steps; two or three are usual."""
CONVERGED: Final = 0.05
"""Step, in standard uncertainties, below which the iteration ends."""
MIN_INFORMATION: Final = 0.1
"""Information of the data on e over that of its prior, below which the prior is the result."""


@dataclass(frozen=True, slots=True)
class RateError:
    """Relative error of the motion's frequencies by the clock of the pulses, and its standard uncertainty.

    ``degrees_of_freedom``: of the uncertainty, infinite if it is that of the clocks. ``clock_fraction``: part of the
    variance that comes from the clocks and not from the noise of the displacement.
    """

    value: float = 0.0
    uncertainty: float = 0.0
    degrees_of_freedom: float = math.inf
    clock_fraction: float = 1.0


@dataclass(frozen=True, slots=True)
class FitWithVelocity:
    """Harmonic fit of a motion, with the velocity of the fitted displacement; all at the valid pulses.

    A small rate error e changes the fitted displacement D by e t dD/dt, to first order.

    ``basis`` Q (pulse, column): orthonormal columns of the fit. ``shrinkage`` h (column,): fitted component along each
    column over that of the data, from 0 to 1; 1 for least squares, less with a prior. ``residual_m`` (pulse,):
    displacement minus D. ``velocity_m_per_s`` (pulse,): dD/dt. ``noise_m2``: variance of the displacement of a pulse,
    with ``degrees_of_freedom``.
    """

    basis: FloatArray
    shrinkage: FloatArray
    residual_m: FloatArray
    velocity_m_per_s: FloatArray
    noise_m2: float
    degrees_of_freedom: float


def with_rate_error(motion: Motion, error: float) -> Motion:
    """Return ``motion`` with its times on the clock of the motion's frequencies, which is fast by ``error``."""
    return replace(motion, time_s=motion.time_s * (1 + error)) if error else motion


def estimate_rate_error(
    motion: Motion,
    frequencies_hz: FloatArray,
    prior_error: RateError,
    *,
    also_hz: FloatArray,
    background_order: int = 0,
    prior: MediumPrior | None = None,
) -> RateError:
    """Return the rate error from the displacement (pulse,) of one train, with its uncertainty.

    It is the relative error of the motion's frequencies as timed by the pulses' clock. ``prior_error``: its value and
    uncertainty without the displacement; an uncertainty of zero is final. The displacement is fitted with the ``prior``
    of media, or by least squares with the further frequencies ``also_hz``. Raises ``ValueError`` as the fit does.
    """
    if not prior_error.uncertainty:
        return prior_error

    def least_squares(corrected: Motion) -> FitWithVelocity:
        """Return the least-squares fit of the motion with times corrected by a trial rate error.

        With a prior of media this fit is only a start, and contains the wanted harmonics alone.
        """
        return _least_squares(corrected, frequencies_hz, also_hz if prior is None else np.zeros(0), background_order)

    def fit(corrected: Motion) -> FitWithVelocity:
        """Return the fit of the motion with times corrected by a trial rate error, with the prior of media if any."""
        if prior is None:
            return least_squares(corrected)
        return _with_medium_prior(corrected, frequencies_hz, prior, background_order)

    start = _initial_error(motion, frequencies_hz, prior_error, background_order)
    if prior is not None:
        # Least squares is far faster, and close enough to save iterations with the prior.
        start = _most_probable_rate_error(motion, least_squares, prior_error, start).value
    error = _most_probable_rate_error(motion, fit, prior_error, start)
    deviation = abs(error.value - prior_error.value)
    if deviation > SIGNIFICANT * prior_error.uncertainty:
        # The stated accuracies of the clocks are wrong. With a prior as wide as the deviation, the mean of the prior
        # hardly attracts the estimate.
        error = _most_probable_rate_error(motion, fit, RateError(prior_error.value, deviation), error.value)
    return error


def _most_probable_rate_error(
    motion: Motion, fit: Callable[[Motion], FitWithVelocity], prior_error: RateError, start: float
) -> RateError:
    """Return the most probable rate error, by Gauss-Newton steps from ``start``, with its standard uncertainty.

    ``fit``: harmonic fit of a motion. ``prior_error``: normal prior of the rate error, from the clocks. It is the
    result if the displacement adds hardly any information at its mean.
    """
    error, prior_information = start, prior_error.uncertainty**-2
    for _ in range(MAX_STEPS):
        fitted = fit(with_rate_error(motion, error))
        # Derivative of the displacement by the rate error, and its part that the harmonics of the fit cannot imitate.
        slope_m = motion.time_s[motion.valid] * fitted.velocity_m_per_s
        unabsorbed_m = slope_m - fitted.basis @ (fitted.shrinkage * (slope_m @ fitted.basis))
        noise_m2 = max(fitted.noise_m2, np.finfo(np.float64).tiny)
        information = max(float(unabsorbed_m @ slope_m), 0.0) / noise_m2
        if error == prior_error.value and information < MIN_INFORMATION * prior_information:
            return prior_error
        uncertainty = (information + prior_information) ** -0.5
        gradient = float(slope_m @ fitted.residual_m) / noise_m2 + prior_information * (prior_error.value - error)
        # A last step that is far below the uncertainty is left out: the fit then has the times of this iteration.
        if abs(gradient * uncertainty) < CONVERGED:
            break
        error += gradient * uncertainty**2
    # The clocks contribute a fraction of the variance that counts as exactly known. The other fraction, from the noise,
    # has the degrees of freedom of the residual. The sum has these over the square of that fraction
    # (Welch-Satterthwaite).
    clock_fraction = prior_information * uncertainty**2
    noise_fraction = max(1 - clock_fraction, 1e-6)
    degrees = fitted.degrees_of_freedom / noise_fraction**2
    return RateError(error, uncertainty, degrees, clock_fraction)


def _least_squares(
    motion: Motion, frequency_hz: FloatArray, also_hz: FloatArray, background_order: int
) -> FitWithVelocity:
    """Return the least-squares fit of ``motion``, and the velocity of the fitted displacement.

    The fit has sinusoids of ``frequency_hz`` and ``also_hz``, and a polynomial of ``background_order``.
    """
    model = linear_model(motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz)
    state, residual_m = model.solve(motion.displacement_m[motion.valid])
    degrees = len(model.matrix) - state.size
    return FitWithVelocity(
        basis=model.matrix @ model.root,
        shrinkage=np.ones(state.size),
        residual_m=residual_m,
        velocity_m_per_s=model.velocity(state),
        noise_m2=float(residual_m @ residual_m) / degrees,
        degrees_of_freedom=degrees,
    )


def _with_medium_prior(
    motion: Motion, frequency_hz: FloatArray, prior: MediumPrior, background_order: int
) -> FitWithVelocity:
    """Return the fit of ``motion`` with a prior of media, and the velocity of the fitted displacement.

    ``prior``: how an ensemble of media would move under the tonebursts, at all their harmonics. ``frequency_hz``: the
    wanted harmonics, which may deviate from every combination of these motions.
    """
    medium = medium_fit(motion, frequency_hz, prior, background_order=background_order)
    # Orthonormal columns (pulse, column): background polynomials, and patterns, which combine to the prior's motions.
    background, patterns = medium.projected.background, medium.projected.patterns
    # Phasors of all harmonics as combinations of the prior's motions. Those of the wanted harmonics are replaced by the
    # fitted ones, which include their deviations.
    _, phasors_m = driven_phasors_m(prior, medium)
    phasors_m[list(prior.harmonic_indices(frequency_hz))] = medium.fit.amplitude_m * np.exp(1j * medium.fit.phase_rad)
    return FitWithVelocity(
        basis=np.hstack([background, patterns]),
        # The prior shrinks the coefficients of the patterns, and leaves the background free.
        shrinkage=np.concatenate([np.ones(background.shape[1]), medium.shrinkage]),
        residual_m=medium.residual_m(motion),
        velocity_m_per_s=prior.velocity_m_per_s(motion.time_s[motion.valid], phasors_m),
        noise_m2=float(medium.evidence.total_noise_m2),
        degrees_of_freedom=float(medium.evidence.degrees_of_freedom),
    )


def _initial_error(motion: Motion, frequency_hz: FloatArray, prior_error: RateError, background_order: int) -> float:
    """Return a start value of the rate error from where the Gauss-Newton iteration converges.

    It is the mean of ``prior_error``, the rate error's prior. If the prior is so wide that the iteration might not
    converge from there, rate errors are scanned, and a significant maximum of the posterior is the start.
    """
    mean, std = prior_error.value, prior_error.uncertainty
    time_s, data_m = motion.time_s[motion.valid], motion.displacement_m[motion.valid]
    # Cycles of the highest frequency over the train; a rate error e shifts its phase by e times as many turns.
    turns = float(frequency_hz.max() * (time_s[-1] - time_s[0]))
    if turns * std < MAX_TURNS:
        return mean
    basis = np.linalg.qr(background_columns(time_s, background_order))[0]
    data_m = data_m - basis @ (basis.T @ data_m)
    scanned_errors = mean + np.arange(-SCANNED_STDS * std, SCANNED_STDS * std, SCAN_STEP_TURNS / turns)
    explained_m2 = _explained_energy_m2(time_s, data_m, frequency_hz, scanned_errors)
    # Likelihood with the best noise variance for each scanned error, times the prior.
    unexplained_m2 = np.maximum(data_m @ data_m - explained_m2, np.finfo(np.float64).tiny)
    log_posterior = -data_m.size / 2 * np.log(unexplained_m2) - ((scanned_errors - mean) / std) ** 2 / 2
    best, at_mean = int(np.argmax(log_posterior)), int(np.argmin(np.abs(scanned_errors - mean)))
    # The more values are scanned, the higher is the largest by chance: their number raises the threshold.
    min_gain = MIN_LOG_GAIN + math.log(scanned_errors.size)
    is_significant = log_posterior[best] - log_posterior[at_mean] > min_gain
    return float(scanned_errors[best]) if is_significant else mean


def _explained_energy_m2(
    time_s: FloatArray, data_m: FloatArray, frequency_hz: FloatArray, errors: FloatArray
) -> FloatArray:
    """Return the energy (error,) of ``data_m`` (pulse,) that sinusoids explain, for each rate error of ``errors``, m².

    The sinusoids have the frequencies ``frequency_hz`` times 1 + error. The train is divided into segments so short
    that the error hardly changes a phasor within one: phasors of segments are computed once, and added for each error.
    """
    segment_s = SEGMENT_TURNS / (float(frequency_hz.max()) * float(np.abs(errors).max()))
    segment = np.floor((time_s - time_s[0]) / segment_s).astype(np.int64)
    count = np.bincount(segment)
    centre_s = np.bincount(segment, time_s)[count > 0] / count[count > 0]
    # Sum of d exp(-jwt) over each segment, (frequency, segment), from the sums of d sin(wt) and d cos(wt).
    columns = harmonic_columns(time_s, frequency_hz) * data_m[:, None]
    sums_m = np.stack([np.bincount(segment, column)[count > 0] for column in columns.T])
    phasors_m = sums_m[1::2] - 1j * sums_m[::2]
    # Phase at each segment's centre; a rate error changes it by that factor.
    angle_rad = 2 * np.pi * frequency_hz[:, None] * centre_s
    energy = [np.sum(np.abs(np.sum(phasors_m * np.exp(-1j * error * angle_rad), axis=1)) ** 2) for error in errors]
    return 2 / data_m.size * np.array(energy)
