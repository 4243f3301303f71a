"""Lock of a run file: one writer at a time; the operating system releases the lock when the program ends.

The locked byte lies beyond the end of any file, so that reading stays possible. The lock belongs to the file and
not to its name: a moved file stays locked. Each operating system has its own kind of lock; on a network share the lock
works if the share supports locks.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import IO, Final

LOCK_OFFSET: Final = 1 << 62
"""Offset of the locked byte."""


def acquire(file: IO[bytes]) -> bool:
    """Lock the open ``file`` until it is closed; return False if its file system has no locks.

    Raises ``BlockingIOError`` if another program holds the lock.
    """
    try:
        _lock(file.fileno(), exclusive=True)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def is_locked(path: Path) -> bool | None:
    """Return whether another program is writing the file ``path``; None if unknown, as on a disk without locks."""
    try:
        with path.open("rb") as file:
            _lock(file.fileno(), exclusive=False)
    except BlockingIOError:
        return True
    except OSError:
        return None
    return False


if sys.platform == "win32":
    import ctypes
    import msvcrt
    from ctypes import wintypes

    class _Overlapped(ctypes.Structure):
        _fields_ = (
            ("internal", ctypes.c_void_p),
            ("internal_high", ctypes.c_void_p),
            ("offset", wintypes.DWORD),
            ("offset_high", wintypes.DWORD),
            ("event", wintypes.HANDLE),
        )

    FAIL_IMMEDIATELY, EXCLUSIVE = 1, 2
    LOCK_VIOLATION = 33

    def _lock(number: int, exclusive: bool) -> None:
        """Lock the file of descriptor ``number``; raise ``BlockingIOError`` if another program has it locked."""
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        where = _Overlapped(offset=LOCK_OFFSET & 0xFFFFFFFF, offset_high=LOCK_OFFSET >> 32)
        kind = FAIL_IMMEDIATELY | (EXCLUSIVE if exclusive else 0)
        handle = wintypes.HANDLE(msvcrt.get_osfhandle(number))
        if kernel.LockFileEx(handle, kind, 0, 1, 0, ctypes.byref(where)):
            return
        if ctypes.get_last_error() == LOCK_VIOLATION:
            raise BlockingIOError
        raise OSError

else:
    import fcntl

    def _lock(number: int, exclusive: bool) -> None:
        """Lock the file of descriptor ``number``; raise ``BlockingIOError`` if another program has it locked."""
        kind = fcntl.F_WRLCK if exclusive else fcntl.F_RDLCK
        if sys.platform == "linux" and hasattr(fcntl, "F_OFD_SETLK"):
            # A lock of the open file: the process would lose its own lock when it closes any other handle of the file.
            request = struct.pack("@hhqqi4x", kind, os.SEEK_SET, LOCK_OFFSET, 1, 0)
            fcntl.fcntl(number, fcntl.F_OFD_SETLK, request)
        else:
            fcntl.lockf(
                number, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB, 1, LOCK_OFFSET, os.SEEK_SET
            )
