"""Types of the arrays that functions take and return: one name for each element type; their text and their range."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
UInt32Array = NDArray[np.uint32]
Int16Array = NDArray[np.int16]
Int64Array = NDArray[np.int64]
IndexArray = NDArray[np.intp]
SingleArray = NDArray[np.float32]
FloatArray = NDArray[np.float64]
ComplexSingleArray = NDArray[np.complex64]
ComplexArray = NDArray[np.complex128]


def numbers_text(numbers: FloatArray) -> str:
    """Return ``numbers`` (number,) as words of a message, such as "100, 200.5"."""
    return ", ".join(f"{number:g}" for number in numbers)


def largest_change(motion: NDArray[Any], axis: int) -> float:
    """Return the largest range of a series of ``motion`` along ``axis``; 0 without finite values."""
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.fmax.reduce(motion, axis=axis) - np.fmin.reduce(motion, axis=axis)
    return float(np.max(change[np.isfinite(change)], initial=0.0))
