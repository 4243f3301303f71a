"""Bounded reading of HDF5 files of unknown origin: no value of another file is read, no declared size is trusted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import h5py

MAX_DEPTH: Final = 32
"""Groups within groups; files of known programs have at most six."""
MAX_OBJECTS: Final = 50_000
"""Groups and datasets; a cell array of MATLAB has one dataset for each element."""
MAX_EXPANSION: Final = 20
"""Size in memory relative to the file; echoes are noisy and compress to a half at best, simulated ones to a tenth."""
MIN_BYTES: Final = 256_000_000
"""Size in memory that is allowed for any file."""


class InvalidContentError(Exception):
    """Content that no file of this program has, or that is not read from the file of another program."""


def max_bytes_of(path: Path) -> int:
    """Return how many bytes of memory the values of a compressed file may take."""
    return max(MIN_BYTES, MAX_EXPANSION * path.stat().st_size)


@contextmanager
def open_bounded(path: Path) -> Iterator[h5py.File]:
    """Yield the HDF5 file ``path`` of unknown origin after a check of all its objects.

    Raises ``InvalidContentError`` for the contents that ``objects`` refuses, and for a dataset that would decompress to
    more bytes than ``max_bytes_of`` the file.
    """
    with h5py.File(path, "r") as file:
        for name, item in objects(file):
            if isinstance(item, h5py.Dataset):
                refuse_expansion(bytes_in_memory(item), max_bytes_of(path), f"/{name}")
        yield file


def objects(file: h5py.File) -> Iterator[tuple[str, h5py.Group | h5py.Dataset]]:
    """Yield path and object of every group and dataset in ``file``, each once; soft links are not followed.

    Raises ``InvalidContentError`` for a link to another file, a dataset with values in another file, and too many or
    too deeply nested objects.
    """
    yield from _objects_in(file, "", 1, set())


def _objects_in(
    group: h5py.Group, prefix: str, depth: int, visited: set[int]
) -> Iterator[tuple[str, h5py.Group | h5py.Dataset]]:
    if depth > MAX_DEPTH:
        raise InvalidContentError(f"it has more than {MAX_DEPTH} groups within each other")
    if len(group) + len(visited) > MAX_OBJECTS:
        raise InvalidContentError(f"it has more than {MAX_OBJECTS} groups and datasets")
    for name in group:
        path, link = f"{prefix}{name}", group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise InvalidContentError(f"/{path} is a link to another file")
        if not isinstance(link, h5py.HardLink):
            continue
        item = group[name]
        address = h5py.h5o.get_info(item.id).addr
        if address in visited:
            continue
        visited.add(address)
        if isinstance(item, h5py.Dataset):
            refuse_elsewhere(item)
        yield path, item
        if isinstance(item, h5py.Group):
            yield from _objects_in(item, f"{path}/", depth + 1, visited)


def refuse_elsewhere(dataset: h5py.Dataset) -> None:
    """Raise ``InvalidContentError`` if the values of ``dataset`` lie in another file."""
    if dataset.is_virtual or dataset.external:
        raise InvalidContentError(f"{dataset.name} keeps its values in another file")


def bytes_in_memory(dataset: h5py.Dataset) -> int:
    """Return the bytes that reading ``dataset`` takes: a chunk is decompressed whole, however little of it is used."""
    chunk = math.prod(dataset.chunks) * dataset.dtype.itemsize if dataset.chunks else 0
    return max(int(dataset.nbytes), chunk)


def refuse_expansion(size: int, max_bytes: int, name: str) -> None:
    """Raise ``InvalidContentError`` if ``size`` bytes are more than ``max_bytes``; ``name`` of the values."""
    if size > max_bytes:
        raise InvalidContentError(
            f"{name} takes {size / 1e6:.6g} MB, more than the {max_bytes / 1e6:.6g} MB that its file may expand to"
        )
