"""Verification of a run or result file: every checksum compared, what fails listed by shot and record."""

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
from hpe_rig.store.validation import Trusted, UntrustedError, trusted

ECHOES_AT_ONCE: Final = 64_000_000
"""Bytes of echoes that are in memory at a time."""


@dataclass(frozen=True, slots=True)
class Damage:
    """Something of a file that is not as its checksum says.

    ``shot`` counts from 0, None where it is of no shot; ``records`` lists first and last of each row of damaged
    records, from 0, where it is of records.
    """

    what: str
    shot: int | None = None
    records: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        where = "" if self.shot is None else f"shot {self.shot + 1}: "
        if not self.records:
            return f"{where}{self.what}"
        ranges = [str(first + 1) if first == last else f"{first + 1} to {last + 1}" for first, last in self.records]
        return f"{where}record {', '.join(ranges)} {self.what}"


@dataclass(frozen=True, slots=True)
class Verification:
    """What a file holds and what of it is damaged; ``checksums``: whether it has any, without which little is said."""

    path: Path
    kind: str
    status: str
    shots: int
    shots_complete: int
    records: int
    checksums: bool
    damage: tuple[Damage, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON has it; shots and records count from 0."""
        return asdict(self) | {"path": str(self.path), "sound": self.checksums and not self.damage}


def verification_schema() -> dict[str, Any]:
    """Return the JSON schema of what ``hpe-rig verify --json`` prints."""
    return titled("Verification of hpe-rig", dataclass_schema(Verification, sound={"type": "boolean"}))


def verify(path: Path) -> Verification:
    """Compare everything in the run or result file ``path`` with its checksums, in bounded memory.

    Raises ``StoreError`` where it is neither or cannot be opened at all.
    """
    if _is_result(path):
        return _verified_result(path)
    stored = read_run(path)
    damage = [Damage(text) for text in stored.damage if not text.startswith("shot ")]
    with trusted(path) as trust:
        damage += _damaged_datasets(trust.file, path)
    records = 0
    for shot in range(stored.shot_complete.size):
        records += int(stored.records.recorded(shot).sum())
        damage += [Damage(what, shot) for what in damage_by_shot(stored, shot)]
        damage += _damaged_records(stored, shot)
    complete = int(stored.shot_complete.sum())
    kind, shots = "run", stored.shot_complete.size
    return Verification(path, kind, stored.status, shots, complete, records, stored.vouched, tuple(damage))


def _damaged_records(stored: StoredRun, shot: int) -> Iterator[Damage]:
    pulses = ECHOES_AT_ONCE // (2 * stored.records.shape[2])
    if (damaged := stored.records.damaged(shot, pulses)).any():
        yield Damage("fail their checksums or lie where the file has nothing", shot, ranges(damaged))
    if stored.shot_complete[shot] and (unvouched := stored.records.unvouched(shot)).any():
        yield Damage("are marked as there, without a checksum", shot, ranges(unvouched))


def _damaged_datasets(file: h5py.File, path: Path) -> Iterator[Damage]:
    """Yield which of the datasets that never change fail their checksums, and whether their units and axes do."""
    if not heap_is_sound(file, path):
        yield Damage("units of datasets, or what tells their axes, fail their checksum")
    for name, dataset in datasets(file):
        if ATTRIBUTE in dataset.attrs and not name.startswith(f"{GROUP}/"):
            try:
                sound = Trusted(file).is_sound(name, dataset)
            except OSError:
                sound = False
            if not sound:
                yield Damage(f"/{name} fails its checksum")


def _is_result(path: Path) -> bool:
    if not path.is_file():
        # A named pipe would be waited for.
        return False
    try:
        with h5py.File(path, "r") as file:
            kind = file.attrs.get("format")
            return bool(kind == RESULT_FORMAT)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):
        return False


def _verified_result(path: Path) -> Verification:
    try:
        with h5py.File(path, "r") as file:
            shots = int(file["results/shot"].shape[0])
            checksums = ATTRIBUTE in file["results/amplitude_m"].attrs
            damage = tuple(_damaged_datasets(file, path))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, UntrustedError) as error:
        raise StoreError(
            f"{path} is not a readable result file ({reason(error)}). Try: hpe-rig process, which writes it anew."
        ) from error
    return Verification(path, "result", "complete", shots, shots, 0, checksums, damage)


def ranges(which: BoolArray) -> tuple[tuple[int, int], ...]:
    """Return first and last index of each row of true values in ``which``.

    >>> ranges(np.array([True, True, False, True]))
    ((0, 1), (3, 3))
    """
    edges: Iterable[int] = np.flatnonzero(np.diff(np.concatenate(([False], which, [False])).astype(np.int8))).tolist()
    return tuple((first, end - 1) for number, (first, end) in enumerate(pairwise(edges)) if not number % 2)
