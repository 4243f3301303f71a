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
    return _low_pass(*_detuning(band, frequency_hz), band.order)


def notch(band: BandFilter, frequency_hz: Floats) -> Complexes:
    """Return the Butterworth band-stop response at ``frequency_hz`` (frequency,): 0 at the centre, -3 dB edges."""
    away, width = _detuning(band, frequency_hz)
    return _low_pass(width, away, band.order)


def sampled(response: Complexes, at_infinity: float) -> Complexes:
    """Return ``response`` (frequency,) from 0 to half the sampling rate, led to its limit there without a step.

    A step would ring before and after every edge of the signal like 1/t; this does like 1/t^3. It leaves what lies
    below six tenths of half the rate alone: 30 MHz of 100 MHz sampling.
    """
    place = np.linspace(0.0, 1.0, len(response))
    share = np.cos(np.pi / 2 * np.clip((place - 0.6) / 0.4, 0.0, 1.0)) ** 2
    return np.asarray(at_infinity + (response - at_infinity) * share)


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


def _detuning(band: BandFilter, frequency_hz: Floats) -> tuple[Complexes, Complexes]:
    """Return j (f / f0 - f0 / f) over the bandwidth as numerator and denominator: neither is infinite at 0 Hz."""
    f = frequency_hz / band.centre_hz
    return np.asarray(1j * (f * f - 1), np.complex128), np.asarray(band.bandwidth * f, np.complex128)


def _low_pass(above: Complexes, below: Complexes, order: int) -> Complexes:
    """Return the low-pass prototype at p = above / below."""
    response = np.ones(above.shape, np.complex128)
    for pole in _poles(order):
        response *= below / (above - pole * below)
    return response
