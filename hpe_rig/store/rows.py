"""Rows of a run file's datasets, compared with their checksums; values that fail them are blank."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray
from hpe_rig.store.checksum import BY_SHOT, GROUP, blank, stored_bytes
from hpe_rig.store.format import SNAPSHOT_BYTES, UNTRUSTED_BYTES
from hpe_rig.store.validation import CheckedFile, stored_values

Shape = tuple[int, int, int]
"""Numbers of shots, pulses and samples."""


def datasets_by_shot(checked: CheckedFile, shape: Shape) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield name and dataset of those datasets in the file that have one checksum for each shot.

    Echoes and their trigger times are not among them, because their checksums are by chunk.
    """
    # Type and shape of each dataset; the others hold one float64 for each shot and frequency.
    layouts: dict[str, tuple[str, tuple[int | None, ...]]] = {
        "snapshot": (f"S{SNAPSHOT_BYTES}", shape[:1]),
        # Why the settings of a shot cannot be relied on; empty if they can.
        "untrusted": (f"S{UNTRUSTED_BYTES}", shape[:1]),
        "changed_settings": (f"S{UNTRUSTED_BYTES}", shape[:1]),
        "records/shot_complete": ("u1", shape[:1]),
        "records/clipped": ("u1", shape[:1]),
        "records/force_set": ("<f8", shape[:1]),
        "records/pulse_onset_s": ("<f8", shape[:2]),
        "truth/displacement_m": ("<f8", shape[:2]),
    }
    for name in BY_SHOT:
        dtype, dataset_shape = layouts.get(name, ("<f8", (shape[0], None)))
        if checked.has(name):
            yield name, checked.dataset(name, dtype, dataset_shape)


def checked_row(checked: CheckedFile, name: str, dataset: h5py.Dataset, row: int | None) -> tuple[Any, bool]:
    """Return row ``row`` of dataset ``name`` (None: all of it), and whether it is intact.

    A row is intact if it matches its checksum, has none, or was never written (version 2). Blank values are returned
    where a checksum does not match.
    """
    index = () if row is None else (row,)
    values = stored_values(dataset, index)
    if not checked.has_checksums:
        return values, True
    expected = int(checked.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[: len(index)])[index])
    matches = expected == checked.row_checksum(name, index, stored_bytes(values, dataset.dtype))
    # In files of version 2 a checksum of 0 is that of values that were never written.
    intact = matches or (expected == 0 and not checked.is_written_once)
    return (values if matches else blank(dataset.dtype, values.shape)), intact


def row_or_blank(checked: CheckedFile, name: str, dataset: h5py.Dataset, row: int) -> Any:
    """Return row ``row`` of dataset ``name``, blank if it was never written or is damaged."""
    values, _ = checked_row(checked, name, dataset, row)
    return values


def checked_rows(checked: CheckedFile, name: str, dataset: h5py.Dataset) -> tuple[NDArray[Any], BoolArray]:
    """Return every row of dataset ``name``, and which rows are intact, (row,).

    As ``checked_row``: rows that do not match their checksums are blank.
    """
    values = stored_values(dataset)
    if not checked.has_checksums:
        return values, np.ones(values.shape[0], bool)
    expected = checked.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[:1])[()]
    content = [stored_bytes(row, dataset.dtype) for row in values]
    actual = [checked.row_checksum(name, (index,), row) for index, row in enumerate(content)]
    matches = expected == np.array(actual, "<u8")
    values[~matches] = blank(dataset.dtype, ())
    # In files of version 2 a checksum of 0 is that of a row that was never written.
    return values, matches | ((expected == 0) & (not checked.is_written_once))


def dataset_by_pulse(checked: CheckedFile, name: str, shape: Shape, dtype: str = "<f8") -> h5py.Dataset:
    """Return the dataset ``name`` (shot, pulse)."""
    return checked.dataset(name, dtype, shape[:2])


def shot_index(shot: int, shots: int) -> int:
    """Return the index of ``shot``, which may count from the end; raise ``IndexError`` if there is none."""
    if not -shots <= shot < shots:
        raise IndexError(f"shot {shot} of {shots}")
    return shot % shots
