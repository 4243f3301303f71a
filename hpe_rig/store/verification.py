"""Verification of a run or result file: compares every checksum and lists damage by shot and record."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import h5py

from hpe_rig.result import dataclass_schema, titled
from hpe_rig.store.checksum import ATTRIBUTE, GROUP, datasets, heap_is_sound, kind_of
from hpe_rig.store.damage import Damage, ranges
from hpe_rig.store.foreign_hdf5 import InvalidContentError, open_bounded
from hpe_rig.store.format import StoreError, reason
from hpe_rig.store.json_checksum import read_sealed
from hpe_rig.store.reader import read_run
from hpe_rig.store.source import open_checked
from hpe_rig.store.validation import CheckedFile

TEXT_KINDS: Final = ("queue", "marks", "study", "summary")
"""Kinds of files of text with a checksum."""


@dataclass(frozen=True, slots=True)
class Verification:
    """Content and damage of a file; without ``checksums`` hardly any damage can be detected.

    ``kind``: run, result, map, queue, marks, study or summary; "text" for one of the last four that is damaged. Only
    runs and results have shots. ``torn_bytes``: length of an interrupted write at the end of a killed run's log, which
    is no damage: the disk had not confirmed it.
    """

    path: Path
    kind: str
    status: str = "complete"
    shots: int = 0
    shots_complete: int = 0
    records: int = 0
    checksums: bool = True
    damage: tuple[Damage, ...] = ()
    torn_bytes: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes of this verification, and ``sound``, as JSON values; shots and records count from 1.

        ``sound``: the file has checksums, and no damage.
        """
        damage = [
            asdict(item)
            | {
                "shot": None if item.shot is None else item.shot + 1,
                "records": [(first + 1, last + 1) for first, last in item.records],
            }
            for item in self.damage
        ]
        return asdict(self) | {
            "path": str(self.path),
            "sound": self.checksums and not self.damage,
            "damage": damage,
        }


def verification_schema() -> dict[str, Any]:
    """Return the JSON schema of ``hpe-rig verify --json``."""
    return titled("Verification of hpe-rig", dataclass_schema(Verification, sound={"type": "boolean"}))


def verify(path: Path) -> Verification:
    """Return the damage in a file of this program, by comparison of its content with its checksums.

    It needs little memory for any file. Raises ``StoreError`` if it is no such file or cannot be opened.
    """
    if path.suffix in (".json", ".csv"):
        return _verified_text(path)
    if (kind := kind_of(path)) in ("result", "map"):
        return _verified_result(path, kind)
    stored = read_run(path)
    damage = list(stored.damage)
    with open_checked(path) as checked:
        # An HDF5 file has no ``codes``. A log has; its constant datasets are in its first frame, checked at reading.
        if checked.codes is None:
            damage += _damaged_datasets(checked.file, path)
        # Bytes of a last write that was interrupted.
        torn_bytes = checked.torn_bytes
    records, shots, complete = 0, stored.shot_complete.size, int(stored.shot_complete.sum())
    for shot in range(shots):
        arrival = stored.records.arrival(shot)
        records += int(arrival.recorded.sum())
        if (damaged := stored.records.damaged(shot)).any():
            damage.append(Damage("fail their checksums or lie beyond the end of the file", shot, ranges(damaged)))
        if stored.shot_complete[shot] and arrival.unverified.any():
            damage.append(Damage("are marked as recorded, without a checksum", shot, ranges(arrival.unverified)))
    damage.sort(key=lambda item: -1 if item.shot is None else item.shot)
    has_checksums = stored.has_checksums
    return Verification(path, "run", stored.status, shots, complete, records, has_checksums, tuple(damage), torn_bytes)


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


def _verified_text(path: Path) -> Verification:
    """Return whether a queue's list, marks, a study or its summary match their checksum.

    Raises ``StoreError`` if the file is none of these or cannot be read.
    """
    kind, has_checksum = "summary", True
    try:
        if path.suffix == ".csv":
            # The table itself has no room for a checksum.
            study, _ = read_sealed(path.with_name("study.json"))
            if study.get("summary_sha256") != hashlib.sha256(path.read_bytes()).hexdigest():
                raise ValueError("its rows do not match the checksum in study.json")
        else:
            tables, has_checksum = read_sealed(path)
            kind = str(tables.get("format", "")).removeprefix("hpe_rig ")
    except OSError as error:
        what = f"{error.filename or path} cannot be read ({reason(error)})"
        raise StoreError(f"{what}. Try: its path; study.json has the checksum of summary.csv.") from None
    except ValueError as error:
        return Verification(path, "text", damage=(Damage(str(error)),))
    if kind not in TEXT_KINDS:
        raise StoreError(f"{path} is no file of hpe-rig with a checksum. Try: {', '.join(TEXT_KINDS)}.")
    return Verification(path, kind, checksums=has_checksum)


def _verified_result(path: Path, kind: str) -> Verification:
    """Return content and damage of a result file or map; raise ``StoreError`` if it cannot be read."""
    try:
        with open_bounded(path) as file:
            shots = int(file["results/shot"].shape[0]) if kind == "result" else 0
            amplitudes = file["results/amplitude_m" if kind == "result" else "amplitude_m"]
            has_checksums = ATTRIBUTE in amplitudes.attrs
            damage = tuple(_damaged_datasets(file, path))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, InvalidContentError) as error:
        raise StoreError(
            f"{path} is not a readable result file ({reason(error)}). Try: hpe-rig process, which writes it anew."
        ) from error
    return Verification(path, kind, shots=shots, shots_complete=shots, checksums=has_checksums, damage=damage)
