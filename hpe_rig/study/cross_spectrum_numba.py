"""Cross-spectrum peak search of the paper in one loop, compiled; `kernels` imports it where Numba is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Loop = TypeVar("Loop", bound=Callable[..., object])

# No spectrum is NaN: only so can the largest of many be found several at a time.
_compiled: Callable[[Loop], Loop] = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"nnan", "nsz", "contract"}
)


@_compiled
def _largest(first: Floats, second: Floats) -> int:
    """Return the first place of the largest product."""
    largest = 0.0
    for i in range(len(first)):
        largest = max(largest, first[i] * second[i])
    for i in range(len(first)):
        if first[i] * second[i] == largest:
            return i
    return 0


@_compiled
def _noisy(clean: Floats, level: float, noise: Floats, value: Floats, power: Floats) -> None:
    bins = len(power)
    for i in range(bins):
        real, imag = clean[i] + level * noise[i], clean[bins + i] + level * noise[bins + i]
        value[i], value[bins + i] = real, imag
        power[i] = real * real + imag * imag


@_compiled
def peak_steps(clean: Floats, which: Integers, level: Floats, noise: Floats, step: Floats, peak: Integers) -> None:
    """Write phase step and place of the peak, (draw, noise, pulse - 1), of consecutive noisy spectra.

    ``clean`` (draw, echo, 2 * bin) and ``noise`` (draw, noise, pulse, 2 * bin): real parts, then imaginary parts;
    ``which`` (pulse,) the echo of every pulse; ``level`` (draw,) of the noise.
    """
    bins = clean.shape[2] // 2
    value, power = np.empty((2, 2 * bins)), np.empty((2, bins))
    for draw in range(len(noise)):
        for n in range(noise.shape[1]):
            _noisy(clean[draw, which[0]], level[draw], noise[draw, n, 0], value[0], power[0])
            for k in range(1, len(which)):
                now, before = k % 2, 1 - k % 2
                _noisy(clean[draw, which[k]], level[draw], noise[draw, n, k], value[now], power[now])
                i = _largest(power[before], power[now])
                a, b, c, d = value[before, i], value[before, bins + i], value[now, i], value[now, bins + i]
                step[draw, n, k - 1] = np.arctan2(a * d - b * c, a * c + b * d)
                peak[draw, n, k - 1] = i
