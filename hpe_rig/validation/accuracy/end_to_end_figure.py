"""The end-to-end figure: error of the final amplitude against seconds, its front, and the shipped default on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.report import label_decades
from hpe_rig.validation.accuracy.end_to_end import EndToEnd
from hpe_rig.validation.accuracy.work_precision import COLOURS

MARKERS = "osd^vx"


def draw_end_to_end(rows: Sequence[EndToEnd], path: Path) -> None:
    """Draw error over run time of every way, and the numerical part of it over tolerance and nodes."""
    figure = Figure(figsize=(11, 4.8))
    whole, numerical = figure.subplots(1, 2, width_ratios=[3, 2])
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.11, top=0.93, wspace=0.18)
    _whole(whole, rows)
    _numerical(numerical, rows)
    for axes in (whole, numerical):
        axes.set(xscale="log", yscale="log")
        label_decades(axes.xaxis)
        axes.grid(alpha=0.3)
    figure.savefig(path)


def _whole(axes: Axes, rows: Sequence[EndToEnd]) -> None:
    for place, name in enumerate(dict.fromkeys(row.estimator for row in rows)):
        own = [row for row in rows if row.estimator == name]
        size = [14 * (row.gate_length_m / 0.5e-3) for row in own]
        axes.scatter(
            [row.time_s for row in own], [row.error for row in own], size,
            marker=MARKERS[place % 6], color=COLOURS[place % len(COLOURS)], alpha=0.7, label=name, linewidths=0.8,
        )  # fmt: skip
    front = sorted((row.time_s, row.error) for row in rows if row.on_front)
    axes.step(*zip(*front, strict=True), where="post", color="k", lw=1.2, label="Pareto front")
    _star(axes, [(row.time_s, row.error) for row in rows if row.shipped])
    for row in rows:
        if row.shipped:
            count = f"{row.realisations} realisation{'s' if row.realisations > 1 else ''}"
            axes.annotate(count, (row.time_s, row.error), (6, 8), textcoords="offset points", fontsize=7)
    axes.set(
        xlabel="processor time, scene to amplitude (s)",
        ylabel="rms error / true amplitude",
        title="Final amplitude; larger marks: longer gates",
    )
    axes.legend(fontsize=7, ncols=2)


def _numerical(axes: Axes, rows: Sequence[EndToEnd]) -> None:
    """Draw what tolerance and nodes alone do, over the run time of the most realisations."""
    most = max(row.realisations for row in rows)
    shipped = [row for row in rows if row.shipped and row.realisations == most]
    for name, colour, marker in (("tolerance", COLOURS[0], "o"), ("nodes", COLOURS[1], "s")):
        own = [row for row in rows if row.varied == name and row.realisations == most]
        times_s, errors = [row.time_s for row in own], [row.numerical_error for row in own]
        axes.plot(times_s, errors, marker, ms=6, color=colour, label=f"{name} varied")
        for row in own:
            text = f"{row.tolerance:.0e}" if name == "tolerance" else f"{row.nodes}"
            axes.annotate(text, (row.time_s, row.numerical_error), (6, -3), textcoords="offset points", fontsize=7)
    _star(axes, [(row.time_s, row.numerical_error) for row in shipped])
    for row in shipped:
        axes.axhline(row.standard_error, color="0.5", lw=0.8, ls="--", label=f"standard error of {most}")
    axes.margins(x=0.12)
    axes.set(
        xlabel=f"processor time of {most} realisations (s)",
        ylabel="rms numerical error / amplitude",
        title="Of which tolerance and nodes",
    )
    axes.legend(fontsize=7)


def _star(axes: Axes, points: Sequence[tuple[float, float]]) -> None:
    if points:
        times_s, errors = zip(*points, strict=True)
        axes.plot(times_s, errors, "*", label="shipped default", ms=15, mfc="none", mec="k", mew=1.3, zorder=5)
