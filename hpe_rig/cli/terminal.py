"""Terminal: how wide it is, text broken to fit it, progress as a bar or as lines, and what of the logs it shows."""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

LEAST_COLUMNS = 40
DEEPEST = 18
"""Columns by which the further lines of a paragraph stand in at the most."""
EVERY_S = 10.0
"""How often a line tells of the progress where there is no terminal to draw a bar on."""

OWN_LOGGERS = ("hpe_rig", "drivers", "sim_backend")
"""Steps of a run, every message to an instrument, what the twin ignores; ``--verbose`` writes a log beside the run."""
Tell = Callable[[int, int, str], None]
"""What is told of the progress: done, of how many, and in words what is under way."""


def terminal_columns() -> int | None:
    """Return how wide the terminal is that standard output goes to; None where it goes to a file or a pipe.

    The environment variable COLUMNS says so in either case.
    """
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdecimal():
        return max(shutil.get_terminal_size().columns, LEAST_COLUMNS)
    return None


def wrapped(text: str, columns: int | None) -> str:
    """Return ``text`` with lines of at most ``columns``; what is broken stands in by as much as its line's own text.

    Lines of a drawing or of a table, which hold a run of spaces inside, stay as they are.
    """
    if columns is None:
        return text
    return "\n".join(line if len(line) <= columns else _broken(line, columns) for line in text.splitlines())


def _broken(line: str, columns: int) -> str:
    named = re.match(r" *(?:(?:WARNING|REFUSED|ok) +|\S(?:\S| (?! ))*  +)?", line)
    begin = named.end() if named else 0
    stand_in = min(begin if begin <= DEEPEST else len(line) - len(line.lstrip()), DEEPEST) or 2
    head, rest = line[:begin], line[begin:]
    # An address or a path is broken nowhere: it would be copied in halves.
    paragraph = textwrap.TextWrapper(columns, break_long_words=False, break_on_hyphens=False)
    paragraph.initial_indent, paragraph.subsequent_indent = head, " " * stand_in
    return paragraph.fill(rest)


@contextmanager
def told(title: str, quiet: bool = False) -> Iterator[Tell]:
    """Yield what shows progress on standard error: a bar with the time left, or a line every ten seconds in a file."""
    if quiet:
        yield lambda done, total, doing: None
    elif sys.stderr.isatty():
        with _bar(title) as tell:
            yield tell
    else:
        yield _lines(title)


@contextmanager
def _bar(title: str) -> Iterator[Tell]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total, doing: bar.update(task, completed=done, total=total, description=doing or title)


def _lines(title: str) -> Tell:
    begun_s = last_s = time.monotonic()

    def tell(done: int, total: int, doing: str) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s >= EVERY_S and 0 < done < total:
            last_s = now_s
            left = in_words((now_s - begun_s) * (total - done) / done)
            print(f"{doing or title}: {done} of {total}, about {left} left", file=sys.stderr, flush=True)

    return tell


def in_words(duration_s: float) -> str:
    """Return a duration as people say it: 40 s, 3 min, 1.5 h."""
    if duration_s < 90:
        return f"{duration_s:.0f} s"
    return f"{duration_s / 60:.0f} min" if duration_s < 5400 else f"{duration_s / 3600:.1f} h"


class LogLevel(StrEnum):
    """Levels of Python's ``logging``, by the names that are typed."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def start_logging(level: LogLevel) -> None:
    """Let records of at least ``level`` reach standard error; those of other packages from warnings on."""
    chosen = logging.getLevelNamesMapping()[level.upper()]
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=max(chosen, logging.WARNING))
    for name in OWN_LOGGERS:
        logging.getLogger(name).setLevel(chosen)
