"""Requests of another process to stop or pause a run: files in the folder of the run file, checked between records.

They need no signal and no process number, and work on any system and over a network share for everyone who may write to
that folder. A request holds the identity of its run, so that no other run of that name obeys it or removes it. An empty
file, made by hand, applies to any run. While a run waits for a movement of the tracking transducer, it writes a pause
itself, with the lateral offset in a second line.
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
from hpe_rig.store import StoreError, atomic_file, is_locked, open_ordinary, read_run, reason

POLL_INTERVAL_S = 0.1
"""Each check costs a call to the file system, too much for every block of records."""
MAX_REQUEST_BYTES = 128
CLEAR_S: Final = 2.0
"""Time that the folder of the run file gets for the removal of requests after the run."""


class StopRequested(KeyboardInterrupt):
    """A safe stop was requested. It unwinds like Ctrl-C: outputs off, recorded shots stored."""


def stop_path(run_file: Path) -> Path:
    """Return the path of the file that requests a stop of the run."""
    return run_file.parent / f"{run_file.name}.stop"


def request_stop(run_file: Path) -> None:
    """Ask the run that writes ``run_file`` to stop.

    Raises ``StoreError`` if no process writes it, or the request cannot be written.
    """
    stored = read_run(run_file)
    if stored.status != "running" or is_locked(run_file) is False:
        how = "its program was killed" if stored.status in ("running", "killed") else stored.status
        raise StoreError(f"the run in {run_file} has ended ({how}): there is nothing to stop. Try: reload the page.")
    write_stop(run_file, stored.run_id)


def write_stop(file: Path, run_id: str = "") -> None:
    """Write a request to stop beside a run file, or beside a queue's list, which then starts no other run.

    Raises ``StoreError`` if it cannot be written.
    """
    try:
        write_request(stop_path(file), run_id)
    except OSError as error:
        raise StoreError(
            f"the request to stop cannot be written beside {file} ({reason(error)}). "
            "Try: Ctrl-C where the run was started."
        ) from None


def stop_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether a stop of the run ``run_id`` in ``run_file`` is requested; "" means any run."""
    return _is_requested(stop_path(run_file), run_id)


def clear_stop(run_file: Path, run_id: str = "") -> None:
    """Remove a request to stop the run ``run_id``; "" means any run.

    Raises ``StoreError`` if the request, or whatever has its name, cannot be removed.
    """
    if read_request(stop_path(run_file)) and not stop_requested(run_file, run_id):
        return
    try:
        stop_path(run_file).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(
            f"{stop_path(run_file)} has the name of a request to stop this run, and cannot be removed "
            f"({reason(error)}). Try: remove it, or another --output."
        ) from None


def clear_stale_stop(run_file: Path) -> None:
    """Remove a request from an earlier run of that name, unless a process writes the file; raises as ``clear_stop``."""
    if not is_locked(run_file):
        clear_stop(run_file)


def with_stop_requests(
    observer: Observer, run_file: Path, run_id: str = "", clock: Callable[[], float] = time.monotonic
) -> Observer:
    """Wrap ``observer`` so that it raises ``StopRequested`` after a stop of ``run_file`` is requested."""
    last_poll_s = -POLL_INTERVAL_S

    def observe(progress: Progress) -> None:
        nonlocal last_poll_s
        observer(progress)
        if progress.step is Step.SAFE:
            # All records of the shot have arrived. It is marked as complete before the run stops.
            return
        now_s = clock()
        if now_s - last_poll_s >= POLL_INTERVAL_S:
            last_poll_s = now_s
            if stop_requested(run_file, run_id):
                raise StopRequested

    return observe


def write_request(path: Path, text: str) -> None:
    """Write a request in one step; raise ``OSError`` if it cannot be written."""
    with atomic_file(path) as request:
        request.write(text.encode("ascii"))


def read_request(path: Path) -> list[str]:
    """Return the lines of a request, at least one; an empty list without a request. A link or a pipe is no request."""
    # Windows has no flag against links. Other systems refuse them when the file is opened.
    with suppress(OSError, ValueError):
        if not path.is_symlink():
            with open(path, "rb", opener=open_ordinary) as file:
                return file.read(MAX_REQUEST_BYTES).decode("ascii", "replace").strip().splitlines() or [""]
    return []


def _is_requested(path: Path, run_id: str) -> bool:
    lines = read_request(path)
    return bool(lines) and (not run_id or lines[0] in ("", run_id))


def pause_path(run_file: Path) -> Path:
    """Return the path of the file that pauses the run."""
    return run_file.parent / f"{run_file.name}.pause"


def pause_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether a pause of the run ``run_id`` in ``run_file`` is requested; "" means any run."""
    return _is_requested(pause_path(run_file), run_id)


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
