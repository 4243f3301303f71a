"""Request to stop a run in another process safely: a file beside the run file, looked for between records.

No signal and no process number: whoever may write beside the run may stop it, on any system and over a network share.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from hpe_rig.acquire.sequencer import Observer, Progress, Step
from hpe_rig.store import StoreError, reason

LOOK_EVERY_S = 0.1
"""Looking costs a call to the file system, so it is not done for every block of records."""


class StopRequested(KeyboardInterrupt):
    """Somebody asked for a safe stop; unwinds like Ctrl-C: outputs off, what was recorded is kept."""


def stop_path(run_file: Path) -> Path:
    """Return the file whose existence asks the run to stop."""
    return run_file.parent / f"{run_file.name}.stop"


def request_stop(run_file: Path) -> None:
    """Ask the run that writes ``run_file`` to stop; raise ``StoreError`` where nothing can be written beside it."""
    try:
        stop_path(run_file).touch()
    except OSError as error:
        raise StoreError(
            f"the request to stop cannot be written beside {run_file} ({reason(error)}). "
            "Try: Ctrl-C where the run was started."
        ) from None


def clear_stop(run_file: Path) -> None:
    """Forget a request to stop, also one left over from an earlier run of that name."""
    try:
        stop_path(run_file).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(
            f"{stop_path(run_file)}, which would ask the run to stop, cannot be removed ({reason(error)}). "
            "Try: remove it, or another --output."
        ) from None


def stoppable(observer: Observer, run_file: Path, clock: Callable[[], float] = time.monotonic) -> Observer:
    """Return ``observer`` such that it raises ``StopRequested`` once a stop of ``run_file`` is asked for."""
    wanted, looked_s = stop_path(run_file), [-LOOK_EVERY_S]

    def observe(progress: Progress) -> None:
        observer(progress)
        if progress.step is Step.SAFE:
            # The shot is over and good: let it be marked as complete first.
            return
        now_s = clock()
        if now_s - looked_s[0] >= LOOK_EVERY_S:
            looked_s[0] = now_s
            if wanted.exists():
                raise StopRequested

    return observe
