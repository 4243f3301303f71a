"""Keys pressed at the terminal during a run, read without waiting and without Enter."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

ReadKeys = Callable[[], str]
"""Returns the keys pressed since the last call, "" for none."""


@contextmanager
def keyboard() -> Iterator[ReadKeys]:
    """Yield a function that reads the pressed keys; the settings of the terminal are restored at the end."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    with _terminal_keys() as read_keys:
        yield read_keys


if sys.platform == "win32":
    import msvcrt

    @contextmanager
    def _terminal_keys() -> Iterator[ReadKeys]:
        def read_keys() -> str:
            keys = ""
            while msvcrt.kbhit():
                keys += msvcrt.getwch()
            return keys

        yield read_keys

else:
    import os
    import select
    import termios
    import tty

    @contextmanager
    def _terminal_keys() -> Iterator[ReadKeys]:
        descriptor = sys.stdin.fileno()
        settings = termios.tcgetattr(descriptor)

        def read_keys() -> str:
            keys = b""
            # `os.read` bypasses Python's buffer, which would hide keys from `select`.
            while select.select([descriptor], [], [], 0)[0] and (more := os.read(descriptor, 64)):
                keys += more
            return keys.decode("utf-8", "replace")

        try:
            # In this mode a key needs no Enter, and Ctrl-C still interrupts.
            tty.setcbreak(descriptor)
            yield read_keys
        finally:
            termios.tcsetattr(descriptor, termios.TCSADRAIN, settings)
