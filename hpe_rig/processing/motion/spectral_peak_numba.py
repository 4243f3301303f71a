"""Cross-spectrum peak search of the paper in one loop, compiled; `spectral_peak` imports it where Numba is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray

Loop = TypeVar("Loop", bound=Callable[..., object])

# No spectrum is NaN, and sums may be taken in any order: only so are many bins worked on at a time.
_compiled: Callable[[Loop], Loop] = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"nnan", "nsz", "contract", "reassoc"}
)


@_compiled
def _largest(first: FloatArray, second: FloatArray) -> int:
    """Return the first place of the largest product."""
    largest = 0.0
    for i in range(len(first)):
        largest = max(largest, first[i] * second[i])
    for i in range(len(first)):
        if first[i] * second[i] == largest:
            return i
    return 0


@_compiled
def _energies(parts: FloatArray, power: FloatArray) -> float:
    """Write the energy of every bin, and return their sum."""
    bins, total = len(power), 0.0
    for i in range(bins):
        power[i] = parts[i] * parts[i] + parts[bins + i] * parts[bins + i]
        total += power[i]
    return total


@_compiled
def _product(before: FloatArray, after: FloatArray) -> complex:
    """Return the inner product of two spectra."""
    bins, real, imag = len(before) // 2, 0.0, 0.0
    for i in range(bins):
        a, b, c, d = before[i], before[bins + i], after[i], after[bins + i]
        real += a * c + b * d
        imag += a * d - b * c
    return complex(real, imag)


@_compiled
def peak_steps(
    parts: FloatArray, step: FloatArray, peak: IndexArray, product: ComplexArray, energy: FloatArray
) -> None:
    """Write what `spectral_peak.Steps` holds of trains (train, pulse, 2 * bin): real parts, then imaginary parts."""
    bins = parts.shape[2] // 2
    power = np.empty((2, bins))
    for train in range(len(parts)):
        energy[train, 0] = _energies(parts[train, 0], power[0])
        for k in range(1, parts.shape[1]):
            before, after = parts[train, k - 1], parts[train, k]
            energy[train, k] = _energies(after, power[k % 2])
            i = _largest(power[1 - k % 2], power[k % 2])
            a, b, c, d = before[i], before[bins + i], after[i], after[bins + i]
            step[train, k - 1] = np.arctan2(a * d - b * c, a * c + b * d)
            peak[train, k - 1] = i
            product[train, k - 1] = _product(before, after)


@_compiled
def noisy_peak_steps(
    clean: FloatArray, which: IndexArray, level: FloatArray, noise: FloatArray, step: FloatArray, peak: IndexArray
) -> None:
    """Write what `spectral_peak.noisy_peak_steps` returns; no noisy spectrum is there but those of two pulses."""
    columns = clean.shape[2]
    bins = columns // 2
    parts, power = np.empty((2, columns)), np.empty((2, bins))
    for draw in range(noise.shape[0]):
        for each in range(noise.shape[1]):
            for k in range(noise.shape[2]):
                echo, added, here = clean[draw, which[k]], noise[draw, each, k], parts[k % 2]
                for i in range(columns):
                    here[i] = echo[i] + level[draw] * added[i]
                _energies(here, power[k % 2])
                if k > 0:
                    before = parts[1 - k % 2]
                    i = _largest(power[1 - k % 2], power[k % 2])
                    a, b, c, d = before[i], before[bins + i], here[i], here[bins + i]
                    step[draw, each, k - 1] = np.arctan2(a * d - b * c, a * c + b * d)
                    peak[draw, each, k - 1] = i
