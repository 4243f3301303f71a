"""Work-precision diagrams: error against run time of every method and setting, as a table and as a figure."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result import csv_text, figure_bytes, json_text, label_decades, mappings, mark, text_table
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import unwritable, write_file

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

Row = TypeVar("Row")
Value = TypeVar("Value")
Group = TypeVar("Group", bound=Hashable)

PANELS_PER_ROW = 4
MIN_DRAWN_ERROR = 1e-17
"""Errors below this, zero included, are drawn here."""


@dataclass(frozen=True, slots=True)
class Point:
    """Error and run time of one method and setting on one case."""

    case: str
    method: str
    setting: str
    error: float
    """Largest error relative to the largest value; NaN if the method failed."""
    time_s: float
    """Median wall time, s."""


def timed(run: Callable[[], Value], clock: Callable[[], float] = time.perf_counter) -> tuple[Value, float]:
    """Return the value of ``run()`` and its duration by ``clock``, s."""
    start_s = clock()
    value = run()
    return value, clock() - start_s


def measured(
    case: str, method: str, setting: str, compute: Callable[[], FloatArray], exact: FloatArray, repeats: int = 3
) -> Point:
    """Compare ``compute()`` with ``exact`` and time it ``repeats`` times; the error is NaN if it raises."""
    start_s = time.perf_counter()
    try:
        values, times_s = zip(*(timed(compute) for _ in range(repeats)), strict=True)
    except (ValueError, ArithmeticError):
        return Point(case, method, setting, float("nan"), time.perf_counter() - start_s)
    error = float(np.abs(values[-1] - exact).max() / np.abs(exact).max())
    return Point(case, method, setting, error, float(np.median(times_s)))


def grouped(rows: Iterable[Row], key: Callable[[Row], Group]) -> dict[Group, list[Row]]:
    """Group the rows by ``key``, in their order of appearance."""
    groups: dict[Group, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def pareto(times_s: Sequence[float], errors: Sequence[float]) -> list[int]:
    """Return the indices of the Pareto front: no other point is better in both time and error. Sorted by time."""
    front: list[int] = []
    # In order of time, a point is on the front if its error is below all previous ones.
    for index in sorted(range(len(times_s)), key=lambda k: (times_s[k], errors[k])):
        if not math.isnan(errors[index]) and (not front or errors[index] < errors[front[-1]]):
            front.append(index)
    return front


def file_mistakes(output: Path | None, figure: Path | None) -> list[Mistake]:
    """Return the mistakes in the file names of a table (``.csv``, ``.json``) and of a figure; None is valid."""
    mistakes = []
    files = (("--output", output, (".csv", ".json")), ("--figure", figure, (".svg", ".png", ".pdf")))
    for option, path, suffixes in files:
        if path is not None and path.suffix not in suffixes:
            remedy = f"a file name that ends in {' or '.join(suffixes)}"
            mistakes.append(Mistake(option, f"{path}: unknown format", remedy))
        if path is not None and not path.parent.is_dir():
            mistakes.append(Mistake(option, f"the folder {path.parent} does not exist", "create it, or choose another"))
        elif path is not None and (why := unwritable(path)):
            mistakes.append(Mistake(option, f"{path} cannot be written ({why})", "another name or folder"))
    return mistakes


def points_text(points: Sequence[Point]) -> str:
    """Return the points as a table for the terminal."""
    cells = (
        (p.case, p.method, p.setting, "failed" if np.isnan(p.error) else f"{p.error:.1e}", f"{p.time_s * 1e3:.2f} ms")
        for p in points
    )
    return text_table(("case", "method", "setting", "error", "time"), cells, words=3)


def write_rows(
    rows: Iterable[Row],
    output: Path | None,
    figure: Path | None,
    draw: Callable[[list[Row], Path], None],
    show: Callable[[str], None],
    as_text: Callable[[list[Row]], str] = csv_text,
) -> list[Row]:
    """Compute and return ``rows``; write them to ``output`` and ``figure``, or pass the table ``as_text`` to ``show``.

    After an interruption the rows computed so far are written. Raises ``SettingsError`` for invalid file names before
    the first row.
    """
    mistakes = file_mistakes(output, figure)
    if mistakes:
        raise SettingsError("command line", mistakes)
    computed: list[Row] = []
    try:
        computed.extend(rows)
    finally:
        if output is None:
            show(as_text(computed).rstrip("\n"))
        else:
            text = json_text(mappings(computed), indent=1) + "\n" if output.suffix == ".json" else csv_text(computed)
            write_file(output, text)
            show(f"{output}: {len(computed)} rows")
    if figure is not None:
        draw(computed, figure)
        show(f"{figure}: error against run time")
    return computed


def save_figure(figure: Figure, path: Path) -> None:
    """Write ``figure`` in the format of the suffix of ``path``; raise ``StoreError`` if that is impossible."""
    write_file(path, figure_bytes(figure, path, figure.dpi, adaptive=False))


def draw_points(points: Sequence[Point], path: Path) -> None:
    """Draw error against run time: one panel per case, one line per method."""
    finite = [point for point in points if not np.isnan(point.error)]
    panels = {
        case: {
            method: [(point.time_s, max(point.error, MIN_DRAWN_ERROR)) for point in method_points]
            for method, method_points in grouped(case_points, lambda point: point.method).items()
        }
        for case, case_points in grouped(finite, lambda point: point.case).items()
    }
    draw_panels(panels, path, "run time (s)", "relative error")


def draw_panels(
    panels: dict[str, dict[str, list[tuple[float, float]]]],
    path: Path,
    x_label: str,
    y_label: str,
    over_bound: bool = False,
) -> None:
    """Draw one panel per title with the (time, error) points of each method, on logarithmic axes.

    A method has the same mark in every panel, with one legend for all panels. ``over_bound``: errors are ratios to a
    bound; all panels then share the error axis, and a line is drawn at 1.
    """
    from matplotlib.figure import Figure

    columns = min(PANELS_PER_ROW, len(panels))
    rows = math.ceil(len(panels) / columns)
    marks = {method: mark(index) for index, method in enumerate(dict.fromkeys(itertools.chain(*panels.values())))}
    # Widths in inches: a letter 0.09 at most, a mark 0.5. A row of the legend is 0.22 high.
    names_per_row = max(1, min(2 * columns, int(3.4 * columns / (0.5 + 0.09 * max(map(len, marks), default=1)))))
    legend_in = 0.22 * max(0, math.ceil(len(marks) / names_per_row) - 2)
    figure = Figure(figsize=(3.4 * columns, 3.2 * rows + legend_in), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=over_bound).ravel()
    for unused in axes[len(panels) :]:
        unused.set_axis_off()
    lines_by_method: dict[str, Artist] = {}
    for panel, (title, methods) in zip(axes, panels.items(), strict=False):
        for method, points in methods.items():
            marker, colour = marks[method]
            line = "" if over_bound else "-"
            (lines_by_method[method],) = panel.plot(
                *zip(*points, strict=True), marker=marker, ls=line, lw=0.8, ms=4, color=colour, label=method
            )
        panel.set(xscale="log", yscale="log", xlabel=x_label)
        panel.set_title(title, fontsize=9)
        label_decades(panel.xaxis)
        label_decades(panel.yaxis)
        panel.grid(alpha=0.3)
        if over_bound:
            panel.axhline(1, color="0.6", lw=0.8)
    for panel in axes[::columns]:
        panel.set_ylabel(y_label)
    lines = [lines_by_method[method] for method in marks]
    figure.legend(lines, list(marks), loc="outside upper center", ncols=names_per_row, frameon=False)
    save_figure(figure, path)
