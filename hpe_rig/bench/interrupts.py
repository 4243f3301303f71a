"""Interrupts while a bench is open: Ctrl-C, SIGTERM, a closed terminal, Ctrl-Break.

The first one raises an exception, so that the bench is left and switched off. Repetitions within ``REPEAT_S`` are
deferred: otherwise they could interrupt the program before it has begun to switch off.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, final

REPEAT_S: Final = 1.0
"""Time after an interrupt during which the next one counts as a repetition."""
RETRY_S: Final = 0.01
"""Time until a signal is sent again that arrived where no exception can be raised."""
CONSOLE_WAIT_S: Final = 4.5
"""Time that a closing Windows console is kept waiting; the system ends the process after five seconds."""
CONSOLE_CLOSING: Final = frozenset({2, 5, 6})
"""Windows' events for a closed console, a log-off and a shutdown."""

# SIGHUP and SIGQUIT exist on POSIX systems only, SIGBREAK (Ctrl-Break) on Windows only.
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
END_SIGNALS: Final[tuple[int, ...]] = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
"""Signals that end the program."""

DISK_THREAD: Final = "disk"
"""Name of the threads of ``store/task.py``; the program ends without one that still waits for its disk."""


class Terminated(BaseException):
    """The program was asked to end by the signal ``name``; like KeyboardInterrupt it is no ``Exception``."""

    def __init__(self, number: int = signal.SIGTERM) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = int(number)
        self.name = signal.Signals(number).name


INTERRUPTS: Final = (KeyboardInterrupt, Terminated)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the signals that end a program raise in the block: KeyboardInterrupt for Ctrl-C, otherwise ``Terminated``."""
    with _interrupts.region(interruptible=True):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer these signals to the end of the block, then raise the first of them.

    If the block raises an exception, the signals are dropped, because that exception ends the program too.
    """
    with _interrupts.region(interruptible=False):
        yield


@final
class _Interrupts:
    """Nested blocks, interruptible or not, and the signals deferred until the innermost is interruptible."""

    def __init__(self) -> None:
        self._blocks: list[bool] = []
        self._deferred: list[int] = []
        self._raised_s = -REPEAT_S
        self._finished = threading.Event()
        self._finished.set()

    @contextmanager
    def region(self, interruptible: bool) -> Iterator[None]:
        """Raise signals in the block, or defer them; the outermost block installs the handlers."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        depth = len(self._blocks)
        before = {} if depth else self._install()
        self._blocks.append(interruptible)
        try:
            self._raise_deferred()
            yield
            # Inside the try block, so that an exception raised here still reaches its finally clause.
            del self._blocks[depth:]
            self._raise_deferred()
        finally:
            # By depth, because a signal raised at this point may have left an inner block on the stack.
            del self._blocks[depth:]
            if not depth:
                self._restore(before)

    def arrive(self, number: int, frame: FrameType | None) -> None:
        """Raise the exception of signal ``number``, or defer it."""
        repeated = time.monotonic() - self._raised_s < REPEAT_S
        if repeated or (self._blocks and not self._blocks[-1]):
            self._deferred.append(number)
        elif _discards_exceptions(frame):
            retry = threading.Timer(RETRY_S, _send_again, (number,))
            retry.daemon = True
            retry.start()
        else:
            self._raise(number)

    def console_closing(self, event: int, interrupt: Callable[[], None]) -> bool:
        """Handle Windows' console ``event``, in a thread of the system: interrupt the program and wait for its end."""
        if event not in CONSOLE_CLOSING:
            return False
        interrupt()
        self._finished.wait(CONSOLE_WAIT_S)
        return True

    def _raise_deferred(self) -> None:
        if self._deferred and (not self._blocks or self._blocks[-1]):
            repeated = time.monotonic() - self._raised_s < REPEAT_S
            number = self._deferred[0]
            self._deferred.clear()
            if not repeated:
                self._raise(number)

    def _raise(self, number: int) -> None:
        self._raised_s = time.monotonic()
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated(number)

    def _install(self) -> dict[int, Any]:
        self._deferred.clear()
        self._raised_s = -REPEAT_S
        self._finished.clear()
        # Ignored signals stay ignored, such as SIGHUP under nohup; None means a handler outside Python.
        handled = [number for number in END_SIGNALS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
        return {number: signal.signal(number, self.arrive) for number in handled}

    def _restore(self, before: dict[int, Any]) -> None:
        for number, handler in before.items():
            signal.signal(number, handler)
        self._finished.set()


def _discards_exceptions(frame: FrameType | None) -> bool:
    """Return whether Python only prints exceptions in ``frame``: a destructor or a weak reference's callback."""
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_code.co_filename == weakref.__file__:
            return True
        frame = frame.f_back
    return False


def _send_again(number: int) -> None:
    """Send signal ``number`` to the main thread, from another one."""
    main = threading.main_thread().ident
    if sys.platform != "win32" and main is not None:
        # Unlike interrupt_main this also ends a blocking call.
        signal.pthread_kill(main, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


_interrupts: Final = _Interrupts()

if sys.platform == "win32":
    import ctypes

    @ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)
    def _console_event(event: int) -> int:
        # The process ends as soon as this returns, so an ordinary signal handler would come too late.
        return int(_interrupts.console_closing(event, lambda: _thread.interrupt_main(signal.SIGBREAK)))

    ctypes.windll.kernel32.SetConsoleCtrlHandler(_console_event, 1)
