"""Terminal: width, wrapped text, questions, progress as a bar or as lines, and the level of logging."""

from __future__ import annotations

import logging
import os
import re
import select
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

MIN_COLUMNS = 40
MAX_INDENT = 18
"""Largest indentation of the further lines of a paragraph."""
POLL_S = 0.2
"""Time until a signal is noticed while a person has not answered."""
REPORT_INTERVAL_S = 10.0
"""Interval of progress reports without a terminal."""

LOGGERS = ("hpe_rig", "drivers", "sim_backend")
"""Loggers of the steps of a run, of messages to instruments, and of commands that the twin ignores."""
LogLevel = Literal["debug", "info", "warning", "error"]
Report = Callable[[int, int, str], None]
"""Reports progress: number done, total, and the present step."""


def has_terminal() -> bool:
    """Return whether a person can read a question on standard error and answer it."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def answer(question: str) -> str:
    """Return the answer of a person at the terminal, in lower case; Ctrl-D is ``KeyboardInterrupt``, like Ctrl-C."""
    print(question, end="", file=sys.stderr, flush=True)
    if sys.platform != "win32":
        # In short pieces: a signal just before a blocking read would be noticed only after the next line.
        while not select.select([sys.stdin], [], [], POLL_S)[0]:
            pass
    line = sys.stdin.readline()
    if not line:
        raise KeyboardInterrupt
    return line.strip().lower()


def terminal_columns() -> int | None:
    """Return the width of the terminal of standard output; None for a file or a pipe.

    The environment variable COLUMNS overrides both.
    """
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdecimal():
        return max(shutil.get_terminal_size().columns, MIN_COLUMNS)
    return None


def wrapped(text: str, columns: int | None) -> str:
    """Return ``text`` with lines of at most ``columns``; continued lines are indented like the text of their line.

    Lines of a drawing or a table, recognised by several spaces in a row, are not broken.
    """
    if columns is None:
        return text
    return "\n".join(line if len(line) <= columns else _wrapped_line(line, columns) for line in text.splitlines())


def _wrapped_line(line: str, columns: int) -> str:
    label = re.match(r" *(?:(?:WARNING|REFUSED|ok) +|\S(?:\S| (?! ))*  +)?", line)
    text_start = label.end() if label else 0
    leading_spaces = len(line) - len(line.lstrip())
    indent = min(text_start if text_start <= MAX_INDENT else leading_spaces, MAX_INDENT) or 2
    # Addresses and paths are not broken, so that they can be copied.
    paragraph = textwrap.TextWrapper(columns, break_long_words=False, break_on_hyphens=False)
    paragraph.initial_indent, paragraph.subsequent_indent = line[:text_start], " " * indent
    return paragraph.fill(line[text_start:])


@contextmanager
def progress_reporter(title: str, quiet: bool = False) -> Iterator[Report]:
    """Yield a function that reports progress on standard error: a bar on a terminal, else a line every ten seconds."""
    if quiet:
        yield lambda done, total, step: None
    elif sys.stderr.isatty():
        with _bar(title) as report:
            yield report
    else:
        yield _lines(title)


@contextmanager
def _bar(title: str) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total, step: bar.update(task, completed=done, total=total, description=step or title)


def _lines(title: str) -> Report:
    start_s = last_report_s = time.monotonic()
    first_done = 0

    def report(done: int, total: int, step: str) -> None:
        nonlocal first_done, last_report_s, start_s
        now_s = time.monotonic()
        if not first_done:
            # The rate is that after the first records: preparation and the twin's first record take longer.
            start_s, first_done = now_s, done
        if now_s - last_report_s >= REPORT_INTERVAL_S and 0 < first_done < done < total:
            last_report_s = now_s
            time_left = duration_text((now_s - start_s) * (total - done) / (done - first_done))
            print(f"{step or title}: {done} of {total}, about {time_left} left", file=sys.stderr, flush=True)

    return report


def duration_text(duration_s: float) -> str:
    """Return a duration in a convenient unit: 40 s, 3 min, 1.5 h."""
    if duration_s < 90:
        return f"{duration_s:.0f} s"
    return f"{duration_s / 60:.0f} min" if duration_s < 5400 else f"{duration_s / 3600:.1f} h"


def start_logging(level: LogLevel) -> None:
    """Log records of at least ``level`` to standard error; those of other packages from warnings on."""
    # Other packages log at length: their records below a warning are discarded.
    number = logging.getLevelNamesMapping()[level.upper()]
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=max(number, logging.WARNING))
    # pyvisa-py logs a traceback for each host that it cannot reach, which the error message explains.
    logging.getLogger("pyvisa").setLevel(logging.CRITICAL if number > logging.DEBUG else logging.WARNING)
    for name in LOGGERS:
        logging.getLogger(name).setLevel(number)
