"""Validation of an HDF5 file that anybody may have written: nothing is taken for granted, no other file is opened.

A file can refer to other files (external links, external storage, virtual datasets), declare sizes that it does not
hold, and name filters; each is refused here, before any data is read.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5f, h5p

from hpe_rig.scene import MAX_TEXT_BYTES, control_character, printable
from hpe_rig.store.checksum import ATTRIBUTE, GROUP, digest, stored_bytes
from hpe_rig.store.format import BITSHUFFLE, FORMAT, FORMAT_VERSION, StoreError, extra, reason

MOST_CHUNK_BYTES: Final = 64_000_000
SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
SUPERBLOCK: Final = 3
"""Version of the HDF5 superblock of every run file; from it on all of the library's metadata carry checksums."""
END_PLACE: Final = 28
"""Byte of that superblock at which the file's length stands, in 8 bytes."""
READ_ATTEMPTS: Final = 20
OPEN_ATTEMPTS: Final = 5
OPEN_PAUSE_S: Final = 0.02


class UntrustedError(Exception):
    """Content of a file that differs from what a run file has there."""


@dataclass(frozen=True, slots=True)
class Trusted:
    """Open file that hands out only what has been checked.

    ``size``: its bytes; ``missing_bytes``: how many it lacks at its end. ``vouched``: whether it has checksums.
    """

    file: h5py.File
    size: int = 0
    missing_bytes: int = 0

    @property
    def vouched(self) -> bool:
        """Whether the file has checksums, which those of early releases have not."""
        return GROUP in self.file

    def text(self, name: str) -> str:
        """Return the text in the scalar dataset ``name``."""
        dataset = self._dataset(name)
        _refuse_outside(dataset, name)
        _refuse_no_text(dataset, f"/{name}")
        self.refuse_damaged(name, dataset)
        return _text(dataset[()], f"/{name}")

    def refuse_damaged(self, name: str, dataset: h5py.Dataset) -> None:
        """Raise ``UntrustedError`` where ``dataset``, which nobody changes after the start, fails its checksum."""
        if self.vouched and not self.is_sound(name, dataset):
            raise UntrustedError(f"/{name} fails its checksum")

    def is_sound(self, name: str, dataset: h5py.Dataset) -> bool:
        """Return whether ``dataset``, which nobody changes after the start, is as its checksum says."""
        stated = dataset.attrs.get(ATTRIBUTE)
        return isinstance(stated, np.uint64) and int(stated) == digest(
            name, (), stored_bytes(dataset[()], dataset.dtype)
        )

    def dataset(self, name: str, dtype: str, shape: tuple[int | None, ...]) -> h5py.Dataset:
        """Return dataset ``name`` if it has this type and shape, where None stands for any length."""
        dataset = self._dataset(name)
        _refuse_outside(dataset, name)
        if dataset.dtype != np.dtype(dtype):
            raise UntrustedError(f"/{name} holds {str(dataset.dtype)[:40]}, not {np.dtype(dtype)}")
        alike = len(dataset.shape or ()) == len(shape)
        if not alike or any(want not in (None, have) for want, have in zip(shape, dataset.shape, strict=True)):
            raise UntrustedError(f"/{name} has shape {dataset.shape}, where {shape} fits the rest of the file")
        _refuse_chunks(dataset, name)
        return dataset

    def attribute(self, name: str, kind: type, of: str | None = None) -> Any:
        """Return the scalar attribute ``name`` of the file or of dataset ``of``, as ``kind``: str, int, bool, float."""
        owner = self.file if of is None else self._dataset(of)
        where = f"attribute {of or ''}.{name}"
        if name not in owner.attrs:
            raise UntrustedError(f"{where} is absent")
        identity = owner.attrs.get_id(name)
        if identity.shape != ():
            raise UntrustedError(f"{where} is not a single value")
        if kind is str:
            _refuse_no_text(identity, where)
            return printable(_text(owner.attrs[name], where))
        if identity.dtype.kind not in {int: "iu", bool: "b", float: "f"}[kind]:
            raise UntrustedError(f"{where} is not of type {kind.__name__}")
        value = kind(owner.attrs[name])
        if not math.isfinite(value):
            raise UntrustedError(f"{where} is {value}")
        return value

    def has(self, name: str) -> bool:
        """Return whether there is something at ``name``."""
        return name in self.file

    def _dataset(self, name: str) -> h5py.Dataset:
        path = ""
        for part in name.split("/"):
            path = f"{path}/{part}"
            link = self.file.get(path, getlink=True)
            if link is None:
                raise UntrustedError(f"{path} is absent")
            if not isinstance(link, h5py.HardLink):
                raise UntrustedError(f"{path} points out of its place, which no run file does")
        item = self.file[name]
        if not isinstance(item, h5py.Dataset):
            raise UntrustedError(f"{path} is not a dataset")
        return item


@contextlib.contextmanager
def trusted(path: Path) -> Iterator[Trusted]:
    """Yield the run file ``path``, also while another program writes it; raise ``StoreError`` for anything wrong."""
    try:
        declared = _declared_size(path)
        # Asked afterwards, since a run that goes on makes it longer.
        size = path.stat().st_size
        with _opened(path) as file:
            trust = Trusted(file, size, max(0, declared - size))
            _refuse_format(trust)
            yield trust
    except UntrustedError as error:
        raise StoreError(
            f"{path} is not a readable run file: {error}. It is damaged, was changed, or comes from elsewhere. "
            "Try: a file written by hpe-rig run."
        ) from None
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError) as error:
        raise StoreError(
            f"{path} is not a readable run file ({reason(error)}). It is cut short, damaged or comes from elsewhere. "
            "Try: a copy of it, or measure again."
        ) from error


def _opened(path: Path) -> h5py.File:
    """Open ``path`` as one that may grow: what is read of it is never older than the marks that say it is there.

    A run ended by a full disk may be shorter than it declares, which HDF5 tolerates in such a file alone.
    """
    opening = os.fsencode(path), h5f.ACC_RDONLY | h5f.ACC_SWMR_READ, _patience()
    for _ in range(OPEN_ATTEMPTS):
        with contextlib.suppress(OSError):
            return h5py.File(h5f.open(*opening))
        with contextlib.suppress(OSError):
            # This program may have it open in the plain way already.
            return h5py.File(path, "r")
        # A writer of an earlier release may be between two of its steps. On a damaged file this costs 0.1 s.
        time.sleep(OPEN_PAUSE_S)
    return h5py.File(h5f.open(*opening))


def _patience() -> h5p.PropFAID:
    """Return file access properties with ``READ_ATTEMPTS`` attempts to read damaged metadata.

    The library's default is 100, with a pause that doubles each time: practically for ever. h5py does not expose the
    setting, hence ctypes.
    """
    access = h5p.create(h5p.FILE_ACCESS)
    beside = Path(h5py.__file__).parent / "hdf5.dll"
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(str(beside if beside.exists() else h5p.__file__))
        library.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(READ_ATTEMPTS))
    return access


def _declared_size(path: Path) -> int:
    """Return the length that the file itself states; raise where it cannot be a run file."""
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "is not a regular file" if path.exists() else "does not exist"
        raise StoreError(f"{path} {what}. Try: a file written by hpe-rig run, here or with its folder's name.")
    with path.open("rb") as file:
        start = file.read(END_PLACE + 8)
    if start[: len(SIGNATURE)] != SIGNATURE:
        raise UntrustedError("it is not an HDF5 file")
    if len(start) < END_PLACE + 8 or start[len(SIGNATURE)] != SUPERBLOCK:
        kind = f"a run file has a superblock of version {SUPERBLOCK}"
        raise UntrustedError(f"it is an HDF5 file of another kind ({kind})")
    return int.from_bytes(start[END_PLACE:], "little")


def _refuse_format(trust: Trusted) -> None:
    try:
        known = trust.attribute("format", str) == FORMAT
    except UntrustedError:
        known = False
    if not known:
        raise UntrustedError("it is an HDF5 file, but a result file or another program's")
    version = trust.attribute("format_version", int)
    newer = f"this program reads up to {FORMAT_VERSION}; a newer hpe-rig reads it"
    if version != FORMAT_VERSION:
        why = newer if version > FORMAT_VERSION else "which predates the promises of run files"
        raise UntrustedError(f"it has format version {version}, {why}")


def _refuse_no_text(holder: Any, where: str) -> None:
    """Raise ``UntrustedError`` unless ``holder`` has a single text of fixed, bounded length."""
    if holder.shape != ():
        raise UntrustedError(f"{where} is not a single text")
    information = h5py.check_string_dtype(holder.dtype)
    if information is None:
        raise UntrustedError(f"{where} is not text")
    if information.length is None:
        # Such text lies in a heap without checksums, where a damaged file can send the library into an endless loop.
        raise UntrustedError(f"{where} is a text of variable length, which no run file holds")
    if holder.dtype.itemsize > MAX_TEXT_BYTES:
        raise UntrustedError(f"{where} is a text of {holder.dtype.itemsize} bytes, more than {MAX_TEXT_BYTES}")


def _text(value: Any, where: str) -> str:
    try:
        text = value.decode("utf-8") if isinstance(value, bytes) else str(value)
        text.encode("utf-8")
    except UnicodeError:
        raise UntrustedError(f"{where} is not UTF-8 text") from None
    if len(text) > MAX_TEXT_BYTES:
        raise UntrustedError(f"{where} is a text of {len(text)} characters, more than {MAX_TEXT_BYTES}")
    # A terminal would execute them.
    if control_character(text):
        raise UntrustedError(f"{where} holds control characters")
    return text


def _refuse_outside(dataset: h5py.Dataset, name: str) -> None:
    if dataset.is_virtual or dataset.external:
        raise UntrustedError(f"/{name} keeps its values in another file, which no run file does")


def _refuse_chunks(dataset: h5py.Dataset, name: str) -> None:
    if dataset.chunks is not None and math.prod(dataset.chunks) * dataset.dtype.itemsize > MOST_CHUNK_BYTES:
        raise UntrustedError(f"/{name} has chunks of {dataset.chunks}, larger than any run file's")
    plist = dataset.id.get_create_plist()
    filters = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    if filters not in ([], [BITSHUFFLE]):
        raise UntrustedError(f"/{name} went through filters {filters[:5]}, of which a run file knows {BITSHUFFLE} only")
    if filters:
        with extra("compression"):
            import hdf5plugin  # noqa: F401, registers the filter
