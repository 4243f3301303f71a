"""The transmitted band of a gate: its frequencies, the taper of its records, and the projection onto the gate.

Echoes move across the edges of a gate, so a gate that cuts them before alignment changes their shape. The spectrum
S_k(f) is therefore that of the record around the gate, tapered at its ends. Echoes are aligned first, and the gate
cuts them afterwards. The analytic signal at sample t is E S_k, E[t, f] = exp(2 pi j f t) / sqrt(bins), and the inner
product over the gate

    <S_k, S_l> = S_k^H G S_l,    G = E^H W E = 1 - B B^H,

W one in the gate and zero in its margins. The margins hold few independent samples of the band, so that B has few
columns, and none if the record ends with the gate. Derivation: docs/explanation/estimation.md.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.echo.gate import EchoGate, margin_samples

BAND = (0.5, 1.5)
"""Transmitted band in units of the carrier: excludes DC and the tonebursts' band, includes 75 % bandwidth."""
MIN_TAPER_PERIODS = 1.45
"""Carrier periods tapered at an end of the record without margin; the taper then reaches into the gate."""
MIN_MARGIN_ENERGY = 1e-5
"""Fraction of a direction's energy in the margins below which B omits the direction."""


@dataclass(frozen=True)
class Band:
    """Bins of a gate's spectra, and their weights over the samples of the gate.

    ``margin``: samples used before and after the gate. ``taper`` (sample,) over margins and gate.
    ``frequency_hz`` (bin,): evenly spaced.
    ``analysis`` (sample, bin): record to tapered spectrum, with phases relative to the gate's centre; it removes the
    mean of the record, which the taper would spread into the band.
    ``fft_phasor`` (bin,): the same phases and scale, as a factor to an FFT. ``constant_spectrum`` (bin,): spectrum of a
    tapered record of ones, to remove the mean after an FFT.
    ``margin_root`` (bin, column), real: B. ``noise`` (bin, bin): covariance of white noise, coloured by the taper.
    """

    margin: tuple[int, int]
    taper: FloatArray
    frequency_hz: FloatArray
    analysis: ComplexArray
    fft_phasor: ComplexArray
    constant_spectrum: ComplexArray
    margin_root: FloatArray
    noise: ComplexArray

    @functools.cached_property
    def gated_noise(self) -> ComplexArray:
        """G times the covariance of the noise, (bin, bin)."""
        return np.asarray(self.noise - self.margin_root @ (self.margin_root.T @ self.noise))

    @functools.cached_property
    def noise_energy(self) -> float:
        """Energy of white noise in the gate."""
        return float(np.trace(self.gated_noise).real)

    @functools.cached_property
    def independent_samples(self) -> float:
        """Effective number of independent complex samples of white noise in the gate."""
        return self.noise_energy**2 / float(np.einsum("ij,ji->", self.gated_noise, self.gated_noise).real)

    def noise_along(self, gated: ComplexArray, energy: FloatArray) -> FloatArray:
        """Return the energy (...) of white noise along an echo, given as ``gated`` (..., bin) and its ``energy``."""
        projected = real_inner_product(gated, np.einsum("...i,ji->...j", gated, self.noise))
        return projected / np.maximum(energy, np.finfo(np.float64).tiny)

    def gated(self, echo: ComplexArray) -> ComplexArray:
        """Return G times an echo (..., bin); its product with another echo is then that over the gate."""
        return np.asarray(echo - (echo @ self.margin_root) @ self.margin_root.T)

    def in_margins(self, spectrum: ComplexArray) -> ComplexArray:
        """Return the part of spectra (..., pulse, bin) in the margins, B^H S: (..., pulse, column)."""
        return np.swapaxes(real_matmul(self.margin_root.T, np.swapaxes(spectrum, -1, -2)), -1, -2)


def band_of(echoes: EchoGate) -> Band:
    """Return the band of a gate: which frequencies of its echoes are processed, and how the gate cuts their spectra.

    Samples around the gate are used as margins. Raises ``ValueError`` for a gate too short to resolve
    two frequencies of the band.
    """
    # The frequencies of the gate without margins are not used: this call raises the ValueError.
    band_frequencies_hz(echoes, echoes.gate_samples)
    max_margin = margin_samples(echoes.sample_rate_hz, echoes.carrier_hz)
    before, after = (min(margin, max_margin) for margin in echoes.margin)
    return _band(before, echoes.gate_samples, after, echoes.sample_rate_hz, echoes.carrier_hz)


@functools.lru_cache(maxsize=32)
def _band(before: int, gate: int, after: int, sample_rate_hz: float, carrier_hz: float) -> Band:
    """Return the band of ``gate`` samples with margins of ``before`` and ``after`` samples, for echoes at a carrier.

    A spectrum S is that of gate and margins, tapered in the margins: the signal is E S with E[t, f] = exp(2 pi j f t) /
    sqrt(bins). The inner product of two spectra is a sum over gate and margins. Over the gate alone it is
    S^H (1 - B B^H) S, where B B^H is the part of E^H E from the samples of the margins.
    """
    from scipy.fft import next_fast_len

    samples = before + gate + after
    # A taper that ends in a margin ends at zero: zero padding to a fast FFT length just extends that margin.
    bins = int(next_fast_len(samples, real=True)) if after else samples
    centre = before + (gate - 1) / 2
    min_taper = min(round(MIN_TAPER_PERIODS * sample_rate_hz / carrier_hz), gate // 4)
    taper = _tapered(samples, max(before, min_taper), max(after, min_taper))
    frequency_hz = _grid(sample_rate_hz, carrier_hz, bins)

    # E, with phases relative to the gate's centre; from records to spectra: its inverse with taper, minus the mean of
    # the record; and the covariance of white noise in such spectra.
    phase = 2 * np.pi * np.outer(np.arange(bins) - centre, frequency_hz / sample_rate_hz)
    signal = np.exp(1j * phase) / np.sqrt(bins)
    analysis = signal[:samples].conj() * taper[:, None]
    constant_spectrum = analysis.sum(axis=0)
    analysis -= constant_spectrum / samples
    noise = analysis.T @ analysis.conj()

    # B from the eigenvectors of the margins' part of E^H E. Relative to the centre that matrix is real, over the gate
    # and hence over the remaining samples.
    margins = np.concatenate([signal[:before], signal[before + gate :]])
    energy, directions = np.linalg.eigh((margins.conj().T @ margins).real)
    significant = energy > MIN_MARGIN_ENERGY
    margin_root = directions[:, significant] * np.sqrt(energy[significant])

    fft_phasor = np.exp(2j * np.pi * centre / sample_rate_hz * frequency_hz) / np.sqrt(bins)
    return Band(
        margin=(before, after),
        taper=taper,
        frequency_hz=frequency_hz,
        analysis=analysis,
        fft_phasor=fft_phasor,
        constant_spectrum=constant_spectrum,
        margin_root=margin_root,
        noise=noise,
    )


def _tapered(samples: int, before: int, after: int) -> FloatArray:
    """Return a window (sample,) that rises as a raised cosine over ``before`` samples and falls over ``after``."""
    taper = np.ones(samples)
    for count, edge in ((before, taper), (after, taper[::-1])):
        edge[:count] *= np.sin(np.pi / 2 * (np.arange(count) + 0.5) / count) ** 2
    return taper


def band_frequencies_hz(echoes: EchoGate, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of a ``bins``-point FFT in the transmitted band, below half the sample rate.

    Raises ``ValueError`` for fewer than two.
    """
    frequency_hz = _grid(echoes.sample_rate_hz, echoes.carrier_hz, bins)
    if frequency_hz.size < 2:
        low, high = (edge * echoes.carrier_hz for edge in BAND)
        raise ValueError(
            f"a gate of {echoes.gate_samples} samples at {echoes.sample_rate_hz:g} Hz has {frequency_hz.size} "
            f"frequencies between {low:g} and {high:g} Hz, 2 needed: the gate is too short or the carrier wrong; try a "
            "longer gate"
        )
    return frequency_hz


def _grid(sample_rate_hz: float, carrier_hz: float, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of a ``bins``-point FFT in the transmitted band, Hz; empty if there are none."""
    grid_hz = np.arange(bins // 2) * sample_rate_hz / bins
    low, high = (edge * carrier_hz for edge in BAND)
    return grid_hz[(grid_hz >= low) & (grid_hz <= high)]


def real_matmul(matrix: FloatArray, columns: ComplexArray) -> ComplexArray:
    """Return a real ``matrix`` (row, bin) times complex ``columns`` (..., bin, pulse).

    A view of the complex numbers as pairs gives one real product, half the work of a complex one.
    """
    product = matrix @ np.ascontiguousarray(columns, dtype=np.complex128).view(np.float64)
    return product.view(np.complex128)


def real_inner_product(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Return the real part of the inner product (...) of two sets of spectra (..., bin), without complex products."""
    product: FloatArray = np.einsum("...i,...i->...", first.real, second.real)
    product += np.einsum("...i,...i->...", first.imag, second.imag)
    return product
