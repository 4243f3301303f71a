"""Checks of a harmonic fit: a change of amplitude within the train, and a spectral line in the residual.

Change of amplitude between the first and the second half of the pulses:

    d = H x + G y + noise,    G = +-(columns of the wanted states): minus in the first half, plus in the second

y is the step of the wanted states in the middle of the train, fitted together with the model H of all pulses. With Q an
orthonormal basis of H, y^ = (G'(1 - QQ')G)^-1 G'(1 - QQ')d.

Spectral line: motion at a frequency that was not fitted, or at one that aliases there. Under white noise each bin of
the residual's periodogram is exponentially distributed. The largest bin's fraction g of the sum over n bins is exceeded
with a probability of at most n (1 - g)^(n - 1) (Fisher, 1929).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.harmonics.medium_fit import fit_residual, medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import (
    MAX_CONDITION,
    aliased_hz,
    harmonic_columns,
    linear_model,
    pulse_rate_hz,
)
from hpe_rig.processing.harmonics.projected_prior import project_prior
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.result import student_widening

MIN_SHRINKAGE = 0.01
"""Directions with at least this shrinkage count as fitted by a fit with a prior."""
SUSPICIOUS_U = 5.0
"""Change in standard uncertainties that is reported."""
SUSPICIOUS_CHANGE = 0.1
"""Relative change that is reported."""
MIN_BINS = 12
"""Number of free bins below which a line is not tested."""


def drift_between_halves(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    prior: MediumPrior | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Return (A_2 - A_1) / mean A of each amplitude (..., frequency) between the halves, and which are suspicious.

    A suspicious change means that bursts are missing or the motion decays. All pulses are first fitted by least squares
    or, with a ``prior`` of the motions that media can have, by the fit with that prior; a change of the states between
    the halves is then fitted in addition. ``also_hz``: further frequencies of the motion. Raises ``ValueError`` if the
    fit does, and if half the pulses cannot resolve the frequencies.
    """
    # ``columns``: those of the wanted frequencies. ``basis``: orthonormal, spans all columns of the fit.
    # ``mean_state``: in-phase and quadrature of the wanted frequencies, fitted to all pulses.
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    if prior is None:
        times = motion.time_s, motion.valid
        model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
        columns, basis = model.matrix[:, : 2 * frequency_hz.size], model.matrix @ model.root
        mean_state = model.solve(motion.displacement_m[..., motion.valid])[0][..., : 2 * frequency_hz.size]
    else:
        projected = project_prior(prior, motion.time_s, motion.valid, frequency_hz, background_order)
        prior_fit = medium_fit(motion, frequency_hz, prior, background_order=background_order)
        # ``left_vectors`` span the prior's motions. Only those count to which the data contribute.
        fitted = np.any(prior_fit.shrinkage.reshape(-1, projected.value.size) > MIN_SHRINKAGE, axis=0)
        basis = np.hstack([projected.background, projected.left_vectors[:, fitted]])
        columns, mean_state = harmonic_columns(motion.time_s, frequency_hz)[motion.valid], prior_fit.fit.state
    return _change(motion, columns, basis, mean_state)


def _change(
    motion: Motion, columns: FloatArray, basis: FloatArray, mean_state: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the relative change of each amplitude between the halves of the train, and which changes are suspicious.

    A step y of the wanted states in the middle of the train is fitted together with all columns of the model.
    ``columns`` (valid pulse, state): those of the wanted states. ``basis`` (valid pulse, column): Q, an orthonormal
    basis of all columns. ``mean_state`` (..., state): the wanted states over all pulses.
    """
    valid = motion.valid
    # G: minus the columns in the first half, plus the columns in the second.
    sign = np.where(np.arange(valid.size) < valid.size // 2, -1.0, 1.0)[valid]
    step, residual = sign * columns.T, motion.displacement_m[..., valid]
    # Project the model's columns Q out of the step G and the data, row by row in place: no second copy of a long train.
    for rows in (step, residual):
        for row in np.ndindex(rows.shape[:-1]):
            rows[row] -= (rows[row] @ basis) @ basis.T
    products = step @ step.T
    smallest, *_, largest = np.linalg.eigvalsh(products)
    degrees = len(basis) - basis.shape[1] - len(step)  # pulses - states of the model - states of the step
    if degrees < 1 or not smallest * MAX_CONDITION**2 > largest:
        raise ValueError("half the pulses cannot resolve the frequencies: use a longer window")
    covariance = np.linalg.inv(products)
    change = residual @ step.T @ covariance  # y^
    remainder = residual - change @ step
    first, second = (np.hypot(half[..., ::2], half[..., 1::2]) for half in (mean_state - change, mean_state + change))
    # The amplitude changes by 2 y along the phasor; its variance is the mean of both quadratures' variances.
    quadratures = np.diag(covariance).reshape(-1, 2).sum(axis=-1) / 2
    variance = np.einsum("...i,...i->...", remainder, remainder)[..., None] / degrees
    u = 2 * np.sqrt(variance * quadratures)
    mean, difference = (first + second) / 2, second - first
    limit = SUSPICIOUS_U * u * student_widening(degrees)
    suspicious = np.abs(difference) > np.maximum(limit, SUSPICIOUS_CHANGE * mean)
    return difference / mean.clip(min=np.finfo(np.float64).tiny), suspicious


@dataclass(frozen=True, slots=True)
class Line:
    """The strongest line: its frequency, its amplitude, and the probability of one as strong in white noise."""

    frequency_hz: float
    amplitude_m: float
    probability: float


def residual_line(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    prior: MediumPrior | None = None,
) -> Line | None:
    """Return the strongest spectral line in the residual of one train's fit, or None if too few bins are free of it.

    It reveals motion that was not fitted. The fit is least squares or, with a ``prior`` of media, that of
    ``medium_fit``. Motion that aliases onto a fitted frequency is not in the residual. Raises ``ValueError`` as the fit
    does.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    rate_hz = pulse_rate_hz(motion.time_s)
    if prior is None:
        model = linear_model(
            motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz
        )
        residual = model.solve(motion.displacement_m[motion.valid])[1]
        fitted_hz = aliased_hz(np.concatenate([frequency_hz, np.asarray(also_hz, dtype=np.float64)]), rate_hz)
    else:
        residual = fit_residual(motion, frequency_hz, prior, background_order=background_order)
        fitted_hz = np.zeros(0)
    # An even series: skipped pulses are zero.
    index = np.round((motion.time_s - motion.time_s[0]) * rate_hz).astype(np.int64)
    series = np.zeros(int(index[-1]) + 1)
    series[index[motion.valid]] = residual
    grid_hz = np.fft.rfftfreq(series.size, 1 / rate_hz)
    # Free bins: more than one bin from every fitted frequency, above the bins of the polynomial (half a bin an order).
    distance = np.abs(grid_hz[:, None] - fitted_hz).min(axis=1, initial=np.inf) * series.size / rate_hz
    free = (distance > 1 + 1e-6) & (grid_hz * series.size / rate_hz > 0.5 + background_order / 2)
    free &= grid_hz < rate_hz / 2 * (1 - 1e-9)
    # Periodogram of the residual; under white noise its bins are exponentially distributed.
    power = np.abs(np.fft.rfft(series)[free]) ** 2
    if power.size < MIN_BINS or not power.sum() > 0:
        return None
    # In white noise, n (1 - fraction)^(n - 1) bounds the probability of so large a bin among n (Fisher, 1929).
    fraction = float(power.max() / power.sum())
    return Line(
        frequency_hz=float(grid_hz[free][np.argmax(power)]),
        amplitude_m=2 * float(np.sqrt(power.max())) / residual.size,
        probability=min(1.0, power.size * (1 - fraction) ** (power.size - 1)),
    )
