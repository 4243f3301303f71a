"""Observers of a run: stop request, log and live page, each loaded only when asked for."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hpe_rig.acquire import (
    Observer,
    Setup,
    clear_leftover,
    clear_pause,
    clear_stop,
    pausable,
    pause_requested,
    stoppable,
    toggle_pause,
)
from hpe_rig.cli.keys import Pressed, keyboard
from hpe_rig.store import StoreError, extra

LOOK_EVERY_S = 0.1
Watch = Callable[[Observer], Observer]


@contextmanager
def watched(
    setup: Setup,
    path: Path,
    run_id: str,
    live: bool,
    verbose: bool,
    announce: Callable[[str], None],
    stays: bool = True,
) -> Iterator[Watch]:
    """Yield a function that wraps an observer so that the run ``run_id`` into ``path`` can be stopped and is logged.

    The key p, and the live page, pause it between two shots. A live page started from a terminal ``stays`` open after
    the run until Ctrl-C. Raises ``StoreError`` where the log or the page cannot start.
    """
    with ExitStack() as stack:
        # Before the run file is there nobody can ask for a stop of this run.
        clear_leftover(path)
        log: Watch | None = None
        if verbose:
            from hpe_rig.acquire import log_path, logged

            log = stack.enter_context(logged(setup, log_path(path)))
        if live:
            with extra("live"):
                from hpe_rig.live import live_page_of

            announce(f"live page: {stack.enter_context(live_page_of(path))}")
        stack.callback(_forget_stop, path, run_id)
        stack.callback(clear_pause, path, run_id)
        with keyboard() as pressed:
            pauses = _pauses(path, run_id, pressed, announce)
            yield lambda observer: pausable(
                stoppable(log(observer) if log else observer, path, run_id), pauses, announce
            )
        if live and stays and sys.stdin.isatty():
            announce("the live page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                while True:
                    time.sleep(0.5)


def _pauses(path: Path, run_id: str, pressed: Pressed, announce: Callable[[str], None]) -> Callable[[], bool]:
    """Return what says whether the run pauses: as the key p says, or whoever puts the request beside the run file."""
    looked_s, paused = -math.inf, False

    def asked() -> bool:
        nonlocal looked_s, paused
        if time.monotonic() - looked_s < LOOK_EVERY_S:
            return paused
        looked_s = time.monotonic()
        for _ in range(pressed().lower().count("p")):
            try:
                if toggle_pause(path, run_id):
                    announce("a pause follows after this shot")
            except StoreError as error:
                announce(f"hpe-rig: {error}")
        paused = pause_requested(path, run_id)
        return paused

    return asked


def _forget_stop(path: Path, run_id: str) -> None:
    # How the run ended matters more than a file that stays.
    with suppress(StoreError):
        clear_stop(path, run_id)
