"""Checksums of everything in a run file: 64 bits of BLAKE2b beside each dataset, each row and each chunk of echoes.

HDF5 itself vouches for its metadata, attributes among them, but not for the values of datasets. What never changes
after the start has its checksum in an attribute ``checksum`` of its own. What is written during a run has one for each
piece that is written at once, in a dataset of the same name below ``/checksum``; zero stands for a piece that was never
written. ``docs/integrity.md`` describes what is covered and what reading does with what fails.
"""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import blake2b
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

GROUP: Final = "checksum"
ATTRIBUTE: Final = "checksum"
BY_SHOT: Final = (
    "snapshot",
    "untrusted",
    "records/pulse_onset_s",
    "records/shot_complete",
    "records/clipped",
    "records/force_set",
    "truth/displacement_m",
    "true_harmonics/in_phase_m",
    "true_harmonics/quadrature_m",
)
"""Datasets with a checksum for each shot."""
BY_CHUNK: Final = ("records/echo", "records/monitor", "records/recorded")
"""Datasets with a checksum for each shot and chunk of echoes; that of ``recorded`` covers the trigger times too."""
AT_ONCE: Final = ("run_time/run_time_s", "provenance/ended")
"""Datasets that are written again as a whole."""
COVERED_ELSEWHERE: Final = ("records/trigger_time_s",)

Place = tuple[int, ...]


def digest(name: str, place: Place, *parts: bytes | memoryview) -> int:
    """Return the checksum of ``parts``, the bytes of the piece of dataset ``name`` at ``place``; never zero."""
    found = blake2b(f"{name} {place}".encode(), digest_size=8)
    for part in parts:
        found.update(part)
    return int.from_bytes(found.digest(), "little") or 1


def stored_bytes(values: Any, dtype: np.dtype[Any]) -> bytes:
    """Return ``values`` as a dataset of ``dtype`` holds them."""
    return np.ascontiguousarray(values, dtype).tobytes()


def blank(dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return what stands for values that were never written or cannot be trusted: NaN, zero or no text."""
    return np.full(shape, np.nan, dtype) if dtype.kind == "f" else np.zeros(shape, dtype)


def add_checksums(file: h5py.File) -> None:
    """Give every dataset of a new run file its place for checksums, or where it never changes its checksum."""
    shots = file["records/echo"].shape[0]
    chunks = -(-file["records/echo"].shape[1] // file["records/echo"].chunks[1])
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(BY_SHOT, (shots,))
    shapes |= dict.fromkeys(BY_CHUNK, (shots, chunks)) | dict.fromkeys(AT_ONCE, ())
    # Groups made on the way to a dataset would hold the time, and no two files be the same.
    root = file.create_group(GROUP)
    for name in [name for name in shapes if name in file]:
        folder, _, last = name.rpartition("/")
        group = root if not folder else root[folder] if folder in root else root.create_group(folder)
        group[last] = np.zeros(shapes[name], "<u8")
    seal(file, {*shapes, *COVERED_ELSEWHERE, *(f"{GROUP}/{name}" for name in shapes)})


def seal(file: h5py.File, changing: set[str] | None = None) -> None:
    """Give every dataset of ``file`` but the ``changing`` ones an attribute with its checksum."""
    for name, dataset in datasets(file):
        if name not in (changing or ()):
            found = digest(name, (), stored_bytes(dataset[()], dataset.dtype))
            dataset.attrs[ATTRIBUTE] = np.uint64(found)


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Return path and dataset of every dataset in ``file``, in the order of their paths."""
    found: dict[str, h5py.Dataset] = {}

    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = item

    file.visititems(look)
    yield from sorted(found.items())
