"""Timing errors: trigger jitter of the generators, aperture jitter and rate error of the digitizer's clock.

    v(t + e) = v(t) + e dv/dt

    e    lateness of a sample, s

Trigger jitter is a function of seed, capture, and time since the master's edge, not a stream of random numbers. A burst
thus keeps its jitter in any order of evaluation, and a resumed run has the jitter of an uninterrupted one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array, UInt64Array
from sim_backend.settings import Instruments
from sim_backend.wiring import PS_PER_S, Bursts

# Central difference, exact for polynomials of degree six: error 2e-4 of the slope at 9 MHz and 100 MHz sampling.
_SLOPE = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
SLOPE_MARGIN = 3
"""Number of samples on either side of a sample that its slope is computed from."""


def jittered(bursts: Bursts, rms_s: float, seed: int, origin_ps: int = 0, index: int = 0) -> Bursts:
    """Return ``bursts`` with Gaussian trigger jitter of ``rms_s`` added to onset and end; unchanged for 0.

    ``origin_ps`` is the master trigger's edge, ``index`` the capture's.
    """
    if rms_s == 0 or bursts.onset_ps.size == 0:
        return bursts
    jitter_ps = np.rint(_normal(bursts.onset_ps - origin_ps, seed, index) * (rms_s * PS_PER_S)).astype(np.int64)
    return replace(bursts, onset_ps=bursts.onset_ps + jitter_ps, end_ps=bursts.end_ps + jitter_ps)


def _normal(instant_ps: Int64Array, seed: int, index: int) -> FloatArray:
    """Return a standard normal number for each instant, which depends on instant, ``seed`` and ``index`` only.

    By Box and Muller from two hashed uniform numbers.
    """
    key = _hashed(_hashed(np.full(instant_ps.shape, seed, np.uint64)) + np.uint64(index))
    word = _hashed(instant_ps.astype(np.uint64) ^ key)
    radius, angle = ((_hashed(word + np.uint64(step)) >> np.uint64(11)).astype(np.float64) for step in (1, 2))
    unit = 2.0**-53
    return np.asarray(np.sqrt(-2 * np.log((radius + 0.5) * unit)) * np.cos(2 * np.pi * angle * unit))


def _hashed(word: UInt64Array) -> UInt64Array:
    """Return a hash of each 64-bit word: the finaliser of the SplitMix64 generator."""
    word = word + np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(word ^ (word >> np.uint64(31)))


def has_clock_error(instruments: Instruments) -> bool:
    """Return whether the sample clock has jitter or a rate error."""
    return instruments.sample_clock_jitter_s > 0 or instruments.clock_error.digitizer != 0


def sampled_with_clock_error(
    volts: FloatArray, selected: slice, period_s: float, instruments: Instruments, rng: np.random.Generator
) -> FloatArray:
    """Return the ``selected`` samples of ``volts`` (record, sample), as sampled by a clock with rate error and jitter.

    ``selected`` leaves `SLOPE_MARGIN` samples on either side. A late sample differs by lateness times slope, to first
    order; the second order is (2 pi 9 MHz x 0.1 ns)² / 2 = 2e-5 for a jitter of 0.1 ns.
    """
    first, last = selected.start, selected.stop
    slope = sum(
        weight * volts[:, first + shift : last + shift : selected.step]
        for shift, weight in zip(range(-SLOPE_MARGIN, SLOPE_MARGIN + 1), _SLOPE, strict=True)
        if weight
    )
    exact = volts[:, selected]
    step = selected.step or 1
    # Lateness in sample periods: the clock's rate error adds up over the record.
    clock_error = instruments.clock_error.digitizer
    lateness = np.arange(exact.shape[1]) * (-step * clock_error / (1 + clock_error))
    if instruments.sample_clock_jitter_s:
        lateness = lateness + rng.standard_normal(exact.shape) * (instruments.sample_clock_jitter_s / period_s)
    return np.asarray(exact + lateness * slope)
