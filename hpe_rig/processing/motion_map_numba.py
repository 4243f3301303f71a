"""Phases and estimates of a map's pixels in one pass each, compiled; `motion_map` imports it where Numba is loaded.

In single precision like the forms of NumPy, from which they differ by rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numba
import numpy as np

from hpe_rig.arrays import ComplexSingleArray, SingleArray

Loop = TypeVar("Loop", bound=Callable[..., object])

# Sums may be taken in any order: only so are many pulses worked on at a time. NaN stays NaN.
_fast: Final[dict[str, Any]] = {"error_model": "numpy", "fastmath": {"nsz", "contract", "reassoc", "arcp"}}
_compiled: Callable[[Loop], Loop] = numba.njit(nogil=True, cache=True, **_fast)
_inlined: Callable[[Loop], Loop] = numba.njit(inline="always", **_fast)

# atan(a) = a + a^3 P(a^2) for 0 <= a <= 1: least largest relative error, 1.5e-8, a quarter of a single's rounding.
# Found by Lawson's weighted least squares on 4000 Chebyshev nodes; the library's own takes one angle at a time.
C0, C1, C2, C3, C4, C5, C6, C7 = (
    np.float32(each)
    for each in (
        *(-0.33333167, 0.199941372, -0.14214209, 0.106789396),
        *(-0.0758057662, 0.0435535198, -0.0165811709, 0.00297458688),
    )
)
TINY: Final = np.float32(1e-38)
QUARTER_TURN, HALF_TURN, TURN = (np.float32(part * math.pi) for part in (0.5, 1, 2))
UNKNOWN_PHASE_RAD: Final = np.float32(math.pi / math.sqrt(3))


@_inlined
def _angle(y: Any, x: Any) -> Any:
    """Return the angle of (x, y), -pi to pi, rad."""
    beside, up = abs(x), abs(y)
    a = min(beside, up) / max(beside, up, TINY)
    s = a * a
    p = ((((((C7 * s + C6) * s + C5) * s + C4) * s + C3) * s + C2) * s + C1) * s + C0
    angle = a + a * s * p
    angle = QUARTER_TURN - angle if up > beside else angle
    angle = HALF_TURN - angle if x < 0 else angle
    return -angle if y < 0 else angle


def followed(z: ComplexSingleArray) -> SingleArray:
    """Return what `motion_map._followed` returns of ``z`` (..., pulse)."""
    flat = np.ascontiguousarray(z).reshape(-1, z.shape[-1])
    angle = np.empty(flat.shape, np.float32)
    _follow(flat.view(np.float32), angle)
    return angle.reshape(z.shape)


@_compiled
def _follow(parts: SingleArray, angle: SingleArray) -> None:
    """Write the phases (pixel, pulse) of ``parts`` (pixel, 2 * pulse): real, imaginary, real, ..."""
    pulses = angle.shape[1]
    for i in range(len(parts)):
        row, out = parts[i], angle[i]
        # turned so that the first is real, and as large as before; where there is none everything is taken as it is
        a, b, far = row[0], row[1], np.float32(0)
        if a == 0 and b == 0:
            a = np.float32(1)
        else:
            size = max(abs(a), abs(b))
            a, b = a / size, b / size
        for k in range(pulses):
            x, y = row[2 * k], row[2 * k + 1]
            out[k] = _angle(y * a - x * b, x * a + y * b)
            far += out[k] * out[k]
        if far >= QUARTER_TURN * QUARTER_TURN:
            before, turns = out[0], np.float32(0)
            for k in range(1, pulses):
                now = out[k]
                turns += np.rint((now - before) / TURN)
                before = now
                out[k] = now - turns * TURN


@_compiled
def distance(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the sum of squares (pixel,) of ``fitted`` less ``phase`` (pixel, pulse)."""
    total = np.empty(len(phase), np.float32)
    for i in range(len(phase)):
        squares = np.float32(0)
        for k in range(phase.shape[1]):
            squares += (fitted[i, k] - phase[i, k]) ** 2
        total[i] = squares
    return total


@_compiled
def estimates(
    state: SingleArray,
    noise_m2: SingleArray,
    metres: SingleArray,
    relative: SingleArray,
    covariance: SingleArray,
    found: tuple[SingleArray, SingleArray, SingleArray, SingleArray],
) -> None:
    """Write amplitude and phase (pixel, frequency), each followed by its u, of ``state`` (pixel, state) in rad.

    ``covariance`` (3, frequency): mean of in-phase and quadrature, half their difference, what crosses them.
    """
    amplitude, amplitude_u, phase, phase_u = found
    for i in range(len(state)):
        for j in range(amplitude.shape[1]):
            mean, half, crossed = covariance[0, j], covariance[1, j], covariance[2, j]
            x, y = state[i, 2 * j] * metres[i], state[i, 2 * j + 1] * metres[i]
            squared = x * x + y * y
            turned = (half * (x * x - y * y) + 2 * crossed * x * y) / squared
            amplitude[i, j], phase[i, j] = np.sqrt(squared), _angle(y, x)
            amplitude_u[i, j] = np.sqrt(noise_m2[i] * (mean + turned) + relative[i] * squared)
            unsure = np.sqrt(noise_m2[i] * (mean - turned) / squared)
            phase_u[i, j] = UNKNOWN_PHASE_RAD if unsure > UNKNOWN_PHASE_RAD else unsure
