"""Journal between HDF5 and the disk: the library writes into memory, and whole steps go from there to the file.

After a disk error, the HDF5 library may crash when the file is closed or the program ends. The journal keeps disk
errors away from the library. It collects all writes until ``commit``, which writes them to the file in an order that
keeps the file readable at every moment. ``commit`` checks that the path still names the same file, and raises errors.

A separate thread writes the file, so that a disk or network share that does not respond cannot delay switching the
outputs off. One commit can run while the next one is prepared; commits run one at a time, in order.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from pathlib import Path
from queue import SimpleQueue
from typing import Final, TypeVar, final

from hpe_rig.bench import interruptible
from hpe_rig.store import lock
from hpe_rig.store.format import StoreError

STEP_TIMEOUT_S: Final = 60.0
"""Time limit of one write; network shares that fail over to another server take tens of seconds."""
LAST_STEP_TIMEOUT_S: Final = 5.0
"""Time limit of each write after the run was interrupted: the user is waiting for it to end."""
UNDO_TIMEOUT_S: Final = 1.0
"""Time that an interrupted program waits for an unfinished task before it undoes it; outputs may be on meanwhile."""
POLL_S: Final = 0.2
"""Interval between checks of a running task; a signal takes effect after this time at the latest."""
SUPERBLOCK_BYTES: Final = 48
FLAGS_OFFSET: Final = 11
"""Byte of the superblock in which the library marks a file as being written."""

Write = tuple[int, bytes]
Product = TypeVar("Product")


@final
class Journal:
    """The run file ``path`` as a file-like object for HDF5; ``locked`` is False if its file system has no locks.

    Call ``commit`` only between calls of the library. After a failed commit nothing but ``overwrite`` changes the file:
    it stays as the last successful commit left it.
    """

    def __init__(self, path: Path) -> None:
        """Open and lock the file ``path``, and start the thread that writes to it.

        Raises ``StoreError`` if another program is writing it, and ``OSError`` if it cannot be opened.
        """
        self.path = path
        self._file = path.open("r+b", buffering=0)
        try:
            self.locked = lock.acquire(self._file)
        except BlockingIOError:
            self._file.close()
            raise StoreError(
                f"{path} is being written by another run. Try: another path, or wait for its end."
            ) from None
        # A second handle for reading, since reading and writing both move the position in the file.
        self._view = path.open("rb", buffering=0)
        self._identity = os.fstat(self._file.fileno())
        self._size = self._end = self._identity.st_size
        self._position = 0
        self._pending: list[Write] = []
        # The writes of the last commit, which may not be in the file yet, and its future until it was awaited.
        self._in_progress: tuple[Write, ...] = ()
        self._done: Future[None] | None = None
        self._failure: Exception | None = None
        self._stuck = self._interrupted = False
        self._tasks: SimpleQueue[tuple[Callable[[], None], Future[None]] | None] = SimpleQueue()
        threading.Thread(target=_run_tasks, args=(self._tasks,), daemon=True, name="run file").start()

    # Methods that HDF5 calls.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position of the next read or write to ``offset`` from the start, the current position or the end."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the position in the file."""
        return self._position

    def readinto(self, buffer: memoryview) -> int:
        """Fill ``buffer`` from the current position as if all pending writes were in the file; zeros beyond its end."""
        self._view.seek(self._position)
        filled = 0
        # One read may return fewer bytes than requested, over a network or beyond 2 GB; zero bytes mark the file's end.
        while filled < len(buffer) and (count := self._view.readinto(buffer[filled:])):
            filled += count
        buffer[filled:] = bytes(len(buffer) - filled)
        # Later writes override earlier ones.
        for offset, data in (*self._in_progress, *self._pending):
            first, last = max(offset, self._position), min(offset + len(data), self._position + len(buffer))
            if first < last:
                buffer[first - self._position : last - self._position] = data[first - offset : last - offset]
        self._position += len(buffer)
        return len(buffer)

    def write(self, data: memoryview) -> int:
        """Collect ``data`` for the next commit; nothing is written to the disk yet. Return its length."""
        self._pending.append((self._position, bytes(data)))
        self._position += len(data)
        self._end = max(self._end, self._position)
        return len(data)

    def truncate(self, size: int) -> int:
        """Set the length of the file to ``size`` at the next commit."""
        self._end = size
        return size

    def flush(self) -> None:
        """Do nothing: the library also calls this between writes that belong together."""

    # Methods that the writer calls.

    def put(self, offset: int, data: bytes) -> None:
        """Add ``data`` at ``offset`` to the next commit; the library must neither read nor write these bytes."""
        self.seek(offset)
        self.write(memoryview(data))

    @property
    def pending(self) -> bool:
        """Whether there are writes since the last commit."""
        return bool(self._pending)

    def pop_pending(self) -> tuple[Write, ...]:
        """Return the writes since the last commit and clear them."""
        writes, self._pending = tuple(self._pending), []
        return writes

    def commit(self, sync: bool = False, wait: bool = True) -> None:
        """Write all pending writes to the file; with ``sync`` flush the disk too, without ``wait`` only start.

        Raises ``OSError`` or ``MemoryError`` of this commit or an earlier one, and ``StoreError`` if the path no longer
        names the same file.
        """
        # Wait before the pending writes are popped: an interrupt during the wait must not lose them.
        self._wait_for_task()
        batch, end = self.pop_pending(), self._end
        if self._failure is not None:
            raise self._failure
        self._in_progress = batch
        self._start(lambda: self._apply(batch, end, sync))
        if wait:
            self._wait_for_task()

    def overwrite(self, writes: tuple[Write, ...]) -> None:
        """Overwrite existing bytes and sync, also after a failed commit; raise ``OSError`` if this fails too."""
        self._do(lambda: self._overwrite(writes))

    def shorten_timeout(self) -> None:
        """Limit the wait for a running task to ``LAST_STEP_TIMEOUT_S``, because the run was interrupted."""
        self._interrupted = self._interrupted or (self._done is not None and not self._done.done())

    def is_in_place(self) -> bool:
        """Return whether ``path`` still names this file; raise ``OSError`` if it cannot be examined."""
        return os.path.samestat(self._identity, self.path.stat())

    def close(self) -> None:
        """Close the file and release its lock; a disk that does not respond keeps both until the program ends."""
        if not self._stuck:
            self._do(self._file.close)
            self._view.close()
        self._tasks.put(None)

    def _do(self, task: Callable[[], None]) -> None:
        """Run ``task`` in the writing thread and wait for it; an interrupt ends the wait and not the task."""
        with contextlib.suppress(Exception):
            # The error of an earlier commit is stored; the next commit raises it.
            self._wait_for_task()
        self._start(task)
        self._wait_for_task()

    def _start(self, task: Callable[[], None]) -> None:
        """Give ``task`` to the writing thread; raise ``OSError`` if the disk has stopped responding."""
        if self._stuck:
            raise OSError(errno.ETIMEDOUT, "the disk does not answer")
        self._done = Future()
        self._tasks.put((task, self._done))

    def _wait_for_task(self) -> None:
        """Wait until the writing thread has finished its last task, and raise its error.

        If the disk does not respond in time, this and all later calls raise ``OSError``.
        """
        if self._done is None:
            return
        done = self._done
        try:
            self._stuck = not _finishes_within(done, self._timeout_s)
        except BaseException:
            self._interrupted = not done.done()
            raise
        finally:
            if self._stuck or done.done():
                self._done = None
        if self._stuck:
            self._failure = OSError(errno.ETIMEDOUT, f"the disk has not answered for {self._timeout_s():g} s")
            raise self._failure
        done.result()

    def _timeout_s(self) -> float:
        return LAST_STEP_TIMEOUT_S if self._interrupted else STEP_TIMEOUT_S

    def _apply(self, batch: tuple[Write, ...], end: int, sync: bool) -> None:
        """Write ``batch`` in an order that leaves the file readable after each write, and set its length to ``end``."""
        try:
            self._refuse_another_file()
            # Writes beyond the old end come first: nothing in the file refers to them yet.
            for offset, data in batch:
                if offset >= self._size:
                    self._write_at(offset, data)
            if end > self._size:
                self._file.truncate(end)
            # The superblock, which states the new length, precedes the writes that refer beyond the old end.
            superblocks = [(0, _unmarked(data)) for offset, data in batch if offset == 0]
            for offset, data in superblocks[-1:]:
                self._write_at(offset, data)
            for offset, data in batch:
                if 0 < offset < self._size:
                    self._write_at(offset, data)
            if end < self._size:
                self._file.truncate(end)
            self._size = end
            if sync:
                os.fsync(self._file.fileno())
        except Exception as error:
            # Any error, MemoryError included: a batch may only follow one that was written completely.
            self._failure = error
            raise

    def _overwrite(self, writes: tuple[Write, ...]) -> None:
        """Write over existing bytes of the file and flush the disk; writes beyond the file's end are left out."""
        size = os.fstat(self._file.fileno()).st_size
        for offset, data in writes:
            if offset + len(data) <= size:
                self._write_at(offset, data)
        os.fsync(self._file.fileno())

    def _write_at(self, offset: int, data: bytes) -> None:
        """Write all of ``data`` at ``offset``; one call of the system may write only a part."""
        self._file.seek(offset)
        remaining = memoryview(data)
        while remaining:
            remaining = remaining[self._file.write(remaining) :]

    def _refuse_another_file(self) -> None:
        """Raise ``StoreError`` if the file was moved, removed, replaced or cut since the last commit."""
        open_file = os.fstat(self._file.fileno())
        try:
            named_file = self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            raise _lost_file_error(self.path, "was moved or removed") from None
        if not os.path.samestat(open_file, named_file):
            raise _lost_file_error(self.path, "was replaced by another file")
        if open_file.st_size != self._size:
            raise _lost_file_error(
                self.path, f"was changed by another program: it has {open_file.st_size} bytes, not {self._size},"
            )


def make_or_undo(
    make: Callable[[threading.Event], Product],
    undo: Callable[[Product], object],
    cancelled: threading.Event | None = None,
) -> Product:
    """Return the product of ``make``, which runs in a thread, so that a disk that does not answer cannot block.

    The wait ends with an exception at a signal, after ``STEP_TIMEOUT_S`` (``OSError``), or when another thread sets
    ``cancelled``. Then ``cancelled`` is set in any case: ``make`` gets this event and should stop. If it still returns
    a product, ``undo`` is called with it.
    """
    cancelled = cancelled or threading.Event()
    products: list[Product] = []
    done: Future[None] = Future()
    timed_out = False

    def undo_product(_: Future[None]) -> None:
        """Undo the product, if ``make`` returned one."""
        for product in products:
            undo(product)

    def make_product() -> None:
        products.append(make(cancelled))

    threading.Thread(target=_run_task, args=(make_product, done), daemon=True, name="new file").start()
    try:
        with interruptible():
            timed_out = not _finishes_within(done, lambda: 0.0 if cancelled.is_set() else STEP_TIMEOUT_S)
        if timed_out:
            raise OSError(errno.ETIMEDOUT, f"the disk has not answered for {STEP_TIMEOUT_S:g} s")
        # Raises the error of ``make``, if any.
        done.result()
        return products[0]
    except BaseException:
        cancelled.set()
        # Wait for a disk that responds: the process may end before the thread calls ``undo``.
        still_running = timed_out or not _finishes_within(done, lambda: UNDO_TIMEOUT_S)
        if still_running:
            done.add_done_callback(undo_product)
        else:
            undo_product(done)
        raise


def _finishes_within(done: Future[None], timeout_s: Callable[[], float]) -> bool:
    """Return whether the task finishes within ``timeout_s``, which another thread may change meanwhile.

    Waits in short intervals, because a signal that arrives just before a wait does not end it.
    """
    start_s = time.monotonic()
    while not done.done():
        remaining_s = start_s + timeout_s() - time.monotonic()
        if remaining_s <= 0:
            return False
        wait([done], min(POLL_S, remaining_s))
    return True


def _lost_file_error(path: Path, what: str) -> StoreError:
    """Return the error that the file of a run was moved, replaced or changed while the run wrote it."""
    return StoreError(
        f"{path} {what} while the run wrote it. Wherever it is now, hpe-rig verify lists its content. "
        "Try: measure again, and leave a run file alone until its run has ended."
    )


def _run_tasks(tasks: SimpleQueue[tuple[Callable[[], None], Future[None]] | None]) -> None:
    """Run the tasks of a queue, each with its future, one after another until it yields None; the body of a thread."""
    while (item := tasks.get()) is not None:
        task, done = item
        _run_task(task, done)


def _run_task(task: Callable[[], None], done: Future[None]) -> None:
    """Run ``task``; when it ends, the future is ``done``, with the task's error if it raised one."""
    try:
        task()
        done.set_result(None)
    except BaseException as error:
        done.set_exception(error)


def _unmarked(superblock: bytes) -> bytes:
    """Return the superblock without the flag that a program is writing the file.

    Every commit leaves a complete file: readers need not be locked out, and a crash needs no repair.
    """
    if len(superblock) != SUPERBLOCK_BYTES:
        return superblock
    content = superblock[:FLAGS_OFFSET] + b"\0" + superblock[FLAGS_OFFSET + 1 : -4]
    return content + lookup3(content).to_bytes(4, "little")


def lookup3(data: bytes) -> int:
    """Return the checksum of HDF5's metadata: Bob Jenkins's lookup3 with initial value 0, as its format specifies."""
    mask = 0xFFFFFFFF
    if not data:
        return 0xDEADBEEF
    padded = data + bytes(-len(data) % 12)
    words = [int.from_bytes(padded[start : start + 4], "little") for start in range(0, len(padded), 4)]
    a = b = c = (0xDEADBEEF + len(data)) & mask

    def rotated(value: int, bits: int) -> int:
        """Return the 32-bit ``value`` rotated left by ``bits``."""
        return ((value << bits) | (value >> (32 - bits))) & mask

    for start in range(0, len(words) - 3, 3):
        a, b, c = ((state + word) & mask for state, word in zip((a, b, c), words[start : start + 3], strict=True))
        for bits in (4, 6, 8, 16, 19, 4):
            a, c = ((a - c) & mask) ^ rotated(c, bits), (c + b) & mask
            a, b, c = b, c, a
    a, b, c = ((state + word) & mask for state, word in zip((a, b, c), words[-3:], strict=True))
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - rotated(b, bits)) & mask
        a, b, c = b, c, a
    return b
