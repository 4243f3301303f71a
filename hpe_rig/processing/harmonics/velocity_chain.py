"""Slow-time chain of the paper: velocity -> D = v/w -> band-pass -> Hann -> Kalman filter -> times 2, per frequency.

Every step is linear in the velocities, so the same chain applied to a unit sinusoid gives the factor by which it
scales amplitude and turns phase. For whole cycles that factor is the Hann window's mean, 1/2, and dividing by it is the
paper's "times 2"; for any other length it is still exact. docs/explanation/estimation.md.

What noise velocities have is told from the spectrum of what a fit leaves of the displacement steps: pulse noise
(2 sin(pi f T_prf))^2 + interval noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.echo.conditioning import hann
from hpe_rig.processing.echo.echoes import Velocity
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, fit_from_state
from hpe_rig.processing.harmonics.kalman_filter import PRIOR, filter_constant
from hpe_rig.processing.harmonics.model import LARGEST_CONDITION, LinearModel, harmonic_columns, linear_model


@dataclass(frozen=True, slots=True)
class Steps:
    """Which of the chain's optional steps are taken: the software band-pass and the Hann window in slow time."""

    band_pass: bool = True
    hann: bool = True


PAPER = Steps()

RATIOS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 49)])
"""Interval over pulse noise, both as variance of a displacement step, that are tried."""
LIKELIHOOD_GAIN = 3.3
"""Gain in log-likelihood that interval noise must bring: 1 % false alarms (chi-square, one degree of freedom)."""
LEAST_BINS = 12


def band_pass(series: FloatArray, rate_hz: float, low_hz: float, high_hz: float) -> FloatArray:
    """Return an evenly sampled series (..., sample) with its spectrum zeroed outside low_hz .. high_hz.

    Without phase shift, and its own transpose as a matrix; near both ends it mixes start and end of the series.
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
    steps: Steps = PAPER,
    largest_condition: float = LARGEST_CONDITION,
    background_order: int = 0,
) -> HarmonicFit:
    """Return amplitude and phase of the displacement from its velocity, frequency by frequency.

    The gain sinc(f / f_prf) of the difference, its half-interval delay and the 90 degrees between velocity and
    displacement are removed. ``also_hz`` are there and not wanted: no residual, and outside the band-pass. The
    covariance carries the noise that ``velocity_noise`` finds through every step taken. The band-pass takes off a
    background, but for what its two ends differ by; from a ``background_order`` of the displacement of 2 on, its
    polynomial is fitted and taken off before. Raises ``ValueError`` for unevenly spaced pulses and as ``least_squares``
    does. Source: paper Sec. II.A and III.B.2.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    interval_s = _even_interval_s(velocity)
    # The velocity of a polynomial is one of an order less.
    order = max(background_order - 1, 0)
    times = velocity.time_s, velocity.valid, frequency_hz
    model = linear_model(*times, largest_condition, background_order=order, also_hz=also_hz)
    every_hz = np.concatenate([frequency_hz, np.asarray(also_hz, dtype=np.float64)])
    fitted = _fitted_columns(model, velocity.valid, slice(2 * frequency_hz.size, model.wanted.stop if order else 0))
    filled = _filled(velocity, model, fitted)
    each = [
        _one_frequency(velocity, filled, f, _half_width_hz(every_hz, f), model, fitted, steps) for f in frequency_hz
    ]
    states, functionals = zip(*each, strict=True)
    pulse_variance, interval_variance, freedom = velocity_noise(velocity, model, every_hz, interval_s)
    over_intervals = np.concatenate(functionals)
    over_pulses = per_pulse(over_intervals, interval_s)
    covariance = pulse_variance[..., None, None] * (over_pulses @ over_pulses.T)
    covariance = covariance + interval_variance[..., None, None] * (over_intervals @ over_intervals.T)
    used = int(np.count_nonzero(np.append(velocity.valid, False) | np.insert(velocity.valid, 0, False)))
    state = np.concatenate(states, axis=-1)
    return fit_from_state(frequency_hz, state, covariance, pulse_variance, used, model.condition, freedom=freedom)


def _even_interval_s(velocity: Velocity) -> float:
    interval_s = float(np.mean(velocity.interval_s))
    spread_s = float(np.ptp(velocity.interval_s))
    if spread_s > 1e-3 * interval_s:
        raise ValueError(
            f"pulse intervals differ by {spread_s:g} s around {interval_s:g} s: the band-pass needs an even rate; "
            "mark missing pulses as invalid instead of leaving them out, or use the estimator 'coherent'"
        )
    return interval_s


def _one_frequency(
    velocity: Velocity,
    filled: FloatArray,
    f: float,
    half_width_hz: float,
    model: LinearModel,
    fitted: FloatArray,
    steps: Steps,
) -> tuple[FloatArray, FloatArray]:
    """Return the state (..., 2) of one frequency and the rows (2, interval) that give it from the velocities."""
    valid, interval_s = velocity.valid, _even_interval_s(velocity)
    window = hann(valid.size) if steps.hann else np.ones(valid.size)

    def passed(series: FloatArray) -> FloatArray:
        if not steps.band_pass:
            return series
        return band_pass(series, 1 / interval_s, f - half_width_hz, f + half_width_hz)

    # What the chain makes of a unit sinusoid, 2 by 2; its inverse undoes gain, delay and the Hann window's mean.
    columns = harmonic_columns(velocity.time_s, np.array([f]))
    solver = np.linalg.pinv(columns[valid])
    response = solver @ (passed(columns.T) * window)[:, valid].T
    correction = _velocity_turn(f, interval_s) @ np.linalg.inv(response) / (2 * np.pi * f)
    windowed = (passed(filled) * window)[..., valid]
    state = filter_constant(columns[valid], windowed, PRIOR).state @ correction.T
    rows = np.zeros((2, valid.size))
    rows[:, valid] = correction @ solver * window[valid]
    # the band-pass is its own transpose, so it carries the rows back to the velocities before it
    back = passed(rows)
    back[:, valid] += back @ fitted @ model.root @ model.root.T @ model.matrix.T
    back[:, ~valid] = 0.0
    return state, back


def _half_width_hz(every_hz: FloatArray, f: float) -> float:
    """Return half the distance to the nearest other frequency, zero included."""
    distance_hz = np.abs(np.append(every_hz, 0.0) - f)
    return float(np.min(distance_hz[distance_hz > 1e-9 * f])) / 2


def _velocity_turn(f: float, interval_s: float) -> FloatArray:
    """Return what takes (in-phase, quadrature) of v/w back to those of D: 90 degrees less, the difference gain off."""
    return np.array([[0.0, 1.0], [-1.0, 0.0]]) / np.sinc(f * interval_s)


def _fitted_columns(model: LinearModel, valid: BoolArray, background: slice) -> FloatArray:
    """Return what of ``model`` is added to the velocities before the band-pass (interval, state).

    Where one is missing all but the ``background``, less the background elsewhere.
    """
    columns = np.where(valid[:, None], 0.0, model.every_pulse)
    columns[:, background] = np.where(valid[:, None], -model.every_pulse[:, background], 0.0)
    return columns


def _filled(velocity: Velocity, model: LinearModel, fitted: FloatArray) -> FloatArray:
    """Return the velocities (..., interval) less their background, missing ones predicted from a fit to all the others.

    The band-pass needs a value everywhere; one that follows the motion does not disturb its neighbours.
    """
    if not fitted.any():
        return velocity.velocity_m_per_s
    known = np.where(velocity.valid, velocity.velocity_m_per_s, 0.0)
    return known + model.solve(velocity.velocity_m_per_s[..., velocity.valid])[0] @ fitted.T


def velocity_noise(
    velocity: Velocity, model: LinearModel, frequency_hz: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the variances (...) of one pulse's displacement (m^2) and of one interval's velocity ((m/s)^2).

    And the degrees of freedom of the residual that tells the first, (tr A)^2 / tr A^2 of its covariance A
    (Satterthwaite, 1946).
    Noise of the echoes is white over pulses, so neighbouring velocities share it with opposite sign. Where the peak of
    the cross-spectrum jumps between two of equal height the velocities carry noise that does not cancel in
    the next interval; it is looked for in the spectrum of the residual from ``model`` outside ``frequency_hz``
    (Whittle likelihood) and 0 unless it stands out.
    """
    # Pulse noise alone: the residual of white noise, differenced, is smaller by what the fit has taken up of it. Its
    # expected energy is the trace over the columns' complement, from the orthonormal columns q.
    q = model.matrix @ model.root
    residual = np.zeros(velocity.velocity_m_per_s.shape)
    residual[..., velocity.valid] = model.solve(velocity.velocity_m_per_s[..., velocity.valid])[1]
    spread = np.zeros((q.shape[1], velocity.valid.size))
    spread[:, velocity.valid] = q.T
    over_pulses = per_pulse(spread, interval_s)
    expected = 2 * len(q) / interval_s**2 - np.sum(over_pulses**2)
    freedom = float(expected**2 / _square_trace(q, over_pulses, velocity.valid, interval_s))
    alone = np.sum(residual**2, axis=-1) / expected
    power, shape = _residual_spectrum(residual * interval_s, velocity, frequency_hz, interval_s)
    if shape.size < LEAST_BINS:
        return alone, np.zeros_like(alone), freedom
    pulse, ratio = _most_likely(power, shape)
    return np.where(ratio > 0, pulse, alone), ratio * pulse / interval_s**2, freedom


def _square_trace(q: FloatArray, over_pulses: FloatArray, valid: BoolArray, interval_s: float) -> float:
    """Return tr (M K M K): K the covariance of velocities of unit pulse noise, M = 1 - q q' what a fit of q leaves.

    ``over_pulses`` (state, pulse): the columns of q (valid interval, state) as rows over pulses.
    """
    covered = np.diff(over_pulses)[:, valid] / interval_s
    whole = (4 * len(q) + 2 * np.count_nonzero(valid[:-1] & valid[1:])) / interval_s**4
    left = whole - 2 * np.sum(covered**2) + np.sum((covered @ q) ** 2)
    return max(float(left), np.finfo(np.float64).tiny)


def per_pulse(functional: FloatArray, interval_s: float) -> FloatArray:
    """Return rows (row, pulse) over pulse displacements from rows (row, interval) over velocities."""
    rows = np.zeros((functional.shape[0], functional.shape[1] + 1))
    rows[:, 1:] += functional / interval_s
    rows[:, :-1] -= functional / interval_s
    return rows


def _residual_spectrum(
    step: FloatArray, velocity: Velocity, frequency_hz: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the periodogram (..., bin) of displacement steps and that expected (bin,) of unit pulse noise."""
    count, used = step.shape[-1], int(velocity.valid.sum())
    grid_hz = np.fft.rfftfreq(count, interval_s)
    distance_hz = np.abs(grid_hz[:, None] - frequency_hz).min(axis=1)
    # the fit has emptied the bins next to the wanted frequencies and at zero
    free = (distance_hz * count * interval_s > 1) & (grid_hz > 0) & (grid_hz < 0.5 / interval_s)
    power = np.abs(np.fft.rfft(step, axis=-1)[..., free]) ** 2 / used
    # a pulse at the edge of a gap or of the train occurs in one interval only: its noise is not differenced
    differenced = int(np.count_nonzero(velocity.valid[:-1] & velocity.valid[1:]))
    alone = 2 * (used - differenced)
    shape = (differenced * (2 * np.sin(np.pi * grid_hz[free] * interval_s)) ** 2 + alone) / used
    return power, shape


def _most_likely(power: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pulse variance and interval-to-pulse ratio (...) by profile likelihood over ``RATIOS``."""
    # For a given ratio the best level has a closed form, the mean of power over shape: one dimension is left to search.
    shapes = shape + RATIOS[:, None]
    level = np.maximum((power @ (1 / shapes).T) / shape.size, np.finfo(np.float64).tiny)
    likelihood = -np.log(shapes).sum(axis=1) - shape.size * np.log(level)
    best = np.argmax(likelihood, axis=-1)
    gain = np.take_along_axis(likelihood, best[..., None], axis=-1)[..., 0] - likelihood[..., 0]
    best = np.where(gain > LIKELIHOOD_GAIN, best, 0)
    return np.take_along_axis(level, best[..., None], axis=-1)[..., 0], RATIOS[best]
