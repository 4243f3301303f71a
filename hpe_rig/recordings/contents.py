"""Content of a foreign file as an importer reads it: arrays by name, and the settings that the file states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from hpe_rig.recordings.settings import Dimension, RecordingSettings


@dataclass(frozen=True, slots=True)
class Contents:
    """Content of a file.

    ``arrays``: possible samples by name, real, or complex for I and Q. ``stated``: settings that the file states, by
    the keys of ``RecordingSettings``; each value with its name in the file, such as "fs". ``axes``: of the samples, if
    the format defines them. ``board``: the digitizer that produced the samples, if known. ``inferred``: sentences for
    the user about values that the importer inferred.
    """

    arrays: Mapping[str, NDArray[Any]]
    stated: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    axes: tuple[Dimension, ...] | None = None
    board: str | None = None
    inferred: tuple[str, ...] = ()


@runtime_checkable
class Importer(Protocol):
    """Reader of one format; an object at an entry point of the group ``hpe_rig.importers``.

    ``suffixes``: lower-case suffixes, with dot, of the files that it reads if no ``format`` is given. ``read`` returns
    the content of a file. It raises ``ValueError`` or ``OSError`` with a message "mistake: remedy" if the
    file cannot be read; the names of file and importer are added. Settings that are stated in ``settings`` (sidecar or
    options) need not be read from the file.
    """

    @property
    def suffixes(self) -> tuple[str, ...]: ...

    def read(self, path: Path, settings: RecordingSettings) -> Contents: ...
