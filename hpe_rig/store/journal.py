"""Journal between HDF5 and the disk: the library writes into memory, and whole steps go from there to the file.

An error of the disk that reaches the HDF5 library leaves it in a state in which closing the file, or the program's end,
may crash. Here it never meets one: all that it writes is kept until ``commit``, which brings it to the file in an order
in which the file is whole at every moment, checks that this is still the file that was begun, and raises what fails.

The file is written by a thread of its own, so that a disk or a share that no longer answers cannot keep a run from
switching its outputs off. A commit may go on while the next one is prepared: one at a time, in their order.
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

LONGEST_STEP_S: Final = 60.0
"""How long a disk may take for one step of writing; shares that fail over to another server take tens of seconds."""
LAST_STEP_S: Final = 5.0
"""The same for the steps after one during which the run was interrupted: somebody waits for its end."""
UNDO_S: Final = 1.0
"""How long an interrupted program waits for what is still made on the disk, to undo it: outputs may be on meanwhile."""
LOOK_S: Final = 0.2
"""How long one look at what the disk does lasts: a signal that comes just before it begins takes effect at its end."""
SUPERBLOCK_BYTES: Final = 48
FLAGS_PLACE: Final = 11
"""Byte of the superblock in which the library marks a file as being written."""

Write = tuple[int, bytes]
Made = TypeVar("Made")


@final
class Journal:
    """The run file ``path`` as a file-like object for HDF5; ``locked`` is False where its disk knows no locks.

    The library must not be in the middle of a call while ``commit`` is asked for. After a commit failed nothing that it
    writes reaches the file any more; the file is then as it was after the last one that went well, but for ``amend``.
    """

    def __init__(self, path: Path) -> None:
        """Open and lock ``path``; raise ``StoreError`` where another program writes it, else ``OSError``."""
        self.path = path
        self._file = path.open("r+b", buffering=0)
        try:
            self.locked = lock.take(self._file)
        except BlockingIOError:
            self._file.close()
            raise StoreError(
                f"{path} is being written by another run. Try: another path, or wait for its end."
            ) from None
        # A view of its own, since reading and writing both move the place in the file.
        self._view = path.open("rb", buffering=0)
        self._identity = os.fstat(self._file.fileno())
        self._size = self._end = self._identity.st_size
        self._place = 0
        self._pending: list[Write] = []
        # What the last commit brings to the file, which may not be there yet, and its end until that was waited for.
        self._under_way: tuple[Write, ...] = ()
        self._done: Future[None] | None = None
        self._failure: Exception | None = None
        self._stuck = self._interrupted = False
        self._tasks: SimpleQueue[tuple[Callable[[], None], Future[None]] | None] = SimpleQueue()
        threading.Thread(target=_work, args=(self._tasks,), daemon=True, name="run file").start()

    # What HDF5 asks of a file.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to ``offset`` from the start, from here or from the end."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        self._place = start + offset
        return self._place

    def tell(self) -> int:
        """Return the place in the file."""
        return self._place

    def readinto(self, buffer: memoryview) -> int:
        """Fill ``buffer`` as if all that was written here were in the file already; zeros where there is nothing."""
        self._view.seek(self._place)
        found = 0
        # One read may bring less than there is, over a network or beyond 2 GB; nothing at all is the file's end.
        while found < len(buffer) and (count := self._view.readinto(buffer[found:])):
            found += count
        buffer[found:] = bytes(len(buffer) - found)
        for offset, data in (*self._under_way, *self._pending):
            first, last = max(offset, self._place), min(offset + len(data), self._place + len(buffer))
            if first < last:
                buffer[first - self._place : last - self._place] = data[first - offset : last - offset]
        self._place += len(buffer)
        return len(buffer)

    def write(self, data: memoryview) -> int:
        """Keep ``data`` for the next commit."""
        self._pending.append((self._place, bytes(data)))
        self._place += len(data)
        self._end = max(self._end, self._place)
        return len(data)

    def truncate(self, size: int) -> int:
        """Let the file end at ``size``."""
        self._end = size
        return size

    def flush(self) -> None:
        """Do nothing: the library calls this in the middle of what belongs together."""

    # What the writer asks of it.

    def put(self, offset: int, data: bytes) -> None:
        """Keep ``data`` for the next commit, to be at ``offset``: of what the library neither reads nor writes."""
        self.seek(offset)
        self.write(memoryview(data))

    @property
    def pending(self) -> bool:
        """Whether the library wrote anything since the last commit."""
        return bool(self._pending)

    def take_pending(self) -> tuple[Write, ...]:
        """Return what the library wrote since the last commit, and forget it."""
        taken, self._pending = tuple(self._pending), []
        return taken

    def commit(self, sync: bool = False, wait: bool = True) -> None:
        """Bring all that was written to the file, with ``sync`` to the disk itself; without ``wait`` begin to.

        Raises ``OSError`` or ``MemoryError``, of this commit or of an earlier one, and ``StoreError`` where the file is
        no longer the one that was begun.
        """
        # First, so that an interrupt while it waits takes nothing of what the next commit has to bring.
        self._settle()
        batch, end = self.take_pending(), self._end
        if self._failure is not None:
            raise self._failure
        self._under_way = batch
        self._begin(lambda: self._apply(batch, end, sync))
        if wait:
            self._settle()

    def amend(self, writes: tuple[Write, ...]) -> None:
        """Overwrite bytes in place and sync, also after a failure; raise ``OSError`` where that fails too."""
        self._do(lambda: self._overwrite(writes))

    def hurry(self) -> None:
        """Wait no longer than ``LAST_STEP_S`` for what is under way: the run was interrupted, its end is waited for."""
        self._interrupted = self._interrupted or (self._done is not None and not self._done.done())

    def is_in_place(self) -> bool:
        """Return whether ``path`` still names the file that was begun, closed or not; raise ``OSError`` else."""
        return os.path.samestat(self._identity, self.path.stat())

    def close(self) -> None:
        """Close the file and so release its lock; a disk that does not answer keeps it until the program's end."""
        if not self._stuck:
            self._do(self._file.close)
            self._view.close()
        self._tasks.put(None)

    def _do(self, task: Callable[[], None]) -> None:
        """Have the thread do ``task``; interrupted while it waits, it is done all the same."""
        with contextlib.suppress(Exception):
            # What a commit before failed with is kept, and raised by the next.
            self._settle()
        self._begin(task)
        self._settle()

    def _begin(self, task: Callable[[], None]) -> None:
        if self._stuck:
            raise OSError(errno.ETIMEDOUT, "the disk does not answer")
        self._done = Future()
        self._tasks.put((task, self._done))

    def _settle(self) -> None:
        """Wait for the task that was begun last, and raise what it failed with."""
        if self._done is None:
            return
        done, patience_s = self._done, LAST_STEP_S if self._interrupted else LONGEST_STEP_S
        try:
            self._stuck = not _ends(done, patience_s)
        except BaseException:
            self._interrupted = not done.done()
            raise
        finally:
            if self._stuck or done.done():
                self._done = None
        if self._stuck:
            self._failure = OSError(errno.ETIMEDOUT, f"the disk has not answered for {patience_s:g} s")
            raise self._failure
        done.result()

    def _apply(self, batch: tuple[Write, ...], end: int, sync: bool) -> None:
        try:
            self._refuse_another_file()
            # Behind the end first: nothing in the file refers there yet.
            for offset, data in batch:
                if offset >= self._size:
                    self._put(offset, data)
            if end > self._size:
                self._file.truncate(end)
            superblocks = [(0, _unmarked(data)) for offset, data in batch if offset == 0]
            for offset, data in superblocks[-1:]:
                self._put(offset, data)
            for offset, data in batch:
                if 0 < offset < self._size:
                    self._put(offset, data)
            if end < self._size:
                self._file.truncate(end)
            self._size = end
            if sync:
                os.fsync(self._file.fileno())
        except Exception as error:
            # Whatever it was, too little memory among it: a later batch may only follow one that is there.
            self._failure = error
            raise

    def _overwrite(self, writes: tuple[Write, ...]) -> None:
        size = os.fstat(self._file.fileno()).st_size
        for offset, data in writes:
            if offset + len(data) <= size:
                self._put(offset, data)
        os.fsync(self._file.fileno())

    def _put(self, offset: int, data: bytes) -> None:
        self._file.seek(offset)
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]

    def _refuse_another_file(self) -> None:
        """Raise ``StoreError`` where the file was moved, removed, replaced or cut since the last commit."""
        here = os.fstat(self._file.fileno())
        try:
            there = self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            raise _lost(self.path, "was moved or removed") from None
        if not os.path.samestat(here, there):
            raise _lost(self.path, "was replaced by another file")
        if here.st_size != self._size:
            raise _lost(self.path, f"was changed by another program: it has {here.st_size} bytes, not {self._size},")


def in_time(make: Callable[[threading.Event], Made], undo: Callable[[Made], object]) -> Made:
    """Return what ``make`` makes on the disk, by a thread of its own; signals interrupt the wait for it.

    Where it is interrupted, or the disk takes longer than ``LONGEST_STEP_S`` (``OSError``), the event that ``make`` is
    given is set, and what it makes all the same is undone.
    """
    given_up, tasks = threading.Event(), SimpleQueue[tuple[Callable[[], None], Future[None]] | None]()
    made: list[Made] = []
    done: Future[None] = Future()
    stuck = False

    def undone(_: Future[None]) -> None:
        for each in made:
            undo(each)

    tasks.put((lambda: made.append(make(given_up)), done))
    tasks.put(None)
    threading.Thread(target=_work, args=(tasks,), daemon=True, name="new file").start()
    try:
        with interruptible():
            stuck = not _ends(done, LONGEST_STEP_S)
        if stuck:
            raise OSError(errno.ETIMEDOUT, f"the disk has not answered for {LONGEST_STEP_S:g} s")
        done.result()
        return made[0]
    except BaseException:
        given_up.set()
        # A disk that answers is waited for: the process may end before its thread has undone anything.
        if stuck or not _ends(done, UNDO_S):
            done.add_done_callback(undone)
        else:
            undone(done)
        raise


def _ends(done: Future[None], patience_s: float) -> bool:
    """Return whether the task ends in time, looking up often: a signal wakes nobody who is about to fall asleep."""
    until_s = time.monotonic() + patience_s
    while not done.done():
        left_s = until_s - time.monotonic()
        if left_s <= 0:
            return False
        wait([done], min(LOOK_S, left_s))
    return True


def _lost(path: Path, what: str) -> StoreError:
    return StoreError(
        f"{path} {what} while the run wrote it. Wherever it is now, hpe-rig verify tells what it holds. "
        "Try: measure again, and leave a run file alone until its run has ended."
    )


def _work(tasks: SimpleQueue[tuple[Callable[[], None], Future[None]] | None]) -> None:
    while (item := tasks.get()) is not None:
        task, done = item
        try:
            task()
            done.set_result(None)
        except BaseException as error:
            done.set_exception(error)


def _unmarked(superblock: bytes) -> bytes:
    """Return the superblock without the mark that a program writes the file.

    Every commit leaves a whole file, so that none has to be kept from reading it, nor repaired after a crash.
    """
    if len(superblock) != SUPERBLOCK_BYTES:
        return superblock
    content = superblock[:FLAGS_PLACE] + b"\0" + superblock[FLAGS_PLACE + 1 : -4]
    return content + lookup3(content).to_bytes(4, "little")


def lookup3(data: bytes) -> int:
    """Return the checksum of HDF5's metadata: Bob Jenkins's lookup3 with initial value 0, as its format specifies."""
    most = 0xFFFFFFFF
    if not data:
        return 0xDEADBEEF
    padded = data + bytes(-len(data) % 12)
    words = [int.from_bytes(padded[place : place + 4], "little") for place in range(0, len(padded), 4)]
    a = b = c = (0xDEADBEEF + len(data)) & most

    def rotated(value: int, bits: int) -> int:
        return ((value << bits) | (value >> (32 - bits))) & most

    for place in range(0, len(words) - 3, 3):
        a, b, c = ((one + more) & most for one, more in zip((a, b, c), words[place : place + 3], strict=True))
        for bits in (4, 6, 8, 16, 19, 4):
            a, c = ((a - c) & most) ^ rotated(c, bits), (c + b) & most
            a, b, c = b, c, a
    a, b, c = ((one + more) & most for one, more in zip((a, b, c), words[-3:], strict=True))
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - rotated(b, bits)) & most
        a, b, c = b, c, a
    return b
