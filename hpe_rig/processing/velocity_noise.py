"""Noise of velocities: what the residual says about the noise of pulses and of intervals.

The spectrum of displacement steps is pulse noise (2 sin(pi f T_prf))^2 + interval noise; docs/theory/estimation.md.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.processing.echoes import FloatArray, Velocity
from hpe_rig.processing.model import LinearModel

RATIOS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 49)])
"""Interval over pulse noise, both as variance of a displacement step, that are tried."""
LIKELIHOOD_GAIN = 3.3
"""Gain in log-likelihood that interval noise must bring: 1 % false alarms (chi-square, one degree of freedom)."""
LEAST_BINS = 12


def velocity_noise(
    velocity: Velocity, model: LinearModel, frequency_hz: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the variances (...) of one pulse's displacement (m^2) and of one interval's velocity ((m/s)^2).

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
    expected = 2 * len(q) / interval_s**2 - np.sum(per_pulse(spread, interval_s) ** 2)
    alone = np.sum(residual**2, axis=-1) / expected
    power, shape = _residual_spectrum(residual * interval_s, velocity, frequency_hz, interval_s)
    if shape.size < LEAST_BINS:
        return alone, np.zeros_like(alone)
    pulse, ratio = _most_likely(power, shape)
    return np.where(ratio > 0, pulse, alone), ratio * pulse / interval_s**2


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
