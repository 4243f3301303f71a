"""Loading of libraries: of what they bring, only that which is used."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import final

NEW_OBJECTS = 100_000
"""So many more objects than were freed before Python looks for cycles among them, by default 700. Loading makes that
many, of which none is ever freed, and looking costs a twentieth of a start."""
UNASKED = ("numpy.f2py", "numpy.testing")
"""SciPy takes over each name that NumPy has and uses none of these: half of the time that scipy.special loads for."""


def load_what_is_used() -> None:
    """From now on look for no plugins of libraries, and run no part of NumPy that SciPy merely lists."""
    gc.set_threshold(NEW_OBJECTS)
    # Pydantic would look through every installed package for plugins of its own, in each process.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if _OnFirstUse not in sys.meta_path:
        sys.meta_path.insert(0, _OnFirstUse)


@final
class _OnFirstUse:
    """Finder of the modules in ``UNASKED``, which run when an attribute of theirs is first looked at."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in UNASKED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec
