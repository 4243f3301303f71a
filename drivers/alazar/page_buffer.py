"""Buffer of page-aligned memory that a board may write into, freed when told and not before."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any, final

import numpy as np
from numpy.typing import NDArray


@final
class PageBuffer:
    """``size_bytes`` of zeroed memory at ``address``, which is a multiple of the page size."""

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        self._kept = False
        self._memory: mmap.mmap | None = mmap.mmap(-1, size_bytes)
        # The anchor keeps the mapping in place; only without it may the mapping be closed.
        self._anchor: ctypes.Array[ctypes.c_char] | None = (ctypes.c_char * size_bytes).from_buffer(self._memory)
        self.address = ctypes.addressof(self._anchor)

    @property
    def freed(self) -> bool:
        """Whether the memory has been given back."""
        return self._memory is None

    def copy(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """Return a copy of the first ``count`` items of ``dtype``, independent of the buffer's life."""
        if self._memory is None:
            raise ValueError("the buffer has been freed")
        return np.frombuffer(self._memory, dtype, count).copy()

    def keep(self) -> None:
        """Never give the memory back, not even when nobody refers to it any more: a board may still write into it."""
        if not self._kept:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))
        self._kept = True

    def free(self) -> None:
        """Give the memory back; a second call does nothing."""
        if self._memory is not None:
            memory, self._memory, self._anchor = self._memory, None, None
            memory.close()
