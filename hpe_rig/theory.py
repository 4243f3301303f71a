"""Closed forms and quadratures: radiation force spectrum, difference gain, beam averaging, speckle, bounds."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.conditioning import hann

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Triple = tuple[float, float, float]
GateWindow = Literal["none", "hann"]

DEPTHS = 512
INSTANTS = 96


def force_spectrum(
    harmonic: NDArray[np.int64] | int, burst_rate_hz: float, burst_length_s: float, amplitude: float = 1.0
) -> ComplexArray:
    """Return the complex Fourier coefficients F_n of the force pulse train, time from a burst's onset.

    Shape and order of ``harmonic`` (n, negative ones too), unit of ``amplitude``; the sinusoid at n f_r has the peak
    2 |F_n|. Source: paper eq. (18).
    """
    duty = burst_rate_hz * burst_length_s
    n = np.asarray(harmonic)
    return np.asarray(amplitude * duty * np.sinc(n * duty) * np.exp(-1j * np.pi * n * duty))


def difference_gain(frequency_hz: FloatArray | float, pulse_rate_hz: float) -> FloatArray:
    """Return the gain sinc(f / f_prf) of velocity taken as a difference of consecutive displacements."""
    return np.sinc(np.asarray(frequency_hz) / pulse_rate_hz)


def beam_averaging_factor(
    excitation_width_m: Triple,
    tracking_width_m: Triple,
    gate_length_m: float,
    pulse_length_m: float,
    coherent_sum: bool = False,
    gate_window: GateWindow = "none",
) -> float:
    """Return the expected tracked over peak displacement for coaxial Gaussian beams with a common focus mid-gate.

    Widths are the sigmas E and T of eqs. (12) and (8). Speckle weights each scatterer by its echo's energy in the
    gate, I^2: lateral factors 1/sqrt(1 + T^2 / (2 E^2)), axially a quadrature over the energy that a Hann pulse of
    full length ``pulse_length_m`` (c/2 times its duration) leaves in the gate. With ``gate_window`` "hann" the gate is
    weighted and one frequency read, as ``cross_spectrum`` does. ``coherent_sum``: all echoes start at once (eq. (11) read
    literally), weights are I, and ``gate_length_m`` is the depth that scatterers fill; the pulse has no effect.
    """
    power = 1 if coherent_sum else 2
    lateral = _lateral_moment(excitation_width_m, tracking_width_m, power, 1)
    if coherent_sum:
        depth = _midpoints(gate_length_m, DEPTHS)
        energy = np.ones(DEPTHS)
    else:
        depth = _midpoints(gate_length_m + pulse_length_m, DEPTHS)
        energy = _gate_energy(depth, gate_length_m, pulse_length_m, gate_window)
    weight = energy * np.exp(-power * depth**2 / (2 * tracking_width_m[2] ** 2))
    moved = np.exp(-(depth**2) / (2 * excitation_width_m[2] ** 2))
    return lateral * float(weight @ moved / weight.sum())


def speckle_spread(
    excitation_width_m: Triple,
    tracking_width_m: Triple,
    gate_length_m: float,
    pulse_length_m: float,
    generator: np.random.Generator,
    gate_window: GateWindow = "none",
    draws: int = 4000,
) -> float:
    """Return the standard deviation over speckle draws of tracked over peak displacement, by a small Monte Carlo.

    Fully developed speckle: at each depth the echo and the displacement-weighted echo are a pair of correlated complex
    Gaussians, known by their lateral moments; both are blurred by the pulse, and the tracked displacement is their
    energy-weighted ratio in the gate ("none") or the ratio at the peak of the windowed gate's spectrum ("hann").
    Relative error about 1/sqrt(2 draws).
    """
    depth = _midpoints(gate_length_m + pulse_length_m, DEPTHS // 4)
    mean = _lateral_moment(excitation_width_m, tracking_width_m, 2, 1)
    spread = np.sqrt(_lateral_moment(excitation_width_m, tracking_width_m, 2, 2) - mean**2)
    resting, independent = (_complex_normal(generator, (draws, depth.size)) for _ in range(2))
    moved = np.exp(-(depth**2) / (2 * excitation_width_m[2] ** 2)) * (mean * resting + spread * independent)
    blur = _pulse(_midpoints(gate_length_m, INSTANTS)[:, None] - depth, pulse_length_m)
    blur = (blur * np.exp(-(depth**2) / (2 * tracking_width_m[2] ** 2))).T
    ratio = _gate_ratio if gate_window == "none" else _peak_ratio
    return float(ratio(resting @ blur, moved @ blur).std())


def harmonic_bound(
    amplitude_m: FloatArray | float,
    gate_samples: int,
    pulses: int,
    snr: float,
    carrier_hz: float,
    sound_speed_m_per_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the Cramer-Rao bounds (m, rad) on the standard deviations of amplitude and phase of one harmonic.

    White noise, ``snr`` echo power over noise power in the gate, narrow-band echo, whole cycles; shapes of
    ``amplitude_m``. Source: phase variance 1/(gate_samples snr) of one echo, 2/pulses of it in each quadrature.
    """
    metres = sound_speed_m_per_s / (4 * np.pi * carrier_hz)
    amplitude = np.asarray(amplitude_m, dtype=np.float64)
    deviation = np.full(amplitude.shape, metres * np.sqrt(2 / (pulses * gate_samples * snr)))
    return deviation, deviation / amplitude


def _lateral_moment(excitation_width_m: Triple, tracking_width_m: Triple, power: int, order: int) -> float:
    """Return the mean of (u/u_0)^order over x and y under the weight I^power."""
    squares = [(t / e) ** 2 for e, t in zip(excitation_width_m[:2], tracking_width_m[:2], strict=True)]
    return float(np.prod([1 / np.sqrt(1 + order * square / power) for square in squares]))


def _midpoints(length_m: float, count: int) -> FloatArray:
    return (np.arange(count) + 0.5) / count * length_m - length_m / 2


def _pulse(offset_m: FloatArray, pulse_length_m: float) -> FloatArray:
    """Return the Hann pulse's envelope, eq. (9), at a distance from its middle."""
    inside = np.abs(offset_m) < pulse_length_m / 2
    return np.where(inside, np.cos(np.pi * offset_m / pulse_length_m) ** 2, 0.0)


def _gate_energy(depth: FloatArray, gate_length_m: float, pulse_length_m: float, window: GateWindow) -> FloatArray:
    """Return what the echo from each depth adds to the gate: energy, or squared windowed amplitude at one frequency."""
    envelope = _pulse(_midpoints(gate_length_m, DEPTHS) - depth[:, None], pulse_length_m)
    if window == "none":
        return np.asarray((envelope**2).sum(axis=1))
    return np.asarray((envelope @ hann(DEPTHS)) ** 2)


def _complex_normal(generator: np.random.Generator, shape: tuple[int, int]) -> ComplexArray:
    return generator.standard_normal(shape) + 1j * generator.standard_normal(shape)


def _gate_ratio(resting: ComplexArray, moved: ComplexArray) -> FloatArray:
    return np.sum((np.conj(resting) * moved).real, axis=-1) / np.sum(np.abs(resting) ** 2, axis=-1)


def _peak_ratio(resting: ComplexArray, moved: ComplexArray) -> FloatArray:
    window = hann(resting.shape[-1])
    spectrum = np.fft.fft(resting * window, 8 * window.size)
    peak = np.argmax(np.abs(spectrum), axis=-1)[:, None]
    there = np.take_along_axis(np.fft.fft(moved * window, 8 * window.size), peak, axis=-1)
    return (there / np.take_along_axis(spectrum, peak, axis=-1)).real[:, 0]
