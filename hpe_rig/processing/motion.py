"""Displacement from the phase of echoes, against their mean or from pulse to pulse: one function an estimator.

Positive displacement is away from the transducer: the echo's delay tau = 2 u / c grows, its phase at frequency f
changes by -2 pi f tau. Derivations and sources: docs/theory/estimation.md.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from hpe_rig.processing.conditioning import hann
from hpe_rig.processing.echoes import (
    ComplexArray,
    EchoGate,
    FloatArray,
    Motion,
    band_grid,
    band_spectrum,
    require_echo,
    require_pulses,
    scatter,
    turned,
    valid_spectrum,
)

DivideBy = Literal["centre", "carrier"]


def coherent(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from its phase against the mean of all other, aligned echoes.

    The phase is that of the inner product over the whole transmitted band, without a gate window, divided by the
    energy-weighted mean frequency. A first guess from accumulated consecutive phases aligns the echoes, so motion of
    many wavelengths is followed as long as one step stays below a quarter wavelength. Raises ``ValueError`` for fewer
    than two valid pulses or no echo in the band. Source: maximum likelihood for a known echo in white noise.
    """
    spectrum, frequency_hz = band_spectrum(echoes, 2)
    phase, variance, mean_hz = coherent_phase(spectrum, frequency_hz)
    return motion_of_phase(echoes, phase, variance, mean_hz[..., None])


def coherent_phase(spectrum: ComplexArray, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return phase and its variance (..., pulse) against all other echoes, and the mean frequency (...)."""
    phase, mean_hz = accumulated_phase(spectrum, frequency_hz)
    power = spectrum.real**2 + spectrum.imag**2
    energy = power.sum(axis=-1), power.sum(axis=-2)
    # the first pass aligns with single-echo noise, the second with the noise of the mean echo
    for _ in range(2):
        phase, mean_hz, variance = _phase_against_others(spectrum, energy, frequency_hz, phase, mean_hz)
    return phase, variance, mean_hz


def kasai(echoes: EchoGate, *, divide_by: DivideBy = "carrier") -> Motion:
    """Return the displacement as the sum of steps from consecutive echoes' phase, averaged over the gate.

    The phase is that of the complex echoes' lag-one correlation, divided by the carrier, as published, or by the
    train's mean frequency. Raises ``ValueError`` as ``coherent``. Source: Kasai et al. (1985).
    """
    spectrum, frequency_hz = band_spectrum(echoes, 2)
    phase, mean_hz = accumulated_phase(spectrum, frequency_hz)
    divisor_hz = mean_hz if divide_by == "centre" else np.full_like(mean_hz, echoes.carrier_hz)
    variance = _pulse_variance(spectrum)
    return motion_of_phase(echoes, phase, variance, divisor_hz[..., None], _walk(spectrum))


def loupas(echoes: EchoGate) -> Motion:
    """Return the displacement as the sum of steps, each phase divided by the centre frequency of its own two echoes.

    The centre frequency is that of the correlation over one sample in depth. Raises ``ValueError`` as ``coherent``.
    Source: Loupas et al. (1995), two-dimensional autocorrelation with two pulses.
    """
    spectrum, frequency_hz = band_spectrum(echoes, 2)
    step, _ = consecutive_phase(spectrum)
    energy = np.abs(spectrum[..., :-1, :]) ** 2 + np.abs(spectrum[..., 1:, :]) ** 2
    turn = energy @ np.exp(2j * np.pi * frequency_hz / echoes.sample_rate_hz)
    centre_hz = np.angle(turn) / (2 * np.pi) * echoes.sample_rate_hz
    return motion_of_steps(echoes, step, centre_hz, _pulse_variance(spectrum), _walk(spectrum))


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
    samples = echoes.volts.shape[-1]
    bins = samples if padding == 1 else 1 << (padding * samples - 1).bit_length()
    frequency_hz = band_grid(echoes, bins)
    window = hann(samples) if gate_window == "hann" else np.ones(samples)
    # the window's side lobes let a constant into the band, which must not pass for an echo: look without
    require_echo(valid_spectrum(echoes, band_grid(echoes, samples)), echoes)
    spectrum = valid_spectrum(echoes, frequency_hz, window)
    step, peak_hz = peak_phase(spectrum, frequency_hz)
    divisor_hz = peak_hz if divide_by == "centre" else np.full_like(peak_hz, echoes.carrier_hz)
    # the padded bins hold no more than the unpadded ones, and the Hann window leaves two thirds of those
    independent = frequency_hz.size * samples / bins / (1.5 if gate_window == "hann" else 1.0)
    return motion_of_steps(echoes, step, divisor_hz, _pulse_variance(spectrum, independent), _walk(spectrum))


def motion_of_phase(
    echoes: EchoGate, phase: FloatArray, variance: FloatArray, frequency_hz: FloatArray, walk: FloatArray | None = None
) -> Motion:
    """Return the motion of phases (..., valid pulse) and their variance, at a frequency (..., 1) of the train."""
    metres = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    return Motion(
        echoes.pulse_time_s,
        scatter(phase * metres, echoes.valid),
        scatter(variance * metres**2, echoes.valid),
        echoes.valid,
        np.abs(np.diff(phase, axis=-1)).max(axis=-1) / np.pi,
        walk,
    )


def motion_of_steps(
    echoes: EchoGate, step: FloatArray, frequency_hz: FloatArray, pulse_variance: FloatArray, walk: FloatArray
) -> Motion:
    """Return the motion whose phase changes by ``step`` (..., valid pulse - 1), each at its own frequency."""
    metres = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    start = np.zeros((*step.shape[:-1], 1))
    displacement_m = np.concatenate([start, np.cumsum(step * metres, axis=-1)], axis=-1)
    scale = np.concatenate([metres[..., :1], metres], axis=-1) ** 2
    return Motion(
        echoes.pulse_time_s,
        scatter(displacement_m, echoes.valid),
        scatter(pulse_variance * scale, echoes.valid),
        echoes.valid,
        np.abs(step).max(axis=-1) / np.pi,
        walk,
    )


def consecutive_phase(spectrum: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return phase steps (..., pulse - 1) averaged over the band, and the cross-spectra (..., pulse - 1, bin)."""
    cross = np.conj(spectrum[..., :-1, :])
    cross *= spectrum[..., 1:, :]
    return np.angle(cross.sum(axis=-1)), cross


def accumulated_phase(spectrum: ComplexArray, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return phase (..., pulse) against the first pulse by adding consecutive phases, and the mean frequency (...)."""
    step, cross = consecutive_phase(spectrum)
    start = np.zeros((*step.shape[:-1], 1))
    phase = np.concatenate([start, np.cumsum(step, axis=-1)], axis=-1)
    energy = (np.exp(-1j * step)[..., None, :] @ cross)[..., 0, :].real
    return phase, mean_frequency(energy, frequency_hz)


def mean_frequency(energy: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return the mean frequency (...) of the energy (..., bin) that aligned echoes have in common.

    Real parts of cross-spectra, not magnitudes: noise then averages to zero instead of pulling the mean to the middle
    of the band.
    """
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
    spectrum: ComplexArray,
    energies: tuple[FloatArray, FloatArray],
    frequency_hz: FloatArray,
    phase: FloatArray,
    mean_hz: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the improved phase, the mean frequency (...), and the phase's variance (..., pulse).

    From ``spectrum`` (..., pulse, bin) and its ``energies``, of every pulse (..., pulse) and bin (..., bin).
    """
    pulses, (energy, energy_of_bin) = spectrum.shape[-2], energies
    aligned = turned(spectrum, -phase / (2 * np.pi * mean_hz[..., None]), frequency_hz)
    total = aligned.sum(axis=-2)
    # a pulse's own noise in its reference would pull its phase to zero: the reference is the total less the pulse
    with_total = (aligned @ np.conj(total)[..., None])[..., 0]
    product = with_total - energy
    tiny = np.finfo(np.float64).tiny
    reference = np.maximum(_energy(total)[..., None] - 2 * with_total.real + energy, tiny)
    misfit = np.maximum(energy - np.abs(product) ** 2 / reference, 0.0)
    variance = misfit / (frequency_hz.size - 1) / (2 * reference) * (pulses - 1) ** 2
    common = np.abs(total) ** 2 - energy_of_bin
    return phase + np.angle(product), mean_frequency(common, frequency_hz), variance


def _energy(spectrum: ComplexArray) -> FloatArray:
    energy: FloatArray = np.einsum("...i,...i->...", spectrum.real, spectrum.real)
    energy += np.einsum("...i,...i->...", spectrum.imag, spectrum.imag)
    return energy


def _pulse_variance(spectrum: ComplexArray, independent: float | None = None) -> FloatArray:
    """Return the phase variance (..., pulse) that the correlation of consecutive echoes implies.

    Two echoes that correlate by rho over M independent bins differ in phase by (1/rho^2 - 1) / (2 M); half of that is
    one pulse's. A pulse takes the better of its two neighbours.
    """
    cross = np.abs(np.sum(np.conj(spectrum[..., :-1, :]) * spectrum[..., 1:, :], axis=-1)) ** 2
    energy = _energy(spectrum)
    tiny = np.finfo(np.float64).tiny
    ratio = np.maximum(energy[..., :-1] * energy[..., 1:], tiny) / np.maximum(cross, tiny)
    step = np.maximum(ratio - 1, 0.0) / (4 * (independent or spectrum.shape[-1]))
    both = np.concatenate([step[..., :1], step], -1), np.concatenate([step, step[..., -1:]], -1)
    return np.asarray(np.minimum(*both))


def _walk(spectrum: ComplexArray) -> FloatArray:
    """Return the variance (...) of a step's own noise over that of a pulse, from the correlation of neighbours.

    Noise times noise of two pulses does not return with the other sign in the next step; it is noise over signal
    power, and rho is signal over signal plus noise.
    """
    cross = np.abs(np.sum(np.conj(spectrum[..., :-1, :]) * spectrum[..., 1:, :], axis=-1)).sum(axis=-1)
    energy = _energy(spectrum)
    whole = np.sqrt(energy[..., :-1] * energy[..., 1:]).sum(axis=-1)
    return np.asarray(np.maximum(whole / np.maximum(cross, np.finfo(np.float64).tiny) - 1, 0.0))


def peak_phase(spectrum: ComplexArray, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return phase and frequency (..., interval) of the consecutive cross-spectrum's largest bin."""
    power = spectrum.real**2 + spectrum.imag**2
    peak = np.argmax(power[..., :-1, :] * power[..., 1:, :], axis=-1)[..., None]
    before = np.take_along_axis(spectrum[..., :-1, :], peak, axis=-1)[..., 0]
    after = np.take_along_axis(spectrum[..., 1:, :], peak, axis=-1)[..., 0]
    return np.angle(np.conj(before) * after), frequency_hz[peak[..., 0]]
