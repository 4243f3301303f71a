"""Interrupts around an open bench: Ctrl-C, SIGTERM, a closed terminal, Ctrl-Break; the first unwinds, none cuts in.

What unwinds may itself be interrupted before it has begun to switch off, so the interrupts that follow the first one
within ``REPEAT_S`` are held back: they ask for what is under way already.
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
"""How long after an interrupt the next one is taken for a repetition; later it unwinds anew, should one get lost."""
AGAIN_S: Final = 0.01
"""How long after a signal that nothing could be raised for it is given again."""
CONSOLE_PATIENCE_S: Final = 4.5
"""How long a closing Windows console is kept waiting; the system itself ends the process after five seconds."""
CONSOLE_GOES: Final = frozenset({2, 5, 6})
"""Windows' events for a closed console, a log-off and a shutdown."""

# What a system does not have is left out: SIGHUP and SIGQUIT are POSIX's, SIGBREAK is Windows' Ctrl-Break.
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
_SIGNALS: Final = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))


class Terminated(BaseException):
    """The program was asked to end, ``name`` says how; like KeyboardInterrupt no ``except Exception`` swallows it."""

    def __init__(self, number: int = signal.SIGTERM) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = int(number)
        self.name = signal.Signals(number).name


INTERRUPTS: Final = (KeyboardInterrupt, Terminated)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the signals that end a program raise in the block: KeyboardInterrupt for Ctrl-C, else ``Terminated``."""
    with _interrupts.region(open_to=True):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold these signals back until the block is done, then let the first of them through.

    Where the block raises nothing is let through: what it raised ends the program as well.
    """
    with _interrupts.region(open_to=False):
        yield


@final
class _Interrupts:
    """Nested blocks, each open to signals or not, and the signals that wait for the innermost to be open again."""

    def __init__(self) -> None:
        self._blocks: list[bool] = []
        self._held: list[int] = []
        self._raised_s = -REPEAT_S
        self._quiet = threading.Event()
        self._quiet.set()

    @contextmanager
    def region(self, open_to: bool) -> Iterator[None]:
        """Be open to signals, or not, in the block; the outermost one installs the handlers."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        depth = len(self._blocks)
        before = {} if depth else self._install()
        self._blocks.append(open_to)
        try:
            self._let_through()
            yield
            # Still inside, so that one which comes in between is met by those who guard this block.
            del self._blocks[depth:]
            self._let_through()
        finally:
            # By depth: a signal that raised right here before has kept an inner block from being taken off.
            del self._blocks[depth:]
            if not depth:
                self._restore(before)

    def arrive(self, number: int, frame: FrameType | None) -> None:
        """Raise what signal ``number`` stands for, or hold it back."""
        repeated = time.monotonic() - self._raised_s < REPEAT_S
        if repeated or (self._blocks and not self._blocks[-1]):
            self._held.append(number)
        elif _swallows(frame):
            again = threading.Timer(AGAIN_S, _give_again, (number,))
            again.daemon = True
            again.start()
        else:
            self._raise(number)

    def console_goes(self, event: int, interrupt: Callable[[], None]) -> bool:
        """Answer Windows' console ``event`` from its own thread: interrupt the program and wait until it is done."""
        if event not in CONSOLE_GOES:
            return False
        interrupt()
        self._quiet.wait(CONSOLE_PATIENCE_S)
        return True

    def _let_through(self) -> None:
        if self._held and (not self._blocks or self._blocks[-1]):
            repeated = time.monotonic() - self._raised_s < REPEAT_S
            number = self._held[0]
            self._held.clear()
            if not repeated:
                self._raise(number)

    def _raise(self, number: int) -> None:
        self._raised_s = time.monotonic()
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated(number)

    def _install(self) -> dict[int, Any]:
        self._held.clear()
        self._raised_s = -REPEAT_S
        self._quiet.clear()
        # What somebody has chosen to ignore, as nohup does with SIGHUP, stays ignored; None is no handler of Python's.
        heard = [number for number in _SIGNALS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
        return {number: signal.signal(number, self.arrive) for number in heard}

    def _restore(self, before: dict[int, Any]) -> None:
        for number, handler in before.items():
            signal.signal(number, handler)
        self._quiet.set()


def _swallows(frame: FrameType | None) -> bool:
    """Return whether Python only prints what is raised in ``frame``: a destructor or a weak reference's callback."""
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_code.co_filename == weakref.__file__:
            return True
        frame = frame.f_back
    return False


def _give_again(number: int) -> None:
    """Give the main thread signal ``number``, from another one."""
    main = threading.main_thread().ident
    if sys.platform != "win32" and main is not None:
        # also out of a call that waits
        signal.pthread_kill(main, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


_interrupts: Final = _Interrupts()

if sys.platform == "win32":
    import ctypes

    @ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)
    def _console_event(event: int) -> int:
        # The process ends as soon as this returns, so an ordinary signal handler would come too late.
        return int(_interrupts.console_goes(event, lambda: _thread.interrupt_main(signal.SIGBREAK)))

    ctypes.windll.kernel32.SetConsoleCtrlHandler(_console_event, 1)
