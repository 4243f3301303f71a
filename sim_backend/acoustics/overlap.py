"""Which bursts are heard in which records, and in which samples of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.wiring import Capture, Picoseconds

Indices = NDArray[np.int64]


def burst_record_pairs(start_ps: Picoseconds, end_ps: Picoseconds, capture: Capture) -> tuple[Indices, Indices]:
    """Return burst and record index of every pair in which the interval (burst,) holds a sample's time, ends included.

    Records must begin in time order, as triggers do.
    """
    first_ps = capture.first_sample_ps
    last_ps = first_ps + (capture.samples - 1) * capture.sample_period_ps
    begin = np.searchsorted(last_ps, start_ps, side="left")
    count = np.maximum(np.searchsorted(first_ps, end_ps, side="right") - begin, 0)
    burst = np.repeat(np.arange(len(start_ps)), count)
    position = np.arange(len(burst)) - np.repeat(np.cumsum(count) - count, count)
    return burst, np.asarray(np.repeat(begin, count) + position)


def sample_span(start_ps: int, end_ps: int, capture: Capture) -> slice:
    """Return the samples of a record whose times after its first sample lie in the interval, ends included."""
    first = max(0, -(-start_ps // capture.sample_period_ps))
    last = min(capture.samples, end_ps // capture.sample_period_ps + 1)
    return slice(first, max(first, last))
