"""Log of every step of a run beside its file, written line by line, so that a crash keeps it."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.measurement.setup import Setup
from hpe_rig.store import StoreError, reason, versions


def log_path(run_file: Path) -> Path:
    """Return the log beside a run file, under a name that is not the run file's own."""
    stem = run_file.name if run_file.suffix == ".log" else run_file.stem
    return run_file.parent / f"{stem}.log"


@contextlib.contextmanager
def logged(setup: Setup, log_file: Path) -> Iterator[Callable[[Observer], Observer]]:
    """Yield a function that wraps an observer so that every step is written to ``log_file``, with how the run ended.

    An existing log is appended to: it may tell of the run because of which this one is refused.

    Raises ``StoreError`` where the file cannot be written.
    """
    try:
        file = log_file.open("a", encoding="utf-8", buffering=1)
    except OSError as error:
        raise StoreError(
            f"{log_file} cannot be written ({reason(error)}). Try: another --output, or no --verbose."
        ) from None
    start_s = time.monotonic()

    def put(text: str) -> None:
        # A disk that fills up ends the run by its own file, with a message; a log alone ends none.
        with contextlib.suppress(OSError):
            file.write(text)

    def write(text: str) -> None:
        put(f"{time.monotonic() - start_s:10.4f} s  {text}\n")

    def log(observer: Observer) -> Observer:
        said = ""

        def observe(progress: Progress) -> None:
            nonlocal said
            if (words := _words(progress)) != said:
                write(words)
            said = words
            observer(progress)

        return observe

    put(f"{datetime.now(UTC).isoformat(timespec='seconds')}  {setup.scene.scene.title}\n")
    put(f"scene {setup.scene.name}, bench {setup.bench.name}: {setup.bench.bench.title}\n")
    put(", ".join(f"{name} {text}" for name, text in versions().items()) + "\n")
    put("".join(f"{finding.level}: {finding}\n" for finding in setup.findings))
    try:
        yield log
        write("complete")
    except BaseException as error:
        write(f"ended by {type(error).__name__}: {error}")
        put(traceback.format_exc())
        raise
    finally:
        with contextlib.suppress(OSError):
            file.close()


def _words(progress: Progress) -> str:
    shot, step = f"shot {progress.shot.index + 1}", progress.step
    if step is Step.COLLECT and progress.records:
        return f"{shot}: {progress.records} of {progress.shot.capture.record_count} records"
    return f"{shot}: {step.value}"
