"""Standard streams without waiting: a stalled terminal, a pipe without a reader or a full disk stops no run.

Standard error carries messages: without a reader its lines are dropped and counted. Standard output carries results:
nothing is dropped, and the end of the program waits for a slow reader such as a pager.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import time
from dataclasses import dataclass
from typing import Any, Final

from hpe_rig.bench import END_SIGNALS
from hpe_rig.queued_file import QueuedFile, WritingThread, queued_text

END_S: Final = 2.0
"""Time that the end of the program gives messages, and results after a signal, on a stalled stream."""
POLL_S: Final = 0.05
EXIT_FAILED, EXIT_SIGNAL = 1, 128
"""Exit code without results; the number added to that of a signal, as in a shell."""


@dataclass(frozen=True, slots=True)
class Streams:
    """Queued standard streams, each with its thread; None for a stream that is no file, as in a notebook."""

    output: tuple[QueuedFile, WritingThread] | None
    errors: tuple[QueuedFile, WritingThread] | None
    replaced: tuple[Any, Any]
    """The streams before; without a reference to them Python would close their files."""


def queue_streams() -> Streams:
    """Replace the standard streams by queued ones, and missing ones by empty ones."""
    # A file opened later would get the descriptor of a closed stream, and printed text would be written to it.
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123
    replaced = sys.stdout, sys.stderr
    targets = [_raw_file(stream) for stream in replaced]
    if None not in targets and os.path.sameopenfile(*(target.fileno() for target in targets)):
        # On one terminal the order of messages and results is kept.
        threads = [WritingThread()] * 2
    else:
        threads = [WritingThread(), WritingThread()]
    output, errors = (
        None if target is None else (QueuedFile(target, thread, notice), thread)
        for target, thread, notice in zip(targets, threads, (None, _dropped_text), strict=True)
    )
    if output is not None:
        # With python -u everything is written through; by lines it is as prompt.
        by_lines = bool(sys.stdout.line_buffering or getattr(sys.stdout, "write_through", False))
        sys.stdout = queued_text(output[0], sys.stdout.encoding, by_lines)
    if errors is not None:
        sys.stderr = queued_text(errors[0], sys.stderr.encoding)
    return Streams(output, errors, replaced)


def finish_streams(streams: Streams, exit_code: int) -> int:
    """Wait until results and messages are written; return ``exit_code``, or another one if results are missing.

    Results are waited for without limit, but at most ``END_S`` after a signal; messages at most ``END_S``.
    """
    arrived = _note_signals()
    if streams.output is not None:
        file, thread = streams.output
        sys.stdout.flush()
        if not _written(thread, arrived, None if file.used else END_S):
            return EXIT_SIGNAL + arrived[0] if arrived else exit_code
        if file.failure is not None:
            exit_code = exit_code or EXIT_FAILED
            # A reader that has seen enough, such as `head`, is no mistake of the user.
            if file.failure.errno != errno.EPIPE:
                print(_missing_results_text(file.failure), file=sys.stderr)
    if streams.errors is not None:
        file, thread = streams.errors
        sys.stderr.flush()
        file.report_dropped()
        _written(thread, arrived, END_S)
    return exit_code


def wait_for_messages() -> None:
    """Wait until the messages so far are written, at most ``END_S``; every output must be off."""
    file = getattr(sys.stderr, "buffer", None)
    if isinstance(file, QueuedFile):
        file.wait_written(END_S)


def results_accepted() -> bool:
    """Wait until the results so far are written, at most ``END_S``; return False if standard output has failed."""
    sys.stdout.flush()
    file = getattr(sys.stdout, "buffer", None)
    if not isinstance(file, QueuedFile):
        return True
    file.wait_written(END_S)
    return file.failure is None


def _raw_file(stream: Any) -> Any:
    """Return the unbuffered file below a text stream; None if there is none."""
    buffer = getattr(stream, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    return raw if isinstance(raw, io.RawIOBase) else None


def _note_signals() -> list[int]:
    """Return a list that gets the number of each signal that would end the program; none ends it any more."""
    arrived: list[int] = []
    for number in END_SIGNALS:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, lambda number, _: arrived.append(number))
    return arrived


def _written(thread: WritingThread, arrived: list[int], patience_s: float | None) -> bool:
    """Wait until ``thread`` has written everything, for ``patience_s`` or until ``END_S`` after a signal."""
    written, start_s = thread.marker(), time.monotonic()
    signal_s = None
    while not written.wait(POLL_S):
        now_s = time.monotonic()
        if arrived and signal_s is None:
            signal_s = now_s
        if patience_s is not None and now_s - start_s > patience_s:
            return False
        if signal_s is not None and now_s - signal_s > END_S:
            return False
    return True


def _dropped_text(lines: int) -> str:
    return f"hpe-rig: {lines} lines were not shown, because none was read for too long\n"


def _missing_results_text(failure: OSError) -> str:
    what = f"results are missing: standard output cannot be written ({failure.strerror or failure})"
    return f"hpe-rig: {what}. Try: another output, such as a file on another disk; run files are not affected."
