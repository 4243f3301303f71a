"""Storage and observers in separate threads while outputs are on: the measuring thread waits for no disk or terminal.

Storage is one queue of tasks in order; observers get the newest progress. An error of either is raised in the measuring
thread at its next step, which ends the shot with its outputs off.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final, final

from hpe_rig.measurement.sequencer import DRIVING_STEPS, Observer, Progress, Step

POLL_S: Final = 0.2
"""A signal that arrives just before a wait takes effect after this time."""
STOP_S: Final = 1.0
"""Time that a call of an observer gets to return at the end of a measurement."""

Task = Callable[[], None]


@final
class BackgroundTasks:
    """Runs tasks one after another in a daemon thread; the first failure discards the tasks after it.

    Its caller is one thread, which signals may interrupt: ``SimpleQueue`` leaves no lock locked then.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._tasks = SimpleQueue[tuple[Task, int] | None]()
        self._ended = SimpleQueue[tuple[Task, int, BaseException | None]]()
        self._discarding = threading.Event()
        self._started = self._has_failed = False
        self._failure: BaseException | None = None
        self.unfinished = self.backlog_bytes = 0

    def submit(self, task: Task, size_bytes: int = 0) -> None:
        """Queue ``task``, which holds ``size_bytes`` of memory; raise the failure of an earlier task."""
        self.check()
        if not self._started:
            threading.Thread(target=self._run, daemon=True, name=self._name).start()
            self._started = True
        self._put(task, size_bytes)

    def check(self) -> None:
        """Raise the first failure of a task, once."""
        while self._next_ended(0.0) is not None:
            pass
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def wait_for_one(self, timeout_s: float) -> None:
        """Wait until one more task ends, at most ``timeout_s``; raise the first failure."""
        self._next_ended(timeout_s)
        self.check()

    def wait(self, timeout_s: float | None = None, progress: Callable[[], object] = lambda: None) -> bool:
        """Wait until every task has ended; return False once none has for ``timeout_s``. Raises no failure.

        A change of the value of ``progress`` counts as the end of a task.
        """
        if not self.unfinished or not self._started:
            return True
        marker: Task = lambda: None  # noqa: E731
        self._put(marker, 0)
        last_s, last_progress = time.monotonic(), progress()
        while (ended := self._next_ended(POLL_S)) is not marker:
            if ended is not None or progress() != last_progress:
                last_s, last_progress = time.monotonic(), progress()
            if timeout_s is not None and time.monotonic() - last_s > timeout_s:
                return False
        # An interrupted ``_put`` may have counted a task that it did not queue.
        self.unfinished = self.backlog_bytes = 0
        return True

    def drain(self) -> None:
        """Wait until every task has ended; raise the first failure."""
        self.wait()
        self.check()

    def discard(self) -> None:
        """Discard all tasks that have not begun."""
        self._discarding.set()

    def end(self) -> None:
        """End the thread after the tasks so far; none may be submitted after this."""
        self._tasks.put(None)

    def _put(self, task: Task, size_bytes: int) -> None:
        self.unfinished += 1
        self.backlog_bytes += size_bytes
        self._tasks.put((task, size_bytes))

    def _next_ended(self, timeout_s: float) -> Task | None:
        """Return the next task that ends within ``timeout_s``, and take note of its failure; None without one."""
        try:
            task, size_bytes, failure = self._ended.get(timeout=timeout_s) if timeout_s else self._ended.get_nowait()
        except Empty:
            return None
        self.unfinished -= 1
        self.backlog_bytes -= size_bytes
        if failure is not None and not self._has_failed:
            self._has_failed, self._failure = True, failure
        return task

    def _run(self) -> None:
        failure: BaseException | None = None
        while (item := self._tasks.get()) is not None:
            task, size_bytes = item
            if failure is None and not self._discarding.is_set():
                try:
                    task()
                except BaseException as error:
                    failure = error
            self._ended.put((task, size_bytes, failure))
            # Otherwise its records would stay in memory until the next task.
            del task, item


@contextmanager
def detached(observer: Observer) -> Iterator[Observer]:
    """Yield ``observer`` such that it is called in a separate thread while outputs may be on.

    While a call lasts, further progress within the same step of the shot is left out. In the other steps the observer
    is called directly: outputs are off, so that it may wait, as for the end of a pause.
    """
    tasks = BackgroundTasks("observer")
    latest: tuple[int, Step] | None = None

    def observe(progress: Progress) -> None:
        nonlocal latest
        if progress.step not in DRIVING_STEPS:
            tasks.drain()
            observer(progress)
            return
        tasks.check()
        step = (progress.shot.index, progress.step)
        if step != latest or not tasks.unfinished:
            latest = step
            tasks.submit(partial(observer, progress))

    try:
        yield observe
    finally:
        # After this the caller closes the files of the observer.
        tasks.wait(STOP_S)
        tasks.end()
