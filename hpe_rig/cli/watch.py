"""Observers of a run: stop request, log and live page, each loaded only when asked for."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hpe_rig.acquire import Observer, Setup, clear_leftover, clear_stop, stoppable
from hpe_rig.store import StoreError, extra

Watch = Callable[[Observer], Observer]


@contextmanager
def watched(
    setup: Setup, path: Path, run_id: str, live: bool, verbose: bool, announce: Callable[[str], None]
) -> Iterator[Watch]:
    """Yield a function that wraps an observer so that the run ``run_id`` into ``path`` can be stopped and is logged.

    A live page started from a terminal stays open after the run until Ctrl-C. Raises ``StoreError`` where the log or
    the page cannot start.
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
        yield lambda observer: stoppable(log(observer) if log else observer, path, run_id)
        if live and sys.stdin.isatty():
            announce("the live page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                while True:
                    time.sleep(0.5)


def _forget_stop(path: Path, run_id: str) -> None:
    # How the run ended matters more than a file that stays.
    with suppress(StoreError):
        clear_stop(path, run_id)
