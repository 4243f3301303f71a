"""Closing tables of a study for the terminal: errors, and run times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hpe_rig.result import text_table
from hpe_rig.study.results import SUMMARY_FILE, StudyResult
from hpe_rig.study.series import error_figures, refused_text, spans

MAX_ROWS = 16
"""Rows of a study that are all printed; of more, the ranges are printed."""


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
    cases. A line about refused estimates follows, if there are any.
    """
    axes = [axis.name for axis in result.definition.axes]
    # A column with one value in all rows is omitted.
    varied = [name for name in ("reading", "frequency_hz") if len({row[name] for row in result.rows}) > 1]
    rows: list[tuple[str, ...]] = []
    if len(result.rows) <= MAX_ROWS:
        names = [*axes, *varied]
        for row in result.rows:
            errors = [f"{value:.2f} +- {error:.2f}" for value, error in error_figures(row)]
            rows.append((row["estimator"], *(_cell(row[name]) for name in names), *errors))
    else:
        names, groups = varied, dict[tuple[str, ...], list[dict[str, Any]]]()
        for row in result.rows:
            groups.setdefault((row["estimator"], *(f"{row[name]}" for name in varied)), []).append(row)
        rows = [(*key, *spans(group_rows)) for key, group_rows in groups.items()]
    headers = ("amplitude bias\n%", "jitter\n%", "phase bias\ndeg", "jitter\ndeg")
    table = text_table(("estimator\n", *(f"{name}\n" for name in names), *headers), rows)
    return "\n\n".join(filter(None, (table, refused_text(result.rows))))


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)
