"""Cross-spectrum of consecutive echoes, read at its peak: paper eqs. (5) and (6).

    samples of the gate --numbers--> sixty numbers --columns--> spectrum on a padded grid --peak_steps--> its phase

The windowed spectra of a gate of 130 samples on 184 bins are spanned by some sixty numbers, so a train takes the way
over these (``orthonormal_rows``). With phases about the gate's middle half of them make the real parts alone, the
samples' even half, and the others the imaginary parts: a quarter of the products. A few pulses at a time, so that
nothing of the padded grid leaves the cache; in one compiled loop where Numba is installed and the echoes are many.
"""

from __future__ import annotations

import functools
import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.processing.echo.band import band_grid, compiled, has_echo, require_pulses, transforms
from hpe_rig.processing.echo.conditioning import hann
from hpe_rig.processing.echo.echoes import EchoGate, Motion, Volts
from hpe_rig.processing.motion.phase_shift import DivideBy, alike, motion_of_steps, noise_of_steps

AT_ONCE = 256
"""Pulses whose padded spectra are there together."""
COMPILED_WORTH = 20_000
"""Echoes from which on the compiled loop saves more than it takes to load."""
NEGLIGIBLE = 1e-13
"""What is left of a column below this share of the largest is rounding."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Consecutive cross-spectra of trains: ``step`` (..., pulse - 1), their phase where they are largest.

    ``peak`` (..., pulse - 1) the bin where that is; ``product`` (..., pulse - 1), the sum over all bins; ``energy``
    (..., pulse) of each echo.
    """

    step: FloatArray
    peak: IndexArray
    product: ComplexArray
    energy: FloatArray


def cross_spectrum(
    echoes: EchoGate,
    *,
    gate_window: Literal["hann", "none"] = "hann",
    divide_by: DivideBy = "centre",
    padding: int = 8,
) -> Motion:
    """Return the displacement as the sum of steps, each from the consecutive cross-spectrum's phase at its peak.

    Hann gate, FFT padded ``padding`` times and to a power of two (1: neither), peak searched inside the transmitted
    band, step = -c dtheta / (2 w), with w = 2 pi times the peak's frequency or the carrier (eq. 6 as printed).
    Raises ``ValueError`` for fewer than two valid pulses or no echo. Source: paper eqs. (5) and (6).
    """
    require_pulses(echoes, 2)
    samples = echoes.gate_volts.shape[-1]
    bins = samples if padding == 1 else 1 << (padding * samples - 1).bit_length()
    frequency_hz = band_grid(echoes, bins)
    window = hann(samples) if gate_window == "hann" else np.ones(samples)
    steps = _steps(echoes, frequency_hz, window, bins)
    peak_hz = frequency_hz[steps.peak]
    divisor_hz = peak_hz if divide_by == "centre" else np.full_like(peak_hz, echoes.carrier_hz)
    # the padded bins hold no more than the unpadded ones, and the Hann window leaves two thirds of those
    independent = frequency_hz.size * samples / bins / (1.5 if gate_window == "hann" else 1.0)
    cross = np.abs(steps.product)
    # a correlation has as many independent numbers as the squared window is long
    seen = frequency_hz.size / bins * np.sum(window**2) ** 2 / np.sum(window**4)
    steps.step[~alike(cross, steps.energy, float(seen))] = np.nan
    return motion_of_steps(echoes, steps.step, divisor_hz, *noise_of_steps(cross, steps.energy, independent))


def _steps(echoes: EchoGate, frequency_hz: FloatArray, window: FloatArray, bins: int) -> Steps:
    """Return the steps of every train's valid pulses, NaN where a train has no echo; `ValueError` where none has."""
    volts, valid = echoes.gate_volts, echoes.valid
    shape = (*volts.shape[:-2], int(valid.sum()))
    trains = volts.reshape(-1, *volts.shape[-2:])
    transform = _transform(echoes, frequency_hz, window, bins)
    every, in_band = _empty((len(trains), shape[-1])), np.zeros(len(trains))
    fast = compiled() and (volts[..., 0].size > COMPILED_WORTH or "numba" in sys.modules)
    together = max(1, AT_ONCE // shape[-1])
    for train, first in itertools.product(range(0, len(trains), together), range(0, shape[-1] - 1, AT_ONCE)):
        some = slice(train, train + together)
        echo = trains[some] if valid.all() else trains[some][:, valid]
        parts, energy = transform(echo[:, first : first + AT_ONCE + 1])
        # the last pulse of a block is the first of the next
        in_band[some] += energy[:, min(first, 1) :].sum(axis=1)
        made = peak_steps(parts, fast)
        until, own = slice(first, first + parts.shape[1] - 1), slice(first, first + parts.shape[1])
        every.step[some, until], every.peak[some, until] = made.step, made.peak
        every.product[some, until], every.energy[some, own] = made.product, made.energy
    in_band, product = in_band.reshape(shape[:-1]), every.product.reshape(*shape[:-1], -1)
    product[~has_echo(in_band / window.size, echoes)] = np.nan
    between = product.shape
    return Steps(every.step.reshape(between), every.peak.reshape(between), product, every.energy.reshape(shape))


def peak_steps(parts: FloatArray, fast: bool | None = None) -> Steps:
    """Return the steps of spectra (..., pulse, 2 * bin): their real parts, then their imaginary parts.

    ``fast``: in the compiled loop; by default where there is one. Both differ by rounding.
    """
    if compiled() if fast is None else fast:
        from hpe_rig.processing.motion.spectral_peak_numba import peak_steps as loop

        found = _empty(parts.shape[:-1])
        pulses = parts.shape[-2]
        between = -1, pulses - 1
        trains = np.ascontiguousarray(parts).reshape(-1, pulses, parts.shape[-1])
        loop(
            trains,
            found.step.reshape(between),
            found.peak.reshape(between),
            found.product.reshape(between),
            found.energy.reshape(-1, pulses),
        )
        return found
    bins = parts.shape[-1] // 2
    real, imag = parts[..., :bins], parts[..., bins:]
    power = real**2 + imag**2
    peak = np.argmax(power[..., :-1, :] * power[..., 1:, :], axis=-1)
    before, after = (
        np.take_along_axis(real[..., at, :], peak[..., None], axis=-1)[..., 0]
        + 1j * np.take_along_axis(imag[..., at, :], peak[..., None], axis=-1)[..., 0]
        for at in (slice(None, -1), slice(1, None))
    )
    product = np.einsum("...i,...i->...", parts[..., :-1, :], parts[..., 1:, :]).astype(np.complex128)
    product.imag = np.einsum("...i,...i->...", real[..., :-1, :], imag[..., 1:, :])
    product.imag -= np.einsum("...i,...i->...", imag[..., :-1, :], real[..., 1:, :])
    return Steps(np.angle(np.conj(before) * after), peak, product, power.sum(axis=-1))


def noisy_peak_steps(
    clean: FloatArray, which: IndexArray, level: FloatArray, noise: FloatArray, fast: bool | None = None
) -> tuple[FloatArray, IndexArray]:
    """Return phase and bin (draw, noise, pulse - 1) of the peaks of clean[draw, which[pulse]] + level[draw] * noise.

    ``clean`` (draw, echo, 2 * bin), ``which`` (pulse,), ``level`` (draw,), ``noise`` (draw, noise, pulse, 2 * bin), in
    the form of `peak_steps`; ``fast`` as there. The sum is as large as the noise: compiled, it is never made.
    """
    if not (compiled() if fast is None else fast):
        found = peak_steps(clean[:, None, which] + level[:, None, None, None] * noise, fast=False)
        return found.step, found.peak
    from hpe_rig.processing.motion.spectral_peak_numba import noisy_peak_steps as loop

    shape = (*noise.shape[:2], noise.shape[2] - 1)
    step, peak = np.empty(shape), np.empty(shape, dtype=np.intp)
    loop(np.ascontiguousarray(clean), which, level, np.ascontiguousarray(noise), step, peak)
    return step, peak


def _empty(shape: tuple[int, ...]) -> Steps:
    between = (*shape[:-1], shape[-1] - 1)
    return Steps(np.empty(between), np.empty(between, np.intp), np.empty(between, np.complex128), np.empty(shape))


def _transform(
    echoes: EchoGate, frequency_hz: FloatArray, window: FloatArray, bins: int
) -> Callable[[Volts], tuple[FloatArray, FloatArray]]:
    """Return what takes volts (train, pulse, sample) to their windowed spectra and to their energy in the band.

    Spectra as `peak_steps` takes them; the energy (train, pulse) is that without a window, whose side lobes let a
    constant into the band, which must not pass for an echo.
    """
    samples, rate_hz = window.size, echoes.sample_rate_hz
    plain_hz = band_grid(echoes, samples)
    if transforms(samples, frequency_hz.size, bins):

        def by_fft(volts: Volts) -> tuple[FloatArray, FloatArray]:
            parts = _band_fft(volts * window.astype(volts.dtype), rate_hz, frequency_hz, bins)
            return parts, _energy(_band_fft(volts, rate_hz, plain_hz, samples))

        return by_fft
    given = (tuple(each.tolist()) for each in (frequency_hz, window, plain_hz))
    numbers, columns = _ways(samples, rate_hz, *given)
    even, odd = (each.shape[0] for each in columns)

    def by_numbers(volts: Volts) -> tuple[FloatArray, FloatArray]:
        found = volts.astype(np.float64, copy=False) @ numbers
        parts = np.empty((*found.shape[:-1], 2 * frequency_hz.size))
        np.matmul(found[..., :even], columns[0], out=parts[..., : frequency_hz.size])
        np.matmul(found[..., even : even + odd], columns[1], out=parts[..., frequency_hz.size :])
        return parts, _energy(found[..., even + odd :])

    return by_numbers


def _energy(parts: FloatArray) -> FloatArray:
    """Return the energy (...) of ``parts`` (..., part)."""
    return np.asarray(np.einsum("...i,...i->...", parts, parts))


def _band_fft(volts: Volts, sample_rate_hz: float, frequency_hz: FloatArray, bins: int) -> FloatArray:
    """Return some bins (..., 2 * bin) of a ``bins``-point FFT, one after another: real parts, then imaginary ones."""
    from scipy.fft import rfft

    first = round(frequency_hz[0] * bins / sample_rate_hz)
    spectrum = rfft(volts, bins)[..., first : first + frequency_hz.size]
    return np.concatenate([spectrum.real, spectrum.imag], axis=-1, dtype=np.float64)


@functools.lru_cache(maxsize=8)
def _ways(
    samples: int,
    sample_rate_hz: float,
    frequency_hz: tuple[float, ...],
    window: tuple[float, ...],
    plain_hz: tuple[float, ...],
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Return the matrix (sample, number) from samples, and those (number, bin) to real and to imaginary parts.

    The numbers are those of the even half, those of the odd half, and the spectrum at ``plain_hz`` without a window.
    Phases are those about the middle, which cross-spectra do not see.
    """
    columns = _about_middle(samples, sample_rate_hz, np.array(frequency_hz)) * np.array(window)[:, None]
    even, odd = (orthonormal_rows(each) for each in columns)
    numbers = np.vstack([even, odd, *np.swapaxes(_about_middle(samples, sample_rate_hz, np.array(plain_hz)), 1, 2)])
    return np.ascontiguousarray(numbers.T), (even @ columns[0], odd @ columns[1])


def _about_middle(samples: int, sample_rate_hz: float, frequency_hz: FloatArray) -> FloatArray:
    """Return the Fourier transform, phases counted from the gate's middle, (2, sample, bin): real, then imaginary."""
    time_s = (np.arange(samples) - (samples - 1) / 2) / sample_rate_hz
    turn = 2 * np.pi * np.outer(time_s, frequency_hz)
    return np.stack([np.cos(turn), -np.sin(turn)])


def fourier_columns(samples: int, sample_rate_hz: float, frequency_hz: FloatArray) -> FloatArray:
    """Return the Fourier transform as a real matrix (sample, 2 * bin): to real parts, then to imaginary parts."""
    turn = 2 * np.pi * np.outer(np.arange(samples) / sample_rate_hz, frequency_hz)
    return np.hstack([np.cos(turn), -np.sin(turn)])


def orthonormal_rows(columns: FloatArray) -> FloatArray:
    """Return orthonormal rows (number, sample) that span ``columns`` (sample, column).

    Where random numbers multiply them they must not hang on rounding, as singular vectors of nearly equal values do.
    Elimination by the largest column hangs on it where two are equally large: a slope keeps them apart.
    """
    from scipy.linalg import qr

    slope = np.linspace(1.0, 0.7, columns.shape[1])
    orthonormal, triangle, _ = qr(columns * slope, mode="economic", pivoting=True)
    pivot = np.diagonal(triangle)
    kept = np.abs(pivot) > NEGLIGIBLE * np.abs(pivot[0])
    # A decomposition leaves the sign of each row open: that of its pivot settles it.
    return np.ascontiguousarray((orthonormal[:, kept] * np.sign(pivot[kept])).T)
