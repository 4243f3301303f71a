"""Compiled peak search of consecutive cross-spectra; imported by `spectral_peak` only if Numba is installed."""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.processing.compilation import compiler

# Spectra hold no NaN, and sums may be reordered: the compiler can then process several bins at once.
_compile = compiler("nnan", "nsz", "contract", "reassoc")


@_compile
def _largest(first: FloatArray, second: FloatArray) -> int:
    """Return the first index of the largest product of ``first`` and ``second`` (bin,), both powers."""
    largest = 0.0
    for i in range(len(first)):
        largest = max(largest, first[i] * second[i])
    for i in range(len(first)):
        if first[i] * second[i] == largest:
            return i
    return 0


@_compile
def _energies(spectrum: FloatArray, power: FloatArray) -> float:
    """Write the energy of every bin into ``power`` (bin,), and return their sum.

    ``spectrum`` (2 * bin,): real parts of all bins, then imaginary parts.
    """
    bins, total = len(power), 0.0
    for i in range(bins):
        power[i] = spectrum[i] * spectrum[i] + spectrum[bins + i] * spectrum[bins + i]
        total += power[i]
    return total


@_compile
def _product(before: FloatArray, after: FloatArray) -> complex:
    """Return the inner product of two spectra (2 * bin,): real parts of all bins, then imaginary parts."""
    bins, real, imag = len(before) // 2, 0.0, 0.0
    for i in range(bins):
        a, b, c, d = before[i], before[bins + i], after[i], after[bins + i]
        real += a * c + b * d
        imag += a * d - b * c
    return complex(real, imag)


@_compile
def peak_steps(
    spectra: FloatArray, step: FloatArray, peak: IndexArray, product: ComplexArray, energy: FloatArray
) -> None:
    """Write phase and bin at the peak of each cross-spectrum of consecutive echoes, their inner product, and energies.

    ``spectra`` (train, pulse, 2 * bin): real parts of all bins, then imaginary parts. ``step``, ``peak`` and
    ``product`` (train, pulse - 1) and ``energy`` (train, pulse) are overwritten.
    """
    bins = spectra.shape[2] // 2
    power = np.empty((2, bins))
    for train in range(len(spectra)):
        energy[train, 0] = _energies(spectra[train, 0], power[0])
        for k in range(1, spectra.shape[1]):
            before, after = spectra[train, k - 1], spectra[train, k]
            energy[train, k] = _energies(after, power[k % 2])
            i = _largest(power[1 - k % 2], power[k % 2])
            # Phase of (a - j b) (c + j d), the cross-spectrum at its peak.
            a, b, c, d = before[i], before[bins + i], after[i], after[bins + i]
            step[train, k - 1] = np.arctan2(a * d - b * c, a * c + b * d)
            peak[train, k - 1] = i
            product[train, k - 1] = _product(before, after)


@_compile
def noisy_peak_steps(
    clean: FloatArray, echo_index: IndexArray, level: FloatArray, noise: FloatArray, step: FloatArray, peak: IndexArray
) -> None:
    """Write phase steps and their bins between consecutive noisy spectra, at the peak of each cross-spectrum.

    The noisy spectrum of a pulse is clean[draw, echo_index[pulse]] + level[draw] noise[draw, realisation, pulse].
    ``clean`` (draw, echo, 2 * bin) and ``noise`` (draw, realisation, pulse, 2 * bin): each row holds the real parts of
    all bins, then the imaginary parts. ``step``, ``peak`` (draw, realisation, pulse - 1) are overwritten.
    """
    columns = clean.shape[2]
    bins = columns // 2
    # Two buffers alternate between the current pulse (k % 2) and the previous one (1 - k % 2), since the noisy spectra
    # of all pulses would need as much memory as the noise.
    spectra, power = np.empty((2, columns)), np.empty((2, bins))
    for draw in range(noise.shape[0]):
        for realisation in range(noise.shape[1]):
            for k in range(noise.shape[2]):
                echo, echo_noise, noisy = clean[draw, echo_index[k]], noise[draw, realisation, k], spectra[k % 2]
                for i in range(columns):
                    noisy[i] = echo[i] + level[draw] * echo_noise[i]
                _energies(noisy, power[k % 2])
                if k > 0:
                    before = spectra[1 - k % 2]
                    i = _largest(power[1 - k % 2], power[k % 2])
                    # Phase of (a - j b) (c + j d), the cross-spectrum at its peak.
                    a, b, c, d = before[i], before[bins + i], noisy[i], noisy[bins + i]
                    step[draw, realisation, k - 1] = np.arctan2(a * d - b * c, a * c + b * d)
                    peak[draw, realisation, k - 1] = i
