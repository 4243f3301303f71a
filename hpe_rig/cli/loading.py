"""Loading of libraries: of what they bring, only that which is used; and the end of the process without a search."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Any, final

NEW_OBJECTS = 100_000
"""So many more objects than were freed before Python looks for cycles among them, by default 700. Loading makes that
many, of which none is ever freed, and looking costs a twentieth of a start: the first time none is looked at."""


def load_what_is_used() -> None:
    """From now on look for no plugins of libraries, and run no part of a library that another merely lists.

    At the end of the process nothing is looked for that could be freed: files are closed and outputs off by then.
    """
    gc.set_threshold(NEW_OBJECTS)
    # Pydantic would look through every installed package for plugins of its own, in each process.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if _OfWhatIsUsed not in sys.meta_path:
        sys.meta_path.insert(0, _OfWhatIsUsed)
        gc.callbacks.append(_keep_what_is_loaded)
        # Python looks for cycles among all that was loaded when it ends, several times: a seventh of a short command.
        atexit.register(gc.freeze)


def _keep_what_is_loaded(phase: str, info: dict[str, int]) -> None:
    """Take out of the first search for cycles, before it begins, all that is there: modules, which nobody frees."""
    gc.callbacks.remove(_keep_what_is_loaded)
    gc.freeze()


@final
class _CompiledFunctions(Loader):
    """Loader of scipy.special: its compiled functions alone, until something else is asked for.

    For other array libraries the package rewrites the documentation of a hundred functions, which takes twenty times as
    long as to load them. Functions of NumPy arrays are the same objects with and without.
    """

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def exec_module(self, module: ModuleType) -> None:
        def found(name: str) -> Any:
            functions = vars(import_module(f"{module.__name__}._ufuncs"))
            if name in functions:
                return functions[name]
            if vars(module).pop("__getattr__", None) is not None:
                self._loader.exec_module(module)
            return getattr(module, name)

        vars(module)["__getattr__"] = found


@final
class _UndocumentedArtists(Loader):
    """Loader of Matplotlib's artists, which lists no properties in the docstrings of a process that nobody asks."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        vars(module)["kwdoc"] = lambda artist: ""


@final
class _NoAxesInSpace(Loader):
    """Loader of Matplotlib's axes of three dimensions: there are none, and with None Matplotlib does without."""

    def __init__(self, loader: Loader) -> None: ...

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["Axes3D"] = None


SPARED: dict[str, Callable[[Loader], Loader]] = {
    # SciPy takes over each name that NumPy has and uses none of these.
    "numpy.f2py": LazyLoader,
    "numpy.testing": LazyLoader,
    # Matplotlib asks it for the glyphs of TeX.
    "fontTools.agl": LazyLoader,
    "scipy.special": _CompiledFunctions,
    "matplotlib.artist": _UndocumentedArtists,
    "mpl_toolkits.mplot3d": _NoAxesInSpace,
}
"""Modules that run when an attribute of theirs is first looked at, or in part, by what loads them."""


@final
class _OfWhatIsUsed:
    """Finder of the modules in ``SPARED``."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in SPARED else None
        if spec is not None and spec.loader is not None:
            spec.loader = SPARED[name](spec.loader)
        return spec
