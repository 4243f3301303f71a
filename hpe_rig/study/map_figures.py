"""Maps over two axes with contours, as Fig. 12 and 13: every point is computed, none interpolated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from hpe_rig.arrays import FloatArray
from hpe_rig.result import STYLE, label_decades
from hpe_rig.scene import Axis
from hpe_rig.study.curve_figures import DEGREES, NM
from hpe_rig.study.results import StudyResult
from hpe_rig.study.series import MapTable, View, axis_label, coordinates_text, maps

Levels = Sequence[float] | FloatArray | None

PAPER_WIDTH_RATIO = 2.19
"""W_x and W_y of the paper's transducer, marked in the maps."""
LATERAL = ("W_x", "W_y")
OUTLINE = "#101010"
"""Outline of white lines and numbers. On a dark screen the page would turn black into its white ink colour."""
HEIGHT_IN, BOTTOM_IN, TOP_IN = 3.1, 0.47, 0.28


def lateral_average(w_x: FloatArray, w_y: FloatArray) -> FloatArray:
    """Return tracked over peak displacement of beams without axial extent, prod W sqrt(2) / sqrt(2 W² + 1).

    Each W has any shape. Speckle weights the motion by the square of the tracking beam's amplitude.
    """
    return np.asarray(np.sqrt(2 * w_x**2 / (2 * w_x**2 + 1) * 2 * w_y**2 / (2 * w_y**2 + 1)))


def map_figure(result: StudyResult, view: View) -> Figure:
    """Return the maps of a view: for one map the four panels of Fig. 12, else one panel each as in Fig. 13."""
    tables = list(maps(result, view))
    *outer_axes, x_axis, y_axis = result.definition.sweep_axes
    with rc_context(STYLE):
        if len(tables) == 1:
            figure = _four_quantities(tables[0])
        else:
            figure = _by_outer_values(tables, outer_axes, (x_axis.name, y_axis.name) == LATERAL)
        for axes in figure.axes:
            if axes.get_label() == "map":
                axes.set(xlabel=axis_label(x_axis), ylabel=axis_label(y_axis))
                axes.grid(False)
        return figure


def map_alt(result: StudyResult, view: View) -> str:
    """Return the alternative text of the maps: ranges of the quantities."""
    descriptions = []
    for table in maps(result, view):
        ratio = _normalised(table)
        jitter = table.columns["amplitude_jitter_m"] * NM
        phase_jitter = table.columns["phase_jitter_rad"]
        descriptions.append(
            f"{coordinates_text(result.definition.sweep_axes[:-2], table.outer_values)}: normalised displacement "
            f"{ratio.min():.2f} to {ratio.max():.2f}, jitter {jitter.min():.0f} to {jitter.max():.0f} nm, phase jitter "
            f"{phase_jitter.min() * DEGREES:.2g} to {phase_jitter.max() * DEGREES:.2g} degrees"
        )
    return f"{view.title}. {'; '.join(descriptions)}."


def _normalised(table: MapTable) -> FloatArray:
    """Return tracked over true amplitude (y, x)."""
    return np.asarray(1 + table.columns["amplitude_bias_m"] / table.columns["amplitude_true_m"])


def _figure(rows: int) -> Figure:
    height_in = HEIGHT_IN * rows
    figure = Figure(figsize=(7.2, height_in))
    figure.subplots_adjust(
        left=0.085, right=0.985, bottom=BOTTOM_IN / height_in, top=1 - TOP_IN / height_in, wspace=0.2, hspace=0.26
    )
    return figure


def _four_quantities(table: MapTable) -> Figure:
    figure = _figure(2)
    columns = table.columns
    panels: tuple[tuple[str, FloatArray, Levels], ...] = (
        ("(a) normalised displacement", _normalised(table), np.arange(1, 10) / 10),
        ("(b) displacement jitter (nm)", columns["amplitude_jitter_m"] * NM, None),
        ("(c) |phase bias| (degrees)", np.abs(columns["phase_bias_rad"]) * DEGREES, np.arange(5, 181, 5.0)),
        ("(d) phase jitter (degrees)", columns["phase_jitter_rad"] * DEGREES, np.arange(5, 181, 10.0)),
    )
    for axes, (title, values, levels) in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
        _map(axes, table, values, levels, title)
    return figure


def _by_outer_values(tables: list[MapTable], outer_axes: Sequence[Axis], lateral: bool) -> Figure:
    rows = -(-len(tables) // 2)
    figure = _figure(rows)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for unused in panels[len(tables) :]:
        unused.set_axis_off()
    values = [_normalised(table) for table in tables]
    if lateral:
        values = [
            lateral_average(table.x[None, :], table.y[:, None]) - ratio
            for table, ratio in zip(tables, values, strict=True)
        ]
    quantity = "lateral theory minus tracked" if lateral else "normalised displacement"
    # One colour scale for all panels.
    low, high = min(float(value.min()) for value in values), max(float(value.max()) for value in values)
    for letter, axes, table, value in zip("abcdefghijkl" * len(tables), panels, tables, values, strict=False):
        step = 0.1 if np.ptp(value) > 0.4 else 0.05
        levels = np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 2)
        # The contour of zero would follow chance where the difference vanishes.
        levels = levels[np.abs(levels) > step / 2]
        title = f"({letter}) {quantity}, {coordinates_text(outer_axes, table.outer_values)}"
        _map(axes, table, value, levels, title, (low, high))
    return figure


def _map(
    axes: Axes,
    table: MapTable,
    values: FloatArray,
    levels: Levels,
    title: str,
    limits: tuple[float | None, float | None] = (None, None),
) -> None:
    """Draw ``values`` (y, x) with the contours of ``levels``; None: levels by Matplotlib."""
    x, y = table.x, table.y
    axes.set_label("map")
    # Rasterised: browsers are slow with ten thousand vector shapes.
    mesh = axes.pcolormesh(
        x, y, values, cmap="cividis", shading="nearest", rasterized=True, vmin=limits[0], vmax=limits[1]
    )
    if levels is not None:
        levels = [level for level in levels if values.min() < level < values.max()]
    if levels is None or levels:
        lines = axes.contour(x, y, values, levels, colors="w", linewidths=0.8)
        # White with a dark outline is visible at both ends of the colour scale.
        lines.set(path_effects=[withStroke(linewidth=1.8, foreground=OUTLINE)])
        for text in axes.clabel(lines, fontsize=7, fmt="%g"):
            text.set_path_effects([withStroke(linewidth=1.5, foreground=OUTLINE)])
    for name, coordinates in (("x", x), ("y", y)):
        if coordinates.min() > 0 and coordinates.max() / coordinates.min() >= 20:
            axes.set(**{f"{name}scale": "log"})
            label_decades(axes.xaxis if name == "x" else axes.yaxis)
    if x.min() <= PAPER_WIDTH_RATIO <= x.max() and y.min() <= PAPER_WIDTH_RATIO <= y.max():
        axes.plot(PAPER_WIDTH_RATIO, PAPER_WIDTH_RATIO, "+", color="#FF9E6D", ms=11, mew=2)
    axes.set_title(title, fontsize=9)
    bar = axes.get_figure().colorbar(mesh, ax=axes)  # type: ignore[union-attr]
    bar.ax.tick_params(labelsize=7)
