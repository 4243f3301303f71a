"""A log of every step of a run beside its file, written line by line, so that a crash keeps it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from hpe_rig.run import Setup
from hpe_rig.sequencer import Observer, Progress, Step
from hpe_rig.store import StoreError, versions
from hpe_rig.store_format import reason


@contextmanager
def logged(
    setup: Setup, log_file: Path, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[Observer], Observer]]:
    """Yield what makes of an observer one whose steps stand in ``log_file`` too, with how the run ended and why.

    Raises ``StoreError`` where the file cannot be written.
    """
    try:
        file = log_file.open("w", encoding="utf-8", buffering=1)
    except OSError as error:
        raise StoreError(
            f"{log_file} cannot be written ({reason(error)}). Try: another --output, or no --verbose."
        ) from None
    with file:
        start_s = clock()

        def write(text: str) -> None:
            file.write(f"{clock() - start_s:10.4f} s  {text}\n")

        def log(observer: Observer) -> Observer:
            def observe(progress: Progress) -> None:
                write(_words(progress))
                observer(progress)

            return observe

        file.write(f"{datetime.now(UTC).isoformat(timespec='seconds')}  {setup.scene.scene.title}\n")
        file.write(f"scene {setup.scene.name}, bench {setup.bench.name}: {setup.bench.bench.title}\n")
        file.write(", ".join(f"{name} {text}" for name, text in versions().items()) + "\n")
        file.writelines(f"{finding.level}: {finding}\n" for finding in setup.findings)
        try:
            yield log
        except BaseException as error:
            write(f"ended by {type(error).__name__}: {error}")
            file.write(traceback.format_exc())
            raise
        write("complete")


def _words(progress: Progress) -> str:
    shot, step = f"shot {progress.shot.index + 1}", progress.step
    if step is Step.COLLECT and progress.records:
        return f"{shot}: {progress.records} of {progress.shot.capture.record_count} records"
    return f"{shot}: {step.value}"
