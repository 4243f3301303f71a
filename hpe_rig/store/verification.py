"""Verification of a run or result file: compares every checksum and lists damage by shot and record."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

from hpe_rig.arrays import BoolArray
from hpe_rig.result import dataclass_schema, titled
from hpe_rig.store.checksum import ATTRIBUTE, GROUP, datasets, heap_is_sound
from hpe_rig.store.format import RESULT_FORMAT, StoreError, reason
from hpe_rig.store.reader import StoredRun, damage_by_shot, read_run
from hpe_rig.store.validation import CheckedFile, InvalidContentError, open_checked

MAX_ECHO_BYTES: Final = 64_000_000
"""Maximum size of the echoes in memory."""


@dataclass(frozen=True, slots=True)
class Damage:
    """Part of a file that fails its checksum.

    ``shot`` counts from 0; None if the damage belongs to no shot. ``records``: first and last of each series of
    consecutive damaged records, from 0.
    """

    what: str
    shot: int | None = None
    records: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        """Return the damage in words, with the shot and the damaged records counted from 1."""
        where = "" if self.shot is None else f"shot {self.shot + 1}: "
        if not self.records:
            return f"{where}{self.what}"
        ranges = [str(first + 1) if first == last else f"{first + 1} to {last + 1}" for first, last in self.records]
        return f"{where}record {', '.join(ranges)} {self.what}"


@dataclass(frozen=True, slots=True)
class Verification:
    """Content and damage of a file; without ``checksums`` hardly any damage can be detected."""

    path: Path
    kind: str
    status: str
    shots: int
    shots_complete: int
    records: int
    checksums: bool
    damage: tuple[Damage, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values; shots and records count from 0."""
        return asdict(self) | {"path": str(self.path), "sound": self.checksums and not self.damage}


def verification_schema() -> dict[str, Any]:
    """Return the JSON schema of ``hpe-rig verify --json``."""
    return titled("Verification of hpe-rig", dataclass_schema(Verification, sound={"type": "boolean"}))


def verify(path: Path) -> Verification:
    """Return the damage in the run or result file ``path``, by comparison of its content with its checksums.

    It needs little memory for any file. Raises ``StoreError`` if it is neither kind of file or cannot be opened.
    """
    if _is_result(path):
        return _verified_result(path)
    stored = read_run(path)
    damage = [Damage(text) for text in stored.damage if not text.startswith("shot ")]
    with open_checked(path) as checked:
        damage += _damaged_datasets(checked.file, path)
    records = 0
    for shot in range(stored.shot_complete.size):
        records += int(stored.records.recorded(shot).sum())
        damage += [Damage(what, shot) for what in damage_by_shot(stored, shot)]
        damage += _damaged_records(stored, shot)
    complete = int(stored.shot_complete.sum())
    kind, shots = "run", stored.shot_complete.size
    return Verification(path, kind, stored.status, shots, complete, records, stored.has_checksums, tuple(damage))


def _damaged_records(stored: StoredRun, shot: int) -> Iterator[Damage]:
    """Yield the damage of the records of ``shot``: those that fail checksums, and those marked without a checksum."""
    pulses = MAX_ECHO_BYTES // (2 * stored.records.shape[2])
    if (damaged := stored.records.damaged(shot, pulses)).any():
        yield Damage("fail their checksums or lie beyond the end of the file", shot, ranges(damaged))
    if stored.shot_complete[shot] and (unverified := stored.records.unverified(shot)).any():
        yield Damage("are marked as recorded, without a checksum", shot, ranges(unverified))


def _damaged_datasets(file: h5py.File, path: Path) -> Iterator[Damage]:
    """Yield the damage of the datasets that never change after the start, and of the heap, where HDF5 keeps texts."""
    if not heap_is_sound(file, path):
        yield Damage("units or axes of datasets fail their checksum")
    for name, dataset in datasets(file):
        if ATTRIBUTE in dataset.attrs and not name.startswith(f"{GROUP}/"):
            try:
                matches = CheckedFile(file).matches_checksum(name, dataset)
            except OSError:
                matches = False
            if not matches:
                yield Damage(f"/{name} fails its checksum")


def _is_result(path: Path) -> bool:
    """Return whether ``path`` is a readable result file."""
    if not path.is_file():
        # Opening a named pipe would block.
        return False
    try:
        with h5py.File(path, "r") as file:
            kind = file.attrs.get("format")
            return bool(kind == RESULT_FORMAT)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):
        return False


def _verified_result(path: Path) -> Verification:
    """Return the damage in a result file; raise ``StoreError`` if it cannot be read."""
    try:
        with h5py.File(path, "r") as file:
            shots = int(file["results/shot"].shape[0])
            checksums = ATTRIBUTE in file["results/amplitude_m"].attrs
            damage = tuple(_damaged_datasets(file, path))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, InvalidContentError) as error:
        raise StoreError(
            f"{path} is not a readable result file ({reason(error)}). Try: hpe-rig process, which writes it anew."
        ) from error
    return Verification(path, "result", "complete", shots, shots, 0, checksums, damage)


def ranges(which: BoolArray) -> tuple[tuple[int, int], ...]:
    """Return first and last index of each series of consecutive true values in ``which``.

    >>> ranges(np.array([True, True, False, True]))
    ((0, 1), (3, 3))
    """
    edges: Iterable[int] = np.flatnonzero(np.diff(np.concatenate(([False], which, [False])).astype(np.int8))).tolist()
    return tuple((first, end - 1) for number, (first, end) in enumerate(pairwise(edges)) if not number % 2)
