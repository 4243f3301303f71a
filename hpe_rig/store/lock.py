"""Lock of a run file: one writer at a time, released by the system when its program ends, in whatever way it ends.

It lies on a byte that no file has, so that it keeps nobody from reading, and it belongs to the file rather than to its
name: a file that is moved takes it along. The kinds of lock differ from system to system; over network shares they work
where the share supports locks at all.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import IO, Final

FAR: Final = 1 << 62
"""Place of the byte that is locked."""


def take(file: IO[bytes]) -> bool:
    """Lock the open ``file`` until it is closed; return False where its file system knows no locks.

    Raises ``BlockingIOError`` where another program holds the lock.
    """
    try:
        _lock(file.fileno(), exclusive=True)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def is_taken(path: Path) -> bool | None:
    """Return whether a program writes the file ``path``; None where that cannot be told."""
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
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        where = _Overlapped(offset=FAR & 0xFFFFFFFF, offset_high=FAR >> 32)
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
        kind = fcntl.F_WRLCK if exclusive else fcntl.F_RDLCK
        if sys.platform == "linux" and hasattr(fcntl, "F_OFD_SETLK"):
            # Of the open file, not of the process, which would lose it as soon as it closes any other view of the file.
            request = struct.pack("@hhqqi4x", kind, os.SEEK_SET, FAR, 1, 0)
            fcntl.fcntl(number, fcntl.F_OFD_SETLK, request)
        else:
            fcntl.lockf(number, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB, 1, FAR, os.SEEK_SET)
