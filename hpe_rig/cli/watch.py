"""Observers of a run: stop request, log and live page, each loaded only when asked for."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hpe_rig.acquire import Observer, Setup, clear_stop, stoppable
from hpe_rig.store import extra

Watch = Callable[[Observer], Observer]


@contextmanager
def watched(setup: Setup, path: Path, live: bool, verbose: bool, announce: Callable[[str], None]) -> Iterator[Watch]:
    """Yield a function that wraps an observer so that the run into ``path`` can be stopped and is logged.

    A live page started from a terminal stays open after the run until Ctrl-C. Raises ``StoreError`` where the log or
    the page cannot start.
    """
    with ExitStack() as stack:
        log: Watch | None = None
        if verbose:
            from hpe_rig.acquire import log_path, logged

            log = stack.enter_context(logged(setup, log_path(path)))
        if live:
            with extra("live"):
                from hpe_rig.live import live_page_of

            announce(f"live page: {stack.enter_context(live_page_of(path))}")
        # A request left over from an earlier run of the same name must not stop this one.
        clear_stop(path)
        stack.callback(clear_stop, path)
        yield lambda observer: stoppable(log(observer) if log else observer, path)
        if live and sys.stdin.isatty():
            announce("the live page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                while True:
                    time.sleep(0.5)
