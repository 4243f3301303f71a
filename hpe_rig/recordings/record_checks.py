"""Checks of single records of a recording: finite values, and values that differ."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray

MAX_LISTED = 4
"""Records that a message lists."""
MIN_SAMPLES = 8
"""Shortest record."""


def per_record(values: NDArray[Any], test: Callable[[NDArray[Any]], BoolArray]) -> BoolArray:
    """Return the ``test`` of every record of ``values`` (line, shot, pulse, sample), one shot in memory at a time."""
    return np.array([[test(shot) for shot in line] for line in values], np.bool_)


def are_finite(records: NDArray[Any]) -> BoolArray:
    """Return which ``records`` (pulse, sample) hold finite values alone."""
    finite = np.ones(len(records), np.bool_)
    if records.dtype.kind in "iu":
        return finite
    # The sum of a record is finite if all of its values are, unless it overflows: only the others need a closer look.
    with np.errstate(over="ignore", invalid="ignore"):
        suspects = np.flatnonzero(~np.isfinite(records.sum(axis=-1)))
    finite[suspects] = np.isfinite(records[suspects]).all(axis=-1)
    return finite


def are_constant(records: NDArray[Any]) -> BoolArray:
    """Return which ``records`` (pulse, sample) hold one value throughout."""
    with np.errstate(invalid="ignore"):
        constant = np.asarray((records[:, :MIN_SAMPLES] == records[:, :1]).all(axis=-1))
        suspects = np.flatnonzero(constant)
        constant[suspects] = (records[suspects] == records[suspects, :1]).all(axis=-1)
    return constant


def list_records(marked: BoolArray) -> str:
    """Return the numbers, from 1, of the first of the ``marked`` records (line, shot, pulse)."""
    indices = np.argwhere(marked)
    numbers = [
        f"line {line + 1} shot {shot + 1} pulse {pulse + 1}" for line, shot, pulse in indices[:MAX_LISTED].tolist()
    ]
    return ", ".join(numbers) + (f" and {len(indices) - MAX_LISTED} more" if len(indices) > MAX_LISTED else "")
