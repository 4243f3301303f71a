"""The simulated clock: whole picoseconds, moved only by what is done."""

from __future__ import annotations

from sim_backend.wiring import PS_PER_S, to_ps


class SimulatedClock:
    """Time of the simulated bench; sleeping takes no real time."""

    def __init__(self) -> None:
        self.now_ps = 0

    def now_s(self) -> float:
        """Return the time since the world began."""
        return self.now_ps / PS_PER_S

    def sleep(self, duration_s: float) -> None:
        """Move on by ``duration_s``."""
        self.now_ps += max(0, to_ps(duration_s))

    def advance_to(self, time_ps: int) -> None:
        """Move on to ``time_ps``; a time in the past changes nothing."""
        self.now_ps = max(self.now_ps, time_ps)
