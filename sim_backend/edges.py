"""Trigger wiring: edges and bursts as arrays in integer picoseconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Picoseconds = NDArray[np.int64]

PS_PER_S = 1_000_000_000_000


def to_ps(time_s: float) -> int:
    """Return ``time_s`` in whole picoseconds."""
    return round(time_s * PS_PER_S)


@dataclass(frozen=True, slots=True)
class Bursts:
    """Sine bursts that reached the transducer; every array has shape (burst,)."""

    onset_ps: Picoseconds
    end_ps: Picoseconds
    carrier_hz: NDArray[np.float64]
    cycles: NDArray[np.float64]
    amplitude_vpp: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Capture:
    """What the digitizer was triggered to record: one record an entry of ``first_sample_ps`` (record,)."""

    index: int
    origin_ps: int
    first_sample_ps: Picoseconds
    sample_period_ps: int
    samples: int
