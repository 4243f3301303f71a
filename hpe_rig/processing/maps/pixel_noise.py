"""Noise of a pixel's phase over the pulses, and its effect on the fitted states.

    phase_k = fit + w_k + b_k,      b_k+1 = b_k + a_k (+ c_0 + ... + c_k)

w_k is white: noise of the receiver. The random walk b_k is decorrelation: each echo differs a little from the one
before, and the phase steps add up. Its steps are independent (a_k) or change slowly (c_k), as where scatterers cross
the beam. The three variances follow from the energies of the residual and of its steps.

A slow decorrelation hides in the fit, since it looks like a velocity. It changes the amplitude of the echoes by as
much as their phase, because in-phase and quadrature of the change have equal variances. The amplitude does not move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, SingleArray
from hpe_rig.processing.harmonics.model import LinearModel

BLOCK: Final = 32
"""Gates over which the amplitude changes are compared: enough for a median with an error of a quarter."""
EXCESS: Final = 1.5
"""Ratio of the amplitude's variance to that of the residual above which the difference is added to u."""
NO_WALK: Final = 0.3
"""Fraction of a block's pixels without a walk up to which it has one; half of them, by chance, in white noise."""
FEW_DEGREES_OF_FREEDOM: Final = 1.25
"""Variance factor of Student's t with ten degrees of freedom, about those of a walk in a short train and of a block."""
MEDIAN_OF_SQUARE: Final = 0.4549
"""Median of the square of a standard normal variable."""
MEDIAN_OF_MEAN_SQUARE: Final = 0.6931
"""Median of the mean square of two of them, ln 2."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Effect of white noise, a random walk and a smooth random walk, each of unit variance, on a pixel's fit.

    ``state_covariance`` (3, state, state): of the fitted states. ``energies`` (3, 2): expected sum of squares of the
    residual, and of its steps from pulse to pulse.
    """

    state_covariance: FloatArray
    energies: FloatArray

    @classmethod
    def of(cls, model: LinearModel) -> NoiseModel:
        """Return the noise model of a least-squares fit.

        Each noise is C e, with e white and C summing its values ``order`` times: 0 white, 1 walk, 2 smooth walk. With
        the orthonormal columns Q of the fit the residual is (1 - QQ') C e, and its steps are D times that, D the
        differences between pulses.
        """
        columns = model.matrix @ model.root
        steps = np.diff(columns, axis=0)
        n = len(columns)
        numbers = np.arange(1.0, n + 1)
        # Expected energies of the noise C e and of its steps D C e, before the fit, for each order: the sums of the
        # squared entries of C and of D C.
        noise_energies = (
            (n, 2 * (n - 1)),
            (n * (n + 1) / 2, n - 1),
            (float(numbers**2 @ numbers[::-1]), n * (n + 1) / 2 - 1),
        )
        covariances, energies = [], []
        for order, (noise_energy, step_energy) in enumerate(noise_energies):
            # A = C'Q and C A, (pulse, state): sums backwards, then forwards.
            backward = columns
            for _ in range(order):
                backward = np.cumsum(backward[::-1], axis=0)[::-1]
            forward = backward
            for _ in range(order):
                forward = np.cumsum(forward, axis=0)
            # A'A is the covariance of the fitted coefficients of Q. The residual has the energy |(1 - QQ') C|² =
            # |C|² - tr A'A; its steps follow with D C and D Q instead of C and Q.
            fitted = backward.T @ backward
            fitted_steps = 2 * np.sum(np.diff(forward, axis=0) * steps) - np.sum((steps.T @ steps) * fitted)
            energies.append((noise_energy - np.trace(fitted), step_energy - fitted_steps))
            covariances.append(model.root @ fitted @ model.root.T)
        return cls(np.array(covariances), np.array(energies))

    def variances(self, energies: SingleArray, has_echo: BoolArray) -> SingleArray:
        """Return the variances (pixel, 3) of white noise, random walk and smooth random walk in the phase, rad².

        They follow from the ``energies`` (pixel, 2) of the residual and of its steps. Two energies determine two
        variances: those of white noise and a walk or, if the steps are too small for a walk alone, those of a walk and
        a smooth walk. In a block of gates where most pixels show no walk, all noise is white. ``has_echo``: (line,
        gate).
        """
        residual, steps = np.ascontiguousarray(energies.T)
        # Two unknown variances from two energies, for white noise and walk.
        inverse = np.linalg.inv(self.energies[:2]).astype(np.float32)
        white, walk = (inverse[0, kind] * residual + inverse[1, kind] * steps for kind in range(2))
        walk[_block_quantile(walk.reshape(has_echo.shape), has_echo, NO_WALK).reshape(-1) <= 0] = 0
        white_energy, _, smooth_energy = self.energies[:, 0].astype(np.float32)
        result = np.zeros((len(energies), 3), np.float32)
        result[:, 0] = np.where(walk > 0, np.maximum(white, 0), residual / white_energy)
        result[:, 1] = np.maximum(walk, 0)
        # A walk alone would have larger steps: the steps are correlated. Two variances for walk and smooth walk.
        is_smooth = (walk > 0) & (white < 0)
        independent, correlated = np.maximum(energies[is_smooth] @ np.linalg.inv(self.energies[1:]), 0).T
        result[is_smooth, 1] = independent
        result[is_smooth, 2] = np.where(independent > 0, correlated, residual[is_smooth] / smooth_energy)
        result[:, 1:] *= np.float32(FEW_DEGREES_OF_FREEDOM)
        return result


def hidden_variance(
    amplitude_state: SingleArray, visible: SingleArray, power: SingleArray, has_echo: BoolArray
) -> SingleArray:
    """Return the variance of the fitted states that slow decorrelation causes and the residual does not contain, rad².

    Result and ``visible``, the variance by the residual, are (frequency + 1, line, gate): of each frequency's
    quadratures, and of the slope. Decorrelation changes the logarithm of the echo's amplitude as much as its phase, so
    the hidden variance is measured there: ``amplitude_state`` (pixel, state) is the fit of that logarithm without the
    part that motion causes. ``power`` and ``has_echo`` (line, gate).
    """
    # Squares of in-phase and quadrature of each frequency (mean of two), and of the slope; over the median that they
    # have at unit variance. The states are two of each frequency, constant, slope.
    state_square = np.square(amplitude_state.T, order="C")
    pairs = (state_square[:-2:2] + state_square[1:-2:2]) * np.float32(0.5 / MEDIAN_OF_MEAN_SQUARE)
    slope = state_square[-1:] / np.float32(MEDIAN_OF_SQUARE)
    square: SingleArray = np.concatenate([pairs, slope]).reshape(visible.shape)
    # Neighbouring echoes change by similar absolute amounts: relative changes times power have a common median.
    square *= power
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        variance = _block_quantile(square, has_echo) * (np.float32(FEW_DEGREES_OF_FREEDOM) / power)
        return np.where(has_echo & (variance > EXCESS * visible), variance - visible, np.float32(0))


def _block_quantile(values: SingleArray, valid: BoolArray, quantile: float = 0.5) -> SingleArray:
    """Return the ``quantile`` of the valid pixels in each block of ``BLOCK`` neighbouring gates of a line.

    ``values`` (..., line, gate), ``valid`` (line, gate). The result has the shape of ``values``: every gate of a block
    has the quantile of its block, infinity if no pixel of it is valid.
    """
    # Invalid pixels are infinite, so that they come after the valid ones in ascending order.
    result = np.where(valid, values, np.float32(np.inf))
    lines, gate_count = np.arange(valid.shape[0]), values.shape[-1]
    for gates in np.array_split(np.arange(gate_count), max(1, gate_count // BLOCK)):
        block = slice(gates[0], gates[-1] + 1)
        ascending = np.sort(result[..., block], axis=-1)
        # Position of the quantile among the valid pixels of each line, (line,).
        position = (quantile * np.maximum(valid[:, block].sum(axis=-1) - 1, 0)).astype(np.int64)
        result[..., block] = ascending[..., lines, position][..., None]
    return result
