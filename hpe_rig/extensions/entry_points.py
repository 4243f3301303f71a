"""Entry points of other packages by group and name: listed without loading, loaded singly, failures with a name."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

ESTIMATORS: Final = "hpe_rig.estimators"
MEDIA: Final = "hpe_rig.media"
IMPORTERS: Final = "hpe_rig.importers"
CONDITIONS: Final = "hpe_rig.conditions"


class ExtensionError(ValueError):
    """An extension that does not load, has the wrong type for its group, or fails; the message names its package."""


@cache
def _group(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of ``group`` by name; of equal names the first by package applies."""
    points = sorted(entry_points(group=group), key=lambda point: (point.name, _package(point)), reverse=True)
    return {point.name: point for point in points}


def installed(group: str) -> tuple[str, ...]:
    """Return the names of the extensions in ``group``, sorted; nothing is imported."""
    return tuple(sorted(_group(group)))


def origin(group: str, name: str) -> str:
    """Return an extension's name with its package and version, for messages and reports."""
    return f"{name} ({group}, of {_package(_group(group)[name])})"


def named(group: str, name: str) -> str:
    """Return ``name``, with its package if it is an extension."""
    return origin(group, name) if name in _group(group) else name


@cache
def load(group: str, name: str) -> Any:
    """Return the object at the entry point ``name``; raise ``ExtensionError`` if it does not load."""
    try:
        return _group(group)[name].load()
    except Exception as error:
        # Any exception may come from the code of another package.
        raise ExtensionError(
            f"extension {origin(group, name)} does not load ({type(error).__name__}: {error}). "
            "Try: its newest version, or uninstall it"
        ) from error


def _package(point: EntryPoint) -> str:
    package = point.dist
    return "an unknown package" if package is None else f"{package.name} {package.version}"
