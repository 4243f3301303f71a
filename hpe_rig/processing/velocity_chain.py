"""The paper's slow-time chain: velocity -> D = v/w -> band-pass -> Hann -> Kalman filter -> times 2, per frequency.

Every step is linear in the velocities, so the same chain applied to a unit sinusoid gives the factor by which it
scales amplitude and turns phase. For whole cycles that factor is the Hann window's mean, 1/2, and dividing by it is the
paper's "times 2"; for any other length it is still exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.conditioning import hann
from hpe_rig.processing.harmonic import HarmonicFit, design, filter_states, fit_from_state, harmonic_columns
from hpe_rig.processing.motion import Velocity
from hpe_rig.processing.velocity_noise import per_pulse, velocity_noise

FloatArray = NDArray[np.float64]

PRIOR = 1e10
"""Prior variance over measurement variance of the Kalman filter: nothing known."""


def band_pass(series: FloatArray, rate_hz: float, low_hz: float, high_hz: float) -> FloatArray:
    """Return an evenly sampled series (..., sample) with its spectrum zeroed outside low_hz .. high_hz.

    Without phase shift, and its own transpose as a matrix; near both ends it mixes start and end of the series.
    """
    spectrum = np.fft.rfft(series, axis=-1)
    frequency_hz = np.fft.rfftfreq(series.shape[-1], 1 / rate_hz)
    inside = (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    return np.fft.irfft(np.where(inside, spectrum, 0), series.shape[-1], axis=-1)


def velocity_to_harmonics(
    velocity: Velocity, frequencies_hz: FloatArray | list[float], *, largest_condition: float = 100.0
) -> HarmonicFit:
    """Return amplitude and phase of the displacement from its velocity, frequency by frequency.

    The gain sinc(f / f_prf) of the difference, its half-interval delay and the 90 degrees between velocity and
    displacement are removed. The covariance carries the noise that ``velocity_noise`` finds through every step. Raises
    ``ValueError`` for unevenly spaced pulses and as ``least_squares`` does. Source: paper Sec. II.A and III.B.2.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    interval_s = _even_interval_s(velocity)
    everything = design(velocity.time_s, velocity.valid, frequency_hz, largest_condition)
    fill = _fill_matrix(velocity, frequency_hz, everything)
    each = [_one_frequency(velocity, frequency_hz, index, fill, interval_s) for index in range(frequency_hz.size)]
    states, functionals = zip(*each, strict=True)
    pulse_variance, interval_variance = velocity_noise(velocity, everything, frequency_hz, interval_s)
    over_intervals = np.concatenate(functionals)
    over_pulses = per_pulse(over_intervals, interval_s)
    covariance = pulse_variance[..., None, None] * (over_pulses @ over_pulses.T)
    covariance = covariance + interval_variance[..., None, None] * (over_intervals @ over_intervals.T)
    used = int(np.count_nonzero(np.append(velocity.valid, False) | np.insert(velocity.valid, 0, False)))
    return fit_from_state(frequency_hz, np.concatenate(states, axis=-1), covariance, pulse_variance, used)


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
    velocity: Velocity, frequency_hz: FloatArray, index: int, fill: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the state (..., 2) of one frequency and the rows (2, interval) that give it from the velocities."""
    f, valid = frequency_hz[index], velocity.valid
    half_width_hz = _half_width_hz(frequency_hz, index)
    window = hann(valid.size)

    def passed(series: FloatArray) -> FloatArray:
        return band_pass(series, 1 / interval_s, f - half_width_hz, f + half_width_hz)

    columns = harmonic_columns(velocity.time_s, frequency_hz[index : index + 1])
    solver = np.linalg.pinv(columns[valid])
    response = solver @ (passed(columns.T) * window)[:, valid].T
    correction = _velocity_turn(f, interval_s) @ np.linalg.inv(response) / (2 * np.pi * f)
    windowed = (passed(_filled(velocity.velocity_m_per_s, valid, fill)) * window)[..., valid]
    state = filter_states(columns[valid], windowed, np.zeros(int(valid.sum())), PRIOR)[0] @ correction.T
    rows = np.zeros((2, valid.size))
    rows[:, valid] = correction @ solver * window[valid]
    # the band-pass is its own transpose, so it carries the rows back to the velocities before it
    back = passed(rows)
    back[:, valid] += back[:, ~valid] @ fill
    back[:, ~valid] = 0.0
    return state, back


def _half_width_hz(frequency_hz: FloatArray, index: int) -> float:
    """Return half the distance to the nearest other frequency, zero included."""
    others = np.append(np.delete(frequency_hz, index), 0.0)
    return float(np.min(np.abs(others - frequency_hz[index]))) / 2


def _velocity_turn(f: float, interval_s: float) -> FloatArray:
    """Return what takes (in-phase, quadrature) of v/w back to those of D: 90 degrees less, the difference gain off."""
    return np.array([[0.0, 1.0], [-1.0, 0.0]]) / np.sinc(f * interval_s)


def _fill_matrix(velocity: Velocity, frequency_hz: FloatArray, everything: FloatArray) -> FloatArray:
    """Return the matrix (missing, valid) that predicts missing velocities from a fit to all the others.

    The band-pass needs a value everywhere; one that follows the wanted motion does not disturb its neighbours.
    """
    missing = ~velocity.valid
    if not missing.any():
        return np.zeros((0, int(velocity.valid.sum())))
    columns = harmonic_columns(velocity.time_s, frequency_hz)[missing]
    return np.asarray(np.hstack([columns, np.ones((len(columns), 1))]) @ np.linalg.pinv(everything))


def _filled(values: FloatArray, valid: NDArray[np.bool_], fill: FloatArray) -> FloatArray:
    filled: FloatArray = values.copy()
    filled[..., ~valid] = values[..., valid] @ fill.T
    return filled
