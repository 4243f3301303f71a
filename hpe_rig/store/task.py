"""A task on a disk that may not respond: it runs in a thread, so that the program can stop waiting for it."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Final, TypeVar

from hpe_rig.bench import interruptible

STEP_TIMEOUT_S: Final = 60.0
"""Time limit of a task; network shares that fail over to another server take tens of seconds."""
UNDO_TIMEOUT_S: Final = 1.0
"""Time that an interrupted program waits for an unfinished task before it undoes it; outputs may be on meanwhile."""
POLL_S: Final = 0.2
"""Interval between checks of a running task; a signal takes effect after this time at the latest."""

Product = TypeVar("Product")


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


def _run_task(task: Callable[[], None], done: Future[None]) -> None:
    """Run ``task``; when it ends, the future is ``done``, with the task's error if it raised one."""
    try:
        task()
        done.set_result(None)
    except BaseException as error:
        done.set_exception(error)
