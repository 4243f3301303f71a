"""Interrupts, Ctrl-C and SIGTERM, around an open bench: both unwind, neither cuts short what makes the bench safe."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Terminated(BaseException):
    """SIGTERM arrived; derived like KeyboardInterrupt so that no ``except Exception`` swallows it."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn SIGTERM into ``Terminated`` while the bench is open, so that it unwinds like Ctrl-C."""

    def terminate(number: int, frame: FrameType | None) -> None:
        raise Terminated

    with _handlers({signal.SIGTERM: terminate}):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C and SIGTERM back until the block is done, then let the first of them through."""
    held: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        held.append(number)

    with _handlers({signal.SIGINT: hold, signal.SIGTERM: hold}):
        yield
    if held:
        signal.raise_signal(held[0])


@contextmanager
def _handlers(handlers: Mapping[signal.Signals, Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
