"""Bias and jitter, eq. (14) and (15), of nested realisations: their Monte Carlo errors, and speckle apart from noise.

Noise is drawn several times for each draw of scatterers, so the draws are independent and the realisations are not:
every standard error here is that of a mean over draws. Law of total variance:

    jitter^2 = noise^2 + speckle^2,    noise^2 = E[var(x | draw)],    speckle^2 = var(E[x | draw])
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from hpe_rig.arrays import FloatArray

UNKNOWN_RAD = math.pi / math.sqrt(3)
"""Standard deviation of a phase about which nothing is known."""


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


def errors(deviation: FloatArray) -> Errors:
    """Return bias and jitter of ``deviation`` (draw, noise) from the true value, NaN rows left out."""
    kept = _whole_rows(deviation)
    draws, repeats = kept.shape
    if draws == 0:
        return Errors(*[math.nan] * 8)
    mean = kept.mean(axis=1)
    bias = float(mean.mean())
    total = _root_of_mean(((kept - bias) ** 2).mean(axis=1))
    bias_se = _error_of_mean(mean)
    if repeats == 1:
        # Two deviations from their own mean are equal, which says nothing of how far their size is known.
        jitter_se = total[1] if draws > 2 else math.nan
        return Errors(bias, bias_se, total[0], jitter_se, *[math.nan] * 4)
    # Divided by repeats, as eq. (15); the correction makes noise unbiased and leaves the sum what it is.
    within = kept.var(axis=1)
    noise = _root_of_mean(within * (repeats / (repeats - 1)))
    speckle = _root_of_mean((mean - bias) ** 2 - within / (repeats - 1))
    return Errors(bias, bias_se, *total, *noise, *speckle)


def phase_errors(phase_rad: FloatArray, true_rad: float) -> Errors:
    """Return bias and jitter of a phase (draw, noise): the circular mean of its error, and what is wrapped about it.

    For small errors those of eq. (14) and (15). A phase about which nothing is known has a jitter of pi / sqrt(3), and
    its bias a standard error of at most that: the one of a mean direction grows as the resultant falls.
    """
    kept = _whole_rows(phase_rad - true_rad)
    if len(kept) == 0:
        return errors(kept)
    centre = float(np.angle(np.exp(1j * kept).mean()))
    turned = kept - centre
    resultant = max(float(np.cos(turned).mean()), 1e-12)
    centre_se = _error_of_mean(np.sin(turned).mean(axis=1)) / resultant
    # The bound first: of one draw the error is NaN and stays so.
    return replace(errors(wrapped(turned)), bias=centre, bias_se=float(np.minimum(UNKNOWN_RAD, centre_se)))


def wrapped(angle_rad: FloatArray) -> FloatArray:
    """Return angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle_rad, 2 * np.pi))


def _whole_rows(values: FloatArray) -> FloatArray:
    return values[~np.isnan(values).any(axis=1)]


def _error_of_mean(values: FloatArray) -> float:
    """Return the standard error of the mean of independent ``values`` (draw,); NaN of a single one."""
    return float(values.std(ddof=1) / math.sqrt(values.size)) if values.size > 1 else math.nan


def _root_of_mean(values: FloatArray) -> tuple[float, float]:
    """Return the root of the mean of independent ``values`` (draw,) and its standard error; of a negative mean 0."""
    mean = float(values.mean())
    spread = _error_of_mean(values)
    root = math.sqrt(max(mean, 0.0))
    # Near zero the slope of the root says nothing; its own spread is what remains.
    return root, spread / (2 * root) if mean > spread else math.sqrt(spread) if spread >= 0 else math.nan
