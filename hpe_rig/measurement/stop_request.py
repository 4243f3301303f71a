"""Request to stop a run in another process safely: a file beside the run file, looked for between records.

No signal and no process number: whoever may write beside the run may stop it, on any system and over a network share.
The file holds the identity of the run that it is for, so that no other run of that name takes it for its own or removes
it; an empty one, made by hand, is for whatever run finds it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.store import StoreError, atomic_file, is_taken, read_run, reason

LOOK_EVERY_S = 0.1
"""Looking costs a call to the file system, so it is not done for every block of records."""
LONGEST_REQUEST = 64


class StopRequested(KeyboardInterrupt):
    """Somebody asked for a safe stop; unwinds like Ctrl-C: outputs off, what was recorded is kept."""


def stop_path(run_file: Path) -> Path:
    """Return the file whose existence asks the run to stop."""
    return run_file.parent / f"{run_file.name}.stop"


def request_stop(run_file: Path) -> None:
    """Ask the run that writes ``run_file`` to stop.

    Raises ``StoreError`` where no run writes it, or none any more, and where nothing can be written beside it.
    """
    stored = read_run(run_file)
    if stored.status != "running" or is_taken(run_file) is False:
        how = "without a word, its program was killed" if stored.status == "running" else stored.status
        raise StoreError(f"the run in {run_file} has ended ({how}): there is nothing to stop. Try: reload the page.")
    write_stop(run_file, stored.run_id)


def write_stop(file: Path, run_id: str = "") -> None:
    """Write a request to stop beside a run file, or beside a queue's list, to end it before its next run.

    Raises ``StoreError`` where that is impossible.
    """
    try:
        # Renamed into place, which follows no link.
        with atomic_file(stop_path(file)) as draft, draft.open("x", encoding="ascii") as written:
            written.write(run_id)
    except OSError as error:
        raise StoreError(
            f"the request to stop cannot be written beside {file} ({reason(error)}). "
            "Try: Ctrl-C where the run was started."
        ) from None


def stop_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether the run ``run_id`` in ``run_file``, any run where that is "", is asked to stop."""
    found = _request(run_file)
    return found is not None and (not run_id or found in ("", run_id))


def clear_stop(run_file: Path, run_id: str = "") -> None:
    """Forget a request to stop the run ``run_id``, where that is "" any, as left over from an earlier run.

    Raises ``StoreError`` where something stands in its place that cannot be removed.
    """
    if _request(run_file) is not None and not stop_requested(run_file, run_id):
        return
    try:
        stop_path(run_file).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(
            f"{stop_path(run_file)} stands where a request to stop this run would, and cannot be removed "
            f"({reason(error)}). Try: remove it, or another --output."
        ) from None


def clear_leftover(run_file: Path) -> None:
    """Forget a request left over from an earlier run of that name, unless a run goes on there; as ``clear_stop``."""
    if not is_taken(run_file):
        clear_stop(run_file)


def stoppable(
    observer: Observer, run_file: Path, run_id: str = "", clock: Callable[[], float] = time.monotonic
) -> Observer:
    """Return ``observer`` such that it raises ``StopRequested`` once a stop of ``run_file`` is asked for."""
    looked_s = [-LOOK_EVERY_S]

    def observe(progress: Progress) -> None:
        observer(progress)
        if progress.step is Step.SAFE:
            # The shot is over and good: let it be marked as complete first.
            return
        now_s = clock()
        if now_s - looked_s[0] >= LOOK_EVERY_S:
            looked_s[0] = now_s
            if stop_requested(run_file, run_id):
                raise StopRequested

    return observe


def _request(run_file: Path) -> str | None:
    """Return the content of the request beside ``run_file``, None where there is none; a link is none."""
    path = stop_path(run_file)
    with suppress(OSError, ValueError):
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as file:
                return file.read(LONGEST_REQUEST).decode("ascii", "replace").strip()
    return None
