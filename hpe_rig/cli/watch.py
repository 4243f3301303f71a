"""Observers of a run: stop request, log and live page, each loaded only when asked for."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from hpe_rig.cli.keys import Pressed, keyboard
from hpe_rig.measurement import (
    Mover,
    Observer,
    Setup,
    clear_leftover,
    clear_pause,
    clear_stop,
    pausable,
    pause_requested,
    stoppable,
    toggle_pause,
    wait_at_place,
)
from hpe_rig.store import StoreError, extra

LOOK_EVERY_S = 0.1
GO_ON = "\r\np"
"""Keys with which a run goes on where the tracking transducer has been moved."""
Watch = Callable[[Observer], Observer]


@dataclass(frozen=True, slots=True)
class Watched:
    """How a run is watched: ``observed`` wraps its observer, ``move`` asks for the tracking transducer to be moved."""

    observed: Watch
    move: Mover


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Live page of a run: its port, 0 for any; ``opened`` in the browser; it ``closes`` with the run."""

    port: int = 0
    opened: bool = False
    closes: bool = False


def page_options(live: bool, port: int, opened: bool, closes: bool) -> PageOptions | None:
    """Return the live page that the command line asks for; None where it asks for none. Each option asks for one."""
    return PageOptions(port, opened, closes) if live or port or opened or closes else None


@contextmanager
def live_page(path: Path, live: PageOptions | None, announce: Callable[[str], None]) -> Iterator[None]:
    """Serve the page of a run, or of a queue in the folder ``path``; afterwards wait until it is closed, or close it.

    Where what it watches ended well it stays until Ctrl-C or its own button. Raises ``StoreError`` where it cannot
    start.
    """
    if live is None:
        yield
        return
    with extra("live"):
        from hpe_rig.live import live_page_of, open_page

    with live_page_of(path, live.port) as page:
        announce(f"live page: {page.address}")
        if live.opened and not open_page(page.address):
            announce("there is no browser to open here: open the address yourself")
        yield
        if not live.closes:
            # What was printed must be read before anybody is waited for, also where it goes to a file.
            sys.stdout.flush()
            announce("the live page stays open until Ctrl-C, or Close page on it; --close ends it with the run")
            with suppress(KeyboardInterrupt):
                while not page.is_closed():
                    time.sleep(0.2)


@contextmanager
def watched(
    setup: Setup,
    path: Path,
    run_id: str,
    live: PageOptions | None,
    verbose: bool,
    announce: Callable[[str], None],
    yes: bool = False,
    paged: bool = False,
) -> Iterator[Watched]:
    """Yield how the run ``run_id`` into ``path`` is watched: it can be stopped and is logged.

    The key p, and the ``live`` page, pause it between two shots; where the tracking transducer is to be moved, unless
    ``yes``, it waits for Enter or the page. ``paged``: it has a page already. Raises ``StoreError`` where the log or
    the page cannot start.
    """
    with ExitStack() as stack:
        # Before the run file is there nobody can ask for a stop of this run.
        clear_leftover(path)
        log: Watch | None = None
        if verbose:
            from hpe_rig.measurement import log_path, logged

            log = stack.enter_context(logged(setup, log_path(path)))
        stack.enter_context(live_page(path, live, announce))
        stack.callback(_forget_stop, path, run_id)
        stack.callback(clear_pause, path, run_id)
        pressed = stack.enter_context(keyboard())
        pauses, paged = _pauses(path, run_id, pressed, announce), paged or live is not None
        answers = pressed if paged or sys.stdin.isatty() else None
        yield Watched(
            lambda observer: pausable(stoppable(log(observer) if log else observer, path, run_id), pauses, announce),
            _asking(path, run_id, answers, announce, yes, paged),
        )


def _asking(
    path: Path, run_id: str, pressed: Pressed | None, announce: Callable[[str], None], yes: bool, paged: bool
) -> Mover:
    """Return what asks for the tracking transducer to be moved and waits; with ``yes`` it only says where to.

    ``pressed`` is None where neither terminal nor live page can answer: then a line of standard input does.
    """

    def move(lateral_m: float) -> None:
        where = f"move the tracking transducer to {lateral_m * 1e3:g} mm beside the push"
        if yes:
            announce(where)
            return
        if pressed is not None:
            # What was pressed before, during a shot, is no answer.
            pressed()
        page = ", or Go on at the live page," if paged else ""
        announce(f"{where}; all outputs are off. Enter{page} when it stands there")
        if pressed is None:
            input()
        else:
            wait_at_place(path, run_id, lateral_m, lambda: any(key in GO_ON for key in pressed()))

    return move


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
