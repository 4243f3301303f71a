"""Lines to the instruments of a bench, all used at the same time and each for a bounded time.

No instrument waits for another one that does not answer, because each bus has a thread. A library call cannot be
cancelled: a thread that is busy at the end is left behind as a daemon, and its connection is closed when it opens.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Final, final

from drivers.interfaces import Instrument, InstrumentError
from hpe_rig.bench.interrupts import uninterrupted

OPENING_S: Final = 4.5
"""Longest time until each instrument has answered or counts as missing: 3 s to connect, the remaining to identify."""
INTERRUPTED_S: Final = 2.0
"""Time that an interrupted opening waits for the bus of an identified instrument, to switch its output off."""
POLL_S: Final = 0.05

Answer = Instrument | Exception
"""An identified instrument, or the reason why it is missing."""


class OpeningEndedError(Exception):
    """The opening has ended: its thread must stop."""


@final
class Answers:
    """Instruments and failures by role, delivered by several threads; ``stack`` closes their connections.

    After ``end`` a thread that delivers is stopped by ``OpeningEndedError``.
    """

    def __init__(self, stack: ExitStack) -> None:
        self.by_role: dict[str, Answer] = {}
        self._stack = stack
        self._lock = threading.Lock()
        self._ended = False

    @property
    def identified(self) -> list[Instrument]:
        """The instruments that have identified themselves."""
        return [answer for answer in self.by_role.values() if not isinstance(answer, Exception)]

    def add(self, role: str, answer: Answer) -> None:
        """Add the answer of ``role``."""
        with self._lock:
            if self._ended:
                raise OpeningEndedError
            self.by_role[role] = answer

    def close_at_end(self, close: Callable[[], None]) -> None:
        """Call ``close`` when the bench is closed, at once if the opening has ended."""
        with self._lock:
            if not self._ended:
                self._stack.callback(close)
                return
        close()
        raise OpeningEndedError

    def end(self) -> None:
        """Accept no further answer."""
        with self._lock:
            self._ended = True


def ask_buses(buses: Iterable[Sequence[str]], ask: Callable[[Sequence[str]], None], answers: Answers) -> None:
    """Call ``ask`` with the roles on each bus, all at the same time; it delivers to ``answers``.

    Returns after ``OPENING_S`` at the latest. Roles without an answer then have a failure.
    """
    threads = {threading.Thread(target=_until_end, args=(ask, roles), daemon=True): roles for roles in buses}
    for thread in threads:
        thread.start()
    try:
        _join(list(threads), OPENING_S)
    except BaseException:
        answers.end()
        # The thread of a bus and the one that makes safe must not use the same line.
        with uninterrupted():
            in_use = [thread for thread, roles in threads.items() if answers.by_role.keys() & set(roles)]
            _join(in_use, INTERRUPTED_S)
        raise
    answers.end()
    for role in (role for roles in threads.values() for role in roles):
        if role not in answers.by_role:
            answers.by_role[role] = InstrumentError(
                role,
                f"no answer within {OPENING_S:g} s",
                "the connection hangs, or other instruments on its bus do not answer",
                f"check power, cable and generators.{role}.address, and those of the instruments on its bus",
            )


def _until_end(ask: Callable[[Sequence[str]], None], roles: Sequence[str]) -> None:
    try:
        ask(roles)
    except OpeningEndedError:
        return


def _join(threads: Sequence[threading.Thread], timeout_s: float) -> None:
    """Wait until ``threads`` have ended, at most for ``timeout_s``; an interrupt ends the wait."""
    until_s = time.monotonic() + timeout_s
    while (busy := [thread for thread in threads if thread.is_alive()]) and time.monotonic() < until_s:
        # In slices, because a wait on Windows cannot be interrupted.
        busy[0].join(POLL_S)
