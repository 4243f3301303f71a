"""Panels of bias and jitter in the paper's arrangement: a curve a value, bands of two standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.result import MARKS, STYLE, label_decades, mark
from hpe_rig.study.results import StudyResult
from hpe_rig.study.series import Curve, View, axis_label, curves, numbers

NM, DEGREES = 1e9, 180 / np.pi
PANELS = (
    ("(a) displacement bias (nm)", "amplitude_bias", "m", NM),
    ("(b) displacement jitter (nm)", "amplitude_jitter", "m", NM),
    ("(c) phase bias (degrees)", "phase_bias", "rad", DEGREES),
    ("(d) phase jitter (degrees)", "phase_jitter", "rad", DEGREES),
)
BAND = 2.0
"""Standard errors to each side."""


def curve_figure(result: StudyResult, one: View) -> Figure:
    """Return the figure of a study with curves: mean and deviation of a single one, else four panels."""
    found = curves(result, one)
    along = result.definition.axes[-1]
    label = axis_label(along)
    with rc_context(STYLE):
        if len(found) == 1:
            return _named(_mean_and_deviation(found[0], label), along.values())
        lines = -(-len(found) // 3)
        figure = Figure(figsize=(7.2, 5.2 + 0.2 * lines))
        # Fixed margins: fitting them to every text takes longer than all the drawing.
        panels = figure.subplots(2, 2, sharex=True)
        figure.subplots_adjust(left=0.11, right=0.98, bottom=0.09, top=0.965 - 0.034 * lines, wspace=0.32, hspace=0.1)
        for axes, (title, quantity, unit, scale) in zip(panels.ravel(), PANELS, strict=True):
            _panel(axes, found, quantity, unit, scale)
            axes.set(ylabel=title)
        for axes in panels[1]:
            axes.set(xlabel=label)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
        return _named(figure, along.values())


def _named(figure: Figure, values: Sequence[Any]) -> Figure:
    """Return the figure with words at its axis where the values along it are words."""
    if not numbers(values):
        for axes in figure.axes:
            axes.set_xticks(range(len(values)), [str(value) for value in values])
    return figure


def curve_alt(result: StudyResult, one: View) -> str:
    """Return the figure in words: bias and jitter of every curve at both ends."""
    parts = []
    for curve in curves(result, one):
        ends = [
            f"bias {curve.values('amplitude_bias_m')[k] * NM:.0f} nm, "
            f"jitter {curve.values('amplitude_jitter_m')[k] * NM:.3g} nm, "
            f"phase jitter {curve.values('phase_jitter_rad')[k] * DEGREES:.2g} degrees at {curve.x[k]:g}"
            for k in (0, -1)
        ]
        parts.append(f"{curve.label or 'default'}: {'; '.join(ends)}")
    return f"{one.title}. {'. '.join(parts)}."


def _panel(axes: Axes, found: Sequence[Curve], quantity: str, unit: str, scale: float) -> None:
    for place, curve in enumerate(found):
        value = curve.values(f"{quantity}_{unit}") * scale
        spread = curve.values(f"{quantity}_se_{unit}") * (scale * BAND)
        marker, colour = mark(place)
        axes.plot(curve.x, value, marker + "-", ms=4, color=colour, label=curve.label)
        low = np.maximum(value - spread, 1e-3 * value) if quantity.endswith("jitter") else value - spread
        axes.fill_between(curve.x, low, value + spread, color=colour, alpha=0.2, lw=0)
    if quantity.endswith("jitter"):
        axes.set_yscale("log")
        label_decades(axes.yaxis)
    else:
        axes.axhline(0, color="k", lw=0.8, ls="--")


def _mean_and_deviation(curve: Curve, label: str) -> Figure:
    """Return mean, deviation of the realisations as bars, and the mean's own band, over a target line: as Fig. 4."""
    figure = Figure(figsize=(7.2, 3.4))
    figure.subplots_adjust(left=0.1, right=0.98, bottom=0.14, top=0.9, wspace=0.28)
    for axes, title, quantity, unit, scale in zip(
        figure.subplots(1, 2), ("(a) displacement (nm)", "(b) phase (degrees)"), ("amplitude", "phase"),
        ("m", "rad"), (NM, DEGREES), strict=True,
    ):  # fmt: skip
        target = curve.values(f"{quantity}_true_{unit}") * scale
        mean = target + curve.values(f"{quantity}_bias_{unit}") * scale
        jitter = curve.values(f"{quantity}_jitter_{unit}") * scale
        spread = curve.values(f"{quantity}_bias_se_{unit}") * (scale * BAND)
        axes.plot(curve.x, target, "k--", lw=1, label="target")
        axes.errorbar(curve.x, mean, jitter, fmt="o-", ms=4, capsize=3, color=MARKS[0][1], label="mean, sd")
        axes.fill_between(
            curve.x, mean - spread, mean + spread, color=MARKS[1][1], alpha=0.4, lw=0, label="mean's 2 s.e."
        )
        axes.set(xlabel=label, ylabel=title)
    figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
    return figure
