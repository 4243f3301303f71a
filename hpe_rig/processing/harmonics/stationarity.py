"""Stationarity of the motion: whether the amplitude changes from the first half of the pulses to the second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_fit, seen_by
from hpe_rig.processing.harmonics.model import LARGEST_CONDITION, harmonic_columns, linear_model
from hpe_rig.result import student_widening

TAKEN = 0.01
"""Share of the data along a direction from which on a fit with a prior has taken it."""


@dataclass(frozen=True, slots=True)
class Drift:
    """How the amplitudes changed from the first half of the pulses to the second.

    All (..., frequency): ``relative_change`` (A_2 - A_1) / A, with A the mean of both; ``significance``, that change
    over its standard uncertainty; ``suspicious``: more than 5 standard uncertainties and more than 10 % of A.
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
    """Return the change of amplitude between both halves: suspicious where bursts are missing or motion decays.

    The wanted states may change by a step in the middle, the rest of the model is that of all pulses: that of
    ``least_squares`` or, with a ``prior``, what the motion has of it. Raises ``ValueError`` as these do, and where half
    the pulses cannot resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    if prior is None:
        times = motion.time_s, motion.valid
        model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
        columns, q = model.matrix[:, : 2 * frequency_hz.size], model.matrix @ model.root
        mean = model.solve(motion.displacement_m[..., motion.valid])[0][..., : 2 * frequency_hz.size]
    else:
        seen = seen_by(prior, motion.time_s, motion.valid, frequency_hz, background_order)
        found = medium_fit(motion, frequency_hz, prior, background_order=background_order)
        taken = np.any(found.taken.reshape(-1, seen.value.size) > TAKEN, axis=0)
        columns, q = harmonic_columns(motion.time_s, frequency_hz), np.hstack([seen.background, seen.left[:, taken]])
        columns, mean = columns[motion.valid], found.fit.state
    return _drift(motion, frequency_hz, columns, q, mean)


def _drift(motion: Motion, frequency_hz: FloatArray, columns: FloatArray, q: FloatArray, mean: FloatArray) -> Drift:
    """Return the drift by steps of ``columns`` (valid pulse, state), off the orthonormal ``q`` (valid pulse, column).

    ``mean`` (..., state): the states over all pulses.
    """
    valid = motion.valid
    side = np.where(np.arange(valid.size) < valid.size // 2, -1.0, 1.0)[valid]
    step, residual = side * columns.T, motion.displacement_m[..., valid]
    # row by row: of a long train nothing is held twice
    for rows in (step, residual):
        for row in np.ndindex(rows.shape[:-1]):
            rows[row] -= (rows[row] @ q) @ q.T
    products = step @ step.T
    smallest, *_, largest = np.linalg.eigvalsh(products)
    free = len(q) - q.shape[1] - len(step)
    if free < 1 or not smallest * LARGEST_CONDITION**2 > largest:
        raise ValueError("half the pulses cannot resolve the frequencies: use a longer window")
    covariance = np.linalg.inv(products)
    change = residual @ step.T @ covariance
    rest = residual - change @ step
    first, second = (np.hypot(half[..., ::2], half[..., 1::2]) for half in (mean - change, mean + change))
    # of a difference of lengths, each uncertain by the mean of its quadratures
    quadratures = np.diag(covariance).reshape(-1, 2).sum(axis=-1) / 2
    variance = np.einsum("...i,...i->...", rest, rest)[..., None] / free
    sigma = 2 * np.sqrt(variance * quadratures)
    middle, difference, tiny = (first + second) / 2, second - first, np.finfo(np.float64).tiny
    limit = 5 * sigma * student_widening(free)
    suspicious = np.abs(difference) > np.maximum(limit, 0.1 * middle)
    return Drift(frequency_hz, difference / middle.clip(min=tiny), difference / sigma.clip(min=tiny), suspicious)
