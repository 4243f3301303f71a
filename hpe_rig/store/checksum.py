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

import re
import secrets
from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.store.datasets import AT_ONCE, BY_CHUNK, BY_SHOT, DATASETS
from hpe_rig.store.foreign_hdf5 import objects
from hpe_rig.store.format import LIBVER

GROUP: Final = "checksum"
ATTRIBUTE: Final = "checksum"
HEAP: Final = "heap_checksum"
MAX_HEAP_PART_BYTES: Final = 1 << 24
"""Maximum length of a part of the heap; those of run and result files with thousands of texts are shorter."""


def digest(name: str, index: tuple[int, ...], *contents: bytes | memoryview) -> int:
    """Return the BLAKE2b of ``contents``, the bytes in row or chunk ``index`` of dataset ``name``; never zero.

    It is the checksum of datasets that never change after the start of a run, of the heap, and of all data in format
    version 2. Later versions use ``crc`` for data that arrive during a run. Zero means that no checksum was written.
    """
    # Name and index are part of the checksum, so that exchanged rows or chunks are detected.
    checksum = blake2b(f"{name} {index}".encode(), digest_size=8)
    for content in contents:
        checksum.update(content)
    return int.from_bytes(checksum.digest(), "little") or 1


def crc(name: str, index: tuple[int, ...], *contents: bytes | memoryview) -> int:
    """Return the CRC-32 of ``contents``, as ``digest``: three times as fast, for data that arrive during a run."""
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
    """Create the checksum datasets of a new run file, for the data that are written during the run.

    These have one checksum for each shot, for each chunk (the piece that HDF5 stores at once), or for a whole dataset.
    """
    shots, records, _ = file["records/echo"].shape
    chunks = -(-records // file["records/echo"].chunks[1])
    # Groups that HDF5 creates implicitly store the time of creation; then no two files would be equal.
    root = file.create_group(GROUP)
    for name in (*BY_SHOT, *BY_CHUNK, *AT_ONCE):
        if name in file:
            shape = () if name in AT_ONCE else (shots, chunks) if name in BY_CHUNK else (shots,)
            folder, _, last = name.rpartition("/")
            (root.require_group(folder) if folder else root)[last] = np.zeros(shape, "<u8")


def sealed_file(write: Callable[[h5py.File], object]) -> bytes:
    """Return the bytes of a new HDF5 file with the content that ``write`` gives it, and with its checksums.

    These are an attribute of every dataset that does not change later, and ``heap_checksum`` of the file: offset,
    length and checksum of each part of the heap, where HDF5 keeps texts of variable length, uint64 (part, 3).
    """
    # Written to memory: a disk error inside the HDF5 library can crash the program. The library takes two files in
    # memory with one name for the same file.
    with h5py.File(secrets.token_hex(), "w", driver="core", backing_store=False, libver=LIBVER) as file:
        write(file)
        for name, dataset in datasets(file):
            if GROUP not in file or not (name in DATASETS or name.startswith(f"{GROUP}/")):
                dataset.attrs[ATTRIBUTE] = np.uint64(digest(name, (), stored_bytes(dataset[()], dataset.dtype)))
        file.flush()
        if sums := _heap_sums(memoryview(file.id.get_file_image())):
            file.attrs[HEAP] = np.array(sums, "<u8")
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


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
