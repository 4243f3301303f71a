"""Stationarity of the motion: whether the amplitude changes from the first half of the pulses to the second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.processing.echoes import BoolArray, FloatArray, Motion
from hpe_rig.processing.model import LARGEST_CONDITION, linear_model


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
) -> Drift:
    """Return the change of amplitude between both halves: suspicious where bursts are missing or motion decays.

    The wanted states may change by a step in the middle, the rest of ``least_squares``' model is that of all pulses.
    Raises ``ValueError`` as that does, and where half the pulses cannot resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    valid, wanted = motion.valid, 2 * frequency_hz.size
    model = linear_model(motion.time_s, valid, frequency_hz, background_order=background_order, also_hz=also_hz)
    side = np.where(np.arange(valid.size) < valid.size // 2, -1.0, 1.0)[valid]
    # one solution for the steps and the motion
    motions = motion.displacement_m[..., valid]
    states, left = model.solve(np.vstack([side * model.matrix[:, :wanted].T, motions.reshape(-1, side.size)]))
    common, step = states[:wanted], left[:wanted]
    state, residual = (part[wanted:].reshape(*motions.shape[:-1], -1) for part in (states, left))
    products = step @ step.T
    smallest, *_, largest = np.linalg.eigvalsh(products)
    free = len(model.matrix) - model.matrix.shape[1] - wanted
    if free < 1 or not smallest * LARGEST_CONDITION**2 > largest:
        raise ValueError("half the pulses cannot resolve the frequencies: use a longer window")
    covariance = np.linalg.inv(products)
    change = residual @ step.T @ covariance
    rest = residual - change @ step
    mean = (state - change @ common)[..., :wanted]
    first, second = (np.hypot(half[..., ::2], half[..., 1::2]) for half in (mean - change, mean + change))
    # of a difference of lengths, each uncertain by the mean of its quadratures
    quadratures = np.diag(covariance).reshape(-1, 2).sum(axis=-1) / 2
    sigma = 2 * np.sqrt(np.einsum("...i,...i->...", rest, rest)[..., None] / free * quadratures)
    middle, difference, tiny = (first + second) / 2, second - first, np.finfo(np.float64).tiny
    suspicious = np.abs(difference) > np.maximum(5 * sigma, 0.1 * middle)
    return Drift(frequency_hz, difference / middle.clip(min=tiny), difference / sigma.clip(min=tiny), suspicious)
