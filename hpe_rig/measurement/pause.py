"""Pause of a run between two shots, every output off: a file beside the run file, there as long as the pause is wanted.

Like a request to stop it may come from another process, such as the live page's; it holds the identity of its run. The
run itself writes it where the tracking transducer is to be moved, with the place in a second line, and waits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.measurement.stop_request import StopRequested, stop_requested
from hpe_rig.store import StoreError, atomic_file, reason

LOOK_EVERY_S = 0.1
LONGEST_REQUEST = 128


def pause_path(run_file: Path) -> Path:
    """Return the file whose existence asks the run to pause."""
    return run_file.parent / f"{run_file.name}.pause"


def pause_requested(run_file: Path, run_id: str = "") -> bool:
    """Return whether the run ``run_id`` in ``run_file``, any run where that is "", is asked to pause."""
    found = _request(run_file)
    return bool(found) and (not run_id or found[0] in ("", run_id))


def awaited_place_m(run_file: Path, run_id: str = "") -> float | None:
    """Return where the run waits for the tracking transducer to be moved to; None where it waits for nobody."""
    found = _request(run_file) if pause_requested(run_file, run_id) else []
    with suppress(IndexError, ValueError):
        return float(found[1])
    return None


def _request(run_file: Path) -> list[str]:
    """Return the lines of the request beside ``run_file``, at least one; none where there is no request."""
    path = pause_path(run_file)
    with suppress(OSError, ValueError):
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as file:
                return file.read(LONGEST_REQUEST).decode("ascii", "replace").strip().splitlines() or [""]
    return []


def toggle_pause(run_file: Path, run_id: str = "") -> bool:
    """Ask the run in ``run_file`` to pause after its shot, or to go on where it was asked; return whether it pauses.

    Raises ``StoreError`` where nothing can be written beside it.
    """
    asked = pause_requested(run_file, run_id)
    try:
        if asked:
            pause_path(run_file).unlink(missing_ok=True)
        else:
            _ask(run_file, run_id)
    except OSError as error:
        what = f"the request to pause cannot be {'removed' if asked else 'written'} beside {run_file}"
        raise StoreError(f"{what} ({reason(error)}). Try: Ctrl-C, and hpe-rig resume later.") from None
    return not asked


def wait_at_place(
    run_file: Path,
    run_id: str,
    lateral_m: float,
    goes_on: Callable[[], bool],
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Return when the tracking transducer stands at ``lateral_m``: as ``goes_on`` says, or somebody ends the pause.

    Raises ``StopRequested`` where somebody stops the run instead, and ``StoreError`` where nothing can be written
    beside it.
    """
    try:
        _ask(run_file, f"{run_id}\n{lateral_m!r}")
    except OSError as error:
        what = f"that the run waits for the transducer at {lateral_m * 1e3:g} mm cannot be written beside {run_file}"
        remedy = "free space and the right to write there, then hpe-rig resume; --yes asks nobody"
        raise StoreError(f"{what} ({reason(error)}). Try: {remedy}.") from None
    try:
        while pause_requested(run_file, run_id) and not goes_on():
            if stop_requested(run_file, run_id):
                raise StopRequested
            sleep(LOOK_EVERY_S)
    finally:
        clear_pause(run_file, run_id)


def _ask(run_file: Path, text: str) -> None:
    with atomic_file(pause_path(run_file)) as draft, draft.open("x", encoding="ascii") as file:
        file.write(text)


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
