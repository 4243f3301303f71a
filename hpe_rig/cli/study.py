"""Command ``study``: workers, progress bar and closing tables of ``run_study``."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from hpe_rig.bench import interruptible
from hpe_rig.cli.console import announce
from hpe_rig.cli.options import SchedulerOptions
from hpe_rig.cli.terminal import progress_reporter
from hpe_rig.result import text_table
from hpe_rig.study import (
    SUMMARY_FILE,
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

MAX_ROWS = 16
"""Rows of a study that are all printed; of more, the ranges are printed."""
CLUSTER_CASES_AHEAD = 64
"""Cases sent to a cluster before their results arrive."""


def run_and_print(
    name: str, output: Path, scheduling: SchedulerOptions, replaced: Mapping[str, Any], report: bool
) -> None:
    """Run the study ``name`` with ``replaced`` settings, print its errors and run times, and write its report."""
    count, scheduler = scheduling.workers or os.cpu_count() or 1, scheduling.scheduler
    tls = TlsFiles(scheduling.tls_ca, scheduling.tls_cert, scheduling.tls_key)
    open_pool = functools.partial(cluster, scheduler, count, tls) if scheduler else functools.partial(processes, count)
    if scheduler and (warning := untrusted_network(scheduler)):
        announce(warning)
    # Enough cases wait in the pool to keep all workers busy.
    cases_ahead = CLUSTER_CASES_AHEAD if scheduler else 2 * count + 2
    with interruptible(), progress_reporter(f"{name}: realisations") as progress:
        results = run_study(
            name, output, open_pool, cases_ahead, replaced, lambda done, total: progress(done, total, ""), announce
        )
    for result in results:
        typer.echo(f"{result.name}: {result.definition.title}\n{error_table(result)}\n")
        if text := refused_text(result.rows):
            typer.echo(f"{text}\n")
    typer.echo(run_time_table(results, output))
    if report:
        from hpe_rig.study import write_study_report
        from hpe_rig.validation import reproduction_part

        comparison = reproduction_part(results)
        page = write_study_report(Path(name).stem, results, output, [comparison] if comparison else [])
        typer.echo(f"{page}: open it in any browser")


def run_time_table(results: Sequence[StudyResult], output: Path) -> str:
    """Return cases, realisations and run time, one row per study."""
    headers = ("study", "results", "cases", "realisations", "processor time", "peak memory")
    rows = (
        (
            *(result.name, str(output / result.name / SUMMARY_FILE), f"{len(result.cases)}", f"{result.realisations}"),
            *(f"{result.seconds:.1f} s", f"{result.peak_memory_mib:.0f} MiB"),
        )
        for result in results
    )
    return text_table(headers, rows, words=2)


def error_table(result: StudyResult) -> str:
    """Return bias and jitter in % of the true amplitude and in degrees, with Monte Carlo standard errors.

    A small study has one row per case and estimator; a large one has one row per estimator, with the range over its
    cases.
    """
    axes = [axis.name for axis in result.definition.axes]
    # A column with one value in all rows is omitted.
    varied = [name for name in ("reading", "frequency_hz") if len({row[name] for row in result.rows}) > 1]
    headers = ("amplitude bias\n%", "jitter\n%", "phase bias\ndeg", "jitter\ndeg")
    if len(result.rows) <= MAX_ROWS:
        rows = []
        for row in result.rows:
            errors = [f"{value:.2f} +- {error:.2f}" for value, error in error_figures(row)]
            rows.append((row["estimator"], *(_cell(row[name]) for name in (*axes, *varied)), *errors))
        return text_table(("estimator\n", *(f"{name}\n" for name in (*axes, *varied)), *headers), rows)
    # Too many rows to print: the range over the cases of each estimator.
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in result.rows:
        groups.setdefault((row["estimator"], *(f"{row[name]}" for name in varied)), []).append(row)
    rows = [(*key, *spans(group_rows)) for key, group_rows in groups.items()]
    return text_table(("estimator\n", *(f"{name}\n" for name in varied), *headers), rows)


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)
