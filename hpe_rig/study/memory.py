"""How much memory this process has used at most."""

from __future__ import annotations

import sys


def peak_memory_bytes() -> int:
    """Return the largest resident size of this process so far."""
    if sys.platform == "win32":
        import ctypes
        from ctypes import wintypes

        class Counters(ctypes.Structure):
            _fields_ = [("size", wintypes.DWORD), ("faults", wintypes.DWORD), ("peak", ctypes.c_size_t)] + [
                (f"other_{n}", ctypes.c_size_t) for n in range(7)
            ]

        counters = Counters(size=ctypes.sizeof(Counters))
        this = wintypes.HANDLE(-1)
        ctypes.windll.kernel32.K32GetProcessMemoryInfo(this, ctypes.byref(counters), counters.size)
        return int(counters.peak)
    import resource

    # Kibibytes on Linux, bytes on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
