"""Command ``study``: workers, progress bar and closing table around ``run_study``."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hpe_rig.bench import interruptible
from hpe_rig.cli.console import announce
from hpe_rig.cli.terminal import told
from hpe_rig.result import text_table
from hpe_rig.study import (
    NO_TLS,
    SUMMARY_FILE,
    OnProgress,
    StudyResult,
    TlsFiles,
    cluster,
    error_figures,
    processes,
    refused_text,
    run_study,
    spans,
    untrusted_network,
)

MOST_ROWS = 16
"""Rows that a study prints; of more it prints the least and the largest."""


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
    """Run the study ``name``, print what it found and how long it took, and write its report if asked."""
    count = workers or os.cpu_count() or 1
    open_pool = functools.partial(cluster, scheduler, count, tls) if scheduler else functools.partial(processes, count)
    if scheduler and (danger := untrusted_network(scheduler)):
        announce(danger)
    ahead = 64 if scheduler else 2 * count + 2
    with interruptible(), _progress(name) as watch:
        results = run_study(name, output, open_pool, ahead, replaced, watch, announce)
    for result in results:
        show(f"{result.name}: {result.definition.title}\n{physics(result)}\n")
        if words := refused_text(result.rows):
            show(f"{words}\n")
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
            *(result.name, str(output / result.name / SUMMARY_FILE), f"{len(result.cases)}", f"{result.realisations}"),
            *(f"{result.seconds:.1f} s", f"{result.peak_memory_mib:.0f} MiB"),
        )
        for result in results
    )
    return text_table(headers, rows, words=2)


def physics(result: StudyResult) -> str:
    """Return what a study found, in % of the true amplitude and in degrees, with Monte Carlo standard errors.

    A small study has a row for each case and estimator. Of a large one there is a row for each estimator, with the
    least and the largest value over its cases.
    """
    axes = [axis.name for axis in result.definition.axes]
    told_apart = [name for name in ("reading", "frequency_hz") if len({row[name] for row in result.rows}) > 1]
    figures = ("amplitude bias\n%", "jitter\n%", "phase bias\ndeg", "jitter\ndeg")
    if len(result.rows) <= MOST_ROWS:
        rows = []
        for row in result.rows:
            found = [f"{value:.2f} +- {error:.2f}" for value, error in error_figures(row)]
            rows.append((row["estimator"], *(_shown(row[name]) for name in (*axes, *told_apart)), *found))
        return text_table(("estimator\n", *(f"{name}\n" for name in (*axes, *told_apart)), *figures), rows)
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in result.rows:
        groups.setdefault((row["estimator"], *(f"{row[name]}" for name in told_apart)), []).append(row)
    rows = [(*key, *spans(found)) for key, found in groups.items()]
    return text_table(("estimator\n", *(f"{name}\n" for name in told_apart), *figures), rows)


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


@contextmanager
def _progress(name: str) -> Iterator[OnProgress]:
    with told(f"{name}: realisations") as tell:
        yield lambda done, total: tell(done, total, "")
