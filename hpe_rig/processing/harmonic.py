"""Harmonic fit of a displacement: D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background, eq. (1).

The state of a frequency is (A cos phi, A sin phi), so the model is linear; all frequencies and the background are
estimated at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.processing.echoes import BoolArray, FloatArray, Motion
from hpe_rig.processing.model import LARGEST_CONDITION, linear_model

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase about which nothing is known, rad^2."""


@dataclass(frozen=True, slots=True)
class Innovations:
    """Innovations of a filter: what it did not foresee, a test of its model.

    ``normalised`` (..., pulse): innovations over their own standard deviation, NaN where no pulse; ``nis`` (...): their
    mean square with the noise that the echoes themselves state (NaN where they state none), 1 when that is true;
    ``nis_tolerance``: three standard deviations of it by chance; ``autocorrelation`` (...) from one pulse to the next,
    0 when the noise is white; ``outliers`` (..., pulse): beyond 5 robust standard deviations.
    """

    normalised: FloatArray
    nis: FloatArray
    nis_tolerance: float
    autocorrelation: FloatArray
    outliers: BoolArray


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Amplitude and phase per frequency, with covariance.

    ``frequency_hz`` (frequency,); ``amplitude_m`` and ``phase_rad`` (..., frequency), phase in (-pi, pi];
    ``covariance`` (..., frequency, 2, 2) of (amplitude, phase); ``state`` (..., state) and ``state_covariance``
    (..., state, state) in m and m^2; ``background_m`` (...), its mean, 0 where the chain removes it;
    ``residual_rms_m`` (...), displacement noise of one pulse; ``pulses``: how many were used; ``condition``: of the
    model, 1 when every state is seen on its own; ``innovations`` where a filter was asked for them; ``aliasing``
    (..., frequency, 2, 2): what of ``covariance`` unresolved harmonics leave, None where it is noise alone.
    """

    frequency_hz: FloatArray
    amplitude_m: FloatArray
    phase_rad: FloatArray
    covariance: FloatArray
    state: FloatArray
    state_covariance: FloatArray
    background_m: FloatArray
    residual_rms_m: FloatArray
    pulses: int
    condition: float = np.nan
    innovations: Innovations | None = None
    aliasing: FloatArray | None = None


def least_squares(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    largest_condition: float = LARGEST_CONDITION,
) -> HarmonicFit:
    """Return all amplitudes and phases from one least-squares fit, with covariance from the residual.

    ``also_hz`` are frequencies that are there as well: fitted, so that they are no residual, and not returned; half
    the pulse rate may be among them. ``background_order`` is that of the polynomial fitted along. Every valid pulse has
    the same weight; the residual is taken as white, for accumulated steps as white plus a random walk. Raises
    ``ValueError`` when the pulses cannot resolve the frequencies (see ``model.linear_model``).
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, largest_condition, background_order=background_order, also_hz=also_hz)
    wanted, (pulses, states) = model.wanted, model.matrix.shape
    state, residual = model.solve(motion.displacement_m[..., motion.valid])
    variance = np.einsum("...i,...i->...", residual, residual) / (pulses - states)
    if motion.walk is not None:
        rows = model.root[wanted] @ (model.matrix @ model.root).T
        variance, covariance = _step_covariance(residual, motion.walk, rows)
    else:
        covariance = variance[..., None, None] * (model.root[wanted] @ model.root[wanted].T)
    return fit_from_state(frequency_hz, state[..., wanted], covariance, variance, pulses, model.condition)


def _step_covariance(residual: FloatArray, walk: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pulse variance (...) and the covariance (..., row, row) of ``rows`` (row, pulse) over summed steps.

    The scale comes from the residual's changes between pulses: two pulses' noise and one step's own.
    """
    changes = np.diff(residual, axis=-1)
    pulse = np.einsum("...i,...i->...", changes, changes) / (changes.shape[-1] - len(rows)) / (2 + walk)
    # a step shifts every later pulse
    over_steps = np.cumsum(rows[:, :0:-1], axis=1)[:, ::-1]
    covariance = pulse[..., None, None] * (rows @ rows.T)
    return pulse, covariance + (walk * pulse)[..., None, None] * (over_steps @ over_steps.T)


def fit_from_state(
    frequency_hz: FloatArray,
    state: FloatArray,
    state_covariance: FloatArray,
    variance: FloatArray,
    pulses: int,
    condition: float = np.nan,
    innovations: Innovations | None = None,
) -> HarmonicFit:
    """Return amplitude and phase with their covariance, from in-phase, quadrature and (if there) the constant."""
    count = frequency_hz.size
    in_phase, quadrature = state[..., 0 : 2 * count : 2], state[..., 1 : 2 * count : 2]
    amplitude = np.hypot(in_phase, quadrature)
    phase = np.arctan2(quadrature, in_phase)
    turn = np.empty((*phase.shape, 2, 2))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(phase)
    turn[..., 0, 1] = np.sin(phase)
    turn[..., 1, 0] = -turn[..., 0, 1]
    pairs = np.arange(2 * count).reshape(count, 2)
    blocks = state_covariance[..., pairs[:, :, None], pairs[:, None, :]]
    turned = turn @ blocks @ np.swapaxes(turn, -1, -2)
    radial = (turned + np.swapaxes(turned, -1, -2)) / 2
    return HarmonicFit(
        frequency_hz,
        amplitude,
        phase,
        _polar_covariance(radial, amplitude),
        state,
        state_covariance,
        state[..., 2 * count] if state.shape[-1] > 2 * count else np.zeros(state.shape[:-1]),
        np.sqrt(variance),
        pulses,
        condition,
        innovations,
    )


def _polar_covariance(radial: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return the covariance of (amplitude, phase) from that along and across the phasor.

    The phase's variance stops at that of an unknown phase, so that a vanishing amplitude stays finite.
    """
    across = radial[..., 1, 1]
    # variance of phase is across / amplitude^2 unless that passes the limit: one scale covers both
    scale = 1 / np.sqrt(np.maximum(amplitude**2, across / PHASE_VARIANCE_LIMIT).clip(min=np.finfo(np.float64).tiny))
    weights = np.stack([np.ones_like(scale), scale], axis=-1)
    return np.asarray(radial * weights[..., :, None] * weights[..., None, :])
