"""Calls of a library that may block for ever, such as those of pyvisa-py, limited in time.

A thread cannot be cancelled. A call that lasts too long is left to its daemon thread; ``discard`` closes the late
result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import TypeVar

from drivers.visa.sockets import TextLine

Outcome = TypeVar("Outcome")


def open_within(timeout_s: float, open_line: Callable[[], TextLine]) -> TextLine:
    """Return the line that ``open_line`` opens, as ``within``; one that opens too late is closed."""
    return within(timeout_s, open_line, lambda line: line.close())


def within(
    timeout_s: float, call: Callable[[], Outcome], discard: Callable[[Outcome], object] = lambda outcome: None
) -> Outcome:
    """Return ``call()``, or raise its exception; raise ``TimeoutError`` if it lasts longer than ``timeout_s``."""
    future: Future[Outcome] = Future()
    try:
        threading.Thread(target=_carry_out, args=(future, call, discard), daemon=True).start()
    except RuntimeError:
        # At the end of the interpreter no thread can be started.
        return call()
    try:
        return future.result(timeout_s)
    except TimeoutError:
        # The call may have ended meanwhile, or raised this exception itself.
        if future.cancel():
            raise TimeoutError(f"it lasted longer than {timeout_s:g} s") from None
        return future.result()
    finally:
        future.cancel()


def _carry_out(future: Future[Outcome], call: Callable[[], Outcome], discard: Callable[[Outcome], object]) -> None:
    try:
        outcome = call()
    except BaseException as error:
        with suppress(InvalidStateError):
            future.set_exception(error)
        return
    try:
        future.set_result(outcome)
    except InvalidStateError:
        with suppress(Exception):
            discard(outcome)
