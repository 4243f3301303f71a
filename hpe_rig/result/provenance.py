"""Provenance of a measurement: who, when, on which machine, and the time of each stage.

A simulated run does not repeat these values. The module imports no large package, so that a stage can time imports.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Provenance:
    """Start and end of a run, ISO 8601 with the offset from UTC, host and user; "" for values that no file states.

    ``drivers``: the packages below the instrument drivers with their versions. Firmware and driver versions reported by
    instruments are stored with their settings. ``continues``: run file from which a resumed run copied shots, which
    were measured before its start.
    """

    started: str = ""
    ended: str = ""
    host: str = ""
    user: str = ""
    drivers: str = ""
    continues: str = ""


class Stages:
    """Wall time by stage, in order of entry; nested stages charge the innermost one.

    ``with stages("read"): ...`` adds the time of the block to ``stages.run_time_s["read"]``.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.run_time_s: dict[str, float] = {}
        self._clock = clock
        self._open: list[str] = []
        self._last_charge_s = clock()

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
        """Put the stages of an earlier process first; a stage of this process replaces one of the same name."""
        self.run_time_s = {**run_time_s, **self.run_time_s}

    def rename(self, name: str) -> None:
        """Continue the innermost stage as ``name``."""
        self._charge()
        self._open[-1] = name

    def _charge(self) -> None:
        now_s = self._clock()
        if self._open:
            name = self._open[-1]
            self.run_time_s[name] = self.run_time_s.get(name, 0.0) + now_s - self._last_charge_s
        self._last_charge_s = now_s
