"""Arguments of the ATSApi functions as Python passes them: ints, ctypes scalars, arrays, ``byref``, pointers."""

from __future__ import annotations

import ctypes
from typing import Any


def number_of(value: Any) -> int:
    """Return an int or ctypes scalar as an int; none is 0."""
    return int(getattr(value, "value", value) or 0)


def address_of(buffer: Any) -> int:
    """Return where a buffer begins."""
    if isinstance(buffer, ctypes.Array):
        return ctypes.addressof(buffer)
    return number_of(buffer)


def pointee_of(target: Any) -> Any:
    """Return what an out-parameter points to."""
    return target._obj if hasattr(target, "_obj") else target.contents
