"""Checks of single records of a recording: finite values, and values that differ."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray

MAX_LISTED = 4
"""Records that a message lists."""
MAX_VALUE = 1e18
"""Largest value of an echo in any unit; its square fits into single precision."""
MIN_SAMPLES = 8
"""Shortest record."""


def per_record(values: NDArray[Any], test: Callable[[NDArray[Any]], BoolArray]) -> BoolArray:
    """Return the ``test`` of every record of ``values`` (line, shot, pulse, sample), one shot in memory at a time."""
    return np.array([[test(shot) for shot in line] for line in values], np.bool_)


def are_finite(records: NDArray[Any]) -> BoolArray:
    """Return which ``records`` (pulse, sample) hold finite values of up to ``MAX_VALUE`` alone."""
    if records.dtype.kind in "iu":
        return np.ones(len(records), np.bool_)
    components = (records.real, records.imag) if records.dtype.kind == "c" else (records,)
    # Maximum and minimum of a record with NaN are NaN, which no comparison accepts.
    in_range = [
        (component.max(axis=-1) <= MAX_VALUE) & (component.min(axis=-1) >= -MAX_VALUE) for component in components
    ]
    return np.asarray(np.logical_and.reduce(in_range))


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
