"""Files written by a thread: whoever writes never waits for a terminal, the reader of a pipe, or a disk.

``QueuedFile`` is the raw stream below a text stream. Its chunks are written in order by a ``WritingThread``, which
several files may share. The thread is a daemon: a write that never returns does not keep the program alive.
"""

from __future__ import annotations

import io
import sys
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Final, final

MAX_CHUNKS: Final = 10_000
"""Number of queued lines beyond which further ones are dropped: about 1 MB."""
RETRY_S: Final = 0.05
"""Time until the next attempt to write to a full descriptor that another program made non-blocking."""


@final
class WritingThread:
    """Writes chunks in the order of their arrival."""

    def __init__(self) -> None:
        self._tasks = SimpleQueue[Callable[[], None] | None]()
        threading.Thread(target=self._run, daemon=True, name="queued file").start()

    @property
    def waiting(self) -> int:
        """Number of queued chunks."""
        return self._tasks.qsize()

    def put(self, write: Callable[[], None]) -> None:
        """Queue a call of ``write``."""
        self._tasks.put(write)

    def marker(self) -> threading.Event:
        """Return an event that is set as soon as everything queued so far has been written."""
        written = threading.Event()
        self.put(written.set)
        return written

    def stop(self) -> None:
        """End the thread after the queued chunks."""
        self._tasks.put(None)

    def _run(self) -> None:
        while (write := self._tasks.get()) is not None:
            write()


@final
class QueuedFile(io.RawIOBase):
    """Raw stream that queues its chunks for ``target``; ``failure`` is the first error of a write, if any.

    ``notice`` returns the line about a number of dropped chunks; without it nothing is dropped. ``used``: whether
    anything has been written.
    """

    def __init__(self, target: Any, thread: WritingThread, notice: Callable[[int], str] | None = None) -> None:
        self._target, self._thread, self._notice = target, thread, notice
        self._lock, self._dropped = threading.Lock(), 0
        self.failure: OSError | None = None
        self.used = False

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the target is a terminal."""
        return bool(self._target.isatty())

    def fileno(self) -> int:
        """Return the target's descriptor. On Windows there is none: click would bypass the queue."""
        if sys.platform == "win32":
            raise io.UnsupportedOperation("fileno")
        return int(self._target.fileno())

    def write(self, data: Any, /) -> int:
        """Queue ``data``, or drop it if too much is queued; return its length."""
        chunk = bytes(data)
        self.used = True
        if self._notice is not None:
            with self._lock:
                # Half of the queue must be free again, so that a slow reader gets whole passages.
                limit = MAX_CHUNKS // 2 if self._dropped else MAX_CHUNKS
                if self._thread.waiting >= limit:
                    self._dropped += 1
                    return len(chunk)
            self.report_dropped()
        self._thread.put(lambda: self._write_all(chunk))
        return len(chunk)

    def wait_written(self, timeout_s: float) -> bool:
        """Wait until everything queued so far is written; return whether that happens within ``timeout_s``."""
        return self._thread.marker().wait(timeout_s)

    def report_dropped(self) -> None:
        """Queue the line about the chunks dropped since the last one, if any."""
        with self._lock:
            dropped, self._dropped = self._dropped, 0
        if dropped and self._notice is not None:
            line = self._notice(dropped).encode("ascii")
            self._thread.put(lambda: self._write_all(line))

    def _write_all(self, chunk: bytes) -> None:
        remaining = memoryview(chunk)
        try:
            while remaining:
                # None: the descriptor is non-blocking and full.
                count = self._target.write(remaining)
                if count is None:
                    time.sleep(RETRY_S)
                else:
                    remaining = remaining[count:]
        except (OSError, ValueError) as error:
            # ValueError: the file was closed. Later chunks are tried again: a full disk may have room by then.
            self.failure = self.failure or (error if isinstance(error, OSError) else OSError(str(error)))


def queued_text(file: QueuedFile, encoding: str, line_buffering: bool = True) -> io.TextIOWrapper:
    """Return a text stream on ``file``; characters that ``encoding`` lacks are replaced."""
    stream: Any = file
    return io.TextIOWrapper(stream, encoding=encoding, errors="replace", line_buffering=line_buffering)
