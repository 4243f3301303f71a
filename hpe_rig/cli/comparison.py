"""Command ``compare``: two runs side by side, as text or JSON, and as a figure in a file."""

from __future__ import annotations

import json as json_format
import math
from pathlib import Path
from typing import Any

import typer

from hpe_rig.cli.console import announce
from hpe_rig.cli.tables import wide_console
from hpe_rig.report import ResultDifference, compare_runs
from hpe_rig.result import rich_table
from hpe_rig.scene import printable
from hpe_rig.store import StoreError

LONGEST_VALUE = 60
FORMATS = (".svg", ".png", ".pdf")


def print_comparison(first: Path, second: Path, named: str | None, figure: Path | None, json: bool) -> None:
    """Print what differs between two runs, and write its figure."""
    found = compare_runs(first, second, named)
    if figure is not None:
        try:
            found.figure().savefig(figure)
        except (OSError, ValueError) as error:
            raise StoreError(f"{figure} cannot be written ({error}). Try: a name that ends in {FORMATS}.") from error
        announce(f"{figure}: both results and their differences")
    if json:
        typer.echo(json_format.dumps(found.as_dict(), indent=2))
        return
    console = wide_console()
    many = {0: "no setting differs", 1: "1 setting differs"}.get(len(found.settings))
    console.print(many or f"{len(found.settings)} settings differ", style="bold")
    settings = [(each.where, each.what, _value(each.before), _value(each.after)) for each in found.settings]
    if settings:
        console.print(rich_table(("", "setting", *found.names), settings, words=4))
    for setting in dict.fromkeys(row.setting for row in found.results):
        console.print(f"\n{setting}", style="bold")
        headers = ["f\nHz"]
        headers += [f"{what}\n{name}" for name in ("first", "second") for what in ("nm, u", "deg, u")]
        rows = [_row(row) for row in found.results if row.setting == setting]
        console.print(rich_table([*headers, "change\n%", "change\ndeg", "p\nall", "p\nnoise", ""], rows, words=0))
    for text in found.alone:
        console.print(text)
    if not found.results:
        console.print("no setting and frequency has a result in both")
        return
    console.print()
    runs = zip(("first", "second"), found.names, found.origins, found.estimators, strict=True)
    for which, name, origin, estimator in runs:
        console.print(f"{which}: {name}, {origin}, estimator {estimator}")
    console.print(
        "p: probability of as large a difference of amplitude and phase by chance, below 0.01 they differ; all: every\n"
        "source of uncertainty independent in the two; noise: noise and trigger jitter alone, for runs alike:\n"
        "of the same place, beams and specimen"
    )


def _row(row: ResultDifference) -> tuple[str, ...]:
    cells = [f"{row.frequency_hz:g}"]
    for side in (0, 1):
        cells.append(f"{row.amplitude_m[side] * 1e9:.4g}, {row.amplitude_uncertainty_m[side] * 1e9:.2g}")
        cells.append(f"{math.degrees(row.phase_rad[side]):.2f}, {math.degrees(row.phase_uncertainty_rad[side]):.2g}")
    cells += [f"{row.amplitude_change * 100:+.1f}", f"{math.degrees(row.phase_change_rad):+.2f}"]
    return (*cells, f"{row.p_all:.2g}", f"{row.p_noise:.2g}", row.verdict)


def _value(value: Any) -> str:
    text = "absent" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
    return printable(text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}...")
