"""Stationarity: whether the amplitude changes between the first and the second half of the pulses.

    d = H x + G y + noise,    G = +-(columns of the wanted states): minus in the first half, plus in the second

y is the step of the wanted states in the middle of the train, fitted together with the model H of all pulses. With Q an
orthonormal basis of H, y^ = (G'(1 - QQ')G)^-1 G'(1 - QQ')d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.harmonics.medium_fit import medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import MAX_CONDITION, harmonic_columns, linear_model
from hpe_rig.processing.harmonics.projected_prior import project_prior
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.result import student_widening

MIN_SHRINKAGE = 0.01
"""Directions with at least this shrinkage count as fitted by a fit with a prior."""
SUSPICIOUS_U = 5.0
"""Change in standard uncertainties that is reported."""
SUSPICIOUS_CHANGE = 0.1
"""Relative change that is reported."""


@dataclass(frozen=True, slots=True)
class Drift:
    """Change of the amplitudes A from the first half of the pulses to the second, all (..., frequency).

    ``relative_change``: (A_2 - A_1) / mean A. ``significance``: A_2 - A_1 over its standard uncertainty.
    ``suspicious``: both are large.
    """

    frequency_hz: FloatArray
    relative_change: FloatArray
    significance: FloatArray
    suspicious: BoolArray


def drift_between_halves(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    prior: MediumPrior | None = None,
) -> Drift:
    """Return the change of amplitude between the halves: suspicious if bursts are missing or the motion decays.

    The model of all pulses is that of ``least_squares`` or, with a ``prior``, of ``medium_fit``. Raises ``ValueError``
    as these do, and if half the pulses cannot resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    if prior is None:
        times = motion.time_s, motion.valid
        model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
        columns, basis = model.matrix[:, : 2 * frequency_hz.size], model.matrix @ model.root
        mean_state = model.solve(motion.displacement_m[..., motion.valid])[0][..., : 2 * frequency_hz.size]
    else:
        projected = project_prior(prior, motion.time_s, motion.valid, frequency_hz, background_order)
        prior_fit = medium_fit(motion, frequency_hz, prior, background_order=background_order)
        fitted = np.any(prior_fit.shrinkage.reshape(-1, projected.value.size) > MIN_SHRINKAGE, axis=0)
        basis = np.hstack([projected.background, projected.left_vectors[:, fitted]])
        columns, mean_state = harmonic_columns(motion.time_s, frequency_hz)[motion.valid], prior_fit.fit.state
    return _drift(motion, frequency_hz, columns, basis, mean_state)


def _drift(
    motion: Motion, frequency_hz: FloatArray, columns: FloatArray, basis: FloatArray, mean_state: FloatArray
) -> Drift:
    """Return the drift from a step of the states of ``columns`` (valid pulse, state).

    ``basis`` (valid pulse, column): Q. ``mean_state`` (..., state): the states over all pulses.
    """
    valid = motion.valid
    sign = np.where(np.arange(valid.size) < valid.size // 2, -1.0, 1.0)[valid]
    step, residual = sign * columns.T, motion.displacement_m[..., valid]
    # (1 - QQ') G and (1 - QQ') d, row by row in place: no second copy of a long train.
    for rows in (step, residual):
        for row in np.ndindex(rows.shape[:-1]):
            rows[row] -= (rows[row] @ basis) @ basis.T
    products = step @ step.T
    smallest, *_, largest = np.linalg.eigvalsh(products)
    degrees = len(basis) - basis.shape[1] - len(step)
    if degrees < 1 or not smallest * MAX_CONDITION**2 > largest:
        raise ValueError("half the pulses cannot resolve the frequencies: use a longer window")
    covariance = np.linalg.inv(products)
    change = residual @ step.T @ covariance  # y^
    remainder = residual - change @ step
    first, second = (np.hypot(half[..., ::2], half[..., 1::2]) for half in (mean_state - change, mean_state + change))
    # A_2 - A_1 = 2 y along the phasor; its variance is the mean of both quadratures.
    quadratures = np.diag(covariance).reshape(-1, 2).sum(axis=-1) / 2
    variance = np.einsum("...i,...i->...", remainder, remainder)[..., None] / degrees
    u = 2 * np.sqrt(variance * quadratures)
    mean, difference, tiny = (first + second) / 2, second - first, np.finfo(np.float64).tiny
    limit = SUSPICIOUS_U * u * student_widening(degrees)
    suspicious = np.abs(difference) > np.maximum(limit, SUSPICIOUS_CHANGE * mean)
    return Drift(frequency_hz, difference / mean.clip(min=tiny), difference / u.clip(min=tiny), suspicious)
