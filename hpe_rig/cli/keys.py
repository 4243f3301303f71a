"""Keys pressed at the terminal during a run, read without waiting and without Enter."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

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
    import errno
    import os
    import select
    import termios
    import tty

    @contextmanager
    def _terminal_keys() -> Iterator[ReadKeys]:
        descriptor = sys.stdin.fileno()

        def read_keys() -> str:
            keys = b""
            # A terminal that was closed has no keys.
            with suppress(OSError):
                # `os.read` bypasses Python's buffer, which would hide keys from `select`.
                while _in_foreground(descriptor) and select.select([descriptor], [], [], 0)[0]:
                    if not (more := os.read(descriptor, 64)):
                        break
                    keys += more
            return keys.decode("utf-8", "replace")

        settings: list[Any] | None = None
        with suppress(OSError, termios.error):
            if _in_foreground(descriptor):
                settings = termios.tcgetattr(descriptor)
                # In this mode a key needs no Enter, and Ctrl-C still interrupts. TCSANOW waits for no output.
                tty.setcbreak(descriptor, termios.TCSANOW)
        try:
            yield read_keys
        finally:
            with suppress(OSError, termios.error):
                if settings is not None and _in_foreground(descriptor):
                    termios.tcsetattr(descriptor, termios.TCSANOW, settings)

    def _in_foreground(descriptor: int) -> bool:
        """Return whether this process may use the terminal: the system stops one in the background, outputs on or off.

        Raises ``OSError`` if the terminal was closed.
        """
        try:
            return os.tcgetpgrp(descriptor) == os.getpgrp()
        except OSError as error:
            # A terminal other than that of the session stops no process.
            if error.errno == errno.ENOTTY:
                return True
            raise
