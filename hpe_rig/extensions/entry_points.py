"""Entry points of other packages by group and name: listed without loading, loaded one by one, failures named."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

ESTIMATORS: Final = "hpe_rig.estimators"
MEDIA: Final = "hpe_rig.media"
IMPORTERS: Final = "hpe_rig.importers"


class ExtensionError(ValueError):
    """An extension that does not load, is not what its group takes, or fails; the message names its package."""


@cache
def _group(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of ``group`` by name; of one name in two packages the first by package counts."""
    found = sorted(entry_points(group=group), key=lambda each: (each.name, _package(each)), reverse=True)
    return {each.name: each for each in found}


def installed(group: str) -> tuple[str, ...]:
    """Return the names of the extensions in ``group``, sorted; nothing is imported."""
    return tuple(sorted(_group(group)))


def origin(group: str, name: str) -> str:
    """Return which package brings an extension, with its version, as messages and reports name it."""
    return f"{name} ({group}, of {_package(_group(group)[name])})"


def named(group: str, name: str) -> str:
    """Return ``name``, with the package that brings it where that is not this one."""
    return origin(group, name) if name in _group(group) else name


@cache
def load(group: str, name: str) -> Any:
    """Return the object at the entry point ``name``; raise ``ExtensionError`` where it does not load."""
    try:
        return _group(group)[name].load()
    except Exception as error:
        raise ExtensionError(
            f"extension {origin(group, name)} does not load ({type(error).__name__}: {error}). "
            "Try: its newest version, or uninstall it"
        ) from error


def _package(point: EntryPoint) -> str:
    package = point.dist
    return "an unknown package" if package is None else f"{package.name} {package.version}"
