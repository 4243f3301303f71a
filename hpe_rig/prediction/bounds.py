"""Cramer-Rao bounds on amplitude and phase of a harmonic: narrow-band, and from a scene's own echoes.

Derivations: docs/theory/prediction.md, "Bounds".
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from hpe_rig.arrays import FloatArray


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
