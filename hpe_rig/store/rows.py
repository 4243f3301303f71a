"""Rows of a run file's datasets, compared with their checksums; values that fail them are blank."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import h5py
import numpy as np

from hpe_rig.store.checksum import blank, stored_bytes
from hpe_rig.store.validation import CheckedFile, stored_values

SLAB_BYTES: Final = 16_000_000
"""Maximum size of the rows that are read together, unless a single one is larger."""


def checked_row(checked: CheckedFile, name: str, shot: int | None) -> tuple[Any, bool]:
    """Return the row of ``shot`` in dataset ``name`` (None: all of the dataset), and whether it is intact.

    A row is intact if it matches its checksum, has none, or was never written (version 2). Blank values are returned
    where a checksum does not match.
    """
    index = () if shot is None else (shot,)
    dataset, sums = checked.dataset(name), checked.checksums(name)
    return _compared(checked, dataset, index, stored_values(dataset, index), None if sums is None else sums[index])


def checked_rows(checked: CheckedFile, name: str) -> Iterator[tuple[Any, bool]]:
    """Yield the row of every shot in dataset ``name``, and whether it is intact, as ``checked_row``."""
    dataset, sums = checked.dataset(name), checked.checksums(name)
    expected = [None] * dataset.shape[0] if sums is None else sums[()]
    step = max(1, SLAB_BYTES * dataset.shape[0] // max(1, dataset.nbytes))
    for first in range(0, dataset.shape[0], step):
        rows = stored_values(dataset, (slice(first, first + step),))
        for shot, row in enumerate(rows, first):
            yield _compared(checked, dataset, (shot,), row, expected[shot])


def _compared(
    checked: CheckedFile, dataset: h5py.Dataset, index: tuple[int, ...], values: Any, expected: Any
) -> tuple[Any, bool]:
    """Return ``values`` of row ``index``, blank if their checksum is not the ``expected`` one, and whether intact."""
    if expected is None:
        return values, True
    if checked.row_checksum(dataset.name[1:], index, stored_bytes(values, dataset.dtype)) == expected:
        return values, True
    # In files of version 2 a checksum of 0 is that of values that were never written.
    return blank(dataset.dtype, np.shape(values)), expected == 0 and not checked.is_written_once


def shot_index(shot: int, shots: int) -> int:
    """Return the index of ``shot``, which may count from the end; raise ``IndexError`` if there is none."""
    if not -shots <= shot < shots:
        raise IndexError(f"shot {shot} of {shots}")
    return shot % shots
