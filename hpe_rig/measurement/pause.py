"""Pause of a run between two shots, with every output off: a file next to the run file during the pause.

Like a stop request it may come from another process, such as the live page, and it holds the identity of its run. The
run writes it too, with a lateral offset in a second line, while it waits for a movement of the tracking transducer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Final

from hpe_rig.measurement.background import BackgroundTasks
from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.measurement.stop_request import (
    POLL_INTERVAL_S,
    StopRequested,
    clear_stop,
    read_request,
    stop_requested,
    with_stop_requests,
    write_request,
)
from hpe_rig.store import StoreError, reason

CLEAR_S: Final = 2.0
"""Time that the folder of the run file gets for the removal of requests after the run."""


def pause_path(run_file: Path) -> Path:
    """Return the path of the file that pauses the run."""
    return run_file.parent / f"{run_file.name}.pause"


def pause_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether a pause of the run ``run_id`` in ``run_file`` is requested; "" means any run."""
    lines = read_request(pause_path(run_file))
    return bool(lines) and (not run_id or lines[0] in ("", run_id))


def awaited_offset_m(run_file: Path, run_id: str = "") -> float | None:
    """Return the lateral offset to which the run waits for a movement of the transducer; None if it waits for none."""
    lines = read_request(pause_path(run_file)) if pause_requested(run_file, run_id) else []
    with suppress(IndexError, ValueError):
        return float(lines[1])
    return None


def toggle_pause(run_file: Path, run_id: str = "") -> bool:
    """Request a pause of the run in ``run_file`` after its shot, or end the pause; return whether it pauses now.

    Raises ``StoreError`` if the request cannot be written or removed.
    """
    paused = pause_requested(run_file, run_id)
    try:
        if paused:
            pause_path(run_file).unlink(missing_ok=True)
        else:
            write_request(pause_path(run_file), run_id)
    except OSError as error:
        what = f"the request to pause cannot be {'removed' if paused else 'written'} beside {run_file}"
        raise StoreError(f"{what} ({reason(error)}). Try: Ctrl-C, and hpe-rig resume later.") from None
    return not paused


def wait_for_move(
    run_file: Path,
    run_id: str,
    lateral_m: float,
    is_confirmed: Callable[[], bool],
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Wait until the tracking transducer is at ``lateral_m``: ``is_confirmed`` returns True, or the pause is ended.

    Raises ``StopRequested`` if a stop is requested meanwhile, and ``StoreError`` if the pause cannot be written.
    """
    try:
        write_request(pause_path(run_file), f"{run_id}\n{lateral_m!r}")
    except OSError as error:
        what = f"the wait for the transducer at {lateral_m * 1e3:g} mm cannot be written beside {run_file}"
        remedy = "free space and the right to write there, then hpe-rig resume; --yes asks no confirmation"
        raise StoreError(f"{what} ({reason(error)}). Try: {remedy}.") from None
    try:
        while pause_requested(run_file, run_id) and not is_confirmed():
            if stop_requested(run_file, run_id):
                raise StopRequested
            sleep(POLL_INTERVAL_S)
    finally:
        clear_pause(run_file, run_id)


def clear_pause(run_file: Path, run_id: str = "") -> None:
    """Remove a request to pause the run ``run_id``, if there is one."""
    if pause_requested(run_file, run_id):
        with suppress(OSError):
            pause_path(run_file).unlink(missing_ok=True)


@contextmanager
def clearing_requests(run_file: Path, run_id: str) -> Iterator[None]:
    """Remove the requests to pause or stop the run ``run_id`` at the end of the block.

    A share that does not answer within ``CLEAR_S`` keeps them.
    """
    tasks = BackgroundTasks("requests")
    try:
        yield
    finally:
        tasks.submit(partial(clear_pause, run_file, run_id))
        tasks.submit(partial(clear_stop, run_file, run_id))
        # An error about a request that cannot be removed must not hide how the run ended.
        tasks.wait(CLEAR_S)
        tasks.end()


def with_requests(
    observer: Observer, run_file: Path, run_id: str, is_paused: Callable[[], bool], report: Callable[[str], None]
) -> Observer:
    """Wrap ``observer`` so that it stops and pauses the run on request; see ``with_pauses``."""
    # A pause calls the observer inside it, so that a stop request ends the run during the pause too.
    return with_pauses(with_stop_requests(observer, run_file, run_id), is_paused, report)


def with_pauses(
    observer: Observer,
    is_paused: Callable[[], bool],
    report: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
) -> Observer:
    """Wrap ``observer`` so that it waits before a shot while ``is_paused`` returns True.

    During a pause ``observer`` is still called, so that it can end the run. ``report`` gets a message at the begin and
    at the end of a pause.
    """

    def observe(progress: Progress) -> None:
        observer(progress)
        # All outputs were verified off after the shot before, and nothing of this shot is programmed yet.
        if progress.step not in (Step.MOVE, Step.CONDITIONS, Step.CONFIGURE):
            # Also during a long shot the key is read, so that its effect is announced.
            is_paused()
        elif is_paused():
            report(f"paused before shot {progress.shot.index + 1}, all outputs are off: p continues, Ctrl-C stops")
            while is_paused():
                sleep(POLL_INTERVAL_S)
                observer(progress)
            report("continuing")

    return observe
