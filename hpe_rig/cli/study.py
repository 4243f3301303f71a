"""Command ``study``: workers, progress bar and closing table around ``run_study``."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hpe_rig.bench import interruptible
from hpe_rig.cli.console import announce
from hpe_rig.result import text_table
from hpe_rig.study import (
    NO_TLS,
    SUMMARY,
    OnProgress,
    StudyResult,
    TlsFiles,
    cluster,
    processes,
    run_study,
    untrusted_network,
)


def study_command(
    name: str,
    output: Path,
    workers: int | None,
    scheduler: str | None,
    replaced: Mapping[str, Any],
    show: Callable[[str], None],
    report: bool = False,
    tls: TlsFiles = NO_TLS,
) -> None:
    """Run the study ``name``, print what it computed and how long it took, and write its report if asked."""
    count = workers or os.cpu_count() or 1
    open_pool = functools.partial(cluster, scheduler, count, tls) if scheduler else functools.partial(processes, count)
    if scheduler and (danger := untrusted_network(scheduler)):
        announce(danger)
    ahead = 64 if scheduler else 2 * count + 2
    with interruptible(), _progress(name) as watch:
        results = run_study(name, output, open_pool, ahead, replaced, watch, announce)
    show(table(results, output))
    if report:
        from hpe_rig.study import write_study_report
        from hpe_rig.validation import reproduction_part

        compared = reproduction_part(results)
        page = write_study_report(Path(name).stem, results, output, [compared] if compared else [])
        show(f"{page}: open it in any browser")


def table(results: list[StudyResult], output: Path) -> str:
    """Return what every study computed and in what time, a row a study."""
    headers = ("study", "results", "cases", "realisations", "processor time", "peak memory")
    rows = (
        (
            *(result.name, str(output / result.name / SUMMARY), f"{len(result.cases)}", f"{result.realisations}"),
            *(f"{result.seconds:.1f} s", f"{result.peak_memory_mib:.0f} MiB"),
        )
        for result in results
    )
    return text_table(headers, rows, words=2)


@contextmanager
def _progress(name: str) -> Iterator[OnProgress]:
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(f"{name}:"), BarColumn(), MofNCompleteColumn(), TextColumn("realisations"))
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
