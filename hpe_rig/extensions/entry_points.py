"""Entry points of other packages by group and name: listed without loading, loaded singly, failures with a name."""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from queue import Empty, SimpleQueue
from typing import Any, Final, TypeVar, cast

ESTIMATORS: Final = "hpe_rig.estimators"
MEDIA: Final = "hpe_rig.media"
IMPORTERS: Final = "hpe_rig.importers"
CONDITIONS: Final = "hpe_rig.conditions"


TIMEOUT_S: Final = 60.0
"""Longest duration of one call of another package's code, unless its data are large."""
VALUES_PER_S: Final = 1e6
"""Slowest processing of large data that is awaited: samples or bytes per second."""
Outcome = TypeVar("Outcome")
_HANGING: Final[set[str]] = set()
"""Extensions that have not returned in time."""


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
    source, remedy = f"extension {origin(group, name)}", "its newest version, or uninstall it"
    return call(source, _group(group)[name].load, remedy=remedy, failure="does not load")


def call(
    source: str,
    function: Callable[[], Outcome],
    timeout_s: float = TIMEOUT_S,
    expected: tuple[type[Exception], ...] = (),
    remedy: str = "report it there",
    failure: str = "failed",
) -> Outcome:
    """Return ``function()``, code of the package that ``source`` names, which runs in a thread.

    Raises its ``expected`` exceptions and ``MemoryError`` as they are. Raises ``ExtensionError`` for all others, for an
    attempt to end the program, and if it lasts longer than ``timeout_s``; then it is not called again.
    """
    if source in _HANGING:
        raise ExtensionError(f"{source} has not returned since an earlier call. Try: {remedy}")
    outcomes = SimpleQueue[tuple[Outcome | None, BaseException | None]]()

    def run() -> None:
        try:
            outcomes.put((function(), None))
        except BaseException as error:
            outcomes.put((None, error))

    # The context has NumPy's settings of floating-point errors.
    threading.Thread(target=contextvars.copy_context().run, args=(run,), daemon=True, name=source).start()
    try:
        outcome, error = outcomes.get(timeout=timeout_s)
    except Empty:
        _HANGING.add(source)
        raise ExtensionError(f"{source} has not returned within {timeout_s:.0f} s. Try: {remedy}") from None
    if error is None:
        return cast("Outcome", outcome)
    if isinstance(error, (MemoryError, *expected)):
        raise error
    what = "tried to end the program" if isinstance(error, SystemExit) else failure
    raise ExtensionError(f"{source} {what} ({type(error).__name__}: {error}). Try: {remedy}") from error


def _package(point: EntryPoint) -> str:
    package = point.dist
    return "an unknown package" if package is None else f"{package.name} {package.version}"
