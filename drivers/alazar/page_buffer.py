"""Page-aligned memory that a board may write into."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any, final

import numpy as np
from numpy.typing import NDArray


@final
class PageBuffer:
    """``size_bytes`` of zeroed memory at ``address``, a multiple of the page size; freed by ``free`` alone."""

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        self._is_permanent = False
        self._memory: mmap.mmap | None = mmap.mmap(-1, size_bytes)
        # A mapping with an exported buffer cannot be closed by accident.
        self._export: ctypes.Array[ctypes.c_char] | None = (ctypes.c_char * size_bytes).from_buffer(self._memory)
        self.address = ctypes.addressof(self._export)

    @property
    def freed(self) -> bool:
        """Whether the memory was freed."""
        return self._memory is None

    def copy(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """Return a copy of the first ``count`` items of ``dtype``, valid after ``free``."""
        if self._memory is None:
            raise ValueError("the buffer has been freed")
        return np.frombuffer(self._memory, dtype, count).copy()

    def make_permanent(self) -> None:
        """Keep the memory for the life of the process, because a board may still write into it."""
        if not self._is_permanent:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))
        self._is_permanent = True

    def free(self) -> None:
        """Free the memory; a second call does nothing."""
        if self._memory is not None:
            memory, self._memory, self._export = self._memory, None, None
            memory.close()
