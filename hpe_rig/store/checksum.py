"""Checksums of everything in a run file: 64 bits of BLAKE2b beside each dataset, each row and each chunk of echoes.

HDF5 itself vouches for its metadata, but neither for the values of datasets nor for its heap: units and other texts of
variable length, and what tells the axes of a dataset. What never changes after the start has its checksum in an
attribute ``checksum`` of its own, the heap in one of the file, ``heap_checksum``. What is written during a run has one
for each piece that is written at once, in a dataset of the same name below ``/checksum``; zero stands for a piece that
was never written. ``docs/reference/integrity.md`` describes what is covered and what reading does with what fails.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

GROUP: Final = "checksum"
ATTRIBUTE: Final = "checksum"
HEAP: Final = "heap_checksum"
MOST_HEAP_BYTES: Final = 1 << 24
"""Length of a part of the heap beyond which none of a run or result file is, those of thousands of texts included."""
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


def seal_heap(file: h5py.File, memory: io.BytesIO | None = None) -> None:
    """Give ``file`` an attribute with place, length and checksum of each part of its heap, uint64 (part, 3).

    ``memory`` is where the library writes it; without, the library is asked for a copy.
    """
    file.flush()
    if memory is None:
        sums = _heap_sums(memoryview(file.id.get_file_image()))
    else:
        with memory.getbuffer() as image:
            sums = _heap_sums(image)
    if sums:
        file.attrs[HEAP] = np.array(sums, "<u8")


def _heap_sums(image: memoryview) -> list[tuple[int, int, int]]:
    # Its signature and version; nothing else that is in a file at its start looks like it.
    places = [found.start() for found in re.finditer(rb"GCOL\x01\0\0\0", image)]
    lengths = [int.from_bytes(image[place + 8 : place + 16], "little") for place in places]
    return [
        (place, length, digest(HEAP, (place,), image[place : place + length]))
        for place, length in zip(places, lengths, strict=True)
    ]


def heap_is_sound(file: h5py.File, path: Path) -> bool:
    """Return whether the heap of ``file`` at ``path`` is as its checksums say; a file that has none is."""
    parts = np.asarray(file.attrs.get(HEAP, np.zeros((0, 3), "<u8")))
    if parts.dtype != np.dtype("<u8") or parts.shape[1:] != (3,):
        return False
    with path.open("rb") as stored:
        for place, length, expected in parts.tolist():
            # Not by the library, which a damaged heap can send astray.
            stored.seek(min(place, 1 << 62))
            if digest(HEAP, (place,), stored.read(min(length, MOST_HEAP_BYTES))) != expected:
                return False
    return True


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Return path and dataset of every dataset in ``file``, in the order of their paths."""
    found: dict[str, h5py.Dataset] = {}

    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = item

    file.visititems(look)
    yield from sorted(found.items())
