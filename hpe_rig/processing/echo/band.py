"""Echo spectra in the transmitted band, and inner products of aligned echoes over the samples of the gate.

An echo that the gate cuts before it is aligned has lost at one edge what it gained at the other. So the spectrum S_k(f)
is that of the record around the gate, tapered where it ends; echoes are aligned, and only then the gate cuts them: the
analytic signal at sample t is E S_k, E[t, f] = exp(2 pi j f t) / sqrt(bins), and the inner product over the gate

    <S_k, S_l> = S_k^H G S_l,    G = E^H W E = 1 - B B^H,

W one in the gate and zero in its margins. The margins hold few independent samples of the band, so that B has few
columns, none where the record ends with the gate. Derivation: docs/explanation/estimation.md.
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import mmap
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.echo.echoes import EchoGate, Volts, margin_samples

BAND = (0.5, 1.5)
"""The transmitted band in units of the carrier: DC and the tonebursts' band stay outside, 75 % bandwidth inside."""
LEAST_IN_BAND = 1e-20
LEAST_IN_FLOAT32 = 1e-12
"""Share of a train's energy that must lie in the band: below it there is nothing but rounding."""
FFT_WORTH = 6.0
"""Products a point and doubling from which on a whole FFT costs less than the wanted bins one by one, measured."""
BLOCK = 64
"""Pulses that are transformed together: few enough to stay in the cache from the volts to the spectrum."""
SHARED_FROM = 1 << 20
"""Points of a train from which on two threads share its blocks."""
TAPER_PERIODS = 1.45
"""Carrier periods at an end of the record that are faded at least, where no margin is left: into the gate."""
SMOOTH = 30**60
"""Divisible by every number of samples without a prime factor above 5."""
MOST_HELD_BYTES = 1 << 25
"""Spectra beyond this lie in a temporary file, of which some pulses at a time are in memory."""
_WRITTEN_AT_ONCE = 1 << 20
LEAST_OUTSIDE = 1e-5
"""Share of a direction's energy in the margins above which it is taken off."""


@dataclass(frozen=True)
class Band:
    """What a gate fixes of its spectra: their bins, and how to weight them over the gate's samples.

    ``margin``: samples before and behind the gate that are used; ``taper`` (sample,) over them and the gate.
    ``frequency_hz`` (bin,), evenly spaced. ``analysis`` (sample, bin): from a record to its tapered spectrum, phases
    counted from the gate's middle, the record's mean taken off, which the taper would spread into the band; ``turn``
    (bin,): its phases and scale as a factor to an FFT, and ``level`` (bin,): the spectrum of a record of ones, which is
    what the mean is taken off by. ``root`` (bin, column), real: B. ``noise`` (bin, bin): covariance of white noise,
    which the taper colours.
    """

    margin: tuple[int, int]
    taper: FloatArray
    frequency_hz: FloatArray
    analysis: ComplexArray
    turn: ComplexArray
    level: ComplexArray
    root: FloatArray
    noise: ComplexArray

    @functools.cached_property
    def fades_gate(self) -> bool:
        """Whether the taper reaches into the gate, whose echoes then change as they move."""
        before, behind = self.margin
        return bool(self.taper[before : self.taper.size - behind].min() < 1)

    @functools.cached_property
    def gated_noise(self) -> ComplexArray:
        """G times the covariance of the noise, (bin, bin)."""
        return np.asarray(self.noise - self.root @ (self.root.T @ self.noise))

    @functools.cached_property
    def noise_energy(self) -> float:
        """Energy of white noise in the gate."""
        return float(np.trace(self.gated_noise).real)

    @functools.cached_property
    def independent(self) -> float:
        """Number of independent complex numbers of white noise in the gate."""
        return self.noise_energy**2 / float(np.einsum("ij,ji->", self.gated_noise, self.gated_noise).real)

    def noise_along(self, gated: ComplexArray, energy: FloatArray) -> FloatArray:
        """Return the energy (...) of white noise along an echo of that ``energy`` (...), ``gated`` (..., bin)."""
        return inner(gated, np.einsum("...i,ji->...j", gated, self.noise)) / np.maximum(
            energy, np.finfo(np.float64).tiny
        )

    def gated(self, echo: ComplexArray) -> ComplexArray:
        """Return G times an echo (..., bin): its product with another echo is that over the gate."""
        return np.asarray(echo - (echo @ self.root) @ self.root.T)

    def outside(self, spectrum: ComplexArray) -> ComplexArray:
        """Return what of spectra (..., pulse, bin) lies in the margins, (..., pulse, column)."""
        return np.swapaxes(real_product(self.root.T, np.swapaxes(spectrum, -1, -2)), -1, -2)


def real_product(matrix: FloatArray, columns: ComplexArray) -> ComplexArray:
    """Return a real ``matrix`` (row, bin) times complex ``columns`` (..., bin, pulse).

    Complex numbers are pairs of neighbours: one real product, half the work.
    """
    both = matrix @ np.ascontiguousarray(columns, dtype=np.complex128).view(np.float64)
    return both.view(np.complex128)


def band_of(echoes: EchoGate) -> Band:
    """Return the band of a gate, with as much of its margins as is of use.

    Raises ``ValueError`` for a gate too short to hold two frequencies of the band.
    """
    wanted = margin_samples(echoes.sample_rate_hz, echoes.carrier_hz)
    before, behind = (min(margin, wanted) for margin in echoes.margin)
    gate = echoes.gate_samples
    band_grid(echoes, gate)
    return _band(before, gate, behind, echoes.sample_rate_hz, echoes.carrier_hz)


@functools.lru_cache(maxsize=32)
def _band(before: int, gate: int, behind: int, sample_rate_hz: float, carrier_hz: float) -> Band:
    samples = before + gate + behind
    # the taper has faded to nothing: zeros behind it, for a faster FFT, are more of the margin
    bins = fast_length(samples) if behind else samples
    middle = before + (gate - 1) / 2
    least = min(round(TAPER_PERIODS * sample_rate_hz / carrier_hz), gate // 4)
    taper = _faded(samples, max(before, least), max(behind, least))
    frequency_hz = _grid(sample_rate_hz, carrier_hz, bins)
    turn = 2 * np.pi * np.outer(np.arange(bins) - middle, frequency_hz / sample_rate_hz)
    signal = np.exp(1j * turn) / np.sqrt(bins)
    analysis = signal[:samples].conj() * taper[:, None]
    level = analysis.sum(axis=0)
    analysis -= level / samples
    noise = analysis.T @ analysis.conj()
    # about the gate's middle E^H E is real, over the gate and so over what is left of all samples
    outside = np.concatenate([signal[:before], signal[before + gate :]])
    share, vectors = np.linalg.eigh((outside.conj().T @ outside).real)
    kept = share > LEAST_OUTSIDE
    root = vectors[:, kept] * np.sqrt(share[kept])
    factor = np.exp(2j * np.pi * middle / sample_rate_hz * frequency_hz) / np.sqrt(bins)
    return Band((before, behind), taper, frequency_hz, analysis, factor, level, root, noise)


def fast_length(samples: int) -> int:
    """Return the smallest number from ``samples`` on with no prime factor above 5: what a Fourier transform likes."""
    return next(count for count in itertools.count(samples) if SMOOTH % count == 0)


def _faded(samples: int, before: int, behind: int) -> FloatArray:
    """Return a window (sample,) of ones with raised cosines over its first and last samples."""
    taper = np.ones(samples)
    for count, part in ((before, taper), (behind, taper[::-1])):
        part[:count] *= np.sin(np.pi / 2 * (np.arange(count) + 0.5) / count) ** 2
    return taper


def band_spectrum(echoes: EchoGate, least_pulses: int) -> tuple[ComplexArray, Band]:
    """Return the spectrum (..., valid pulse, bin) around the gate, NaN for trains without an echo, and its band.

    Bins come first in memory, in the precision of the volts; see `spectra` for those of long trains. Raises
    ``ValueError`` for too few valid pulses, a gate too short to hold two frequencies of the band, and where no train
    has an echo in it.
    """
    require_pulses(echoes, least_pulses)
    band = band_of(echoes)
    first = echoes.gate.start - band.margin[0]
    samples, count = band.analysis.shape
    precision = np.result_type(echoes.volts.dtype, np.complex64)
    spectrum = spectra((*echoes.volts.shape[:-2], count, int(echoes.valid.sum())), precision)
    bins = round(echoes.sample_rate_hz / (band.frequency_hz[1] - band.frequency_hz[0]))
    by_fft = transforms(samples, count, bins)
    done = 0
    with np.errstate(invalid="ignore"):
        for pulses, volts in echoes.blocks(slice(first, first + samples)):
            valid = echoes.valid[pulses]
            here = spectrum[..., done : done + int(valid.sum())]
            # a few bins of what is not valid cost less than a copy of all samples that are; they may hold anything
            made = here if valid.all() else np.empty((*here.shape[:-1], valid.size), precision)
            if by_fft:
                _transform(volts, band, bins, made)
            else:
                _project(volts, band.analysis, made)
            if made is not here:
                np.compress(valid, made, axis=-1, out=here)
            done += here.shape[-1]
            let_go(spectrum)
    spectrum = np.swapaxes(spectrum, -1, -2)
    spectrum[~has_echo(_whole_energy(spectrum), echoes)] = np.nan
    return spectrum, band


def spectra(shape: tuple[int, ...], precision: np.dtype[Any]) -> ComplexArray:
    """Return an array for spectra: in memory or, of more than `MOST_HELD_BYTES`, in a temporary file if it has room."""
    size = int(np.prod(shape)) * precision.itemsize
    if size <= MOST_HELD_BYTES:
        return np.empty(shape, precision)
    try:
        with tempfile.TemporaryFile() as file:
            # written now: a disk that is full is met here and not in the middle of a computation, which it would end
            for first in range(0, size, _WRITTEN_AT_ONCE):
                file.write(bytes(min(size - first, _WRITTEN_AT_ONCE)))
            file.flush()
            # what is mapped stays when the file is closed
            return np.memmap(file, precision, "r+", shape=shape)
    except OSError:
        return np.empty(shape, precision)


def let_go(spectrum: ComplexArray) -> None:
    """Give back the memory of a spectrum that lies in a file, where the system can: its values stay there."""
    mapped = getattr(spectrum, "_mmap", None)
    if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def _transform(volts: Volts, band: Band, bins: int, spectrum: ComplexArray) -> None:
    """Put the spectrum of volts (..., pulse, sample) into ``spectrum`` (..., bin, pulse), by FFT of ``bins`` points."""
    # Here, as in the other ways that transform whole records: few short ones do without, and without loading SciPy.
    from scipy.fft import rfft

    count, pulses = spectrum.shape[-2:]
    start = round(band.frequency_hz[0] / (band.frequency_hz[1] - band.frequency_hz[0]))
    taper = band.taper.astype(volts.dtype)
    turn, level = (each.astype(spectrum.dtype) for each in (band.turn, band.level))

    @np.errstate(invalid="ignore")
    def transform(train: tuple[int, ...], firsts: Iterator[int]) -> None:
        for first in firsts:
            here = slice(first, min(first + BLOCK, pulses))
            some = volts[train][here]
            part = rfft(some * taper, bins)[:, start : start + count] * turn
            # the mean comes off in the band, where there is less of it than there are samples
            part -= np.outer(some.mean(axis=-1), level)
            spectrum[train][:, here] = part.T

    for train in np.ndindex(volts.shape[:-2]):
        firsts = iter(range(0, pulses, BLOCK))
        if pulses * bins < SHARED_FROM:
            transform(train, firsts)
        else:
            from concurrent.futures import ThreadPoolExecutor

            with ThreadPoolExecutor(1) as other:
                # each takes the next block: where another program has half a core, that thread takes fewer
                beside = other.submit(transform, train, firsts)
                transform(train, firsts)
                beside.result()


def _project(volts: Volts, columns: ComplexArray, spectrum: ComplexArray) -> None:
    """Put volts (..., pulse, sample) times columns (sample, bin) into ``spectrum`` (..., bin, pulse)."""
    # one real product: numpy would turn the volts into complex numbers for a complex one
    both = volts.reshape(-1, volts.shape[-1]) @ np.hstack([columns.real, columns.imag]).astype(volts.dtype)
    both = both.reshape(*volts.shape[:-1], -1)
    count = columns.shape[1]
    # what follows works on whole rows of pulses
    by_pulse = np.swapaxes(spectrum, -1, -2)
    by_pulse.real, by_pulse.imag = both[..., :count], both[..., count:]


def require_pulses(echoes: EchoGate, least: int) -> None:
    """Raise ``ValueError`` for fewer than ``least`` valid pulses."""
    found = int(echoes.valid.sum())
    if found < least:
        raise ValueError(f"{found} valid pulses, {least} needed: records are missing; try more tracking pulses")


def _whole_energy(spectrum: ComplexArray) -> FloatArray:
    """Return the energy (...) of spectra (..., pulse, bin), gone through bin by bin."""
    total = np.zeros(spectrum.shape[:-2])
    for index in range(spectrum.shape[-1]):
        # real and imaginary parts in a row
        parts = np.ascontiguousarray(spectrum[..., index]).view(spectrum.real.dtype)
        total += np.einsum("...i,...i->...", parts, parts)
        let_go(spectrum)
    return total


def has_echo(in_band: FloatArray, echoes: EchoGate) -> BoolArray:
    """Return which trains (...) hold more energy ``in_band`` (...) than the rounding of their volts has.

    Raises ``ValueError`` where none does.
    """
    total = echoes.energy[..., echoes.valid].sum(axis=-1)
    least = LEAST_IN_FLOAT32 if echoes.volts.dtype == np.float32 else LEAST_IN_BAND
    found = np.asarray(in_band > least * total)
    if not found.any():
        raise ValueError(
            "no echo: the gate is constant or zero in the transmitted band; check gate, input range and tracking pulser"
        )
    return found


def inner(one: ComplexArray, other: ComplexArray) -> FloatArray:
    """Return the real part of the inner product (...) of spectra (..., bin)."""
    product: FloatArray = np.einsum("...i,...i->...", one.real, other.real)
    product += np.einsum("...i,...i->...", one.imag, other.imag)
    return product


def products_with(echo: ComplexArray, spectrum: ComplexArray) -> ComplexArray:
    """Return the inner product (..., pulse) of one echo (..., bin) with each of spectra (..., pulse, bin).

    Bin by bin, not by BLAS: its threads, once awake, wait for more work on cores where the next echoes are transformed.
    """
    product = np.zeros(spectrum.shape[:-1], np.complex128)
    for index in range(spectrum.shape[-1]):
        product += np.conj(echo[..., index, None]) * spectrum[..., index]
    return product


def energy_of(spectrum: ComplexArray) -> FloatArray:
    """Return the energy (...) of spectra (..., bin)."""
    return inner(spectrum, spectrum)


def band_grid(echoes: EchoGate, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of a ``bins``-point FFT inside the transmitted band, below half the sample rate."""
    inside = _grid(echoes.sample_rate_hz, echoes.carrier_hz, bins)
    if inside.size < 2:
        low, high = (edge * echoes.carrier_hz for edge in BAND)
        raise ValueError(
            f"a gate of {echoes.gate_samples} samples at {echoes.sample_rate_hz:g} Hz has {inside.size} "
            f"frequencies between {low:g} and {high:g} Hz, 2 needed: the gate is too short or the carrier wrong; try a "
            "longer gate"
        )
    return inside


def _grid(sample_rate_hz: float, carrier_hz: float, bins: int) -> FloatArray:
    grid_hz = np.arange(bins // 2) * sample_rate_hz / bins
    low, high = (edge * carrier_hz for edge in BAND)
    return grid_hz[(grid_hz >= low) & (grid_hz <= high)]


def transforms(samples: int, count: int, bins: int) -> bool:
    """Return whether an FFT of ``bins`` points is the faster way from ``samples`` to ``count`` of its bins."""
    return bool(samples * count > FFT_WORTH * bins * np.log2(bins))


def turned(spectrum: ComplexArray, delay_s: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """Return spectra (..., pulse, bin) of evenly spaced bins with every pulse advanced by ``delay_s`` (..., pulse).

    In double precision, whatever that of the spectra. Two exponentials a pulse and a running product in place of one
    exponential a bin.
    """
    step_hz = (frequency_hz[-1] - frequency_hz[0]) / (frequency_hz.size - 1)
    factor = np.exp(2j * np.pi * frequency_hz[0] * delay_s)
    step = np.exp(2j * np.pi * step_hz * delay_s)
    out = np.swapaxes(np.empty((*delay_s.shape[:-1], frequency_hz.size, delay_s.shape[-1]), factor.dtype), -1, -2)
    for index in range(frequency_hz.size):
        # one type at a time: a product of two costs a third more
        here = out[..., index]
        here[...] = spectrum[..., index]
        here *= factor
        factor *= step
    return out


@functools.cache
def compiled() -> bool:
    """Return whether Numba is installed; without it results differ by rounding."""
    return importlib.util.find_spec("numba") is not None
