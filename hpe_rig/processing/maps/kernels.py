"""Phases, residuals and estimates of a map's pixels with NumPy; `kernels_numba` has the same functions compiled."""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.arrays import ComplexSingleArray, SingleArray
from hpe_rig.result import phase_variance_rad2, rectified_variance_m2

MAX_DIRECT_RAD = math.pi / 2
"""Phase against the first pulse up to which no pulse can have passed pi, where the phase would wrap."""


def unwrapped(z: ComplexSingleArray) -> SingleArray:
    """Return the unwrapped phase of the complex baseband ``z`` (..., pulse) relative to the first pulse, rad."""
    angle = np.arctan2(np.ascontiguousarray(z.imag), np.ascontiguousarray(z.real))
    angle -= angle[..., :1].copy()
    # The sum of squares bounds every single phase: where it is small, no phase can have wrapped.
    may_wrap = np.einsum("...p,...p->...", angle, angle) >= MAX_DIRECT_RAD**2
    if may_wrap.any():
        # Whole turns between consecutive pulses, subtracted from all later ones.
        wrapped = angle[may_wrap]
        jumps = np.rint(np.diff(wrapped, axis=-1) * np.float32(1 / (2 * np.pi)))
        wrapped[:, 1:] -= np.cumsum(jumps, axis=-1) * np.float32(2 * np.pi)
        angle[may_wrap] = wrapped
    return angle


def log_amplitude(echo: ComplexSingleArray) -> SingleArray:
    """Return the logarithm of the amplitude of ``echo`` (..., pulse) relative to its root mean square.

    For the ratio r of both, ln r = 2 u + 2 u³ / 3 + ... with u = (r - 1) / (r + 1): bounded where an echo vanishes.
    """
    # In place, since every new array costs as much as the arithmetic.
    ratio = echo.real**2
    ratio += echo.imag**2
    ratio /= np.maximum(ratio.mean(axis=-1, keepdims=True), np.finfo(np.float32).tiny)
    np.sqrt(ratio, out=ratio)
    result = ratio - np.float32(1)
    ratio += np.float32(1)
    result /= ratio
    np.square(result, out=ratio)
    ratio += np.float32(3)
    ratio *= np.float32(2 / 3)
    result *= ratio
    return np.asarray(result)


def residual_energies(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the sum of squares of the residual ``fitted`` - ``phase`` (pixel, pulse), and of its steps, (pixel, 2).

    ``fitted`` is overwritten.
    """
    fitted -= phase
    step = np.diff(fitted, axis=-1)
    return np.stack([np.einsum("ij,ij->i", rows, rows) for rows in (fitted, step)], axis=-1)


def write_amplitude_and_phase(
    state: SingleArray,
    covariance: SingleArray,
    metres_per_radian: SingleArray,
    relative_variance: SingleArray,
    results: tuple[SingleArray, SingleArray, SingleArray, SingleArray],
) -> None:
    """Write amplitude and phase (pixel, frequency) of a motion map, each followed by its standard uncertainty.

    ``state`` (pixel, state): in-phase and quadrature of each frequency, rad. ``covariance`` (pixel, 3, frequency) of
    in-phase and quadrature, rad²: mean of their variances, half the difference of these, their covariance.
    ``relative_variance`` (pixel,): of ``metres_per_radian``.
    """
    amplitude, amplitude_u, phase, phase_u = results
    mean, half_difference, cross = (covariance[:, kind] * metres_per_radian[:, None] ** 2 for kind in range(3))
    scaled = state[:, : 2 * amplitude.shape[1]] * metres_per_radian[:, None]
    in_phase, quadrature = scaled[:, ::2], scaled[:, 1::2]
    squared = in_phase**2 + quadrature**2
    np.sqrt(squared, out=amplitude)
    np.arctan2(quadrature, in_phase, out=phase)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # The covariance rotated to the phasor: variance mean + anisotropy along it, mean - anisotropy across it.
        anisotropy = (half_difference * (in_phase**2 - quadrature**2) + 2 * cross * in_phase * quadrature) / squared
        along, across = (np.asarray(mean + sign * anisotropy, np.float64) for sign in (1, -1))
        amplitude_m = amplitude.astype(np.float64)
        # Noise alone also has an amplitude (Rician bias); the conversion from radians has a relative error.
        variance = along + rectified_variance_m2(amplitude_m, along, across) + relative_variance[:, None] * squared
        np.sqrt(variance, out=amplitude_u)
        np.sqrt(phase_variance_rad2(amplitude_m, across, along), out=phase_u)
