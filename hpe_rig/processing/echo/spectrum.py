"""Spectra of echoes in the transmitted band, and operations on the spectra of a whole train.

    S_k(f) = sum over samples of taper(t) (r_k(t) - mean r_k) exp(-2 pi j f (t - t_centre)) / sqrt(bins)

by FFT or, for few bins, by a matrix product (`Band.analysis`). Spectra of long trains are kept in a temporary file.
"""

from __future__ import annotations

import mmap
import tempfile
from typing import Any

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.echo.band import Band, band_of
from hpe_rig.processing.echo.gate import EchoGate, Volts

MIN_BAND_ENERGY = {np.dtype(np.float32): 1e-12, np.dtype(np.float64): 1e-20}
"""Fraction of a train's energy in the band, by precision of the volts, below which there is only rounding error."""
FFT_COST = 6.0
"""Cost of an FFT per point and doubling, in products of a matrix multiplication; measured."""
BLOCK_PULSES = 64
"""Pulses transformed together: few enough that volts and spectra stay in the cache."""
MAX_MEMORY_BYTES = 1 << 25
"""Size above which a spectrum is kept in a temporary file."""
_WRITE_BYTES = 1 << 20


def band_spectrum(echoes: EchoGate) -> tuple[ComplexArray, Band]:
    """Return the spectrum (..., valid pulse, bin) of each record around the gate in the transmitted band, and the band.

    NaN for trains without an echo. The bin axis is the slowest in memory; the precision is that of the volts. Raises
    ``ValueError`` for fewer than two valid pulses, a gate too short to resolve two frequencies of the band, and if no
    train has an echo in the band.
    """
    require_pulses(echoes)
    band = band_of(echoes)
    first = echoes.gate.start - band.margin[0]
    samples, count = band.analysis.shape
    precision = np.result_type(echoes.volts.dtype, np.complex64)
    by_bin = spectrum_buffer((*echoes.volts.shape[:-2], count, int(echoes.valid.sum())), precision)
    fft_points = round(echoes.sample_rate_hz / (band.frequency_hz[1] - band.frequency_hz[0]))
    use_fft = fft_is_faster(samples, count, fft_points)
    done = 0
    with np.errstate(invalid="ignore"):
        for pulses, volts in echoes.blocks(slice(first, first + samples)):
            valid = echoes.valid[pulses]
            target = by_bin[..., done : done + int(valid.sum())]
            # Transforming invalid pulses too costs less than copying the valid ones.
            block = target if valid.all() else np.empty((*target.shape[:-1], valid.size), precision)
            if use_fft:
                _transform(volts, band, fft_points, block)
            else:
                _project(volts, band.analysis, block)
            if block is not target:
                np.compress(valid, block, axis=-1, out=target)
            done += target.shape[-1]
            release_pages(by_bin)
    spectrum = np.swapaxes(by_bin, -1, -2)
    spectrum[~has_echo(_train_energy(spectrum), echoes)] = np.nan
    return spectrum, band


def spectrum_buffer(shape: tuple[int, ...], precision: np.dtype[Any]) -> ComplexArray:
    """Return an empty array: in memory or, above `MAX_MEMORY_BYTES`, in a temporary file if the disk has room."""
    size = int(np.prod(shape)) * precision.itemsize
    if size <= MAX_MEMORY_BYTES:
        return np.empty(shape, precision)
    try:
        with tempfile.TemporaryFile() as file:
            # Written now, so that a full disk is an error here; in a mapped array it would end the process.
            for first in range(0, size, _WRITE_BYTES):
                file.write(bytes(min(size - first, _WRITE_BYTES)))
            file.flush()
            # The mapping outlives the closed file.
            return np.memmap(file, precision, "r+", shape=shape)
    except OSError:
        return np.empty(shape, precision)


def release_pages(spectrum: ComplexArray) -> None:
    """Return the memory pages of a spectrum in a file to the system, if it can; the file keeps the values."""
    mapping = getattr(spectrum, "_mmap", None)
    if mapping is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapping.madvise(mmap.MADV_DONTNEED)


def _transform(volts: Volts, band: Band, fft_points: int, spectrum: ComplexArray) -> None:
    """Write the spectrum of volts (..., pulse, sample) into ``spectrum`` (..., bin, pulse), by FFTs of ``fft_points``.

    Records are tapered and lose their mean; ``spectrum`` holds the bins of ``band`` only.
    """
    # Imported only if an FFT is used: short records do without SciPy.
    from scipy.fft import rfft

    count, pulses = spectrum.shape[-2:]
    start = round(band.frequency_hz[0] / (band.frequency_hz[1] - band.frequency_hz[0]))
    taper = band.taper.astype(volts.dtype)
    phasor, constant = (values.astype(spectrum.dtype) for values in (band.fft_phasor, band.constant_spectrum))

    for train in np.ndindex(volts.shape[:-2]):
        for first in range(0, pulses, BLOCK_PULSES):
            block = slice(first, first + BLOCK_PULSES)
            records = volts[train][block]
            in_band = rfft(records * taper, fft_points)[:, start : start + count] * phasor
            # The mean is removed in the band, which has fewer bins than the record has samples.
            in_band -= np.outer(records.mean(axis=-1), constant)
            spectrum[train][:, block] = in_band.T


def _project(volts: Volts, analysis: ComplexArray, spectrum: ComplexArray) -> None:
    """Write the spectrum of volts (..., pulse, sample) into ``spectrum`` (..., bin, pulse) by one matrix product.

    ``analysis`` (sample, bin): record to tapered spectrum. For few bins this is faster than an FFT.
    """
    # One real product: NumPy would convert the volts to complex numbers for a complex one.
    product = volts.reshape(-1, volts.shape[-1]) @ np.hstack([analysis.real, analysis.imag]).astype(volts.dtype)
    product = product.reshape(*volts.shape[:-1], -1)
    count = analysis.shape[1]
    # ``spectrum`` is contiguous along pulses, because later operations work on whole rows of pulses.
    by_pulse = np.swapaxes(spectrum, -1, -2)
    by_pulse.real, by_pulse.imag = product[..., :count], product[..., count:]


def fft_is_faster(samples: int, count: int, fft_points: int) -> bool:
    """Return whether an FFT of ``fft_points`` is faster than a matrix from ``samples`` to ``count`` bins."""
    return bool(samples * count > FFT_COST * fft_points * np.log2(fft_points))


def require_pulses(echoes: EchoGate) -> None:
    """Raise ``ValueError`` for fewer than two valid pulses."""
    count = int(echoes.valid.sum())
    if count < 2:
        raise ValueError(f"{count} valid pulses, 2 needed: records are missing; try more tracking pulses")


def has_echo(band_energy: FloatArray, echoes: EchoGate) -> BoolArray:
    """Return which trains (...) have an echo: more energy in the band than the rounding error of their volts.

    ``band_energy`` (...): summed over the pulses of a train. Raises ``ValueError`` if no train has an echo.
    """
    total = echoes.energy[..., echoes.valid].sum(axis=-1)
    present = np.asarray(band_energy > MIN_BAND_ENERGY[echoes.volts.dtype] * total)
    if not present.any():
        raise ValueError(
            "no echo: the gate is constant or zero in the transmitted band; check gate, input range and tracking pulser"
        )
    return present


def _train_energy(spectrum: ComplexArray) -> FloatArray:
    """Return the energy (...) of the spectra (..., pulse, bin) of each train, summed bin by bin to save memory."""
    total = np.zeros(spectrum.shape[:-2])
    for index in range(spectrum.shape[-1]):
        # Real and imaginary parts as one row of real numbers.
        real_and_imag = np.ascontiguousarray(spectrum[..., index]).view(spectrum.real.dtype)
        total += np.einsum("...i,...i->...", real_and_imag, real_and_imag)
        release_pages(spectrum)
    return total


def inner_products(echo: ComplexArray, spectrum: ComplexArray) -> ComplexArray:
    """Return the inner product (..., pulse) of one echo (..., bin) with each of spectra (..., pulse, bin).

    Bin by bin instead of BLAS: its idle threads would compete with the transform of the next echoes for the cores.
    """
    product = np.zeros(spectrum.shape[:-1], np.complex128)
    for index in range(spectrum.shape[-1]):
        product += np.conj(echo[..., index, None]) * spectrum[..., index]
    return product


def advanced(spectrum: ComplexArray, delay_s: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """Return spectra (..., pulse, bin) with the echo of each pulse advanced in time by its ``delay_s`` (..., pulse).

    The bins are evenly spaced and the result in double precision. Two exponentials per pulse and a running product
    replace one exponential per bin.
    """
    step_hz = (frequency_hz[-1] - frequency_hz[0]) / (frequency_hz.size - 1)
    # Factor exp(2 pi j f delay) of the first bin, and from one bin to the next.
    phasor = np.exp(2j * np.pi * frequency_hz[0] * delay_s)
    step = np.exp(2j * np.pi * step_hz * delay_s)
    by_bin = np.empty((*delay_s.shape[:-1], frequency_hz.size, delay_s.shape[-1]), phasor.dtype)
    result = np.swapaxes(by_bin, -1, -2)
    for index in range(frequency_hz.size):
        # Conversion before the product: a product of two types takes a third longer.
        column = result[..., index]
        column[...] = spectrum[..., index]
        column *= phasor
        phasor *= step
    return result
