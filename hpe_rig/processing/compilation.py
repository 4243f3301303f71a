"""Optional compilation of loops by Numba.

Numba takes a second to load. A compiled loop is therefore used if Numba is loaded already or the work is long enough.
Results with and without Numba differ by rounding.
"""

from __future__ import annotations

import functools
import importlib.util
import sys
from collections.abc import Callable
from typing import Any, TypeVar

Loop = TypeVar("Loop", bound=Callable[..., object])


@functools.cache
def numba_installed() -> bool:
    """Return whether Numba is installed."""
    return importlib.util.find_spec("numba") is not None


def use_numba(size: float, worth_loading: float) -> bool:
    """Return whether to run the compiled loop: Numba is loaded, or ``size`` of the work exceeds ``worth_loading``."""
    return numba_installed() and (size > worth_loading or "numba" in sys.modules)


def compiler(*fastmath: str, inline: bool = False) -> Callable[[Loop], Loop]:
    """Return the decorator that compiles a loop; ``fastmath`` are the LLVM flags that allow reordering.

    Compiled loops release the interpreter lock and are cached on disk. ``inline`` copies the function into its callers.
    """
    import numba

    options: dict[str, Any] = {"inline": "always"} if inline else {"nogil": True, "cache": True}
    decorator: Callable[[Loop], Loop] = numba.njit(error_model="numpy", fastmath=set(fastmath), **options)
    return decorator
