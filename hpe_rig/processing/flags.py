"""Pulses that are unlike the others: leaked tonebursts, spikes, dropped or clipped records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.echoes import BoolArray, EchoGate

LIMIT = 8.0
"""Robust standard deviations beyond which a pulse's logarithmic energy is foreign; and at least a factor of two."""


def unlike_pulses(echoes: EchoGate) -> BoolArray:
    """Return which valid pulses (pulse,) hold an energy unlike the others' in any realisation.

    The energy is that of the whole gate, so that what leaks outside the tracked band is seen as well; one echo's energy
    changes little with its motion. Half of the pulses must be sound.
    """
    level = np.log(np.maximum(echoes.energy[..., echoes.valid], np.finfo(np.float64).tiny))
    middle = np.median(level, axis=-1, keepdims=True)
    spread = np.median(np.abs(level - middle), axis=-1, keepdims=True) / 0.6745
    foreign = np.abs(level - middle) > np.maximum(LIMIT * spread, np.log(2))
    flagged = np.zeros(echoes.valid.shape, dtype=bool)
    flagged[echoes.valid] = foreign.any(axis=tuple(range(foreign.ndim - 1)))
    return flagged


def clipped_pulses(codes: NDArray[np.int16], limits: tuple[int, int]) -> BoolArray:
    """Return which records (..., pulse) of ``codes`` (..., pulse, sample) reach the digitizer's full scale."""
    return np.asarray((codes.min(axis=-1) <= limits[0]) | (codes.max(axis=-1) >= limits[1]))
