"""Supervision of a run: stop request, pause, log and live page, each loaded only if an option requires it."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hpe_rig.bench import INTERRUPTS
from hpe_rig.cli.keys import ReadKeys, keyboard
from hpe_rig.cli.options import WatchOptions
from hpe_rig.measurement import (
    Mover,
    Observer,
    Setup,
    clear_stale_stop,
    clearing_requests,
    pause_requested,
    toggle_pause,
    wait_for_move,
    with_requests,
)
from hpe_rig.store import StoreError, extra

POLL_INTERVAL_S = 0.1
CONFIRM_KEYS = "\r\np"
"""Keys that confirm a movement of the tracking transducer."""


@contextmanager
def live_page(path: Path, options: WatchOptions, announce: Callable[[str], None]) -> Iterator[None]:
    """Serve the live page of a run file, or of a queue in the folder ``path``, if the options request one.

    After the block has ended without an error, wait for Ctrl-C or the button of the page, unless ``options.close``.
    Raises ``StoreError`` if the page cannot start.
    """
    if not options.has_page:
        yield
        return
    with extra("live"):
        from hpe_rig.live import live_page_of, open_page

    with live_page_of(path, options.port) as (address, is_closed):
        announce(f"live page: {address}")
        if options.open and not open_page(address):
            announce("no browser can be opened here: open the address yourself")
        yield
        if not options.close:
            # The results must be readable before the program waits, also if they are written to a file.
            sys.stdout.flush()
            announce("the live page stays open until Ctrl-C, or Close page on it; --close ends it with the run")
            with suppress(KeyboardInterrupt):
                while not is_closed():
                    time.sleep(0.2)


@contextmanager
def supervise(
    setup: Setup,
    path: Path,
    run_id: str,
    options: WatchOptions,
    announce: Callable[[str], None],
    in_queue: bool = False,
) -> Iterator[tuple[Callable[[Observer], Observer], Mover]]:
    """Supervise the run ``run_id`` into ``path``: it can be stopped and paused, and is logged.

    Yield a wrapper of its observer, and the mover that asks for movements of the transducer. The key p and the live
    page pause the run between two shots. Before a movement it waits for Enter or the page, unless ``options.yes``. With
    ``in_queue`` the page of the queue serves the run. Raises ``StoreError`` if log or page cannot start.
    """
    with ExitStack() as stack:
        for finding in setup.findings:
            # Said before an output is enabled; other warnings are part of the result.
            if finding.check == "commissioning" and finding.level == "warning":
                announce(f"WARNING {finding}")
        # No request can concern this run before its run file exists.
        clear_stale_stop(path)
        log: Callable[[Observer], Observer] = lambda observer: observer  # noqa: E731
        if options.verbose:
            from hpe_rig.measurement import run_log

            log = stack.enter_context(run_log(setup, path))
        if not in_queue:
            stack.enter_context(live_page(path, options, announce))
        stack.enter_context(clearing_requests(path, run_id))
        read_keys = stack.enter_context(keyboard())
        is_paused = _pause_poller(path, run_id, read_keys, announce)
        has_page = options.has_page
        # Without a terminal and a page no key can confirm: a line of standard input does.
        confirmation_keys = read_keys if has_page or sys.stdin.isatty() else None
        ask = _ask_for_moves(path, run_id, confirmation_keys, announce, has_page)
        move = _announce_moves(announce) if options.yes else ask
        yield lambda observer: with_requests(log(observer), path, run_id, is_paused, announce), move


def _announce_moves(announce: Callable[[str], None]) -> Mover:
    """Return a mover that announces each movement without waiting for it."""
    return lambda lateral_m: announce(_move_text(lateral_m))


def _ask_for_moves(
    path: Path, run_id: str, read_keys: ReadKeys | None, announce: Callable[[str], None], has_page: bool
) -> Mover:
    """Return a mover that announces each movement and waits for its confirmation.

    ``read_keys`` is None without terminal and live page: then a line of standard input confirms.
    """

    def move(lateral_m: float) -> None:
        if read_keys is not None:
            # Keys pressed before, during a shot, confirm nothing.
            read_keys()
        page = ', or "Go on" on the live page,' if has_page else ""
        announce(f"{_move_text(lateral_m)}; all outputs are off. Enter{page} after the movement")
        if read_keys is None:
            _wait_for_line()
        else:
            wait_for_move(path, run_id, lateral_m, lambda: any(key in CONFIRM_KEYS for key in read_keys()))

    return move


def _wait_for_line() -> None:
    """Wait for a line of standard input; raise ``StoreError`` if there is none to come."""
    try:
        input()
    except (EOFError, OSError, ValueError) as error:
        what = f"nobody can confirm the movement: standard input has ended ({error})"
        raise StoreError(f"{what}. Try: hpe-rig run at a terminal, --live or --yes, then hpe-rig resume.") from None


def _move_text(lateral_m: float) -> str:
    return f"move the tracking transducer to a lateral offset of {lateral_m * 1e3:g} mm from the push"


def _pause_poller(path: Path, run_id: str, read_keys: ReadKeys, announce: Callable[[str], None]) -> Callable[[], bool]:
    """Return a function that reports whether the run is paused, by the key p or by the file of a request."""
    last_poll_s, paused = -math.inf, False

    def is_paused() -> bool:
        nonlocal last_poll_s, paused
        if time.monotonic() - last_poll_s < POLL_INTERVAL_S:
            return paused
        last_poll_s = time.monotonic()
        for _ in range(read_keys().lower().count("p")):
            try:
                if toggle_pause(path, run_id):
                    announce("a pause follows after this shot")
            except StoreError as error:
                announce(f"hpe-rig: {error}")
        paused = pause_requested(path, run_id)
        return paused

    return is_paused


@contextmanager
def after_complete_run(path: Path) -> Iterator[None]:
    """Add to an interrupt in the block that the run in ``path`` is complete: its result is only not printed yet."""
    try:
        yield
    except INTERRUPTS as interrupt:
        interrupt.add_note(f"{path} is complete: hpe-rig process {path} prints its result")
        raise
