"""Bias and jitter of nested realisations, eq. (14) and (15), with Monte Carlo standard errors.

Noise is drawn several times for each draw of scatterers, so only the draws are independent: every standard error is
that of a mean over draws. The law of total variance separates the two sources:

    jitter² = noise² + speckle²,    noise² = E[var(x | draw)],    speckle² = var(E[x | draw])
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from hpe_rig.arrays import FloatArray

UNIFORM_PHASE_SD_RAD = math.pi / math.sqrt(3)
"""Standard deviation of a phase that is uniform over the circle."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Bias and jitter of one quantity in its unit, each with its standard error; NaN where undetermined."""

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
    """Return bias and jitter of ``deviation`` (draw, noise) from the true value; draws with a NaN are left out."""
    complete = _complete_draws(deviation)
    draws, repeats = complete.shape
    if draws == 0:
        return Errors(*[math.nan] * 8)
    draw_means = complete.mean(axis=1)
    bias = float(draw_means.mean())
    total = _root_of_mean(((complete - bias) ** 2).mean(axis=1))
    bias_se = _standard_error(draw_means)
    if repeats == 1:
        # Two deviations from their own mean are equal in size: they give no error of that size.
        jitter_se = total[1] if draws > 2 else math.nan
        return Errors(bias, bias_se, total[0], jitter_se, *[math.nan] * 4)
    # eq. (15) divides by the number of repeats. The correction makes the noise term unbiased and keeps the sum.
    within = complete.var(axis=1)
    noise = _root_of_mean(within * (repeats / (repeats - 1)))
    speckle = _root_of_mean((draw_means - bias) ** 2 - within / (repeats - 1))
    return Errors(bias, bias_se, *total, *noise, *speckle)


def phase_errors(phase_rad: FloatArray, true_rad: float) -> Errors:
    """Return bias and jitter of a phase (draw, noise): circular mean of its error, and deviation wrapped about it.

    They equal eq. (14) and (15) for small errors. A uniformly distributed phase has a jitter of pi / sqrt(3), which
    also bounds the standard error of the bias: that of a mean direction grows as the resultant falls.
    """
    error_rad = _complete_draws(phase_rad - true_rad)
    if len(error_rad) == 0:
        return errors(error_rad)
    centre = float(np.angle(np.exp(1j * error_rad).mean()))
    # Jitter of the error wrapped about its circular mean; the resultant scales the standard error of the direction.
    deviation = error_rad - centre
    resultant = max(float(np.cos(deviation).mean()), 1e-12)
    centre_se = _standard_error(np.sin(deviation).mean(axis=1)) / resultant
    # np.minimum keeps the NaN of a single draw.
    return replace(errors(wrapped(deviation)), bias=centre, bias_se=float(np.minimum(UNIFORM_PHASE_SD_RAD, centre_se)))


def wrapped(angle_rad: FloatArray) -> FloatArray:
    """Return angles in (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angle_rad, 2 * np.pi))


def _complete_draws(values: FloatArray) -> FloatArray:
    return values[~np.isnan(values).any(axis=1)]


def _standard_error(values: FloatArray) -> float:
    """Return the standard error of the mean of independent ``values`` (draw,); NaN for a single value."""
    return float(values.std(ddof=1) / math.sqrt(values.size)) if values.size > 1 else math.nan


def _root_of_mean(values: FloatArray) -> tuple[float, float]:
    """Return the root of the mean of independent ``values`` (draw,) and its standard error; 0 for a negative mean."""
    mean = float(values.mean())
    standard_error = _standard_error(values)
    root = math.sqrt(max(mean, 0.0))
    if mean > standard_error:
        return root, standard_error / (2 * root)
    # Near zero the root is not linear: the root of the standard error bounds it.
    return root, math.sqrt(standard_error) if standard_error >= 0 else math.nan
