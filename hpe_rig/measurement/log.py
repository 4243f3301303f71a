"""Log file of a run, beside its run file; a thread writes each line at once, so that a crash keeps it.

No run waits for the disk of its log, or ends because that disk is full or does not answer.
"""

from __future__ import annotations

import contextlib
import io
import time
import traceback
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from hpe_rig.measurement.sequencer import Observer, Progress, Step
from hpe_rig.measurement.setup import Setup
from hpe_rig.queued_file import QueuedFile, WritingThread, queued_text
from hpe_rig.store import StoreError, open_ordinary, reason, versions

CLOSE_S: Final = 2.0
"""Time that the disk gets for the last lines."""


@contextlib.contextmanager
def run_log(setup: Setup, run_file: Path) -> Iterator[Callable[[Observer], Observer]]:
    """Yield a function that wraps an observer so that the log of ``run_file`` gets a line for every step.

    The last line states how the run ended. An existing log is extended: it may explain why this run is refused.
    Raises ``StoreError`` if the file cannot be written.
    """
    # The log of a run file RUN.log is RUN.log.log.
    stem = run_file.name if run_file.suffix == ".log" else run_file.stem
    log_file = run_file.parent / f"{stem}.log"
    try:
        disk = io.FileIO(log_file, "ab", opener=open_ordinary)
    except OSError as error:
        raise StoreError(
            f"{log_file} cannot be written ({reason(error)}). Try: another --output, or no --verbose."
        ) from None
    thread = WritingThread()
    queue = QueuedFile(disk, thread, lambda lines: f"{lines} lines are missing: the disk was too slow\n")
    # Each line is queued at once.
    write = queued_text(queue, "utf-8").write
    start_s = time.monotonic()

    def write_line(text: str) -> None:
        write(f"{time.monotonic() - start_s:10.4f} s  {text}\n")

    def with_log(observer: Observer) -> Observer:
        last_line = ""

        def observe(progress: Progress) -> None:
            nonlocal last_line
            if (line := _step_text(progress)) != last_line:
                write_line(line)
            last_line = line
            observer(progress)

        return observe

    write(f"{datetime.now(UTC).isoformat(timespec='seconds')}  {setup.scene.scene.title}\n")
    write(f"scene {setup.scene.name}, bench {setup.bench.name}: {setup.bench.bench.title}\n")
    write(", ".join(f"{name} {version}" for name, version in versions().items()) + "\n")
    write("".join(f"{finding.level}: {finding}\n" for finding in setup.findings))
    try:
        yield with_log
        write_line("complete")
    except BaseException as error:
        write_line(f"ended by {type(error).__name__}: {error}")
        write(traceback.format_exc())
        raise
    finally:
        queue.report_dropped()
        # A disk that does not answer keeps its file until the program ends.
        if queue.wait_written(CLOSE_S):
            with contextlib.suppress(OSError):
                disk.close()
        thread.stop()


def _step_text(progress: Progress) -> str:
    shot = f"shot {progress.shot.index + 1}"
    if progress.step is Step.COLLECT and progress.records:
        return f"{shot}: {progress.records} of {progress.shot.capture.record_count} records"
    return f"{shot}: {progress.step.value}"
