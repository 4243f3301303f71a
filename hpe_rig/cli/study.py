"""Command ``study``: workers and progress bar of ``run_study``."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from hpe_rig.bench import interruptible
from hpe_rig.cli.console import announce, print_json
from hpe_rig.cli.options import SchedulerOptions
from hpe_rig.cli.terminal import progress_reporter
from hpe_rig.study import (
    StudyResult,
    TlsFiles,
    cluster,
    error_table,
    processes,
    run_study,
    run_time_table,
    untrusted_network,
)

CLUSTER_CASES_AHEAD = 64
"""Cases sent to a cluster before their results arrive."""


def run_and_print(
    name: str, output: Path, scheduling: SchedulerOptions, replaced: Mapping[str, Any], *, report: bool, json: bool
) -> None:
    """Run the study ``name`` with ``replaced`` settings, print its errors and run times, and write its report.

    ``json`` prints every row of the results instead.
    """
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
    if json:
        print_json([_as_dict(result) for result in results])
    for result in () if json else results:
        typer.echo(f"{result.name}: {result.definition.title}\n{error_table(result)}\n")
    if not json:
        typer.echo(run_time_table(results, output))
    if report:
        from hpe_rig.study import write_study_report
        from hpe_rig.validation import reproduction_part

        comparison = reproduction_part(results)
        page = write_study_report(Path(name).stem, results, output, [comparison] if comparison else [])
        (announce if json else typer.echo)(f"{page}: open it in any browser")


def _as_dict(result: StudyResult) -> dict[str, Any]:
    """Return name, title and rows of a study; JSON has null where an error is undetermined."""
    rows = [
        {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()}
        for row in result.rows
    ]
    return {"name": result.name, "title": result.definition.title, "rows": rows}
