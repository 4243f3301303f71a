"""Bias and jitter, eq. (14) and (15), of nested realisations: their Monte Carlo errors, and speckle apart from noise.

Noise is drawn several times for each draw of scatterers, so the draws are independent and the realisations are not:
every standard error here is that of a mean over draws. Law of total variance:

    jitter^2 = noise^2 + speckle^2,    noise^2 = E[var(x | draw)],    speckle^2 = var(E[x | draw])
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Errors:
    """Bias and jitter of one quantity in its unit, each with its standard error; NaN where it cannot be told."""

    bias: float
    bias_se: float
    jitter: float
    jitter_se: float
    noise_jitter: float
    noise_jitter_se: float
    speckle_jitter: float
    speckle_jitter_se: float

    def named(self, quantity: str, unit: str) -> dict[str, float]:
        """Return the values under names such as ``amplitude_bias_m``."""
        return {f"{quantity}_{name}_{unit}": value for name, value in asdict(self).items()}


def errors(deviation: Floats, centre: float = 0.0) -> Errors:
    """Return bias and jitter of ``deviation`` (draw, noise) from the true value, NaN rows left out.

    ``centre`` is added to the bias: deviations of an angle are taken about their circular mean.
    """
    kept = deviation[~np.isnan(deviation).any(axis=1)]
    draws, repeats = kept.shape
    if draws == 0:
        return Errors(*[math.nan] * 8)
    mean = kept.mean(axis=1)
    bias = float(mean.mean())
    total, total_se = _root_of_mean(((kept - bias) ** 2).mean(axis=1))
    bias_se = float(mean.std(ddof=1) / math.sqrt(draws)) if draws > 1 else math.nan
    if repeats == 1:
        return Errors(bias + centre, bias_se, total, total_se, *[math.nan] * 4)
    # Divided by repeats, as eq. (15); the correction makes noise unbiased and leaves the sum what it is.
    within = kept.var(axis=1)
    noise = _root_of_mean(within * (repeats / (repeats - 1)))
    speckle = _root_of_mean((mean - bias) ** 2 - within / (repeats - 1))
    return Errors(bias + centre, bias_se, total, total_se, *noise, *speckle)


def phase_errors(phase_rad: Floats, true_rad: float) -> Errors:
    """Return bias and jitter of a phase (draw, noise): deviations are wrapped about the circular mean.

    For small errors those of eq. (14) and (15); a phase about which nothing is known has a jitter of pi / sqrt(3).
    """
    error = phase_rad - true_rad
    centre = float(np.angle(np.nanmean(np.exp(1j * error)))) if not np.isnan(error).all() else math.nan
    return errors(wrapped(error - centre), centre)


def wrapped(angle_rad: Floats) -> Floats:
    """Return angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle_rad, 2 * np.pi))


def _root_of_mean(values: Floats) -> tuple[float, float]:
    """Return the root of the mean of independent ``values`` (draw,) and its standard error; of a negative mean 0."""
    mean = float(values.mean())
    spread = float(values.std(ddof=1) / math.sqrt(values.size)) if values.size > 1 else math.nan
    root = math.sqrt(max(mean, 0.0))
    # Near zero the slope of the root says nothing; its own spread is what remains.
    return root, spread / (2 * root) if mean > spread else math.sqrt(spread) if spread >= 0 else math.nan
