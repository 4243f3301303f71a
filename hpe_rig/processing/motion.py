"""Echoes to motion: one function an estimator.

Positive displacement is away from the transducer: the echo's delay tau = 2 u / c grows, its phase at frequency f
changes by -2 pi f tau.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.conditioning import hann

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]

BAND = (0.5, 1.5)
"""The transmitted band in units of the carrier: DC and the tonebursts' band stay outside, 75 % bandwidth inside."""


@dataclass(frozen=True, slots=True)
class EchoGate:
    """Gated echoes of one train, ready for estimation; raises ``ValueError`` when shapes or values do not fit.

    ``volts`` (..., pulse, sample): leading axes are independent realisations. ``pulse_time_s`` (pulse,): when each
    pulse senses the displacement (fired plus z/c), increasing. ``valid`` (pulse,): False where a record is missing;
    the samples of such a pulse are never read.
    """

    volts: FloatArray
    sample_rate_hz: float
    pulse_time_s: FloatArray
    carrier_hz: float
    sound_speed_m_per_s: float
    valid: BoolArray

    def __post_init__(self) -> None:
        pulses = self.volts.shape[-2] if self.volts.ndim >= 2 else 0
        if pulses == 0 or self.pulse_time_s.shape != (pulses,) or self.valid.shape != (pulses,):
            raise ValueError(
                f"volts {self.volts.shape}, pulse_time_s {self.pulse_time_s.shape} and valid {self.valid.shape} do not "
                "fit: volts needs the axes (..., pulse, sample), the others (pulse,)"
            )
        if not np.all(np.diff(self.pulse_time_s) > 0):
            raise ValueError("pulse_time_s does not increase: records are out of order; sort them by pulse time")
        if not np.isfinite(self.volts[..., self.valid, :]).all():
            raise ValueError("a pulse marked valid holds samples that are not finite: mark it invalid or read it again")


@dataclass(frozen=True, slots=True)
class Motion:
    """Displacement per pulse, up to a constant.

    ``time_s`` (pulse,); ``displacement_m`` (..., pulse), NaN where not valid; ``variance_m2`` (..., pulse), from that
    pulse's own residual against the reference echo; ``valid`` (pulse,).
    """

    time_s: FloatArray
    displacement_m: FloatArray
    variance_m2: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True)
class Velocity:
    """Mean velocity between consecutive pulses; interval n lies between pulses n and n + 1.

    ``time_s`` (interval,): its middle; ``interval_s`` (interval,): its length; ``velocity_m_per_s`` (..., interval),
    NaN where not valid; ``valid`` (interval,): both pulses are there.
    """

    time_s: FloatArray
    interval_s: FloatArray
    velocity_m_per_s: FloatArray
    valid: BoolArray


def coherent(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from its phase against the mean of all other, aligned echoes.

    The phase is that of the inner product over the whole transmitted band, without a gate window, divided by the
    energy-weighted mean frequency. A first guess from accumulated consecutive phases aligns the echoes, so motion of
    many wavelengths is followed as long as one step stays below a quarter wavelength. Raises ``ValueError`` for fewer
    than two valid pulses or no echo in the band. Source: maximum likelihood for a known echo in white noise.
    """
    _require_pulses(echoes, 2)
    frequency_hz = _band_grid(echoes, echoes.volts.shape[-1])
    spectrum = _spectrum(echoes.volts[..., echoes.valid, :], echoes.sample_rate_hz, frequency_hz)
    phase, mean_hz = _accumulated_phase(spectrum, frequency_hz)
    # the first pass aligns with single-echo noise, the second with the noise of the mean echo
    for _ in range(2):
        phase, mean_hz, variance = _phase_against_others(spectrum, frequency_hz, phase, mean_hz)
    metres = -echoes.sound_speed_m_per_s / (4 * np.pi * mean_hz[..., None])
    return Motion(
        echoes.pulse_time_s,
        _scatter(phase * metres, echoes.valid),
        _scatter(variance * metres**2, echoes.valid),
        echoes.valid,
    )


def cross_spectrum(
    echoes: EchoGate,
    *,
    gate_window: Literal["hann", "none"] = "hann",
    divide_by: Literal["centre", "carrier"] = "centre",
    padding: int = 8,
) -> Velocity:
    """Return the velocity between consecutive pulses from their cross-spectrum's phase at its peak.

    Hann gate, FFT padded ``padding`` times and to a power of two (1: neither), peak searched inside the transmitted
    band, v = -c dtheta / (2 w T), with w = 2 pi times the peak's frequency or the carrier (eq. 6 as printed).
    Raises ``ValueError`` for fewer than two valid pulses or no echo. Source: paper eqs. (5) and (6).
    """
    _require_pulses(echoes, 2)
    samples = echoes.volts.shape[-1]
    bins = samples if padding == 1 else 1 << (padding * samples - 1).bit_length()
    frequency_hz = _band_grid(echoes, bins)
    window = hann(samples) if gate_window == "hann" else np.ones(samples)
    volts = np.where(echoes.valid[:, None], echoes.volts, 0.0) * window
    phase, peak_hz = _peak_phase(_spectrum(volts, echoes.sample_rate_hz, frequency_hz), frequency_hz)
    valid = echoes.valid[:-1] & echoes.valid[1:]
    interval_s = np.diff(echoes.pulse_time_s)
    divisor_hz = peak_hz if divide_by == "centre" else np.full_like(peak_hz, echoes.carrier_hz)
    velocity = -echoes.sound_speed_m_per_s * phase / (4 * np.pi * divisor_hz * interval_s)
    return Velocity(echoes.pulse_time_s[:-1] + interval_s / 2, interval_s, np.where(valid, velocity, np.nan), valid)


def _require_pulses(echoes: EchoGate, least: int) -> None:
    found = int(echoes.valid.sum())
    if found < least:
        raise ValueError(f"{found} valid pulses, {least} needed: records are missing; try more tracking pulses")
    if not np.any(echoes.volts[..., echoes.valid, :], axis=(-2, -1)).all():
        raise ValueError("no echo: every sample of the gate is zero; check gate, input range and tracking pulser")


def _band_grid(echoes: EchoGate, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of a ``bins``-point FFT inside the transmitted band, below half the sample rate."""
    grid_hz = np.arange(bins // 2) * echoes.sample_rate_hz / bins
    low, high = (edge * echoes.carrier_hz for edge in BAND)
    inside = grid_hz[(grid_hz >= low) & (grid_hz <= high)]
    if inside.size < 2:
        raise ValueError(
            f"a gate of {echoes.volts.shape[-1]} samples at {echoes.sample_rate_hz:g} Hz has {inside.size} frequencies "
            f"between {low:g} and {high:g} Hz, 2 needed: the gate is too short or the carrier wrong; try a longer gate"
        )
    return inside


def _spectrum(volts: FloatArray, sample_rate_hz: float, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Fourier transform (..., bin) of ``volts`` (..., sample) at the wanted frequencies only."""
    angle = 2 * np.pi * np.outer(np.arange(volts.shape[-1]) / sample_rate_hz, frequency_hz)
    # two real products: numpy would turn the volts into complex numbers for one complex product
    return volts @ np.cos(angle) - 1j * (volts @ np.sin(angle))


def _accumulated_phase(spectrum: ComplexArray, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return phase (..., pulse) against the first pulse by adding consecutive phases, and the mean frequency (...)."""
    cross = np.conj(spectrum[..., :-1, :]) * spectrum[..., 1:, :]
    step = np.angle(cross.sum(axis=-1))
    start = np.zeros((*step.shape[:-1], 1))
    phase = np.concatenate([start, np.cumsum(step, axis=-1)], axis=-1)
    return phase, _mean_frequency(cross * np.exp(-1j * step)[..., None], frequency_hz)


def _mean_frequency(cross: ComplexArray, frequency_hz: FloatArray) -> FloatArray:
    """Return the energy-weighted mean frequency (...) of aligned cross-spectra (..., pulse, bin).

    Real parts, not magnitudes: noise then averages to zero instead of pulling the mean to the middle of the band.
    """
    energy = cross.real.sum(axis=-2)
    total = energy.sum(axis=-1)
    mean_hz: FloatArray = (energy @ frequency_hz) / np.where(total > 0, total, 1.0)
    usable = (total > 0) & (mean_hz >= frequency_hz[0]) & (mean_hz <= frequency_hz[-1])
    if not usable.all():
        raise ValueError(
            f"echoes of {np.count_nonzero(~usable)} of {usable.size} trains have no common part between "
            f"{frequency_hz[0]:g} and {frequency_hz[-1]:g} Hz: noise without echo, or the wrong carrier; check both"
        )
    return mean_hz


def _phase_against_others(
    spectrum: ComplexArray, frequency_hz: FloatArray, phase: FloatArray, mean_hz: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return refined phase and its variance (..., pulse) and the mean frequency (...)."""
    pulses = spectrum.shape[-2]
    aligned = spectrum * np.exp(-1j * (phase / mean_hz[..., None])[..., None] * frequency_hz)
    # a pulse's own noise in its reference would pull its phase to zero: leave it out
    others = (aligned.sum(axis=-2, keepdims=True) - aligned) / (pulses - 1)
    cross = np.conj(others) * aligned
    product = cross.sum(axis=-1)
    power = np.maximum(np.sum(np.abs(others) ** 2, axis=-1), np.finfo(np.float64).tiny)
    misfit = np.sum(np.abs(aligned - others * (product / power)[..., None]) ** 2, axis=-1)
    variance = misfit / (frequency_hz.size - 1) / (2 * power)
    return phase + np.angle(product), _mean_frequency(cross, frequency_hz), variance


def _peak_phase(spectrum: ComplexArray, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return phase and frequency (..., interval) of the consecutive cross-spectrum's largest bin."""
    magnitude = np.abs(spectrum)
    peak = np.argmax(magnitude[..., :-1, :] * magnitude[..., 1:, :], axis=-1)[..., None]
    before = np.take_along_axis(spectrum[..., :-1, :], peak, axis=-1)[..., 0]
    after = np.take_along_axis(spectrum[..., 1:, :], peak, axis=-1)[..., 0]
    return np.angle(np.conj(before) * after), frequency_hz[peak[..., 0]]


def _scatter(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return values (..., valid pulse) at their places among all pulses, NaN elsewhere."""
    placed = np.full((*values.shape[:-1], valid.size), np.nan)
    placed[..., valid] = values
    return placed
