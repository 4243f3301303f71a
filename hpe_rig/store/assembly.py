"""Log of a run -> its run file in HDF5, and a log as an HDF5 file in memory for readers.

The HDF5 library never works on a file that a run depends on: it fills a draft, which replaces the log when it is
complete. Each chunk of echoes goes from its frames into the draft unchanged, together with the checksum that was
computed when the records arrived.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from io import FileIO
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, final

import h5py
import numpy as np
from h5py import h5f, h5p, h5s
from numpy.typing import NDArray

from hpe_rig.arrays import Int16Array
from hpe_rig.store.atomic import atomic_file
from hpe_rig.store.checksum import blank, crc
from hpe_rig.store.datasets import AT_ONCE, BY_SHOT
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import LIBVER, STATUS_BYTES, STATUSES, StoreError
from hpe_rig.store.lock import is_locked
from hpe_rig.store.log import (
    CODES,
    STATUS,
    TRIGGER_TIMES,
    FrameIndex,
    Log,
    LogWriter,
    is_log,
    payload,
    read_log,
)
from hpe_rig.store.records import MISSING
from hpe_rig.store.task import make_or_undo
from hpe_rig.store.validation import CheckedFile, checked_run

KILLED: Final = "killed"
"""Status of a run whose program was killed: its log has none."""
MAX_VIEWS: Final = 2
"""Number of logs whose content stays in memory, except for the echoes."""
BUFFER_BYTES: Final = 4_000_000
"""Size of the writes that go to the disk together: a thread for each write takes as long as the write."""
CHUNK_CACHE_BYTES: Final = 65_536
"""Size of the library's cache for each dataset, smaller than a chunk of echoes, which is written once, whole. The
default of 1 MB is filled by each of the 15 datasets of a run of 20 GB."""
LIBRARY_ERRORS: Final = (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, MemoryError)


class DamagedLogError(Exception):
    """A log with damage in frames that were synced: it is read as it is and not replaced."""


def _codes(
    checked: CheckedFile, frames: FrameIndex, stream: IO[bytes], name: str, shot: int, number: int
) -> tuple[Int16Array, int] | None:
    """Return the codes of chunk ``number`` of ``shot`` in a log, (record, sample), and their checksum; None if damaged.

    Missing records hold ``MISSING``.
    """
    index, first, (_, records, samples) = (shot, number), number * checked.chunk_records, checked.shape
    shape = (min(checked.chunk_records, records - first), samples)
    codes = np.full((0, samples), MISSING)
    for frame in frames.find(name, index):
        content, is_intact = payload(stream, frame, checked.chunk_records)
        start, stop = frame.first - first, frame.first - first + len(content) // (2 * samples)
        if not is_intact or len(content) % (2 * samples) or stop > shape[0]:
            return None
        values = np.frombuffer(content, "<i2").reshape(-1, samples)
        if values.shape == shape:
            # The usual case: one frame holds the whole chunk, and its checksum is the chunk's.
            return values, frame.checksum
        codes = codes if codes.size else np.full(shape, MISSING)
        codes[start:stop] = values
    codes = codes if codes.size else np.full(shape, MISSING)
    return codes, crc(name, index, codes.data)


_views: dict[tuple[object, ...], tuple[CheckedFile, FrameIndex]] = {}


def view_of(path: Path, stream: IO[bytes]) -> CheckedFile:
    """Return the log ``path``, open as ``stream``, as if it were the finished HDF5 file, with its checked content.

    An HDF5 file in memory has everything but the echoes, which are read from ``stream``. The last ``MAX_VIEWS`` of
    these files are kept until their log changes. A log with records that no program has locked is that of a killed run.
    Raises ``InvalidContentError`` for a damaged log.
    """
    # Before the log is read: a run that ends in between has written its status.
    is_unlocked = is_locked(path) is False
    status = os.fstat(stream.fileno())
    key = (path, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, is_unlocked)
    if key not in _views:
        log = read_log(stream)
        if log is None:
            raise InvalidContentError("the start of the log is damaged")
        checked = _empty_run(CheckedFile(_open_image(log.image), log.size))
        # A log without frames may be that of a run that is just starting and has not locked it yet.
        status_without_frame = KILLED if is_unlocked and log.frames.size else STATUSES[0]
        if is_unlocked and log.is_torn:
            log = log.without_torn_frames(stream, checked.chunk_records)
        unread = log.size - log.end
        checked = replace(
            checked, missing_bytes=0 if log.is_torn else unread, torn_bytes=unread if is_unlocked and log.is_torn else 0
        )
        view = checked, _fill(checked, log.frames, stream, status_without_frame)
        while len(_views) >= MAX_VIEWS:
            # Not closed, as another thread may still read it: it closes with its last reference.
            _views.pop(next(iter(_views)), None)
        _views[key] = view
    checked, frames = _views[key]
    return replace(checked, codes=partial(_codes, checked, frames, stream))


def _empty_run(unchecked: CheckedFile) -> CheckedFile:
    """Return the run file of a log, which has no records yet; raise ``InvalidContentError`` unless it is one."""
    checked = checked_run(unchecked)
    if not checked.is_written_once:
        raise InvalidContentError("it is a log of an earlier format, which has none")
    return checked


def assemble(
    path: Path,
    release: Callable[[], None],
    proceed: Callable[[], None] = lambda: None,
    cancelled: threading.Event | None = None,
) -> None:
    """Replace the log ``path`` by the run file in HDF5; leave the log as it is if that fails.

    ``release``: closes the log before it is replaced. ``proceed``: called between the chunks, may raise to stop. As
    soon as ``cancelled`` is set, a disk that does not answer is not waited for.
    Raises ``OSError`` or ``MemoryError``, ``InvalidContentError`` for a log that hpe_rig did not write, and
    ``DamagedLogError`` for damage that is no consequence of a crash.
    """
    with path.open("rb", buffering=0) as stream:
        log = read_log(stream)
        if log is None or not log.is_torn:
            raise DamagedLogError
        with atomic_file(path) as draft:
            _write_draft(draft, log, stream, proceed, cancelled or threading.Event())
            stream.close()
            release()


def recover(path: Path) -> None:
    """Replace ``path`` by its run file in HDF5 if it is the log of a run whose program was killed.

    Does nothing if another program is writing the log, if it holds no records, and if it cannot be replaced.
    """
    with contextlib.suppress(*LIBRARY_ERRORS, StoreError, InvalidContentError, DamagedLogError):
        if not is_log(path):
            return
        with path.open("rb", buffering=0) as stream:
            log = read_log(stream)
        # A log without frames may be that of a run that is just starting and has not locked it yet: do not lock it.
        if log is None or not log.frames.size:
            return
        writer = LogWriter(path)
        try:
            if writer.has_lock:
                assemble(path, writer.close)
        finally:
            writer.close()


def _write_draft(
    draft: BinaryIO, log: Log, stream: IO[bytes], proceed: Callable[[], None], cancelled: threading.Event
) -> None:
    """Write the run file in HDF5 to ``draft``, from the ``log`` of an ended or killed run, open as ``stream``.

    Frames that a power loss has left incomplete are omitted. ``proceed`` is called before each chunk of echoes and may
    raise to stop. The first error of the disk is raised between chunks and at the end, because the HDF5 library must
    not meet it. If ``cancelled`` is set, a disk that does not answer is not waited for.
    """
    draft.write(log.image)
    draft.flush()
    output = _Output(draft.fileno(), cancelled)

    def refuse_failure_and_proceed() -> None:
        output.refuse_failure()
        proceed()

    options = {"driver": "fileobj", "fileobj": output, "rdcc_nbytes": CHUNK_CACHE_BYTES}
    with h5py.File("draft", "r+", libver=LIBVER, **options) as file:
        checked = _empty_run(CheckedFile(file))
        frames = log.without_torn_frames(stream, checked.chunk_records).frames
        _write_codes(checked, _fill(checked, frames, stream, KILLED), stream, refuse_failure_and_proceed)
    output.finish()


@final
class _Output:
    """Draft of the run file as a file-like object, to which the HDF5 library writes.

    The library may crash if it meets an error of the disk, so it meets none: small writes are collected, the first
    error is stored, and later writes stay in memory until the library has closed the file.
    """

    def __init__(self, number: int, cancelled: threading.Event) -> None:
        """Write to the file with the descriptor ``number`` until ``cancelled`` is set."""
        self._cancelled = cancelled
        self._disk = FileIO(number, "r+", closefd=False)
        self._position = 0
        self._end = os.fstat(number).st_size
        self._failure: BaseException | None = None
        self._unwritten: list[tuple[int, bytes]] = []
        self._unwritten_bytes = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position of the next read or write to ``offset`` from the start, the current position or the end."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the position in the file."""
        return self._position

    def readinto(self, buffer: memoryview) -> int:
        """Fill ``buffer`` from the current position; zeros beyond the end of the file."""
        first, last = self._position, self._position + len(buffer)
        buffer[:] = bytes(len(buffer))
        with contextlib.suppress(OSError, MemoryError):
            self._disk.seek(first)
            buffer[:] = self._disk.read(len(buffer)).ljust(len(buffer), b"\0")
        for offset, data in self._unwritten:
            start, stop = max(offset, first), min(offset + len(data), last)
            if start < stop:
                buffer[start - first : stop - first] = data[start - offset : stop - offset]
        self._position = last
        return len(buffer)

    def write(self, data: memoryview) -> int:
        """Write ``data`` at the current position: to memory first, and to the disk with others that wait."""
        # A copy: the library reuses its buffer.
        self._unwritten.append((self._position, bytes(data)))
        self._unwritten_bytes += len(data)
        self._position += len(data)
        self._end = max(self._end, self._position)
        if self._unwritten_bytes >= BUFFER_BYTES:
            self._attempt(self._write_all)
        return len(data)

    def truncate(self, size: int) -> int:
        """Set the length of the file."""
        self._end = size
        self._attempt(lambda: self._write_all(size))
        return size

    def flush(self) -> None:
        """Do nothing: the draft is synced when it is complete."""

    def finish(self) -> None:
        """Write everything to the disk; raise its first error."""
        self._attempt(self._write_all)
        self.refuse_failure()

    def _attempt(self, change: Callable[[], object]) -> None:
        """Call ``change`` in a thread, and store its error; nothing is done after the first error.

        The library is locked meanwhile, so that it must not wait for a disk that does not answer.
        """
        if self._failure is None:
            try:
                make_or_undo(lambda _: change(), lambda _: None, self._cancelled)
                self._unwritten, self._unwritten_bytes = [], 0
            except BaseException as error:
                self._failure = error

    def _write_all(self, size: int | None = None) -> None:
        """Write what waits for the disk, in order; then set the length of the file to ``size``."""
        for position, content in self._unwritten:
            remaining = memoryview(content)
            while remaining:
                self._refuse_cancelled()
                self._disk.seek(position + len(content) - len(remaining))
                remaining = remaining[self._disk.write(remaining) :]
        if size is not None:
            self._refuse_cancelled()
            self._disk.truncate(size)

    def _refuse_cancelled(self) -> None:
        """Raise ``InterruptedError`` if the draft is given up: its descriptor may soon be that of another file."""
        if self._cancelled.is_set():
            raise InterruptedError

    def refuse_failure(self) -> None:
        """Raise the first error of the disk."""
        if self._failure is not None:
            raise self._failure


def _open_image(image: bytes) -> h5py.File:
    """Return the HDF5 file with the bytes ``image``, opened in memory for reading and writing.

    The library's own driver is safe if the file is still open when the program ends, one with a Python object is not.
    """
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    access.set_fapl_core(backing_store=False)
    access.set_file_image(image)
    # The library takes two files in memory with one name for the same file.
    return h5py.File(h5f.open(secrets.token_hex().encode(), h5f.ACC_RDWR, access))


def _fill(checked: CheckedFile, log_frames: NDArray[np.void], stream: IO[bytes], status: str) -> FrameIndex:
    """Write everything in ``log_frames`` but the codes into the empty run file ``checked``; return the sorted frames.

    ``status``: of the run, unless the frames state it.
    """
    frames = FrameIndex(log_frames, checked.chunk_records)
    for name in (*BY_SHOT, *AT_ONCE):
        if checked.has(name):
            _fill_rows(checked, name, frames, stream)
    _fill_arrivals(checked, frames, stream)
    if ended := frames.find(STATUS, ()):
        text, is_intact = payload(stream, ended[-1])
        status = text.decode("ascii", "replace") if is_intact else status
    checked.file.attrs.modify("status", np.array(status.encode(), f"S{STATUS_BYTES}"))
    checked.file.flush()
    return frames


def _fill_rows(checked: CheckedFile, name: str, frames: FrameIndex, stream: IO[bytes]) -> None:
    """Write the rows of dataset ``name`` and the checksums of all of its rows."""
    dataset, stored_sums = checked.dataset(name), checked.checksums(name)
    sums = np.zeros(stored_sums.shape, "<u8")
    shape = dataset.shape[sums.ndim :]
    empty = blank(dataset.dtype, shape).tobytes()
    for index in np.ndindex(sums.shape):
        sums[index] = crc(name, index, empty)
        # The last frame of a row counts. A damaged one is written too: readers compare it with the frame's checksum.
        for frame in frames.find(name, index)[-1:]:
            content, _ = payload(stream, frame)
            if len(content) != len(empty):
                raise InvalidContentError(f"a row of /{name} has {len(content)} bytes, not {len(empty)}")
            _write(dataset, index, np.frombuffer(content, dataset.dtype).reshape(shape))
            sums[index] = frame.checksum
    _write(stored_sums, (), sums)


def _fill_arrivals(checked: CheckedFile, frames: FrameIndex, stream: IO[bytes]) -> None:
    """Write the marks and trigger times of all records, and their checksums by chunk."""
    (shots, records, _), chunk_records = checked.shape, checked.chunk_records
    stored_marks, stored_time_s = checked.dataset("records/recorded"), checked.dataset(TRIGGER_TIMES)
    stored_sums = checked.checksums("records/recorded")
    sums = np.zeros(stored_sums.shape, "<u8")
    for shot in range(shots):
        marks, time_s = np.zeros(records, "u1"), np.full(records, np.nan)
        for number in range(sums.shape[1]):
            chunk, is_damaged = slice(number * chunk_records, (number + 1) * chunk_records), False
            for frame in frames.find(TRIGGER_TIMES, (shot, number)):
                content, is_intact = payload(stream, frame, chunk_records)
                rows = slice(frame.first, frame.first + len(content) // 8)
                if len(content) % 8 or rows.stop > min(records, chunk.stop):
                    raise InvalidContentError(f"the log has trigger times of records {rows.start} to {rows.stop}")
                marks[rows], time_s[rows] = 1, np.frombuffer(content, "<f8")
                is_damaged = is_damaged or not is_intact
            checksum = crc("records/recorded", (shot, number), marks[chunk].data, time_s[chunk].data)
            # Marks of damaged trigger times get a checksum that they do not match.
            sums[shot, number] = checksum + is_damaged
        if marks.any():
            _write(stored_marks, (shot,), marks)
            _write(stored_time_s, (shot,), time_s)
    _write(stored_sums, (), sums)


def _write_codes(checked: CheckedFile, frames: FrameIndex, stream: IO[bytes], proceed: Callable[[], None]) -> None:
    """Write the echoes, chunk by chunk, and their checksums; raise ``DamagedLogError`` if one is damaged."""
    for name in CODES:
        if not checked.has(name):
            continue
        echoes, stored_sums = checked.dataset(name), checked.checksums(name)
        sums = np.zeros(stored_sums.shape, "<u8")
        for shot, number in np.ndindex(sums.shape):
            if frames.find(name, (shot, number)):
                proceed()
                chunk = _codes(checked, frames, stream, name, shot, number)
                if chunk is None:
                    raise DamagedLogError
                codes, sums[shot, number] = chunk
                _write(echoes, (shot, number * checked.chunk_records), codes)
        _write(stored_sums, (), sums)


def _write(dataset: h5py.Dataset, start: tuple[int, ...], values: NDArray[Any]) -> None:
    """Write ``values`` into ``dataset`` from index ``start`` on: along its first axes, and from 0 along the others.

    Uses the library's low-level interface: h5py takes ten times as long to interpret an index as to write.
    """
    count = (1,) * (len(dataset.shape) - values.ndim) + values.shape
    memory, selection = dataset.id.get_space(), dataset.id.get_space()
    if count:
        memory = h5s.create_simple(count)
        selection.select_hyperslab(start + (0,) * (len(count) - len(start)), count)
    dataset.id.write(memory, selection, np.ascontiguousarray(values.reshape(count)))
