"""Jitter from an instrument's trigger to its output, a function of seed, capture, and time since the master's edge.

No stream of random numbers: a burst keeps its jitter however often, and in whatever order, bursts are worked out, and a
run that goes on from another has the jitter that the other would have had.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_backend.wiring import PS_PER_S, Bursts

Floats = NDArray[np.float64]


def jittered(bursts: Bursts, rms_s: float, seed: int, origin_ps: int = 0, index: int = 0) -> Bursts:
    """Return ``bursts`` moved by Gaussian jitter of ``rms_s``, onset and end alike; unchanged for 0.

    ``origin_ps`` is the master trigger's edge, ``index`` the capture's.
    """
    if rms_s == 0 or bursts.onset_ps.size == 0:
        return bursts
    move_ps = np.rint(_normal(bursts.onset_ps - origin_ps, seed, index) * (rms_s * PS_PER_S)).astype(np.int64)
    return replace(bursts, onset_ps=bursts.onset_ps + move_ps, end_ps=bursts.end_ps + move_ps)


def _normal(instant_ps: NDArray[np.int64], seed: int, index: int) -> Floats:
    """Return a standard normal number for each instant: Box and Muller on two hashed uniform ones."""
    key = _scrambled(_scrambled(np.full(instant_ps.shape, seed, np.uint64)) + np.uint64(index))
    first = _scrambled(instant_ps.astype(np.uint64) ^ key)
    radius, turn = ((_scrambled(first + np.uint64(step)) >> np.uint64(11)).astype(np.float64) for step in (1, 2))
    unit = 2.0**-53
    return np.asarray(np.sqrt(-2 * np.log((radius + 0.5) * unit)) * np.cos(2 * np.pi * turn * unit))


def _scrambled(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the finaliser of the SplitMix64 generator, each word on its own."""
    word = word + np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(word ^ (word >> np.uint64(31)))
