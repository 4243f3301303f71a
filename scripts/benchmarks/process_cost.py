"""Processor time and peak memory of the process, for the other scripts of this folder."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable


def processor_times_s(compute: Callable[[], object], count: int) -> list[float]:
    """Return the processor time of each of ``count`` calls of ``compute``, all threads together."""
    times_s = []
    for _ in range(count):
        start_s = time.process_time()
        compute()
        times_s.append(time.process_time() - start_s)
    return times_s


def resource_usage() -> tuple[float, float]:
    """Return the processor time of this process since its start, s, and its peak memory, MB. POSIX only."""
    import resource

    usage = resource.getrusage(resource.RUSAGE_SELF)
    # ``ru_maxrss`` is in bytes on macOS and in kilobytes elsewhere.
    bytes_per_unit = 1 if sys.platform == "darwin" else 1e3
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * bytes_per_unit / 1e6
