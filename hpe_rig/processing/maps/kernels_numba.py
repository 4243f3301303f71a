"""Compiled form of `kernels`, one pass per pixel; imported by `motion_map` only if Numba is used.

In single precision as with NumPy; the results differ by rounding.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hpe_rig.arrays import ComplexSingleArray, SingleArray
from hpe_rig.processing.compilation import compiler

# Sums may be reordered, so that the compiler can process several pulses at once. NaN is preserved.
_FASTMATH: Final = ("nsz", "contract", "reassoc", "arcp")
_compile = compiler(*_FASTMATH)

# atan(a) = a + a³ P(a²) for 0 <= a <= 1: minimax relative error 1.5e-8, a quarter of single-precision rounding. The
# coefficients are by Lawson's weighted least squares on 4000 Chebyshev nodes. The library's atan2 is not vectorised.
C0, C1, C2, C3, C4, C5, C6, C7 = (
    np.float32(coefficient)
    for coefficient in (
        *(-0.33333167, 0.199941372, -0.14214209, 0.106789396),
        *(-0.0758057662, 0.0435535198, -0.0165811709, 0.00297458688),
    )
)
TINY: Final = np.float32(1e-38)
QUARTER_TURN, HALF_TURN, TURN = (np.float32(half_turns * math.pi) for half_turns in (0.5, 1, 2))
UNKNOWN_PHASE_RAD: Final = np.float32(math.pi / math.sqrt(3))


@compiler(*_FASTMATH, inline=True)
def _angle(y: Any, x: Any) -> Any:
    """Return the angle of (x, y), -pi to pi, rad: arctan2 by a polynomial, which compiles to vector instructions."""
    # Tangent of the angle to the nearer axis, at most 1, and its arctan: an odd polynomial with coefficients C0 to C7.
    width, height = abs(x), abs(y)
    a = min(width, height) / max(width, height, TINY)
    s = a * a
    p = ((((((C7 * s + C6) * s + C5) * s + C4) * s + C3) * s + C2) * s + C1) * s + C0
    angle = a + a * s * p
    # From the nearer axis to the x axis, then to the quadrant of the signs.
    angle = QUARTER_TURN - angle if height > width else angle
    angle = HALF_TURN - angle if x < 0 else angle
    return -angle if y < 0 else angle


def unwrapped(z: ComplexSingleArray) -> SingleArray:
    """Return the unwrapped phase of the complex baseband ``z`` (..., pulse) relative to the first pulse, rad."""
    flat = np.ascontiguousarray(z).reshape(-1, z.shape[-1])
    angle = np.empty(flat.shape, np.float32)
    _unwrap(flat.view(np.float32), angle)
    return angle.reshape(z.shape)


@_compile
def _unwrap(real_and_imag: SingleArray, angle: SingleArray) -> None:
    """Write the unwrapped phases (pixel, pulse) relative to the first pulse.

    ``real_and_imag`` (pixel, 2 * pulse): real, imaginary, real, ... of the complex baseband.
    """
    pulses = angle.shape[1]
    for i in range(len(real_and_imag)):
        row, phase = real_and_imag[i], angle[i]
        # Multiplied by the conjugate of the first pulse, scaled to keep its size; by 1 if that is zero.
        a, b, square_sum = row[0], row[1], np.float32(0)
        if a == 0 and b == 0:
            a = np.float32(1)
        else:
            size = max(abs(a), abs(b))
            a, b = a / size, b / size
        for k in range(pulses):
            x, y = row[2 * k], row[2 * k + 1]
            phase[k] = _angle(y * a - x * b, x * a + y * b)
            square_sum += phase[k] * phase[k]
        # The sum of squares bounds every single phase: below it none can have wrapped.
        if square_sum >= QUARTER_TURN * QUARTER_TURN:
            before, turns = phase[0], np.float32(0)
            for k in range(1, pulses):
                now = phase[k]
                turns += np.rint((now - before) / TURN)
                before = now
                phase[k] = now - turns * TURN


@_compile
def squared_distance(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the residual's sum of squares (pixel,): of ``fitted`` - ``phase`` (pixel, pulse), over the pulses."""
    total = np.empty(len(phase), np.float32)
    for i in range(len(phase)):
        squares = np.float32(0)
        for k in range(phase.shape[1]):
            squares += (fitted[i, k] - phase[i, k]) ** 2
        total[i] = squares
    return total


@_compile
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
    for i in range(len(state)):
        for j in range(amplitude.shape[1]):
            mean, half_difference, covariance = unit_covariance[0, j], unit_covariance[1, j], unit_covariance[2, j]
            x, y = state[i, 2 * j] * metres_per_radian[i], state[i, 2 * j + 1] * metres_per_radian[i]
            squared = x * x + y * y
            # The variance along the phasor is mean + anisotropy, across it mean - anisotropy.
            anisotropy = (half_difference * (x * x - y * y) + 2 * covariance * x * y) / squared
            amplitude[i, j], phase[i, j] = np.sqrt(squared), _angle(y, x)
            amplitude_u[i, j] = np.sqrt(noise_m2[i] * (mean + anisotropy) + relative_variance[i] * squared)
            unlimited_u = np.sqrt(noise_m2[i] * (mean - anisotropy) / squared)
            phase_u[i, j] = UNKNOWN_PHASE_RAD if unlimited_u > UNKNOWN_PHASE_RAD else unlimited_u
