"""Analogue band-pass and notch filters by their frequency response, and how long they ring."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import BandFilter

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def band_pass(band: BandFilter, frequency_hz: Floats) -> Complexes:
    """Return the Butterworth band-pass response at ``frequency_hz`` (frequency,) >= 0: 1 at the centre, -3 dB edges."""
    with np.errstate(divide="ignore"):
        detuning = frequency_hz / band.centre_hz - np.divide(band.centre_hz, frequency_hz)
    return _low_pass(np.asarray(1j * detuning / band.bandwidth), band.order)


def notch(band: BandFilter, frequency_hz: Floats) -> Complexes:
    """Return the Butterworth band-stop response at ``frequency_hz`` (frequency,): 0 at the centre, -3 dB edges."""
    with np.errstate(divide="ignore"):
        detuning = frequency_hz / band.centre_hz - np.divide(band.centre_hz, frequency_hz)
        return _low_pass(np.asarray(-1j * np.divide(band.bandwidth, detuning)), band.order)


def ringing_s(bands: Iterable[BandFilter], tolerance: float) -> float:
    """Return after which time a cascade of ``bands`` has rung down to ``tolerance``; notch and band-pass alike."""
    slowest_s = [_slowest_s(band) for band in bands]
    # Equal filters in cascade ring longer than one, by powers of t / slowest: a factor of 100 covers four of them.
    return max(slowest_s, default=0.0) * math.log(100 / tolerance)


def _slowest_s(band: BandFilter) -> float:
    roots = np.concatenate([np.roots([1.0, -band.bandwidth * pole, 1.0]) for pole in _poles(band.order)])
    return float(-1 / (2 * np.pi * band.centre_hz * roots.real.max()))


def _poles(order: int) -> Complexes:
    angle = np.pi * (2 * np.arange(order) + order + 1) / (2 * order)
    return np.asarray(np.exp(1j * angle))


def _low_pass(p: Complexes, order: int) -> Complexes:
    response = np.zeros(p.shape, np.complex128)
    seen = np.isfinite(p)
    denominator = np.ones(np.count_nonzero(seen), np.complex128)
    for pole in _poles(order):
        denominator *= p[seen] - pole
    response[seen] = 1 / denominator
    return response
