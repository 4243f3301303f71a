"""Maps over two axes with contours, as Fig. 12 and 13: every point computed, none interpolated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from hpe_rig.arrays import FloatArray
from hpe_rig.result import STYLE, label_decades
from hpe_rig.study.curve_figures import DEGREES, NM
from hpe_rig.study.definition import Axis
from hpe_rig.study.results import StudyResult
from hpe_rig.study.series import View, axis_label, maps, shown

Levels = Sequence[float] | FloatArray | None

OURS = 2.19
"""W_x and W_y of the paper's transducer, marked."""
LATERAL = ("W_x", "W_y")
DARK = "#101010"
"""Outline of white lines and numbers: black would turn white with the page's ink on a dark screen."""
HEIGHT_IN, BELOW_IN, ABOVE_IN = 3.1, 0.47, 0.28


def lateral_average(w_x: FloatArray, w_y: FloatArray) -> FloatArray:
    """Return tracked over peak displacement of beams without axial extent; each W any shape.

    Speckle weights by the square of the tracking beam's amplitude: prod W sqrt(2) / sqrt(2 W^2 + 1).
    """
    return np.asarray(np.sqrt(2 * w_x**2 / (2 * w_x**2 + 1) * 2 * w_y**2 / (2 * w_y**2 + 1)))


def map_figure(result: StudyResult, one: View) -> Figure:
    """Return four panels as Fig. 12 for one map; for several a panel each: differences as Fig. 13 over W_x, W_y."""
    found = list(maps(result, one))
    *outer, across, up = result.definition.axes
    with rc_context(STYLE):
        if len(found) == 1:
            figure = _four_quantities(*found[0][1:])
        else:
            figure = _by_outer_value(found, outer, (across.name, up.name) == LATERAL)
        for axes in figure.axes:
            if axes.get_label() == "map":
                axes.set(xlabel=axis_label(across), ylabel=axis_label(up))
                axes.grid(False)
        return figure


def map_alt(result: StudyResult, one: View) -> str:
    """Return the maps in words: ranges of what they show."""
    parts = []
    for values, _x, _y, table in maps(result, one):
        ratio = _normalised(table)
        jitter = table["amplitude_jitter_m"] * NM
        outer = result.definition.axes[:-2]
        head = ", ".join(f"{axis.name} = {shown(v, axis.unit)}" for axis, v in zip(outer, values, strict=True))
        parts.append(
            f"{head}: normalised displacement {ratio.min():.2f} to {ratio.max():.2f}, jitter {jitter.min():.0f} to "
            f"{jitter.max():.0f} nm, phase jitter {table['phase_jitter_rad'].min() * DEGREES:.2g} to "
            f"{table['phase_jitter_rad'].max() * DEGREES:.2g} degrees"
        )
    return f"{one.title}. {'; '.join(parts)}."


def _normalised(table: dict[str, FloatArray]) -> FloatArray:
    return np.asarray(1 + table["amplitude_bias_m"] / table["amplitude_true_m"])


def _figure(rows: int) -> Figure:
    height_in = HEIGHT_IN * rows
    figure = Figure(figsize=(7.2, height_in))
    figure.subplots_adjust(
        left=0.085, right=0.985, bottom=BELOW_IN / height_in, top=1 - ABOVE_IN / height_in, wspace=0.2, hspace=0.26
    )
    return figure


def _four_quantities(x: FloatArray, y: FloatArray, table: dict[str, FloatArray]) -> Figure:
    figure = _figure(2)
    phase = np.arange(5, 181, 5.0)
    panels: tuple[tuple[str, FloatArray, Levels], ...] = (
        ("(a) normalised displacement", _normalised(table), np.arange(1, 10) / 10),
        ("(b) displacement jitter (nm)", table["amplitude_jitter_m"] * NM, None),
        ("(c) |phase bias| (degrees)", np.abs(table["phase_bias_rad"]) * DEGREES, phase),
        ("(d) phase jitter (degrees)", table["phase_jitter_rad"] * DEGREES, np.arange(5, 181, 10.0)),
    )
    for axes, (title, values, levels) in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
        _map(axes, x, y, values, levels, title)
    return figure


def _by_outer_value(
    found: list[tuple[tuple[Any, ...], FloatArray, FloatArray, dict[str, FloatArray]]],
    outer: Sequence[Axis],
    lateral: bool,
) -> Figure:
    rows = -(-len(found) // 2)
    figure = _figure(rows)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for spare in panels[len(found) :]:
        spare.set_axis_off()
    values, title = [], ""
    for _, x, y, table in found:
        ratio = _normalised(table)
        values.append(lateral_average(x[None, :], y[:, None]) - ratio if lateral else ratio)
        title = "lateral theory minus tracked" if lateral else "normalised displacement"
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    for place, (axes, (at, x, y, _), value) in enumerate(zip(panels, found, values, strict=False)):
        head = ", ".join(f"{axis.name} = {shown(v, axis.unit)}" for axis, v in zip(outer, at, strict=True))
        step = 0.1 if np.ptp(value) > 0.4 else 0.05
        levels = np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 2)
        # Where nothing differs a line of zero would follow chance alone.
        levels = levels[np.abs(levels) > step / 2]
        _map(axes, x, y, value, levels, f"({'abcdefghijkl'[place % 12]}) {title}, {head}", (low, high))
    return figure


def _map(
    axes: Axes,
    x: FloatArray,
    y: FloatArray,
    values: FloatArray,
    levels: Levels,
    title: str,
    limits: tuple[float | None, float | None] = (None, None),
) -> None:
    axes.set_label("map")
    # As a picture inside the drawing: ten thousand small shapes would be slow to show.
    mesh = axes.pcolormesh(
        x, y, values, cmap="cividis", shading="nearest", rasterized=True, vmin=limits[0], vmax=limits[1]
    )
    wanted = None if levels is None else [level for level in levels if values.min() < level < values.max()]
    if wanted is None or wanted:
        lines = axes.contour(x, y, values, wanted, colors="w", linewidths=0.8)
        # Light on a dark line shows on both ends of the colour scale.
        lines.set(path_effects=[withStroke(linewidth=1.8, foreground=DARK)])
        for text in axes.clabel(lines, fontsize=7, fmt="%g"):
            text.set_path_effects([withStroke(linewidth=1.5, foreground=DARK)])
    for name, values_of in (("x", x), ("y", y)):
        if values_of.min() > 0 and values_of.max() / values_of.min() >= 20:
            axes.set(**{f"{name}scale": "log"})
            label_decades(axes.xaxis if name == "x" else axes.yaxis)
    if x.min() <= OURS <= x.max() and y.min() <= OURS <= y.max():
        axes.plot(OURS, OURS, "+", color="#FF9E6D", ms=11, mew=2)
    axes.set_title(title, fontsize=9)
    bar = axes.get_figure().colorbar(mesh, ax=axes)  # type: ignore[union-attr]
    bar.ax.tick_params(labelsize=7)
