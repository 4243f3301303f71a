"""A task on a disk that may not respond: it runs in a thread, so that the program can stop waiting for it."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Final, TypeVar

from hpe_rig.bench import DISK_THREAD, interruptible

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
    """Run ``make`` in a thread and return its product, so that a disk that does not answer cannot block the caller.

    The wait is given up at a signal, after ``STEP_TIMEOUT_S``, or when another thread sets ``cancelled``; the last two
    raise ``OSError``. Whenever this function raises, it sets ``cancelled``, which tells ``make`` to stop; a product
    that ``make`` still returns is passed to ``undo``.
    """
    cancelled = cancelled or threading.Event()
    done: Future[Product] = Future()
    gave_up = False

    def run() -> None:
        """Run ``make``; the future gets its product or its error."""
        try:
            done.set_result(make(cancelled))
        except BaseException as error:
            done.set_exception(error)

    def undo_product(future: Future[Product]) -> None:
        """Undo the product, if ``make`` returned one."""
        if future.exception() is None:
            undo(future.result())

    threading.Thread(target=run, daemon=True, name=DISK_THREAD).start()
    try:
        with interruptible():
            gave_up = not _finishes_within(done, lambda: 0.0 if cancelled.is_set() else STEP_TIMEOUT_S)
        if gave_up:
            waited = "before the program stopped waiting" if cancelled.is_set() else f"for {STEP_TIMEOUT_S:g} s"
            raise OSError(errno.ETIMEDOUT, f"the disk has not answered {waited}")
        return done.result()
    except BaseException:
        cancelled.set()
        # Give ``make`` a short time to finish, so that ``undo`` runs before the process can end.
        if not gave_up:
            _finishes_within(done, lambda: UNDO_TIMEOUT_S)
        # At once, if ``make`` has finished.
        done.add_done_callback(undo_product)
        raise


def _finishes_within(done: Future[Product], timeout_s: Callable[[], float]) -> bool:
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
