"""Keys pressed at the terminal while a run goes on, without waiting for them and without Enter."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Pressed = Callable[[], str]
"""Returns the keys pressed since it was asked last, "" where there is none or no terminal."""


@contextmanager
def keyboard() -> Iterator[Pressed]:
    """Yield what tells which keys were pressed; the terminal is as it was when the block ends."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    with _listening() as pressed:
        yield pressed


if sys.platform == "win32":
    import msvcrt

    @contextmanager
    def _listening() -> Iterator[Pressed]:
        def pressed() -> str:
            keys = ""
            while msvcrt.kbhit():
                keys += msvcrt.getwch()
            return keys

        yield pressed

else:
    import os
    import select
    import termios
    import tty

    @contextmanager
    def _listening() -> Iterator[Pressed]:
        number = sys.stdin.fileno()
        before = termios.tcgetattr(number)

        def pressed() -> str:
            keys = b""
            # Read past Python's own buffer, which would keep keys from select.
            while select.select([number], [], [], 0)[0] and (more := os.read(number, 64)):
                keys += more
            return keys.decode("utf-8", "replace")

        try:
            # Ctrl-C still interrupts: only the waiting for a whole line ends.
            tty.setcbreak(number)
            yield pressed
        finally:
            termios.tcsetattr(number, termios.TCSADRAIN, before)
