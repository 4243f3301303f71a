"""Phases, residuals and estimates of a map's pixels with NumPy; `kernels_numba` has the same functions compiled."""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.arrays import ComplexSingleArray, SingleArray

MAX_DIRECT_RAD = math.pi / 2
"""Phase against the first pulse up to which no pulse can have passed pi, where the phase would wrap."""
UNKNOWN_PHASE_RAD = np.float32(math.pi / math.sqrt(3))
"""Standard deviation of a phase uniform over a whole period."""


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


def squared_distance(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the sum of squares (pixel,) of ``fitted`` - ``phase`` (pixel, pulse); ``fitted`` is overwritten."""
    fitted -= phase
    return np.asarray(np.einsum("ij,ij->i", fitted, fitted))


def write_amplitude_and_phase(
    state: SingleArray,
    noise_m2: SingleArray,
    metres_per_radian: SingleArray,
    relative_variance: SingleArray,
    unit_covariance: SingleArray,
    results: tuple[SingleArray, SingleArray, SingleArray, SingleArray],
) -> None:
    """Write amplitude and phase (pixel, frequency) of a motion map, each followed by its standard uncertainty.

    ``state`` (pixel, state): in-phase and quadrature of each frequency, rad. ``noise_m2`` (pixel,): noise variance of a
    pulse. ``relative_variance`` (pixel,): of ``metres_per_radian``. ``unit_covariance`` (3, frequency): of in-phase and
    quadrature for a noise variance of 1: mean of their variances, half the difference of these, their covariance.
    """
    amplitude, amplitude_u, phase, phase_u = results
    mean, half_difference, covariance = unit_covariance
    scaled = state[:, : 2 * mean.size] * metres_per_radian[:, None]
    in_phase, quadrature = scaled[:, ::2], scaled[:, 1::2]
    squared = in_phase**2 + quadrature**2
    np.sqrt(squared, out=amplitude)
    np.arctan2(quadrature, in_phase, out=phase)
    with np.errstate(invalid="ignore", divide="ignore"):
        # The variance along the phasor is mean + anisotropy, across it mean - anisotropy.
        difference = half_difference * (in_phase**2 - quadrature**2)
        anisotropy = (difference + 2 * covariance * in_phase * quadrature) / squared
        np.sqrt(noise_m2[:, None] * (mean + anisotropy) + relative_variance[:, None] * squared, out=amplitude_u)
        np.sqrt(noise_m2[:, None] * (mean - anisotropy) / squared, out=phase_u)
    np.minimum(phase_u, UNKNOWN_PHASE_RAD, out=phase_u)
