"""Cramer-Rao bounds: delay between speckle signals, amplitude and phase of a harmonic; correlation of moved echoes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.special import roots_jacobi

FloatArray = NDArray[np.float64]


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


def echo_bound(
    resting_v: FloatArray,
    sample_rate_hz: float,
    noise_v: FloatArray | float,
    columns: FloatArray,
    sound_speed_m_per_s: float,
) -> FloatArray:
    """Return the Cramer-Rao covariance (..., state, state) of states x from a scene's own echoes.

    The echo ``resting_v`` (..., sample) shifts as a whole by the displacement ``columns`` (pulse, state) @ x; it is
    unknown itself, which costs what the columns have in common with a constant. ``noise_v`` is the rms of white noise.
    The derivative of the echo is that of a quintic spline: an FFT would take the gate's ends for a jump that moves.
    Source: Fisher information, resting echo as nuisance parameter.
    """
    sample_s = np.arange(resting_v.shape[-1]) / sample_rate_hz
    slope = make_interp_spline(sample_s, resting_v, 5, axis=-1)(sample_s, 1) * 2 / sound_speed_m_per_s
    information = np.sum(slope**2, axis=-1) / np.square(noise_v)
    centred = columns - columns.mean(axis=0)
    return np.asarray(np.linalg.inv(centred.T @ centred) / information[..., None, None])


def speckle_delay_bound(
    centre_hz: float, window_s: float, fractional_bandwidth: float, correlation: float, amplitude_snr: float
) -> float:
    """Return the bound, s, on the standard deviation of the delay between two partially correlated speckle signals.

    Flat band, ``amplitude_snr`` an rms ratio in that band; holds where bandwidth times window is well above 1. Source:
    Walker and Trahey (1995).
    """
    band = fractional_bandwidth**3 + 12 * fractional_bandwidth
    surplus = (1 + 1 / amplitude_snr**2) ** 2 / correlation**2 - 1
    return float(np.sqrt(3 / (2 * centre_hz**3 * np.pi**2 * window_s * band) * surplus))


def echo_correlation(
    displacement_m: FloatArray | float,
    width_ratio: float,
    carrier_hz: float,
    sound_speed_m_per_s: float,
    power: int = 2,
) -> NDArray[np.complex128]:
    """Return the complex correlation of an echo with itself at rest, at the carrier, shapes of ``displacement_m``.

    Circular Gaussian beams, ``width_ratio`` W = E/T across, no axial variation; its magnitude is the correlation at
    the best lag, its phase that of the tracked motion. ``power`` 2: speckle, 1: echoes in phase. Source: mean of
    exp(j theta u/u0) under the weight I^power, Kummer's M(a, a + 1, j theta) with a = power W^2.
    """
    theta = 4 * np.pi * carrier_hz / sound_speed_m_per_s * np.asarray(displacement_m, dtype=np.float64)
    shape = power * width_ratio**2
    # Gauss-Jacobi takes the weight s^(a - 1) exactly; scipy's hyp1f1 is wrong in the fourth digit at theta = 73
    nodes, weights = roots_jacobi(40 + int(np.abs(theta).max(initial=0.0)), 0.0, shape - 1)
    turns = np.exp(0.5j * np.multiply.outer(theta, 1 + nodes))
    return np.asarray(turns @ (weights / weights.sum()))
