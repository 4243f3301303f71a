"""Provenance of a measurement: who, when, on which machine, and how long each stage took.

Outside of what a simulated run repeats bit for bit. Imports nothing heavy, so that loading heavy packages can be a
stage itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Provenance:
    """When a run started and ended, ISO 8601 with the offset from UTC, and where; "" is what nobody knows.

    ``drivers``: the packages below the instruments' drivers with their versions. What instruments and boards say of
    themselves, firmware and driver among it, stands with their settings.
    """

    started: str = ""
    ended: str = ""
    host: str = ""
    user: str = ""
    drivers: str = ""


UNKNOWN = Provenance()
"""Of files of earlier releases, and of what no run was made for."""


class Stages:
    """Wall time by stage, in the order of entering; of nested stages the innermost one is charged.

    ``with stages("read"): ...`` adds the time of the block to ``stages.run_time_s["read"]``.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.run_time_s: dict[str, float] = {}
        self._clock = clock
        self._open: list[str] = []
        self._since_s = clock()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._charge()
        self._open.append(name)
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def come_after(self, run_time_s: Mapping[str, float]) -> None:
        """Put the stages of an earlier process before the own ones; where both have one the own counts."""
        self.run_time_s = {**run_time_s, **self.run_time_s}

    def rename(self, name: str) -> None:
        """Have the innermost stage go on as ``name``."""
        self._charge()
        self._open[-1] = name

    def _charge(self) -> None:
        now_s = self._clock()
        if self._open:
            name = self._open[-1]
            self.run_time_s[name] = self.run_time_s.get(name, 0.0) + now_s - self._since_s
        self._since_s = now_s
