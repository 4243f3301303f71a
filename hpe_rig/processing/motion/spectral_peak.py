"""Velocity from the consecutive cross-spectrum's phase at its peak: paper eqs. (5) and (6).

    C_n(f) = conj(S_n(f)) S_n+1(f)       S: spectrum under a Hann window, zero-padded; f_n = argmax |C_n|
    u_n+1 - u_n = -c arg C_n(f_n) / (4 pi f_n)

The windowed spectra of 130 samples on 184 bins span only about sixty dimensions. Samples are therefore projected onto
an orthonormal basis of these, and the basis onto the padded bins. With phases relative to the gate's centre, the even
half of the samples gives the real parts and the odd half the imaginary parts: a quarter of the products. Chunks of
pulses keep the padded spectra in the cache. For many echoes a compiled loop is used if Numba is installed.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.processing.compilation import numba_installed, use_numba
from hpe_rig.processing.echo.band import band_frequencies_hz
from hpe_rig.processing.echo.conditioning import hann
from hpe_rig.processing.echo.gate import EchoGate, Volts
from hpe_rig.processing.echo.spectrum import fft_is_faster, has_echo, require_pulses
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.motion.phase_shift import are_correlated, motion_of_steps, noise_of_steps

PADDING = 8
"""Zero-padding of the paper: to at least so many times the gate, and to a power of two."""
CHUNK_PULSES = 256
"""Pulses per chunk of padded spectra in memory."""
COMPILED_ECHOES = 20_000
"""Minimum number of echoes for which the compiled loop saves more time than Numba takes to load."""
RANK_TOLERANCE = 1e-13
"""Pivot relative to the largest below which a column is rounding error."""


@dataclass(frozen=True, slots=True)
class PeakSteps:
    """Consecutive cross-spectra of trains.

    ``step`` and ``peak`` (..., pulse - 1): phase at the largest bin, and that bin. ``product`` (..., pulse - 1): sum
    over all bins. ``energy`` (..., pulse): of each echo.
    """

    step: FloatArray
    peak: IndexArray
    product: ComplexArray
    energy: FloatArray

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> PeakSteps:
        """Return uninitialised arrays for the steps between echoes of ``shape`` (..., pulse)."""
        steps = (*shape[:-1], shape[-1] - 1)
        return cls(
            step=np.empty(steps),
            peak=np.empty(steps, np.intp),
            product=np.empty(steps, np.complex128),
            energy=np.empty(shape),
        )


def cross_spectrum(echoes: EchoGate) -> Motion:
    """Return the displacement as a sum of steps, each from the phase at the peak of the consecutive cross-spectrum.

    The phase is divided by the frequency of the peak, which is searched inside the transmitted band. Raises
    ``ValueError`` for fewer than two valid pulses or no echo. Source: eqs. (5) and (6) of the paper, with the peak's
    frequency as w.
    """
    require_pulses(echoes)
    samples = echoes.gate_samples
    bins = padded_bins(samples)
    frequency_hz = band_frequencies_hz(echoes, bins)
    window = hann(samples)
    steps = _steps(echoes, frequency_hz, window, bins)
    # A train without echo has no steps. Effective number of samples in a correlation: length of the squared window.
    cross, band_fraction = np.abs(steps.product), frequency_hz.size / bins
    correlated_samples = band_fraction * np.sum(window**2) ** 2 / np.sum(window**4)
    steps.step[~are_correlated(cross, steps.energy, float(correlated_samples))] = np.nan
    # Noise: padding adds no information, and the Hann window leaves two thirds of the unpadded bins independent.
    independent = frequency_hz.size * samples / bins / 1.5
    variance, step_noise_ratio = noise_of_steps(cross, steps.energy, independent)
    return motion_of_steps(echoes, steps.step, frequency_hz[steps.peak], variance, step_noise_ratio)


def padded_bins(samples: int) -> int:
    """Return the FFT length for a gate of so many samples: a power of two, at least `PADDING` times as long."""
    return 1 << (PADDING * samples - 1).bit_length()


def _steps(echoes: EchoGate, frequency_hz: FloatArray, window: FloatArray, bins: int) -> PeakSteps:
    """Return the phase steps between valid pulses at the peaks of their cross-spectra, chunk by chunk of pulses.

    ``window`` (sample,) is applied to the gate before an FFT of ``bins`` points. NaN for trains without an echo; raises
    ``ValueError`` if none has one.
    """
    volts, valid = echoes.gate_volts, echoes.valid
    shape = (*volts.shape[:-2], int(valid.sum()))
    trains = volts.reshape(-1, *volts.shape[-2:])
    transform = _transform(echoes, frequency_hz, window, bins)
    steps, band_energy = PeakSteps.empty((len(trains), shape[-1])), np.zeros(len(trains))
    use_compiled = use_numba(volts[..., 0].size, COMPILED_ECHOES)
    trains_per_chunk = max(1, CHUNK_PULSES // shape[-1])
    first_trains, first_pulses = range(0, len(trains), trains_per_chunk), range(0, shape[-1] - 1, CHUNK_PULSES)
    for train, first in itertools.product(first_trains, first_pulses):
        chunk = slice(train, train + trains_per_chunk)
        echo = trains[chunk] if valid.all() else trains[chunk][:, valid]
        # The last pulse of a chunk is the first of the next.
        spectra, energy = transform(echo[:, first : first + CHUNK_PULSES + 1])
        band_energy[chunk] += energy[:, min(first, 1) :].sum(axis=1)
        chunk_steps = peak_steps(spectra, use_compiled)
        intervals, pulses = slice(first, first + spectra.shape[1] - 1), slice(first, first + spectra.shape[1])
        steps.step[chunk, intervals], steps.peak[chunk, intervals] = chunk_steps.step, chunk_steps.peak
        steps.product[chunk, intervals], steps.energy[chunk, pulses] = chunk_steps.product, chunk_steps.energy
    product = steps.product.reshape(*shape[:-1], -1)
    product[~has_echo(band_energy.reshape(shape[:-1]) / window.size, echoes)] = np.nan
    return PeakSteps(
        step=steps.step.reshape(product.shape),
        peak=steps.peak.reshape(product.shape),
        product=product,
        energy=steps.energy.reshape(shape),
    )


def peak_steps(spectra: FloatArray, use_compiled: bool = True) -> PeakSteps:
    """Return the phase steps between consecutive spectra, each at the bin where their cross-spectrum is largest.

    ``spectra`` (..., pulse, 2 * bin): the real parts of all bins, then the imaginary parts. ``use_compiled``: by the
    compiled loop if Numba is installed; the results differ by rounding.
    """
    if use_compiled and numba_installed():
        from hpe_rig.processing.motion.spectral_peak_numba import peak_steps as compiled_loop

        steps, pulses = PeakSteps.empty(spectra.shape[:-1]), spectra.shape[-2]
        between = -1, pulses - 1
        compiled_loop(
            np.ascontiguousarray(spectra).reshape(-1, pulses, spectra.shape[-1]),
            steps.step.reshape(between),
            steps.peak.reshape(between),
            steps.product.reshape(between),
            steps.energy.reshape(-1, pulses),
        )
        return steps
    # The magnitude of the cross-spectrum is largest where the product of the powers is.
    bins = spectra.shape[-1] // 2
    real, imag = spectra[..., :bins], spectra[..., bins:]
    power = real**2 + imag**2
    peak = np.argmax(power[..., :-1, :] * power[..., 1:, :], axis=-1)
    before, after = (
        np.take_along_axis(real[..., pulses, :], peak[..., None], axis=-1)[..., 0]
        + 1j * np.take_along_axis(imag[..., pulses, :], peak[..., None], axis=-1)[..., 0]
        for pulses in (slice(None, -1), slice(1, None))
    )
    # Inner product of consecutive echoes over all bins: real part, then imaginary part.
    product = np.einsum("...i,...i->...", spectra[..., :-1, :], spectra[..., 1:, :]).astype(np.complex128)
    product.imag = np.einsum("...i,...i->...", real[..., :-1, :], imag[..., 1:, :])
    product.imag -= np.einsum("...i,...i->...", imag[..., :-1, :], real[..., 1:, :])
    return PeakSteps(step=np.angle(np.conj(before) * after), peak=peak, product=product, energy=power.sum(axis=-1))


def noisy_peak_steps(
    clean: FloatArray,
    echo_index: IndexArray,
    level: FloatArray,
    noise: FloatArray,
    use_compiled: bool = True,
) -> tuple[FloatArray, IndexArray]:
    """Return phase and bin (draw, noise, pulse - 1) at the peaks of the cross-spectra between consecutive noisy echoes.

    The echoes are clean[draw, echo_index[pulse]] + level[draw] * noise. ``clean`` (draw, echo, 2 * bin), ``echo_index``
    (pulse,), ``level`` (draw,), ``noise`` (draw, noise, pulse, 2 * bin); real parts of all bins, then imaginary parts.
    The compiled loop never stores the sum, which is as large as the noise.
    """
    if not (use_compiled and numba_installed()):
        steps = peak_steps(clean[:, None, echo_index] + level[:, None, None, None] * noise, use_compiled=False)
        return steps.step, steps.peak
    from hpe_rig.processing.motion.spectral_peak_numba import noisy_peak_steps as compiled_loop

    shape = (*noise.shape[:2], noise.shape[2] - 1)
    step, peak = np.empty(shape), np.empty(shape, dtype=np.intp)
    compiled_loop(np.ascontiguousarray(clean), echo_index, level, np.ascontiguousarray(noise), step, peak)
    return step, peak


def _transform(
    echoes: EchoGate, frequency_hz: FloatArray, window: FloatArray, bins: int
) -> Callable[[Volts], tuple[FloatArray, FloatArray]]:
    """Return the function from volts (train, pulse, sample) to windowed spectra and to their energy in the band.

    Spectra (train, pulse, 2 * bin): real parts of the bins at ``frequency_hz``, then imaginary parts. The energy
    (train, pulse) is that without ``window``: its side lobes would leak a constant into the band, where it would count
    as an echo.
    """
    samples, rate_hz = window.size, echoes.sample_rate_hz
    # Bins of the spectrum without padding and window, for the energy.
    plain_hz = band_frequencies_hz(echoes, samples)
    if fft_is_faster(samples, frequency_hz.size, bins):

        def by_fft(volts: Volts) -> tuple[FloatArray, FloatArray]:
            """Return spectra and energy by FFTs of ``bins`` points, zero-padded."""
            spectra = _band_fft(volts * window.astype(volts.dtype), rate_hz, frequency_hz, bins)
            return spectra, _energy(_band_fft(volts, rate_hz, plain_hz, samples))

        return by_fft
    arguments = (tuple(values.tolist()) for values in (frequency_hz, window, plain_hz))
    to_coefficients, to_real, to_imag = _short_gate_transform(samples, rate_hz, *arguments)
    even, odd, count = to_real.shape[0], to_imag.shape[0], frequency_hz.size

    def by_matrices(volts: Volts) -> tuple[FloatArray, FloatArray]:
        """Return spectra and energy by two matrix products, which for short gates are faster than an FFT."""
        # Coefficients for the real parts, for the imaginary parts, and the spectrum at ``plain_hz``.
        coefficients = volts.astype(np.float64, copy=False) @ to_coefficients
        spectra = np.empty((*coefficients.shape[:-1], 2 * count))
        np.matmul(coefficients[..., :even], to_real, out=spectra[..., :count])
        np.matmul(coefficients[..., even : even + odd], to_imag, out=spectra[..., count:])
        return spectra, _energy(coefficients[..., even + odd :])

    return by_matrices


def _energy(spectra: FloatArray) -> FloatArray:
    """Return the energy (...) of ``spectra`` (..., 2 * bin)."""
    return np.asarray(np.einsum("...i,...i->...", spectra, spectra))


def _band_fft(volts: Volts, sample_rate_hz: float, frequency_hz: FloatArray, bins: int) -> FloatArray:
    """Return the bins at ``frequency_hz`` of a ``bins``-point FFT (..., 2 * bin): real parts, then imaginary parts."""
    from scipy.fft import rfft

    first = round(frequency_hz[0] * bins / sample_rate_hz)
    spectrum = rfft(volts, bins)[..., first : first + frequency_hz.size]
    return np.concatenate([spectrum.real, spectrum.imag], axis=-1, dtype=np.float64)


@functools.lru_cache(maxsize=8)
def _short_gate_transform(
    samples: int,
    sample_rate_hz: float,
    frequency_hz: tuple[float, ...],
    window: tuple[float, ...],
    plain_hz: tuple[float, ...],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return three real matrices that replace the FFT of a short gate under ``window`` (sample,), of low rank.

    The first (sample, coefficient) gives a few coefficients for the real parts, then for the imaginary parts, and the
    spectrum at ``plain_hz`` without a window. The others (coefficient, bin) give real and imaginary parts at
    ``frequency_hz``. Phases are relative to the gate's centre, which cancels in cross-spectra.
    """
    # Relative to the centre the cosines are even and the sines odd: each spans half of the samples' space.
    centre = (samples - 1) / 2
    windowed = fourier_columns(samples, sample_rate_hz, np.array(frequency_hz), centre) * np.array(window)[:, None]
    real, imag = (np.ascontiguousarray(half) for half in np.hsplit(windowed, 2))
    even, odd = orthonormal_rows(real), orthonormal_rows(imag)
    plain = fourier_columns(samples, sample_rate_hz, np.array(plain_hz), centre)
    return np.ascontiguousarray(np.vstack([even, odd, plain.T]).T), even @ real, odd @ imag


def fourier_columns(
    samples: int, sample_rate_hz: float, frequency_hz: FloatArray, origin_sample: float = 0.0
) -> FloatArray:
    """Return the Fourier transform as a real matrix (sample, 2 * bin): to real parts, then to imaginary parts.

    Voltages (..., sample) times this matrix are the spectrum at ``frequency_hz`` (bin,). Phases are relative to
    ``origin_sample``.
    """
    phase = 2 * np.pi * np.outer((np.arange(samples) - origin_sample) / sample_rate_hz, frequency_hz)
    return np.hstack([np.cos(phase), -np.sin(phase)])


def orthonormal_rows(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis, as rows (coefficient, sample), of the space of ``columns`` (sample, column).

    The design of experiments multiplies it by random coefficients, so it must not depend on rounding. Singular vectors
    of nearly equal singular values do; QR with pivoting does not if the columns differ in size, which a slope ensures.
    """
    from scipy.linalg import qr

    # Columns of equal size would be pivoted in an order that depends on rounding.
    slope = np.linspace(1.0, 0.7, columns.shape[1])
    orthonormal, triangle, _ = qr(columns * slope, mode="economic", pivoting=True)
    pivot = np.diagonal(triangle)
    significant = np.abs(pivot) > RANK_TOLERANCE * np.abs(pivot[0])
    # The sign of a row is arbitrary in the decomposition; the sign of its pivot makes it unique.
    return np.ascontiguousarray((orthonormal[:, significant] * np.sign(pivot[significant])).T)
