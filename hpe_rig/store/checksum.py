"""Checksums of everything in a run file: of each dataset, each row and each chunk of echoes.

HDF5 compares its own checksums of metadata and chunks, but has none for its heap, which holds units, other texts of
variable length and the references from datasets to their axes. Three kinds of checksum cover all content:

    a dataset that never changes after the start    BLAKE2b, attribute ``checksum`` of the dataset
    the heap                                        BLAKE2b, attribute ``heap_checksum`` of the file
    a dataset written during a run                  CRC-32 of each row or chunk, ``/checksum/<name of the dataset>``;
                                                    format version 2: BLAKE2b, zero where never written

``docs/reference/integrity.md`` describes the coverage and how a reader treats a wrong checksum.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.store.foreign_hdf5 import objects

GROUP: Final = "checksum"
ATTRIBUTE: Final = "checksum"
HEAP: Final = "heap_checksum"
MAX_HEAP_PART_BYTES: Final = 1 << 24
"""Maximum length of a part of the heap; those of run and result files with thousands of texts are shorter."""
BY_SHOT: Final = (
    "snapshot",
    "untrusted",
    "changed_settings",
    "conditions/before",
    "conditions/after",
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
"""Datasets with a checksum for each shot and chunk of echoes; the one of ``recorded`` covers the trigger times too."""
AT_ONCE: Final = ("run_time/run_time_s", "provenance/ended")
"""Datasets that are always written completely."""


def digest(name: str, index: tuple[int, ...], *contents: bytes | memoryview) -> int:
    """Return the checksum of ``contents``, the bytes in row or chunk ``index`` of dataset ``name``; never zero."""
    # Name and index are part of the checksum, so that exchanged rows or chunks are detected.
    checksum = blake2b(f"{name} {index}".encode(), digest_size=8)
    for content in contents:
        checksum.update(content)
    return int.from_bytes(checksum.digest(), "little") or 1


def crc(name: str, index: tuple[int, ...], *contents: bytes | memoryview) -> int:
    """Return the CRC-32 of ``contents``, the bytes in row or chunk ``index`` of dataset ``name``; never zero."""
    # Name and index are part of the checksum, so that exchanged rows or chunks are detected.
    checksum = crc32(f"{name} {index}".encode())
    for content in contents:
        checksum = crc32(content, checksum)
    return checksum or 1


def stored_bytes(values: Any, dtype: np.dtype[Any]) -> bytes:
    """Return the bytes of ``values`` in a dataset of ``dtype``."""
    return np.ascontiguousarray(values, dtype).tobytes()


def blank(dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array of NaN, zero or empty text, for values that were never written or fail their checksum."""
    return np.full(shape, np.nan, dtype) if dtype.kind == "f" else np.zeros(shape, dtype)


def add_checksums(file: h5py.File) -> None:
    """Create the checksum datasets of a new run file, and write the checksums of all datasets that never change.

    Data that are written during the run have one checksum for each shot, for each chunk, or for the whole dataset.
    """
    # Number of shots, and of chunks (pieces that HDF5 stores at once) in each.
    shots = file["records/echo"].shape[0]
    chunks = -(-file["records/echo"].shape[1] // file["records/echo"].chunks[1])
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(BY_SHOT, (shots,))
    shapes |= dict.fromkeys(BY_CHUNK, (shots, chunks)) | dict.fromkeys(AT_ONCE, ())
    # Groups that HDF5 creates implicitly store the time of creation; then no two files would be equal.
    root = file.create_group(GROUP)
    for name in [name for name in shapes if name in file]:
        folder, _, last = name.rpartition("/")
        group = root if not folder else root[folder] if folder in root else root.create_group(folder)
        group[last] = np.zeros(shapes[name], "<u8")
    # The checksums of records/recorded cover the trigger times.
    seal(file, {*shapes, "records/trigger_time_s", *(f"{GROUP}/{name}" for name in shapes)})


def seal(file: h5py.File, changing: set[str] | None = None) -> None:
    """Write the checksum of every dataset of ``file`` as its attribute, except of those in ``changing``."""
    for name, dataset in datasets(file):
        if name not in (changing or ()):
            dataset.attrs[ATTRIBUTE] = np.uint64(digest(name, (), stored_bytes(dataset[()], dataset.dtype)))


def seal_heap(file: h5py.File, memory: io.BytesIO | None = None) -> None:
    """Write the checksums of the heap, where HDF5 keeps texts of variable length, as an attribute of the file.

    It holds offset, length and checksum of each part, uint64 (part, 3). ``memory``: the bytes of the file, if it is in
    memory; otherwise the library makes a copy.
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
    """Return offset, length and checksum of each part of the heap in ``image``, the bytes of an HDF5 file.

    HDF5 keeps texts of variable length there.
    """
    # Signature and version of a global heap collection; no other content of a new file has these bytes.
    offsets = [match.start() for match in re.finditer(rb"GCOL\x01\0\0\0", image)]
    lengths = [int.from_bytes(image[offset + 8 : offset + 16], "little") for offset in offsets]
    return [
        (offset, length, digest(HEAP, (offset,), image[offset : offset + length]))
        for offset, length in zip(offsets, lengths, strict=True)
    ]


def heap_is_sound(file: h5py.File, path: Path) -> bool:
    """Return whether the heap of ``file`` at ``path`` matches its checksums; True for a file without any.

    HDF5 keeps texts of variable length in the heap, and writes no checksums there.
    """
    heap_sums = np.asarray(file.attrs.get(HEAP, np.zeros((0, 3), "<u8")))
    if heap_sums.dtype != np.dtype("<u8") or heap_sums.shape[1:] != (3,):
        return False
    with path.open("rb") as stored:
        for offset, length, expected in heap_sums.tolist():
            # Read directly: a damaged heap can crash the library.
            stored.seek(min(offset, 1 << 62))
            if digest(HEAP, (offset,), stored.read(min(length, MAX_HEAP_PART_BYTES))) != expected:
                return False
    return True


def kind_of(path: Path) -> str | None:
    """Return the kind of an HDF5 file: run, result, map or "" for another; None if it cannot be opened.

    It is recognised by names alone. Reading a text of variable length from a damaged file can trap the library in an
    endless loop, also one that states the kind.
    """
    if not path.is_file():
        # Opening a named pipe would block.
        return None
    try:
        with h5py.File(path, "r") as file:
            attributes = set(file.attrs)
            if {"format_version", "scene_name"} <= attributes:
                return "run"
            if {"run_file", "estimator"} <= attributes:
                return "result"
            return "map" if HEAP in attributes and "velocity_m_per_s" in file else ""
    except (OSError, KeyError, ValueError, TypeError, RuntimeError):
        return None


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield path and dataset of every dataset in ``file``, sorted by path; raises as ``objects``."""
    yield from sorted((path, item) for path, item in objects(file) if isinstance(item, h5py.Dataset))
