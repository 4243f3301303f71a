"""Pause of a run between two shots, every output off: a file beside the run file, there as long as the pause is wanted.

Like a request to stop it may come from another process, such as the live page's; it holds the identity of its run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from hpe_rig.acquire.sequencer import Observer, Progress, Step
from hpe_rig.store import StoreError, atomic_file, reason

LOOK_EVERY_S = 0.1
LONGEST_REQUEST = 64


def pause_path(run_file: Path) -> Path:
    """Return the file whose existence asks the run to pause."""
    return run_file.parent / f"{run_file.name}.pause"


def pause_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether the run ``run_id`` in ``run_file``, any run where that is "", is asked to pause."""
    path = pause_path(run_file)
    with suppress(OSError, ValueError):
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as file:
                found = file.read(LONGEST_REQUEST).decode("ascii", "replace").strip()
            return not run_id or found in ("", run_id)
    return False


def toggle_pause(run_file: Path, run_id: str = "") -> bool:
    """Ask the run in ``run_file`` to pause after its shot, or to go on where it was asked; return whether it pauses.

    Raises ``StoreError`` where nothing can be written beside it.
    """
    path, asked = pause_path(run_file), pause_requested(run_file, run_id)
    try:
        if asked:
            path.unlink(missing_ok=True)
        else:
            with atomic_file(path) as draft, draft.open("x", encoding="ascii") as file:
                file.write(run_id)
    except OSError as error:
        what = f"the request to pause cannot be {'removed' if asked else 'written'} beside {run_file}"
        raise StoreError(f"{what} ({reason(error)}). Try: Ctrl-C, and hpe-rig resume later.") from None
    return not asked


def clear_pause(run_file: Path, run_id: str = "") -> None:
    """Forget a request to pause the run ``run_id``, as its end does."""
    if pause_requested(run_file, run_id):
        with suppress(OSError):
            pause_path(run_file).unlink(missing_ok=True)


def pausable(
    observer: Observer,
    asked: Callable[[], bool],
    tell: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
) -> Observer:
    """Return ``observer`` such that it waits before a shot, where every output is off, while a pause is ``asked`` for.

    Meanwhile ``observer`` is still asked: it ends the run where somebody wants that instead. ``tell`` is told when a
    pause begins and ends.
    """

    def observe(progress: Progress) -> None:
        observer(progress)
        # Outputs went off with the shot before, verified, and nothing of this one is programmed yet.
        if progress.step not in (Step.MOVE, Step.CONFIGURE):
            # Also during a long shot somebody wants to know that the key was heard.
            asked()
        elif asked():
            tell(f"paused before shot {progress.shot.index + 1}, all outputs are off: p goes on, Ctrl-C stops")
            while asked():
                sleep(LOOK_EVERY_S)
                observer(progress)
            tell("going on")

    return observe
