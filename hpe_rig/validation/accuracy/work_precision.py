"""Work precision: error against run time, one row a method and setting, as table and as figure."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result import csv_text, label_decades, mappings, mark, text_table
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import unwritable

if TYPE_CHECKING:
    from matplotlib.artist import Artist

Row = TypeVar("Row")
Group = TypeVar("Group", bound=Hashable)

PANELS_A_ROW = 4
LEAST_ERROR = 1e-17
"""Where an error of zero is drawn."""


@dataclass(frozen=True, slots=True)
class Point:
    """One way to compute one case: how wrong, how long."""

    case: str
    method: str
    setting: str
    error: float
    """Largest error over the largest value; NaN where the method gave up."""
    time_s: float
    """Median wall time."""


def measured(
    case: str, method: str, setting: str, compute: Callable[[], FloatArray], exact: FloatArray, repeats: int = 3
) -> Point:
    """Return the point of ``compute``, timed ``repeats`` times, against ``exact``; NaN error where it raises."""
    times_s = []
    error = float("nan")
    for _ in range(repeats):
        start_s = time.perf_counter()
        try:
            value = compute()
        except (ValueError, ArithmeticError, FloatingPointError):
            return Point(case, method, setting, error, time.perf_counter() - start_s)
        times_s.append(time.perf_counter() - start_s)
    error = float(np.abs(value - exact).max() / np.abs(exact).max())
    return Point(case, method, setting, error, float(np.median(times_s)))


def grouped(rows: Iterable[Row], key: Callable[[Row], Group]) -> dict[Group, list[Row]]:
    """Return the rows by ``key``, groups and rows in the order of the rows."""
    found: dict[Group, list[Row]] = {}
    for row in rows:
        found.setdefault(key(row), []).append(row)
    return found


def pareto(times_s: Sequence[float], errors: Sequence[float]) -> list[int]:
    """Return the indices, by ascending time, of the points that no other beats in both time and error."""
    front: list[int] = []
    for index in sorted(range(len(times_s)), key=lambda k: (times_s[k], errors[k])):
        if not math.isnan(errors[index]) and (not front or errors[index] < errors[front[-1]]):
            front.append(index)
    return front


def file_mistakes(output: Path | None, figure: Path | None) -> list[Mistake]:
    """Return what is wrong with the names of a table, ``.csv`` or ``.json``, and of a figure; absent ones are right."""
    found = []
    files = (("--output", output, (".csv", ".json")), ("--figure", figure, (".svg", ".png", ".pdf")))
    for option, path, suffixes in files:
        if path is not None and path.suffix not in suffixes:
            found.append(Mistake(option, f"{path} is no format it has", f"a name in {' or '.join(suffixes)}"))
        if path is not None and not path.parent.is_dir():
            found.append(Mistake(option, f"there is no folder {path.parent}", "make it, or another one"))
        elif path is not None and (why := unwritable(path)):
            found.append(Mistake(option, f"{path} cannot be written ({why})", "another name or folder"))
    return found


def points_text(points: Sequence[Point]) -> str:
    """Return the points as a table for the terminal."""
    cells = (
        (p.case, p.method, p.setting, "gave up" if np.isnan(p.error) else f"{p.error:.1e}", f"{p.time_s * 1e3:.2f} ms")
        for p in points
    )
    return text_table(("case", "method", "setting", "error", "time"), cells, words=3)


def write_rows(
    rows: Iterable[Any],
    output: Path | None,
    figure: Path | None,
    draw: Callable[[list[Any], Path], None],
    show: Callable[[str], None],
    as_text: Callable[[list[Any]], str] = csv_text,
) -> None:
    """Measure ``rows``, write table and figure; without a file for the table ``show`` gets it ``as_text``.

    What was measured until an interruption is written. Raises ``SettingsError`` for wrong names before any row.
    """
    mistakes = file_mistakes(output, figure)
    if mistakes:
        raise SettingsError("command line", mistakes)
    found: list[Any] = []
    try:
        found.extend(rows)
    finally:
        if output is None:
            show(as_text(found).rstrip("\n"))
        else:
            text = json.dumps(mappings(found), indent=1) + "\n" if output.suffix == ".json" else csv_text(found)
            output.write_text(text, encoding="utf-8")
            show(f"{output}: {len(found)} rows")
    if figure is not None:
        draw(found, figure)
        show(f"{figure}: error against run time")


def draw_points(points: Sequence[Point], path: Path) -> None:
    """Draw error against run time, a panel a case, a line a method."""
    known = [point for point in points if not np.isnan(point.error)]
    panels = {
        case: {
            method: [(point.time_s, max(point.error, LEAST_ERROR)) for point in some]
            for method, some in grouped(own, lambda point: point.method).items()
        }
        for case, own in grouped(known, lambda point: point.case).items()
    }
    draw_panels(panels, path, "run time (s)", "relative error")


def draw_panels(
    panels: dict[str, dict[str, list[tuple[float, float]]]],
    path: Path,
    x_label: str,
    y_label: str,
    over_bound: bool = False,
) -> None:
    """Draw panels by title, in each (time, error) by method, on logarithmic axes: the best is low and to the left.

    A method has the same mark in every panel; one legend above them all.

    ``over_bound``: errors are ratios to a bound, so that all panels share an axis, with a line at 1 and no others.
    """
    from matplotlib.figure import Figure

    columns = min(PANELS_A_ROW, len(panels))
    lines = math.ceil(len(panels) / columns)
    marks = {method: mark(place) for place, method in enumerate(dict.fromkeys(itertools.chain(*panels.values())))}
    # A letter takes less than 0.09 inch, the mark beside a name 0.5, a row of names 0.22.
    names_a_row = max(1, min(2 * columns, int(3.4 * columns / (0.5 + 0.09 * max(map(len, marks), default=1)))))
    legend_in = 0.22 * max(0, math.ceil(len(marks) / names_a_row) - 2)
    figure = Figure(figsize=(3.4 * columns, 3.2 * lines + legend_in), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False, sharey=over_bound).ravel()
    for spare in axes[len(panels) :]:
        spare.set_axis_off()
    drawn: dict[str, Artist] = {}
    for one, (title, methods) in zip(axes, panels.items(), strict=False):
        for method, points in methods.items():
            marker, colour = marks[method]
            line = "" if over_bound else "-"
            (drawn[method],) = one.plot(
                *zip(*points, strict=True), marker=marker, ls=line, lw=0.8, ms=4, color=colour, label=method
            )
        one.set(xscale="log", yscale="log", xlabel=x_label)
        one.set_title(title, fontsize=9)
        label_decades(one.xaxis)
        label_decades(one.yaxis)
        one.grid(alpha=0.3)
        if over_bound:
            one.axhline(1, color="0.6", lw=0.8)
    for one in axes[::columns]:
        one.set_ylabel(y_label)
    figure.legend(
        [drawn[method] for method in marks], list(marks), loc="outside upper center", ncols=names_a_row, frameon=False
    )
    figure.savefig(path)
