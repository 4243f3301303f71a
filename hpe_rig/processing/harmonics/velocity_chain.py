"""Slow-time chain of the paper: velocity -> D = v/w -> band-pass -> Hann window -> Kalman filter -> times 2.

Each frequency is processed on its own. Every step is linear in the velocities, so the chain's response to a unit
sinusoid, a 2-by-2 matrix, gives the factor on amplitude and phase; its inverse removes that factor. For whole cycles
the factor is the mean of the Hann window, 1/2, and its inverse is the paper's "times 2"; for other lengths the inverse
is exact too.

The noise of the velocities is estimated from the spectrum of the residual displacement steps,

    S(f) = pulse variance (2 sin(pi f T_prf))² + interval variance

Source: sections II.A and III.B.2 of the paper. Derivation: docs/explanation/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.echo.conditioning import hann
from hpe_rig.processing.harmonics.harmonic_fit import FitQuality, HarmonicFit, fit_from_state
from hpe_rig.processing.harmonics.model import MAX_CONDITION, LinearModel, harmonic_columns, linear_model
from hpe_rig.processing.motion.displacement import Velocity

RATIOS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 49)])
"""Ratios of interval noise to pulse noise that are tried, both as variance of a displacement step."""
LIKELIHOOD_GAIN = 3.3
"""Smallest gain in log-likelihood that includes interval noise: 1 % false alarms (chi-square, 1 degree of freedom)."""
MIN_BINS = 12
"""Number of free bins below which no interval noise is estimated."""


def band_pass(series: FloatArray, rate_hz: float, low_hz: float, high_hz: float) -> FloatArray:
    """Return an evenly sampled series (..., sample) with its spectrum zeroed outside low_hz .. high_hz.

    The filter has no phase shift and equals its own transpose as a matrix. It is circular: near the ends it mixes the
    start and the end of the series.
    """
    spectrum = np.fft.rfft(series, axis=-1)
    frequency_hz = np.fft.rfftfreq(series.shape[-1], 1 / rate_hz)
    inside = (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    return np.fft.irfft(np.where(inside, spectrum, 0), series.shape[-1], axis=-1)


def velocity_to_harmonics(
    velocity: Velocity,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    with_band_pass: bool = True,
    with_hann: bool = True,
    background_order: int = 0,
) -> HarmonicFit:
    """Return amplitude and phase of the displacement from its velocity, frequency by frequency, by the paper's chain.

    The gain sinc(f / f_prf) of the difference, its half-interval delay and the 90 degrees between velocity and
    displacement are removed. ``also_hz``: further driven frequencies, kept out of the residual and the band-pass. The
    band-pass removes a background except for the difference between the ends of the series; from ``background_order``
    (of the displacement) 2 on, its polynomial is fitted and subtracted first. The covariance is the velocities' noise
    carried through all steps. Band-pass and Hann window in slow time can be left out. Raises ``ValueError`` for
    unevenly spaced pulses, and if the pulses or the band-pass cannot resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    interval_s = _even_interval_s(velocity)
    # The velocity of a polynomial has one order less.
    order = max(background_order - 1, 0)
    model = linear_model(velocity.time_s, velocity.valid, frequency_hz, background_order=order, also_hz=also_hz)
    every_hz = np.concatenate([frequency_hz, np.asarray(also_hz, dtype=np.float64)])
    background = slice(2 * frequency_hz.size, model.wanted_states.stop if order else 0)
    fill = _fill_columns(model, velocity.valid, background)
    window = hann(velocity.valid.size) if with_hann else np.ones(velocity.valid.size)
    # The chain is linear: its weights (state, interval) give the states and, below, their covariance.
    half_widths_hz = [_half_width_hz(every_hz, f) if with_band_pass else np.inf for f in frequency_hz]
    velocity_weights = np.concatenate(
        [
            _weights(velocity, f, half_width_hz, window, model, fill)
            for f, half_width_hz in zip(frequency_hz.tolist(), half_widths_hz, strict=True)
        ]
    )
    state = np.where(velocity.valid, velocity.velocity_m_per_s, 0.0) @ velocity_weights.T
    pulse_m2, interval_m2_per_s2, degrees = velocity_noise(velocity, model, every_hz, interval_s)
    # Covariance: the noise of each pulse's displacement and that of each interval's velocity, through these weights.
    pulse_weights = displacement_weights(velocity_weights, interval_s)
    covariance = pulse_m2[..., None, None] * (pulse_weights @ pulse_weights.T)
    covariance = covariance + interval_m2_per_s2[..., None, None] * (velocity_weights @ velocity_weights.T)
    pulses = int(np.count_nonzero(np.append(velocity.valid, False) | np.insert(velocity.valid, 0, False)))
    quality = FitQuality(
        residual_rms_m=np.sqrt(pulse_m2), degrees_of_freedom=degrees, pulses=pulses, condition=model.condition
    )
    return fit_from_state(frequency_hz, state, covariance, quality)


def _even_interval_s(velocity: Velocity) -> float:
    """Return the pulse interval, s; raise ``ValueError`` if intervals differ by more than 0.1 %."""
    interval_s = float(np.mean(velocity.interval_s))
    spread_s = float(np.ptp(velocity.interval_s))
    if spread_s > 1e-3 * interval_s:
        raise ValueError(
            f"pulse intervals differ by {spread_s:g} s around {interval_s:g} s: the band-pass needs an even rate; "
            "mark missing pulses as invalid instead of leaving them out, or use the estimator 'coherent'"
        )
    return interval_s


def _weights(
    velocity: Velocity, f: float, half_width_hz: float, window: FloatArray, model: LinearModel, fill: FloatArray
) -> FloatArray:
    """Return the weight (2, interval) of each velocity in in-phase and quadrature of the displacement at ``f`` (Hz).

    Chain: gaps filled, band-pass, ``window`` over slow time, Kalman filter with constant states and a diffuse prior,
    which is least squares. ``fill`` (interval, state): what is added to the velocities for each state of ``model``.
    ``half_width_hz``: half width of the band-pass, infinite without one.
    """
    valid, interval_s = velocity.valid, _even_interval_s(velocity)

    def band_passed(series: FloatArray) -> FloatArray:
        """Return ``series`` after the band-pass; unchanged without one."""
        if np.isinf(half_width_hz):
            return series
        return band_pass(series, 1 / interval_s, f - half_width_hz, f + half_width_hz)

    # Response of the chain to a unit sinusoid, 2 by 2; its inverse removes gain, delay and the Hann window's mean.
    columns = harmonic_columns(velocity.time_s, np.array([f]))
    solver = np.linalg.pinv(columns[valid])
    response = solver @ (band_passed(columns.T) * window)[:, valid].T
    if not np.linalg.cond(response) < MAX_CONDITION:
        raise ValueError(
            f"the band-pass of {f:g} Hz, +-{half_width_hz:g} Hz, passes no line of {valid.size * interval_s:.3g} s: "
            f"try a window of at least {1 / half_width_hz:.3g} s, or the estimator 'coherent'"
        )
    # From (in-phase, quadrature) of v/w to those of D: -90 degrees, over the gain of the difference.
    to_displacement = np.array([[0.0, 1.0], [-1.0, 0.0]]) / np.sinc(f * interval_s)
    correction = to_displacement @ np.linalg.inv(response) / (2 * np.pi * f)
    # Weights of the filled velocities: solver, window and band-pass in reverse order. The band-pass is a symmetric
    # matrix.
    weights = np.zeros((2, valid.size))
    weights[:, valid] = correction @ solver * window[valid]
    weights = band_passed(weights)
    # The values added to fill gaps are linear in the valid velocities: fill times their least-squares states.
    weights[:, valid] += weights @ fill @ model.root @ model.root.T @ model.matrix.T
    weights[:, ~valid] = 0.0
    return weights


def _half_width_hz(every_hz: FloatArray, f: float) -> float:
    """Return half the distance from ``f`` to the nearest other frequency, zero included."""
    distance_hz = np.abs(np.append(every_hz, 0.0) - f)
    return float(np.min(distance_hz[distance_hz > 1e-9 * f])) / 2


def _fill_columns(model: LinearModel, valid: BoolArray, background: slice) -> FloatArray:
    """Return the matrix (interval, state) that fills gaps in velocities and removes their background.

    The band-pass needs a value at every interval; one that follows the motion does not disturb its neighbours. Times
    the fitted states of ``model`` the matrix gives the values to be added to the velocities: at missing ones the fitted
    motion without ``background`` (slice of its columns), at ``valid`` ones (interval,) minus the fitted background.
    """
    columns = np.where(valid[:, None], 0.0, model.every_pulse)
    columns[:, background] = np.where(valid[:, None], -model.every_pulse[:, background], 0.0)
    return columns


def velocity_noise(
    velocity: Velocity, model: LinearModel, frequency_hz: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return two noise variances of the velocities (...), and the degrees of freedom of the first.

    1. Displacement noise of a pulse, m²: it enters the velocities before and after the pulse with opposite sign, and
       cancels in their sum. Echo noise is of this kind.
    2. Velocity noise of an interval, (m/s)²: it does not cancel in the next interval. It arises if the peak of the
       cross-spectrum jumps between two of equal height, and is 0 unless it is significant.

    Both come from the residual of ``model``, the second from its spectrum outside ``frequency_hz`` (Whittle
    likelihood). Degrees of freedom: expected energy of the residual's displacement steps for pulse noise of unit
    variance, over 3 (Satterthwaite, below).
    """
    residual = np.zeros(velocity.velocity_m_per_s.shape)
    residual[..., velocity.valid] = model.solve(velocity.velocity_m_per_s[..., velocity.valid])[1]
    # Orthonormal columns of the model as weights of the velocities, and of the pulses' displacements.
    columns = model.matrix @ model.root
    velocity_weights = np.zeros((columns.shape[1], velocity.valid.size))
    velocity_weights[:, velocity.valid] = columns.T
    pulse_weights = displacement_weights(velocity_weights, interval_s)
    # Expected energy of the residual for pulse noise of unit variance: two pulses in each velocity, minus the part that
    # the columns absorb.
    expected = 2 * len(columns) / interval_s**2 - np.sum(pulse_weights**2)
    # (tr A)² / tr A² (Satterthwaite, 1946) of the steps' covariance A, 2 on its diagonal and -1 beside it: tr A / 3.
    degrees = float(expected * interval_s**2 / 3)
    pulse_only_m2 = np.sum(residual**2, axis=-1) / expected
    power, expected_power = _residual_spectrum(residual * interval_s, velocity, frequency_hz, interval_s)
    if expected_power.size < MIN_BINS:
        return pulse_only_m2, np.zeros_like(pulse_only_m2), degrees
    pulse_m2, ratio = _most_likely(power, expected_power)
    return np.where(ratio > 0, pulse_m2, pulse_only_m2), ratio * pulse_m2 / interval_s**2, degrees


def displacement_weights(velocity_weights: FloatArray, interval_s: float) -> FloatArray:
    """Return the weights (row, pulse) of displacements in a sum of velocities with weights (row, interval).

    Each velocity is the difference of two consecutive displacements over the interval.
    """
    weights = np.zeros((velocity_weights.shape[0], velocity_weights.shape[1] + 1))
    weights[:, 1:] += velocity_weights / interval_s
    weights[:, :-1] -= velocity_weights / interval_s
    return weights


def _residual_spectrum(
    step: FloatArray, velocity: Velocity, frequency_hz: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the periodogram (..., bin) of a fit's residual, and its expectation for pulse noise of unit variance.

    ``step`` (..., interval): residual of the displacement's change over each interval; 0 at invalid ones. Bins near
    ``frequency_hz`` are left out: the fit has emptied them.
    """
    count, used = step.shape[-1], int(velocity.valid.sum())
    grid_hz = np.fft.rfftfreq(count, interval_s)
    distance_hz = np.abs(grid_hz[:, None] - frequency_hz).min(axis=1)
    # Bins more than one from the fitted frequencies and from zero.
    free = (distance_hz * count * interval_s > 1) & (grid_hz > 0) & (grid_hz < 0.5 / interval_s)
    power = np.abs(np.fft.rfft(step, axis=-1)[..., free]) ** 2 / used
    # A pulse at the edge of a gap or of the train is in one interval only: its noise is not differenced.
    differenced = int(np.count_nonzero(velocity.valid[:-1] & velocity.valid[1:]))
    undifferenced = 2 * (used - differenced)
    expected_power = (differenced * (2 * np.sin(np.pi * grid_hz[free] * interval_s)) ** 2 + undifferenced) / used
    return power, expected_power


def _most_likely(power: FloatArray, expected_power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variance (...) of the pulse noise, and the ratio (...) of interval noise to it, from a periodogram.

    ``power`` (..., bin): periodogram of the displacement steps. ``expected_power`` (bin,): its expectation for pulse
    noise of unit variance. Noise of the intervals, white in the steps, adds its ratio to every bin. The result is the
    ratio of largest likelihood in ``RATIOS``, or 0 if it is not significant.
    """
    # For each ratio the expectation (ratio, bin), and the most likely variance: the mean of power over expectation.
    expectations = expected_power + RATIOS[:, None]
    variance = np.maximum((power @ (1 / expectations).T) / expected_power.size, np.finfo(np.float64).tiny)
    log_likelihood = -np.log(expectations).sum(axis=1) - expected_power.size * np.log(variance)
    best = np.argmax(log_likelihood, axis=-1)
    gain = np.take_along_axis(log_likelihood, best[..., None], axis=-1)[..., 0] - log_likelihood[..., 0]
    best = np.where(gain > LIKELIHOOD_GAIN, best, 0)
    return np.take_along_axis(variance, best[..., None], axis=-1)[..., 0], RATIOS[best]
