"""Kalman filter with harmonic and background states: displacement to amplitude and phase, pulse by pulse.

    x_k = x_{k-1} + w_k        states: (in-phase, quadrature) of each frequency, background polynomial
    y_k = h_k x_k + n_k        h_k: row k of H of harmonics/model.py

w is the process noise, n the measurement noise; all variances are in units of the measurement noise. The covariance P
of the states is kept as a root S, P = S S', which stays positive for any ratio of prior to noise. Update by a
measurement, in Potter's form (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977):

    a = S'h,   alpha = 1 + a'a,   K = S a / alpha
    x <- x + K (y - h x),         S <- S - K a' / (1 + 1 / sqrt(alpha))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import (
    FitQuality,
    HarmonicFit,
    InnovationCorrelation,
    fit_from_state,
)
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion

PRIOR = 1e10
"""Initial variance of a state over the measurement variance: a diffuse prior."""


@dataclass(frozen=True, slots=True)
class Filtered:
    """Result of a Kalman filter, in units of the measurement noise.

    ``state`` x (..., state). ``root`` S (state, state), or (..., state, state) where trains start with different
    variances: S S' is the covariance. ``innovations`` (..., pulse): measured minus predicted values over their standard
    deviations.
    """

    state: FloatArray
    root: FloatArray
    innovations: FloatArray


def kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    process_noise: float = 0.0,
    prior: float = PRIOR,
) -> HarmonicFit:
    """Return all amplitudes and phases of a displacement from a Kalman filter over the valid pulses.

    Variances are in units of the measurement noise, which is estimated from the innovations: ``process_noise`` is that
    of a harmonic state's change per pulse, ``prior`` that of a state at the start. Without process noise the result is
    that of least squares. ``also_hz``: further driven frequencies, fitted but not returned. Raises ``ValueError`` if
    the pulses cannot resolve the frequencies.

    Sources: harmonic states of Zheng et al. (2007), background states of Zheng et al. (2006).
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
    pulses, states = model.matrix.shape
    change_sd = None
    if process_noise:
        # The states of the wanted harmonics change before each pulse; a gap of n pulses has n times the variance.
        change_sd, used = np.zeros((pulses, states)), np.flatnonzero(motion.valid)
        change_sd[:, : 2 * frequency_hz.size] = np.sqrt(process_noise * np.diff(used, prepend=used[0]))[:, None]
    initial_sd = np.full(states, np.sqrt(prior))
    filtered = filter_states(model.matrix, motion.displacement_m[..., motion.valid], initial_sd, change_sd)
    # The noise variance scales the covariance, which the filter states for unit noise.
    variance = np.einsum("...i,...i->...", filtered.innovations, filtered.innovations) / (pulses - states)
    root = filtered.root[model.wanted_states]
    quality = FitQuality(
        residual_rms_m=np.sqrt(variance),
        degrees_of_freedom=pulses - states,
        pulses=pulses,
        condition=model.condition,
        innovation_correlation=innovation_correlation(filtered.innovations, states),
    )
    covariance = variance[..., None, None] * (root @ root.T)
    return fit_from_state(frequency_hz, filtered.state[..., model.wanted_states], covariance, quality)


def filter_states(
    matrix: FloatArray, data: FloatArray, initial_sd: FloatArray, change_sd: FloatArray | None = None
) -> Filtered:
    """Return the states that a Kalman filter estimates from ``data`` (..., pulse).

    The model is data = ``matrix`` (pulse, state) @ states + noise of unit variance. ``initial_sd`` (state,) or
    (..., state): standard deviation of every state at the start. ``change_sd`` (pulse, state): that of the independent
    random change of each state before each pulse; None for states that never change; only with ``initial_sd`` (state,).
    The formulas are those of the module.
    """
    states = matrix.shape[1]
    root, state = initial_sd[..., None] * np.eye(states), np.zeros((*data.shape[:-1], states))
    innovations = np.empty(data.shape)
    for k, h in enumerate(matrix):
        if change_sd is not None and k:
            # Time update: P + Q has the root [S, sqrt Q]; QR makes it square again.
            triangle: FloatArray = np.asarray(np.linalg.qr(np.vstack([root.T, np.diag(change_sd[k])]), mode="r"))
            root = triangle.T
        a = h @ root
        alpha = 1.0 + (a * a).sum(axis=-1, keepdims=True)
        gain = (root @ a[..., None])[..., 0] / alpha
        innovation = data[..., k] - state @ h
        state = state + innovation[..., None] * gain
        root = root - gain[..., None] * (a / (1.0 + 1.0 / np.sqrt(alpha)))[..., None, :]
        innovations[..., k] = innovation / np.sqrt(alpha[..., 0])
    return Filtered(state, root, innovations)


def innovation_correlation(innovations: FloatArray, states: int) -> InnovationCorrelation:
    """Return the correlation of a Kalman filter's innovations at a lag of one pulse, and its tolerance.

    It is 0 for a complete model; the tolerance is four standard deviations. The innovations (..., valid pulse) of the
    first ``states`` pulses depend on the prior and are excluded.
    """
    later = innovations[..., states:]
    energy = np.einsum("...i,...i->...", later, later)
    neighbours = np.einsum("...i,...i->...", later[..., 1:], later[..., :-1])
    return neighbours / np.maximum(energy, np.finfo(np.float64).tiny), 4 / np.sqrt(later.shape[-1])
