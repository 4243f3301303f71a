"""Request to stop a run from another process: a file in the folder of the run file, checked between records.

The request needs no signal and no process number. It works on any system and over a network share for everyone who may
write to that folder. The file holds the identity of its run, so that no other run of that name obeys it or removes
it. An empty file, made by hand, applies to any run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.store import StoreError, atomic_file, is_locked, open_ordinary, read_run, reason

POLL_INTERVAL_S = 0.1
"""Each check costs a call to the file system, too much for every block of records."""
MAX_REQUEST_BYTES = 128


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
    lines = read_request(stop_path(run_file))
    return bool(lines) and (not run_id or lines[0] in ("", run_id))


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
