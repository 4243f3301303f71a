"""Panels of a figure for papers: new ones, or the axes of the caller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


def figure_panels(
    rows: int,
    columns: int,
    ax: Axes | Sequence[Axes] | None,
    figsize: tuple[float, float] | None,
    **layout: Any,
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row: those in ``ax``, else new ones in ``rows`` and ``columns``.

    ``figsize``: width and height of a new figure, inches; ``layout``: further arguments of ``Figure.subplots``. Raises
    ``ValueError`` if ``ax`` holds another number of axes.
    """
    if ax is None:
        figure = Figure(figsize=figsize, layout="constrained")
        return figure, list(figure.subplots(rows, columns, squeeze=False, **layout).ravel())
    axes = [ax] if isinstance(ax, Axes) else list(np.ravel(np.asarray(ax, dtype=object)))
    if len(axes) != rows * columns or not all(isinstance(item, Axes) for item in axes):
        raise ValueError(f"ax must hold the {rows * columns} matplotlib axes of this figure; try ax=None for new ones")
    root = axes[0].get_figure(root=True)
    if not isinstance(root, Figure):
        raise ValueError("ax belongs to no figure; try axes from matplotlib.pyplot.subplots")
    return root, axes
