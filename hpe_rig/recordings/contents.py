"""Contents of a foreign file, as an importer finds them: arrays by name, and what the file states of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from hpe_rig.recordings.settings import Axis, RecordingSettings


@dataclass(frozen=True, slots=True)
class Contents:
    """What a file holds.

    ``arrays``: by name, all that may be the samples: real, or complex for I and Q, of two axes or more. ``stated``:
    what the file says, by the keys of ``RecordingSettings``, each with the name of its place there, such as "fs".
    ``axes``: those of the samples, where the format fixes them; None where it does not. ``board``: the name of the
    digitizer whose codes the samples are; None where they are values of any kind.
    """

    arrays: Mapping[str, NDArray[Any]]
    stated: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    axes: tuple[Axis, ...] | None = None
    board: str | None = None


@runtime_checkable
class Importer(Protocol):
    """Reader of one format; an object at an entry point of the group ``hpe_rig.importers``.

    ``suffixes``: endings of the files that it takes where no ``format`` is given, in small letters with their dot.
    ``read`` returns the contents of a file; whatever is wrong with the file it raises as ``ValueError`` or ``OSError``
    with words that say what, and what to try. The file's name and the importer's are put before them. What is stated
    in ``settings`` (sidecar or options) need not be looked for in the file.
    """

    @property
    def suffixes(self) -> tuple[str, ...]: ...

    def read(self, path: Path, settings: RecordingSettings) -> Contents: ...
