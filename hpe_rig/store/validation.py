"""Validation of an HDF5 file of unknown origin, before any data is read.

Rejected are references to other files (external links, external storage, virtual datasets), sizes beyond the file's
content, and filters that no run file uses.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5f, h5p, h5z
from numpy.typing import NDArray

from hpe_rig.arrays import Int16Array
from hpe_rig.scene import MAX_TEXT_BYTES, control_character, printable
from hpe_rig.store.checksum import ATTRIBUTE, GROUP, crc, digest, stored_bytes
from hpe_rig.store.datasets import AT_ONCE, BY_CHUNK, DATASETS, RECORD_AXES
from hpe_rig.store.foreign_hdf5 import InvalidContentError, bytes_in_memory, refuse_elsewhere, refuse_expansion
from hpe_rig.store.format import BITSHUFFLE, FORMAT, FORMAT_VERSION, OLDEST_VERSION, StoreError, extra

Shape = tuple[int, int, int]
"""Numbers of shots, pulses and samples."""

MAX_SHOTS: Final = 1_000_000
MAX_LENGTHS: Final = {"stage": 64, "condition": 64, "frequency": 1_000_000}
"""Maximum lengths of the axes that ``/records/echo`` does not have."""
MAX_CHUNK_BYTES: Final = 64_000_000
SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
SUPERBLOCK: Final = 3
"""Version of the HDF5 superblock of every run file: the first version with checksums of all HDF5 metadata."""
END_OFFSET: Final = 28
"""Offset in the superblock of the file's length, 8 bytes."""
METADATA_ATTEMPTS: Final = 20


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """Open HDF5 file that returns only checked content; ``shape`` and ``chunk_records`` are those of a run.

    ``size``: bytes of the file. ``missing_bytes``: how much shorter it is than it declares, negative if bytes follow
    its end; of a log, the damaged bytes. ``torn_bytes``: bytes of an interrupted write at the end of a killed run's
    log. ``codes``: returns the codes of a chunk of records in a log, by dataset, shot and number, and their checksum;
    None if ``file`` has them. ``shape``: numbers of shots, pulses and samples, 0 if any is allowed. ``chunk_records``:
    records in a chunk of echoes.
    """

    file: h5py.File
    size: int = 0
    missing_bytes: int = 0
    torn_bytes: int = 0
    codes: Callable[[str, int, int], tuple[Int16Array, int] | None] | None = None
    shape: Shape = (0, 0, 0)
    chunk_records: int = 0

    @property
    def is_written_once(self) -> bool:
        """Whether the file was written after its run; those of format version 2 were written during the run."""
        return int(self.file.attrs["format_version"]) > OLDEST_VERSION

    def row_checksum(self, name: str, index: tuple[int, ...], *contents: bytes | memoryview) -> int:
        """Return the checksum of row or chunk ``index`` of dataset ``name`` by the format of this file."""
        return (crc if self.is_written_once else digest)(name, index, *contents)

    @property
    def has_checksums(self) -> bool:
        """Whether the file has checksums; files of early releases have none."""
        return GROUP in self.file

    def checksums(self, name: str) -> Any:
        """Return the checksums of dataset ``name``, (shot,), (shot, chunk) or a single one; None in an early file."""
        if not self.has_checksums:
            return None
        chunks = -(-self.shape[1] // self.chunk_records)
        shape = () if name in AT_ONCE else (self.shape[0], chunks) if name in BY_CHUNK else (self.shape[0],)
        return self.dataset_of_type(f"{GROUP}/{name}", "<u8", shape)

    def text(self, name: str) -> str:
        """Return the text in the scalar dataset ``name``; raise ``InvalidContentError`` if it is damaged or no text."""
        dataset = self._dataset(name)

        def read() -> Any:
            """Return the value, once its type and length are known to be those of a text."""
            self.refuse_damaged(name, dataset)
            return dataset[()]

        return _text(dataset, read, f"/{name}")

    def refuse_damaged(self, name: str, dataset: h5py.Dataset) -> None:
        """Raise ``InvalidContentError`` if ``dataset``, which never changes after the start, fails its checksum."""
        if self.has_checksums and not self.matches_checksum(name, dataset):
            raise InvalidContentError(f"/{name} fails its checksum")

    def matches_checksum(self, name: str, dataset: h5py.Dataset) -> bool:
        """Return whether ``dataset``, which never changes after the start, matches the checksum in its attribute."""
        stated = dataset.attrs.get(ATTRIBUTE)
        # Such a dataset is stored whole and uncompressed.
        refuse_expansion(bytes_in_memory(dataset), self.file.id.get_filesize(), f"/{name}")
        content = stored_bytes(stored_values(dataset), dataset.dtype)
        return isinstance(stated, np.uint64) and int(stated) == digest(name, (), content)

    def dataset(self, name: str) -> h5py.Dataset:
        """Return dataset ``name`` of a run if its type, shape and chunks are those of a run file."""
        layout = DATASETS[name]
        lengths = dict(zip(RECORD_AXES, self.shape, strict=True))
        dataset = self.dataset_of_type(name, layout.dtype, tuple(lengths.get(axis) or None for axis in layout.axes))
        if any(size > MAX_LENGTHS.get(axis, size) for axis, size in zip(layout.axes, dataset.shape, strict=True)):
            raise InvalidContentError(f"/{name} has shape {dataset.shape}")
        if layout.axes == RECORD_AXES:
            if dataset.chunks is None:
                raise InvalidContentError(f"/{name} is in one piece")
            chunk_records = self.chunk_records or dataset.chunks[1]
            if dataset.chunks != (1, chunk_records, dataset.shape[2]):
                raise InvalidContentError(f"/{name} has chunks of {dataset.chunks}")
        return dataset

    def dataset_of_type(self, name: str, dtype: str, shape: tuple[int | None, ...]) -> h5py.Dataset:
        """Return dataset ``name`` if it has this type and shape; None in ``shape`` allows any length."""
        dataset = self._dataset(name)
        if dataset.dtype != np.dtype(dtype):
            raise InvalidContentError(f"/{name} holds {str(dataset.dtype)[:40]}, not {np.dtype(dtype)}")
        same_rank = len(dataset.shape or ()) == len(shape)
        if not same_rank or any(size not in (None, actual) for size, actual in zip(shape, dataset.shape, strict=True)):
            raise InvalidContentError(f"/{name} has shape {dataset.shape}, where {shape} fits the rest of the file")
        _refuse_chunks(dataset, name)
        return dataset

    def attribute(self, name: str, kind: type, of: str | None = None) -> Any:
        """Return the scalar attribute ``name`` of the file or of dataset ``of``, as ``kind``: str, int, bool, float."""
        owner = self.file if of is None else self._dataset(of)
        where = f"attribute {of or ''}.{name}"
        if name not in owner.attrs:
            raise InvalidContentError(f"{where} is absent")
        identity = owner.attrs.get_id(name)
        if identity.shape != ():
            raise InvalidContentError(f"{where} is not a single value")
        if kind is str:
            return printable(_text(identity, lambda: owner.attrs[name], where))
        if identity.dtype.kind not in {int: "iu", bool: "b", float: "f"}[kind]:
            raise InvalidContentError(f"{where} is not of type {kind.__name__}")
        value = kind(owner.attrs[name])
        if not math.isfinite(value):
            raise InvalidContentError(f"{where} is {value}")
        return value

    def has(self, name: str) -> bool:
        """Return whether the file has a group or dataset ``name``."""
        return name in self.file

    def _dataset(self, name: str) -> h5py.Dataset:
        """Return dataset ``name``; raise ``InvalidContentError`` if it is absent, a group or in another file."""
        path = ""
        # Each group on the path is checked: any of them can be a link to another file.
        for component in name.split("/"):
            path = f"{path}/{component}"
            link = self.file.get(path, getlink=True)
            if link is None:
                raise InvalidContentError(f"{path} is absent")
            if not isinstance(link, h5py.HardLink):
                raise InvalidContentError(f"{path} is a link to another object, which no run file has")
        item = self.file[name]
        if not isinstance(item, h5py.Dataset):
            raise InvalidContentError(f"{path} is not a dataset")
        refuse_elsewhere(item)
        return item


def stored_values(dataset: h5py.Dataset, index: tuple[int | slice, ...] = ()) -> NDArray[Any]:
    """Return the values of ``dataset`` at ``index``, with all bytes 255 in chunks that fail HDF5's own checksum.

    No run has such values, so that they fail the checksum of the run file too.
    """
    try:
        return np.asarray(dataset[index], dataset.dtype)
    except OSError:
        if dataset.chunks is None:
            raise
    values = np.full(dataset.nbytes, 255, "u1").view(dataset.dtype).reshape(dataset.shape)
    for chunk in dataset.iter_chunks():
        with contextlib.suppress(OSError):
            values[chunk] = dataset[chunk]
    return np.asarray(values[index])


def open_hdf5(path: Path) -> h5py.File:
    """Return the run file ``path`` opened for reading, also one that is shorter than it declares.

    HDF5 opens such a file only in its mode for files that are being written (SWMR), and never in any other mode while
    this program has it open in that one.
    """
    arguments = os.fsencode(path), h5f.ACC_RDONLY | h5f.ACC_SWMR_READ, _access_properties()
    with contextlib.suppress(OSError):
        return h5py.File(h5f.open(*arguments))
    with contextlib.suppress(OSError):
        # This program may have opened it without SWMR before.
        return h5py.File(path, "r")
    return h5py.File(h5f.open(*arguments))


def _access_properties() -> h5p.PropFAID:
    """Return file access properties with ``METADATA_ATTEMPTS`` attempts to read damaged metadata.

    The library's default is 100 with a pause that doubles each time: it practically never ends. h5py does not expose
    the setting, hence ctypes.
    """
    access = h5p.create(h5p.FILE_ACCESS)
    windows_library = Path(h5py.__file__).parent / "hdf5.dll"
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(str(windows_library if windows_library.exists() else h5p.__file__))
        library.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(METADATA_ATTEMPTS))
    return access


def declared_size(path: Path) -> int:
    """Return the length, bytes, that the file's HDF5 superblock declares; a shorter file has been cut off.

    Raises ``StoreError`` if ``path`` is no regular file, and ``InvalidContentError`` if the header is not that of a run
    file.
    """
    if not path.is_file():
        problem = "is a folder" if path.is_dir() else "is not a regular file" if path.exists() else "does not exist"
        raise StoreError(
            f"{path} {problem}. Try: a file written by hpe-rig run, with its folder unless it is in the current one."
        )
    with path.open("rb") as file:
        start = file.read(END_OFFSET + 8)
    if start[: len(SIGNATURE)] != SIGNATURE:
        raise InvalidContentError("it is not an HDF5 file")
    if len(start) < END_OFFSET + 8 or start[len(SIGNATURE)] != SUPERBLOCK:
        kind = f"a run file has a superblock of version {SUPERBLOCK}"
        raise InvalidContentError(f"it is an HDF5 file of another kind ({kind})")
    return int.from_bytes(start[END_OFFSET:], "little")


def checked_run(checked: CheckedFile) -> CheckedFile:
    """Return the content of a run with its shape; raise ``InvalidContentError`` unless it is one of this format."""
    try:
        is_run = checked.attribute("format", str) == FORMAT
    except InvalidContentError:
        is_run = False
    if not is_run:
        raise InvalidContentError("it is an HDF5 file, but a result file or another program's")
    version = checked.attribute("format_version", int)
    if not OLDEST_VERSION <= version <= FORMAT_VERSION:
        newer = f"this program reads up to {FORMAT_VERSION}; a newer hpe-rig reads it"
        why = newer if version > FORMAT_VERSION else f"older than the first supported version, {OLDEST_VERSION}"
        raise InvalidContentError(f"it has format version {version}, {why}")
    # Only files of version 2, written during the run, may lack checksums: early releases had none.
    if checked.is_written_once and not checked.has_checksums:
        raise InvalidContentError("its checksums are absent")
    echo = checked.dataset("records/echo")
    if min(echo.shape) < 1 or echo.shape[0] > MAX_SHOTS:
        raise InvalidContentError(f"/records/echo has shape {echo.shape}")
    return replace(checked, shape=echo.shape, chunk_records=echo.chunks[1])


def _text(holder: Any, read: Callable[[], Any], where: str) -> str:
    """Return the text in ``holder``, a dataset or attribute that ``read`` reads; ``where``: its name in messages.

    Raises ``InvalidContentError`` unless it is a single text in UTF-8 of fixed length, up to ``MAX_TEXT_BYTES``,
    without control characters, which a terminal would execute.
    """
    if holder.shape != ():
        raise InvalidContentError(f"{where} is not a single text")
    information = h5py.check_string_dtype(holder.dtype)
    if information is None:
        raise InvalidContentError(f"{where} is not text")
    if information.length is None:
        # Such a text lies in the heap, which has no checksums in HDF5: damage can trap the library in an endless loop.
        raise InvalidContentError(f"{where} is a text of variable length, which no run file holds")
    if holder.dtype.itemsize > MAX_TEXT_BYTES:
        raise InvalidContentError(f"{where} is a text of {holder.dtype.itemsize} bytes, more than {MAX_TEXT_BYTES}")
    try:
        value = read()
        text = value.decode("utf-8") if isinstance(value, bytes) else str(value)
        text.encode("utf-8")
    except UnicodeError:
        raise InvalidContentError(f"{where} is not UTF-8 text") from None
    if control_character(text):
        raise InvalidContentError(f"{where} holds control characters")
    return text


def _refuse_chunks(dataset: h5py.Dataset, name: str) -> None:
    """Raise ``InvalidContentError`` for chunks that are too large or filters other than bitshuffle and Fletcher-32."""
    if dataset.chunks is not None and math.prod(dataset.chunks) * dataset.dtype.itemsize > MAX_CHUNK_BYTES:
        raise InvalidContentError(f"/{name} has chunks of {dataset.chunks}, larger than any run file's")
    numbers = filters(dataset)
    if [number for number in numbers if number != h5z.FILTER_FLETCHER32] not in ([], [BITSHUFFLE]):
        raise InvalidContentError(
            f"/{name} went through filters {numbers[:5]}, of which a run file knows {BITSHUFFLE} only"
        )
    if BITSHUFFLE in numbers:
        with extra("compression"):
            import hdf5plugin  # noqa: F401, registers the filter


def filters(dataset: h5py.Dataset) -> list[int]:
    """Return the registered numbers of the filters of ``dataset``."""
    properties = dataset.id.get_create_plist()
    return [properties.get_filter(index)[0] for index in range(properties.get_nfilters())]
