"""Displacement to amplitude and phase: D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + constant, eq. (1).

The state of a frequency is (A cos phi, A sin phi), so the model is linear; all frequencies and the constant are
estimated at once. State order: in-phase and quadrature of each frequency, then the constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from hpe_rig.processing.motion import Motion

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PHASE_VARIANCE_LIMIT = np.pi**2 / 3
"""Variance of a phase about which nothing is known, rad^2."""


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Amplitude and phase per frequency, with covariance.

    ``frequency_hz`` (frequency,); ``amplitude_m`` and ``phase_rad`` (..., frequency), phase in (-pi, pi];
    ``covariance`` (..., frequency, 2, 2) of (amplitude, phase); ``state`` (..., state) and ``state_covariance``
    (..., state, state) in m and m^2; ``background_m`` (...), the constant, 0 where the chain removes it;
    ``residual_rms_m`` (...), displacement noise of one pulse; ``pulses``: how many were used.
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


def least_squares(
    motion: Motion,
    frequencies_hz: FloatArray | list[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    largest_condition: float = 100.0,
) -> HarmonicFit:
    """Return all amplitudes and phases from one QR least-squares fit, with covariance from the residual.

    ``also_hz`` are frequencies that are there as well: fitted, so that they are no residual, and not returned; half
    the pulse rate may be among them. Every valid pulse has the same weight; the covariance takes the residual as
    white. Raises ``ValueError`` when the pulses cannot tell the frequencies apart (see ``design``).
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    matrix = design(motion.time_s, motion.valid, frequency_hz, largest_condition, also_hz=also_hz)
    q, r = np.linalg.qr(matrix)
    displacement = motion.displacement_m[..., motion.valid]
    inverse = solve_triangular(r, np.eye(r.shape[0]))
    state = (displacement @ q) @ inverse.T
    residual = displacement - state @ matrix.T
    variance = np.sum(residual**2, axis=-1) / (matrix.shape[0] - matrix.shape[1])
    wanted = slice(0, 2 * frequency_hz.size + 1)
    covariance = variance[..., None, None] * (inverse @ inverse.T)[wanted, wanted]
    return fit_from_state(frequency_hz, state[..., wanted], covariance, variance, len(matrix))


def kalman(
    motion: Motion,
    frequencies_hz: FloatArray | list[float],
    *,
    process_noise: float = 0.0,
    prior: float = 1e10,
    largest_condition: float = 100.0,
) -> HarmonicFit:
    """Return all amplitudes and phases from a square-root Kalman filter over the valid pulses.

    ``process_noise`` and ``prior`` are variances of a state's change per pulse and of its start, both in units of the
    measurement noise, which itself follows from the innovations. Without process noise this is recursive least
    squares. Raises ``ValueError`` as ``least_squares``. Source: harmonic state of Zheng et al. (2007), Potter's form.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    matrix = design(motion.time_s, motion.valid, frequency_hz, largest_condition)
    displacement = motion.displacement_m[..., motion.valid]
    gaps = np.diff(np.flatnonzero(motion.valid), prepend=np.flatnonzero(motion.valid)[0])
    state, root, fitness = filter_states(matrix, displacement, process_noise * gaps, prior)
    variance = fitness / (matrix.shape[0] - matrix.shape[1])
    return fit_from_state(frequency_hz, state, variance[..., None, None] * (root @ root.T), variance, len(matrix))


def filter_states(
    matrix: FloatArray, data: FloatArray, process_variance: FloatArray, prior: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return last state (..., state), covariance root (state, state) and sum of squared normalised innovations (...).

    ``matrix`` (pulse, state), ``data`` (..., pulse), ``process_variance`` (pulse,) before each pulse; everything in
    units of the measurement noise. The root keeps the covariance positive whatever the ratio of prior to noise.
    """
    states = matrix.shape[1]
    root = np.sqrt(prior) * np.eye(states)
    state = np.zeros((*data.shape[:-1], states))
    fitness = np.zeros(data.shape[:-1])
    for k, row in enumerate(matrix):
        if process_variance[k] > 0:
            stacked = np.vstack([root.T, np.sqrt(process_variance[k]) * np.eye(states)])
            root = np.linalg.qr(stacked)[1].T
        seen = root.T @ row
        innovation_variance = 1.0 + seen @ seen
        gain = root @ seen / innovation_variance
        innovation = data[..., k] - state @ row
        state = state + innovation[..., None] * gain
        root = root - np.outer(gain, seen) / (1.0 + 1.0 / np.sqrt(innovation_variance))
        fitness = fitness + innovation**2 / innovation_variance
    return state, root, fitness


def harmonic_columns(time_s: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return sin and cos of 2 pi f t, interleaved (pulse, 2 * frequency).

    The cycles before the first pulse are counted exactly, in fractions: a start at 1e5 s loses no phase.
    """
    start = Fraction(float(time_s[0]))
    before = np.array([float(Fraction(float(f)) * start % 1) for f in frequency_hz])
    angle = 2 * np.pi * (np.outer(time_s - time_s[0], frequency_hz) + before)
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1).reshape(time_s.size, -1)


def design(
    time_s: FloatArray,
    valid: BoolArray,
    frequency_hz: FloatArray,
    largest_condition: float,
    *,
    constant: bool = True,
    also_hz: FloatArray | Sequence[float] = (),
) -> FloatArray:
    """Return the model matrix (valid pulse, state): wanted frequencies, constant, then the others (``also_hz``).

    Raises ``ValueError`` for no or non-positive or repeated frequencies, a frequency at or above half the pulse rate,
    too few pulses, or frequencies too close for the time they are watched.
    """
    _require_frequencies(time_s, frequency_hz)
    others = _other_columns(time_s, frequency_hz, np.asarray(also_hz, dtype=np.float64))
    states = 2 * frequency_hz.size + constant + others.shape[1]
    found = int(valid.sum())
    if found <= states:
        raise ValueError(
            f"{found} valid pulses cannot give {states} unknowns and their uncertainty: too few; "
            f"try at least {states + 1} pulses or fewer frequencies"
        )
    columns = [harmonic_columns(time_s, frequency_hz), *[np.ones((time_s.size, 1))] * constant, others]
    matrix: FloatArray = np.hstack(columns)[valid]
    condition = np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0).clip(min=np.finfo(np.float64).tiny))
    if not condition <= largest_condition:
        raise ValueError(_unresolved(time_s[valid], frequency_hz, condition, largest_condition))
    return matrix


def _other_columns(time_s: FloatArray, frequency_hz: FloatArray, also_hz: FloatArray) -> FloatArray:
    """Return the columns of ``also_hz`` without those of ``frequency_hz``; half the pulse rate has only one."""
    rate_hz = 1 / float(np.median(np.diff(time_s)))
    new_hz = also_hz[~np.isclose(also_hz[:, None], frequency_hz, rtol=1e-9, atol=0).any(axis=1)]
    below = new_hz[new_hz < rate_hz / 2 * (1 - 1e-6)]
    columns = harmonic_columns(time_s, below) if below.size else np.zeros((time_s.size, 0))
    if np.isclose(new_hz, rate_hz / 2, rtol=1e-6, atol=0).any():
        alternating = np.cos(np.pi * np.round((time_s - time_s[0]) * rate_hz))
        columns = np.hstack([columns, alternating[:, None]])
    return columns


def fit_from_state(
    frequency_hz: FloatArray, state: FloatArray, state_covariance: FloatArray, variance: FloatArray, pulses: int
) -> HarmonicFit:
    """Return amplitude and phase with their covariance, from in-phase, quadrature and (if there) the constant."""
    count = frequency_hz.size
    in_phase, quadrature = state[..., 0 : 2 * count : 2], state[..., 1 : 2 * count : 2]
    amplitude = np.hypot(in_phase, quadrature)
    phase = np.arctan2(quadrature, in_phase)
    turn = np.stack([np.stack([np.cos(phase), np.sin(phase)], -1), np.stack([-np.sin(phase), np.cos(phase)], -1)], -2)
    first = 2 * np.arange(count)
    pairs = np.stack([first, first + 1], axis=-1)
    blocks = state_covariance[..., pairs[:, :, None], pairs[:, None, :]]
    radial = turn @ blocks @ np.swapaxes(turn, -1, -2)
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


def _require_frequencies(time_s: FloatArray, frequency_hz: FloatArray) -> None:
    if frequency_hz.ndim != 1 or frequency_hz.size == 0:
        raise ValueError("no vibration frequency given: name at least one")
    if not np.all(np.isfinite(frequency_hz) & (frequency_hz > 0)):
        raise ValueError(f"frequencies {frequency_hz.tolist()} Hz: each must be finite and above zero")
    if np.unique(frequency_hz).size != frequency_hz.size:
        raise ValueError(f"frequencies {frequency_hz.tolist()} Hz name one twice: it cannot be told from itself")
    if time_s.size < 2:
        raise ValueError(f"{time_s.size} pulse: no motion can be seen; try more tracking pulses")
    rate_hz = 1 / float(np.median(np.diff(time_s)))
    if frequency_hz.max() >= rate_hz / 2 * (1 - 1e-9):
        raise ValueError(
            f"frequency {frequency_hz.max():g} Hz is not below half the pulse rate of {rate_hz:g} Hz: "
            "it would be aliased; try a higher pulse rate or fewer harmonics"
        )


def _unresolved(time_s: FloatArray, frequency_hz: FloatArray, condition: float, limit: float) -> str:
    span_s = float(time_s[-1] - time_s[0])
    closest_hz = float(np.min(np.diff(np.sort(frequency_hz), prepend=0.0)))
    return (
        f"frequencies {frequency_hz.tolist()} Hz cannot be told apart (condition {condition:.3g}, limit {limit:g}): "
        f"the closest two, zero included, are {closest_hz:g} Hz apart and watched for {span_s:g} s, or the valid "
        f"pulses are spaced badly; try at least {1 / closest_hz:g} s or other frequencies"
    )
