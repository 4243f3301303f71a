"""Integers of a recording as the codes of a run file: 16 bits, zero in the middle."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import Int16Array

MAX_CODE = 32766
"""Code of the largest value: one below full scale, which counts as clipped."""
FULL_SCALE_CODES = MAX_CODE + 1
"""Code that counts as clipped, as its negative does; the lowest code of 16 bits marks missing records."""
UNSTATED_SCALE_V = 2.0 / (2 * FULL_SCALE_CODES + 1)
"""Volts of one code if they are not stated: full scale, half a code above the highest code, is 1 V."""


def are_codes(values: NDArray[Any]) -> bool:
    """Return whether ``values`` are integers of up to 16 bits, which are kept as they are."""
    return values.dtype.kind in "iu" and values.dtype.itemsize <= 2


def zero_code(values: NDArray[Any]) -> int:
    """Return the integer that is zero volts: 0, or the middle of the range of integers without sign."""
    return 0 if values.dtype.kind == "i" else 1 << (8 * values.dtype.itemsize - 1)


def signed_codes(values: NDArray[Any]) -> Int16Array:
    """Return integers of up to 16 bits as codes around zero; the lowest code is replaced by the next higher one."""
    return np.maximum(values.astype(np.int32) - zero_code(values), -FULL_SCALE_CODES).astype(np.int16)
