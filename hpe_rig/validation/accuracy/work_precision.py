"""Error against run time: one point a method and setting, and the table of them."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpe_rig.scene import Mistake, SettingsError

Floats = NDArray[np.float64]

COLOURS = ("#0072B2", "#D55E00", "#007A5A", "#8A4F7D", "#5A5A5A", "#E69F00", "#56B4E9", "#000000")
"""Told apart by the colour-blind."""


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
    case: str, method: str, setting: str, compute: Callable[[], Floats], exact: Floats, repeats: int = 3
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


def as_text(points: Sequence[Point]) -> str:
    """Return the points as a table for people."""
    lines = [f"{'case':28} {'method':34} {'setting':24} {'error':>9} {'time':>11}"]
    for point in points:
        error = "gave up" if np.isnan(point.error) else f"{point.error:.1e}"
        name = f"{point.case:28} {point.method:34} {point.setting:24}"
        lines.append(f"{name} {error:>9} {point.time_s * 1e3:8.2f} ms")
    return "\n".join(lines)


def as_csv(points: Sequence[Point]) -> str:
    """Return the points as comma separated values with a header, times in seconds."""
    out = io.StringIO()
    writer = csv.DictWriter(out, ["case", "method", "setting", "error", "time_s"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(point) for point in points)
    return out.getvalue()


def file_mistakes(output: Path | None, figure: Path | None) -> list[Mistake]:
    """Return what is wrong with the names of a table, ``.csv`` or ``.json``, and of a figure; absent ones are right."""
    found = []
    files = (("--output", output, (".csv", ".json")), ("--figure", figure, (".svg", ".png", ".pdf")))
    for option, path, suffixes in files:
        if path is not None and path.suffix not in suffixes:
            found.append(Mistake(option, f"{path} is no format it has", f"a name in {' or '.join(suffixes)}"))
        if path is not None and not path.parent.is_dir():
            found.append(Mistake(option, f"there is no folder {path.parent}", "make it, or another one"))
    return found


def write_points(
    points: Iterable[Point], output: Path | None, figure: Path | None, show: Callable[[str], None]
) -> None:
    """Measure ``points``, write table and figure; without a file for the table ``show`` gets it as text.

    What was measured until an interruption is written. Raises ``SettingsError`` for wrong names before any point.
    """
    mistakes = file_mistakes(output, figure)
    if mistakes:
        raise SettingsError("command line", mistakes)
    found: list[Point] = []
    try:
        found.extend(points)
    finally:
        if output is None:
            show(as_text(found))
        elif output.suffix == ".json":
            output.write_text(json.dumps([asdict(point) for point in found], indent=1) + "\n", encoding="utf-8")
        else:
            output.write_text(as_csv(found), encoding="utf-8")
    if figure is not None:
        write_figure(found, figure)


def write_figure(points: Sequence[Point], path: Path, panels_a_row: int = 4) -> None:
    """Write error against run time: a panel a case, a line a method."""
    from matplotlib.figure import Figure

    from hpe_rig.report import label_decades

    cases = list(dict.fromkeys(point.case for point in points))
    columns = min(panels_a_row, len(cases))
    figure = Figure(figsize=(3.4 * columns, 3.2 * math.ceil(len(cases) / columns)), layout="constrained")
    panels = figure.subplots(math.ceil(len(cases) / columns), columns, squeeze=False).ravel()
    for spare in panels[len(cases) :]:
        spare.set_axis_off()
    for panel, case in zip(panels, cases, strict=False):
        here = [point for point in points if point.case == case and not np.isnan(point.error)]
        for place, method in enumerate(dict.fromkeys(point.method for point in here)):
            some = [point for point in here if point.method == method]
            times_s, errors = [point.time_s for point in some], [max(point.error, 1e-17) for point in some]
            marker = "osd^vx"[place % 6]
            panel.plot(times_s, errors, marker=marker, ms=4, lw=0.8, color=COLOURS[place % len(COLOURS)], label=method)
        panel.set(xscale="log", yscale="log", xlabel="run time (s)", ylabel="relative error", title=case)
        label_decades(panel.xaxis)
        panel.grid(alpha=0.3)
        panel.legend(fontsize=7, framealpha=0.5)
    figure.savefig(path)
