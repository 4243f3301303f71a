"""Compiled form of `kernels`, one pass per pixel; imported by `motion_map` only if Numba is used.

In single precision as with NumPy; the results differ by rounding.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hpe_rig.arrays import ComplexSingleArray, SingleArray
from hpe_rig.processing.compilation import compiler
from hpe_rig.result import DETECTED, PHASE_VARIANCE_LIMIT, PRIOR_ODDS, RAYLEIGH_SQUARE

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
# An integer in their place would make Numba compute in double precision, in twice the time.
HALF, ONE, TWO, TWO_THIRDS = (np.float32(number) for number in (0.5, 1, 2, 2 / 3))
QUARTER_TURN, HALF_TURN, TURN = (np.float32(half_turns * math.pi) for half_turns in (0.5, 1, 2))
# Constants of result/phase.py in single precision; at MAX_SNR the probability of no motion is below rounding.
ODDS, RECTIFIED, UNIFORM = (np.float32(c) for c in (PRIOR_ODDS, RAYLEIGH_SQUARE - 1, PHASE_VARIANCE_LIMIT))
AT_DETECTION: Final = np.float32(1 / (1 + PRIOR_ODDS * math.exp(DETECTED**2 / 2)))
MAX_SNR: Final = np.float32(100)


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


def log_amplitude(echo: ComplexSingleArray) -> SingleArray:
    """Return ln(amplitude / rms amplitude over the pulses) of ``echo`` (..., pulse), approximately, as in `kernels`."""
    flat = np.ascontiguousarray(echo).reshape(-1, echo.shape[-1])
    result = np.empty(flat.shape, np.float32)
    _log_amplitude(flat.view(np.float32), result)
    return result.reshape(echo.shape)


@_compile
def _log_amplitude(real_and_imag: SingleArray, result: SingleArray) -> None:
    """Write ln(amplitude / rms amplitude over the pulses) of each pixel, (pixel, pulse), approximately.

    ``real_and_imag`` (pixel, 2 * pulse): real, imaginary, real, ... of the echo.
    """
    pulses = result.shape[1]
    for i in range(len(result)):
        row, log_ratio, power_sum = real_and_imag[i], result[i], np.float32(0)
        # The result first holds the powers.
        for k in range(pulses):
            power = row[2 * k] * row[2 * k] + row[2 * k + 1] * row[2 * k + 1]
            log_ratio[k] = power
            power_sum += power
        scale = ONE / max(power_sum / np.float32(pulses), TINY)
        # ln r = 2 atanh((r - 1) / (r + 1)), its series to third order: good near r = 1.
        for k in range(pulses):
            r = np.sqrt(log_ratio[k] * scale)
            u = (r - ONE) / (r + ONE)
            log_ratio[k] = u * (TWO_THIRDS * u * u + TWO)


@_compile
def residual_energies(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the sum of squares of the residual ``fitted`` - ``phase`` (pixel, pulse), and of its steps, (pixel, 2)."""
    energies = np.empty((len(phase), 2), np.float32)
    for i in range(len(phase)):
        squares, steps = np.float32(0), np.float32(0)
        for k in range(phase.shape[1]):
            fitted[i, k] -= phase[i, k]
            squares += fitted[i, k] ** 2
        for k in range(1, phase.shape[1]):
            steps += (fitted[i, k] - fitted[i, k - 1]) ** 2
        energies[i, 0], energies[i, 1] = squares, steps
    return energies


@compiler(*_FASTMATH, inline=True)
def _no_motion_probability(snr: Any) -> Any:
    """Return the probability that an amplitude is noise, from its square over the noise variance (result/phase.py)."""
    return ONE / (ONE + ODDS * np.exp(min(snr, MAX_SNR) * HALF))


@_compile
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
    for i in range(len(state)):
        scale = metres_per_radian[i]
        for j in range(amplitude.shape[1]):
            mean, half_difference, cross = covariance[i, 0, j], covariance[i, 1, j], covariance[i, 2, j]
            x, y = state[i, 2 * j], state[i, 2 * j + 1]
            amplitude_squared = x * x + y * y
            # The covariance rotated to the phasor: variance mean + anisotropy along it, mean - anisotropy across it.
            anisotropy = (half_difference * (x * x - y * y) + TWO * cross * x * y) / amplitude_squared
            along, across = mean + anisotropy, mean - anisotropy
            # An amplitude that may be noise alone has a Rician bias and, to that extent, an unknown phase.
            no_motion = _no_motion_probability(amplitude_squared / max(along, TINY))
            rician_bias = RECTIFIED * max(no_motion - AT_DETECTION, np.float32(0)) / (ONE - AT_DETECTION) * across
            variance = along + rician_bias + relative_variance[i] * amplitude_squared
            amplitude[i, j], phase[i, j] = np.sqrt(amplitude_squared) * abs(scale), _angle(y * scale, x * scale)
            amplitude_u[i, j] = np.sqrt(variance) * abs(scale)
            angle_variance = min(across / max(amplitude_squared, TINY), UNIFORM)
            phase_u[i, j] = np.sqrt(no_motion * UNIFORM + (ONE - no_motion) * angle_variance)
