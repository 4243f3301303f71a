"""From a generator's output to the transducer: hybrid junction, power amplifier, matching transformer.

A saturating amplifier flattens the carrier: the fundamental grows less than the drive, and odd harmonics appear, of
which a 3 MHz toneburst's third falls on the 9 MHz of the tracking pulses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Transmitter

Floats = NDArray[np.float64]

_PHASES = 64


def harmonic_v(drive_vpp: Floats, transmitter: Transmitter, harmonic: int = 1) -> Floats:
    """Return the amplitude of a harmonic of the carrier at the transducer, V, shape of ``drive_vpp``.

    ``drive_vpp`` at the hybrid's input, from one generator alone. Negative where the harmonic is in counterphase.
    """
    amplifier_v = drive_vpp / 2 * _gain(transmitter.gain_db - transmitter.hybrid_loss_db)
    if transmitter.saturation_v is None:
        out_v = amplifier_v if harmonic == 1 else np.zeros_like(amplifier_v)
    else:
        out_v = _flattened_v(amplifier_v, transmitter.saturation_v, transmitter.saturation_sharpness, harmonic)
    return np.asarray(out_v * _gain(transmitter.matching_gain_db))


def _flattened_v(amplitude_v: Floats, ceiling_v: float, sharpness: float, harmonic: int) -> Floats:
    """Return the Fourier sine coefficient of a sine through v / (1 + |v / ceiling|^2p)^(1/2p), the Rapp law."""
    # The midpoint rule over a half period: the sine's other half has the same odd harmonics.
    phase = (np.arange(_PHASES) + 0.5) * np.pi / _PHASES
    wave_v = np.asarray(amplitude_v)[..., None] * np.sin(phase)
    flat_v = wave_v / (1 + np.abs(wave_v / ceiling_v) ** (2 * sharpness)) ** (1 / (2 * sharpness))
    return np.asarray(flat_v @ np.sin(harmonic * phase) * (2 / _PHASES))


def _gain(gain_db: float) -> float:
    return float(10 ** (gain_db / 20))
