"""Spectrum of echo envelopes in the band that the estimators use.

An envelope of ``INSTANTS`` samples over the gate has the spectrum of ``bins`` bins, with zeros appended. The band is
``BAND_OVER_CARRIER`` times the carrier wide and centred on it.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.prediction.conditions import Conditions
from hpe_rig.prediction.speckle import INSTANTS

BAND_OVER_CARRIER = 1.0
"""Width of the band over the carrier."""


def instant_s(conditions: Conditions) -> float:
    """Return the time between two instants of the gate."""
    return 2 * conditions.gate_length_m / conditions.sound_speed_m_per_s / INSTANTS


def to_band(conditions: Conditions, bins: int, window: FloatArray | float = 1.0) -> ComplexArray:
    """Return the matrix (instant, bin in the band) from envelopes times ``window`` to their spectrum of ``bins``.

    The band has a sixth of the bins: the product takes a third of the time of a full Fourier transform.
    """
    frequency_hz = np.fft.fftfreq(bins, instant_s(conditions))
    band_hz = frequency_hz[np.abs(frequency_hz) <= conditions.carrier_hz * BAND_OVER_CARRIER / 2]
    phase_rad = 2 * np.pi * instant_s(conditions) * np.outer(band_hz, np.arange(INSTANTS))
    return np.asarray((window * np.exp(-1j * phase_rad)).T)
