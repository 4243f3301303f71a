"""Log of a run in progress: a file to which only whole frames are appended, at the path of the run file.

A frame holds the bytes of one row of a dataset, or of consecutive records in one chunk of echoes. It states their place
and their checksum. A crash can damage only frames after the last sync: the first frame that fails its checks ends
the log. When the run ends, ``assembly.py`` writes the frames into an HDF5 file, which replaces the log.

    file     SIGNATURE, nonce (8 random bytes), frames
    frame    header (``_HEADER``), payload

The first frame, ``IMAGE``, holds the bytes of an empty run file (``layout.py``).
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, final
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from hpe_rig.store import lock
from hpe_rig.store.checksum import crc
from hpe_rig.store.datasets import DATASETS
from hpe_rig.store.format import StoreError

SIGNATURE: Final = b"\x89HPE\r\n\x1a\n"
NONCE_BYTES: Final = 8
MARK: Final = b"HPEF"
IMAGE: Final = "image"
STATUS: Final = "status"
TRIGGER_TIMES: Final = "records/trigger_time_s"
SHOT_COMPLETE: Final = "records/shot_complete"
SYNCED: Final = (SHOT_COMPLETE, STATUS)
"""Frames after which the writer syncs the disk: what lies before them survives a power loss."""
CODES: Final = ("records/echo", "records/monitor")
"""Datasets with the codes of an input; the frames of one block of records are these, then the trigger times."""
MAX_IMAGE_BYTES: Final = 1 << 28
SEARCH_BYTES: Final = 1 << 20

_HEADER: Final = struct.Struct("<4s32siqQI")
"""Mark, dataset, shot (-1: no shot), first record in the shot, bytes of the payload, checksum of the payload."""
_HEADER_CHECKSUM: Final = struct.Struct("<I")
HEADER_BYTES: Final = _HEADER.size + _HEADER_CHECKSUM.size

_NUMBERS: Final = {name: number for number, name in enumerate((IMAGE, STATUS, *DATASETS))}
"""Number of the name of a frame in memory."""
_UNKNOWN: Final = len(_NUMBERS)
"""Number of every name that only another version writes: these frames are omitted."""


class Frame(NamedTuple):
    """A frame with an intact header; ``offset``: of its payload in the file."""

    number: int
    shot: int
    first: int
    size: int
    checksum: int
    offset: int

    @property
    def name(self) -> str:
        """Path of the dataset, ``IMAGE`` or ``STATUS``; "" if this version does not know it."""
        return [*_NUMBERS, ""][self.number]

    def row_or_chunk(self, chunk_records: int) -> tuple[int, ...]:
        """Return the row or chunk of the frame, which its checksum includes; a chunk has ``chunk_records`` records."""
        if self.name in (*CODES, TRIGGER_TIMES):
            return self.shot, self.first // chunk_records
        return () if self.shot < 0 else (self.shot,)


_ROW: Final = np.dtype(list(zip(Frame._fields, ("u1", "i4", "i8", "i8", "u4", "i8"), strict=True)))
"""A frame in memory: a run of 20 GB has 50 000."""


@final
class FrameIndex:
    """Frames of a log, sorted so that those of a row or chunk of a dataset are found without reading all."""

    def __init__(self, frames: NDArray[np.void], chunk_records: int) -> None:
        """Sort ``frames``, rows of a ``Log``, in which a chunk of echoes has ``chunk_records`` records."""
        # ``number`` is that of the frame's dataset.
        is_chunked = np.isin(frames["number"], [_NUMBERS[name] for name in (*CODES, TRIGGER_TIMES)])
        keys = _key(frames["number"], frames["shot"], np.where(is_chunked, frames["first"] // chunk_records, 0))
        order = np.argsort(keys, kind="stable")
        self._keys, self._frames = keys[order], frames[order]

    def find(self, name: str, index: tuple[int, ...]) -> list[Frame]:
        """Return the frames of row or chunk ``index`` of dataset ``name``, in the order of arrival."""
        key = _key(_NUMBERS[name], *(*index, *(-1, 0)[len(index) :]))
        first, last = (np.searchsorted(self._keys, key, side) for side in ("left", "right"))
        return [Frame._make(row) for row in self._frames[first:last].tolist()]


def _key(name: Any, shot: Any, chunk: Any) -> Any:
    """Return a number that increases with the number of the ``name``, then with shot (-1: none), then with chunk."""
    return np.int64(name) << 56 | np.int64(shot) + 1 << 32 | np.int64(chunk)


@final
class LogWriter:
    """Open log of a run; ``has_lock`` is False if its file system has no locks.

    After an error the last frame may be incomplete; ``cut_back`` removes it.
    """

    def __init__(self, path: Path) -> None:
        """Open and lock the log ``path``; raise ``StoreError`` if another program is writing it."""
        self.path = path
        self._file = path.open("r+b", buffering=0)
        try:
            self.has_lock = lock.acquire(self._file)
        except BlockingIOError:
            self._file.close()
            raise StoreError(
                f"{path} is being written by another run. Try: another path, or wait for its end."
            ) from None
        self._identity = os.fstat(self._file.fileno())
        self._nonce = self._file.read(len(SIGNATURE) + NONCE_BYTES)[len(SIGNATURE) :]
        self.size = self._file.seek(0, os.SEEK_END)

    def append(self, name: str, shot: int, payload: bytes | memoryview, index: tuple[int, ...], first: int = 0) -> None:
        """Append a frame with ``payload`` for ``index``, the row or chunk of dataset ``name``.

        Raises ``OSError`` or ``MemoryError``, and ``StoreError`` if the path no longer names this file.
        """
        self.refuse_another_file()
        size = memoryview(payload).nbytes
        header = _header(name, shot, first, size, crc(name, index, payload), self.size, self._nonce)
        self._write(header)
        self._write(payload)
        self.size += HEADER_BYTES + size

    def sync(self) -> None:
        """Wait until the disk has stored every frame."""
        os.fsync(self._file.fileno())

    def cut_back(self) -> None:
        """Remove an incomplete frame at the end."""
        self._file.truncate(self.size)
        self._file.seek(self.size)

    def refuse_another_file(self) -> None:
        """Raise ``StoreError`` if the file was moved, removed, replaced, cut or extended by another program."""
        open_file = os.fstat(self._file.fileno())
        try:
            named_file = self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            raise _lost_file_error(self.path, "was moved or removed") from None
        if not os.path.samestat(open_file, named_file):
            raise _lost_file_error(self.path, "was replaced by another file")
        if open_file.st_size != self.size:
            raise _lost_file_error(
                self.path, f"was changed by another program: it has {open_file.st_size} bytes, not {self.size},"
            )

    def is_in_place(self) -> bool:
        """Return whether the path still names this file; raise ``OSError`` if it cannot be examined."""
        return os.path.samestat(self._identity, self.path.stat())

    def moved_to(self, path: Path) -> None:
        """Record that the file ``path`` has replaced the log: ``is_in_place`` compares with it from then on."""
        self._identity = path.stat()

    def close(self) -> None:
        """Close the file and release its lock."""
        self._file.close()

    def _write(self, data: bytes | memoryview) -> None:
        """Write all of ``data`` at the end; one call of the system may write only a part."""
        remaining = memoryview(data).cast("B")
        while remaining:
            written = self._file.write(remaining)
            if not written:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            remaining = remaining[written:]


@dataclass(frozen=True, slots=True)
class Log:
    """Frames of a log up to the first damaged header, each a row as in ``Frame``.

    ``size``: bytes of the file. ``end``: of the last frame. ``is_torn``: whether the bytes after ``end`` were never
    synced: they are of an interrupted write. Otherwise the log was damaged later.
    """

    image: bytes
    frames: NDArray[np.void]
    size: int
    end: int
    is_torn: bool

    def without_torn_frames(self, file: IO[bytes], chunk_records: int) -> Log:
        """Return the log, open as ``file``, up to the first frame that a power loss has left incomplete.

        That can only be one after the last sync; earlier frames are not examined.
        """
        syncs = np.flatnonzero(np.isin(self.frames["number"], [_NUMBERS[name] for name in SYNCED]))
        first = int((syncs + 1).max(initial=0))
        for number, frame in enumerate(map(Frame._make, self.frames[first:].tolist()), first):
            if not payload(file, frame, chunk_records)[1]:
                return replace(self, frames=self.frames[:number], end=frame.offset - HEADER_BYTES)
        return self


def payload(file: IO[bytes], frame: Frame, chunk_records: int = 1) -> tuple[bytes, bool]:
    """Return the payload of ``frame``, and whether it matches its checksum.

    ``chunk_records``: number of records in a chunk, for frames of echoes and trigger times.
    """
    file.seek(frame.offset)
    content = file.read(frame.size)
    is_intact = crc(frame.name, frame.row_or_chunk(chunk_records), content) == frame.checksum
    return content, is_intact and len(content) == frame.size


def new_log(image: bytes) -> bytes:
    """Return the bytes of a log without records; ``image``: of an empty run file."""
    nonce = os.urandom(NONCE_BYTES)
    start = SIGNATURE + nonce
    header = _header(IMAGE, -1, 0, len(image), crc(IMAGE, (), image), len(start), nonce)
    return start + header + image


def is_log(path: Path) -> bool:
    """Return whether ``path`` is the log of a run; False for a file that cannot be read."""
    try:
        if not path.is_file():
            # Opening a named pipe would block.
            return False
        with path.open("rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False


def read_log(file: IO[bytes]) -> Log | None:
    """Return the frames of the log ``file``; None if its first frame, which holds the empty run file, is damaged."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    nonce = file.read(len(SIGNATURE) + NONCE_BYTES)[len(SIGNATURE) :]
    frames = np.fromiter(_frames(file, nonce, size), _ROW)
    if not frames.size or frames["number"][0] != _NUMBERS[IMAGE] or frames["size"][0] > MAX_IMAGE_BYTES:
        return None
    end = int(frames["offset"][-1] + frames["size"][-1])
    image, is_intact = payload(file, Frame._make(frames[0].item()))
    is_torn = not _has_sync_after(file, end, nonce, size)
    known_frames = frames[1:][frames["number"][1:] != _UNKNOWN]
    return Log(image, known_frames, size, end, is_torn) if is_intact else None


def _frames(file: IO[bytes], nonce: bytes, size: int) -> Iterator[Frame]:
    """Yield the frames of a log of ``size`` bytes up to the first one with a damaged header or incomplete payload."""
    position = len(SIGNATURE) + NONCE_BYTES
    while True:
        file.seek(position)
        frame = _frame(file.read(HEADER_BYTES), position, nonce)
        if frame is None or frame.offset + frame.size > size:
            return
        yield frame
        position = frame.offset + frame.size


def _has_sync_after(file: IO[bytes], start: int, nonce: bytes, size: int) -> bool:
    """Return whether a frame that is followed by a sync lies anywhere after ``start``; a cut one was not synced."""
    for position in range(start, size, SEARCH_BYTES):
        file.seek(position)
        block = file.read(SEARCH_BYTES + HEADER_BYTES)
        start_of_frame = block.find(MARK)
        while start_of_frame >= 0:
            header = block[start_of_frame : start_of_frame + HEADER_BYTES]
            frame = _frame(header, position + start_of_frame, nonce)
            if frame is not None and frame.name in SYNCED and frame.offset + frame.size <= size:
                return True
            start_of_frame = block.find(MARK, start_of_frame + 1)
    return False


def _frame(header: bytes, position: int, nonce: bytes) -> Frame | None:
    """Return the frame with ``header`` at ``position`` of a log; None if the header is damaged."""
    if len(header) < HEADER_BYTES:
        return None
    fields, (checksum,) = header[: _HEADER.size], _HEADER_CHECKSUM.unpack(header[_HEADER.size :])
    mark, name, shot, first, size, payload_checksum = _HEADER.unpack(fields)
    if mark != MARK or checksum != _header_checksum(fields, position, nonce):
        return None
    number = _NUMBERS.get(name.rstrip(b"\0").decode("ascii", "replace"), _UNKNOWN)
    return Frame(number, shot, first, size, payload_checksum, position + HEADER_BYTES)


def _header(name: str, shot: int, first: int, size: int, checksum: int, position: int, nonce: bytes) -> bytes:
    """Return the header of a frame at ``position``."""
    fields = _HEADER.pack(MARK, name.encode("ascii"), shot, first, size, checksum)
    return fields + _HEADER_CHECKSUM.pack(_header_checksum(fields, position, nonce))


def _header_checksum(fields: bytes, position: int, nonce: bytes) -> int:
    """Return the checksum of a header; frames of other logs, or moved within one, do not match it."""
    return crc32(fields, crc32(position.to_bytes(8, "little"), crc32(nonce)))


def _lost_file_error(path: Path, what: str) -> StoreError:
    """Return the error that the file of a run was moved, replaced or changed while the run wrote it."""
    return StoreError(
        f"{path} {what} while the run wrote it. Wherever it is now, hpe-rig verify lists its content. "
        "Try: measure again, and leave a run file alone until its run has ended."
    )
