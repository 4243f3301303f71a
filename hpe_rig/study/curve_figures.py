"""Figures of bias and jitter over one axis, arranged as in the paper, with bands of two standard errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.result import MARKS, STYLE, label_decades, mark
from hpe_rig.study.results import StudyResult
from hpe_rig.study.series import Curve, View, are_numbers, axis_label, curves

NM, DEGREES = 1e9, 180 / np.pi
PANELS = (
    ("(a) displacement bias (nm)", "amplitude_bias", "m", NM),
    ("(b) displacement jitter (nm)", "amplitude_jitter", "m", NM),
    ("(c) phase bias (degrees)", "phase_bias", "rad", DEGREES),
    ("(d) phase jitter (degrees)", "phase_jitter", "rad", DEGREES),
)
BAND = 2.0
"""Half width of a band in standard errors."""


def curve_figure(result: StudyResult, view: View) -> Figure:
    """Return the curves of a view: mean and deviation for a single curve, else four panels."""
    view_curves = curves(result, view)
    last_axis = result.definition.sweep_axes[-1]
    with rc_context(STYLE):
        if len(view_curves) == 1:
            figure = _mean_and_deviation(view_curves[0], axis_label(last_axis))
        else:
            figure = _four_panels(view_curves, axis_label(last_axis))
    values = last_axis.labels
    if not are_numbers(values):
        for axes in figure.axes:
            axes.set_xticks(range(len(values)), [str(value) for value in values])
    return figure


def curve_alt(result: StudyResult, view: View) -> str:
    """Return the figure's alternative text: bias and jitter of every curve at both ends."""
    descriptions = []
    for curve in curves(result, view):
        ends = [
            f"bias {curve.values('amplitude_bias_m')[k] * NM:.0f} nm, "
            f"jitter {curve.values('amplitude_jitter_m')[k] * NM:.3g} nm, "
            f"phase jitter {curve.values('phase_jitter_rad')[k] * DEGREES:.2g} degrees at {curve.x[k]:g}"
            for k in (0, -1)
        ]
        descriptions.append(f"{curve.label or 'default'}: {'; '.join(ends)}")
    return f"{view.title}. {'. '.join(descriptions)}."


def _four_panels(view_curves: Sequence[Curve], x_label: str) -> Figure:
    legend_lines = -(-len(view_curves) // 3)
    figure = Figure(figsize=(7.2, 5.2 + 0.2 * legend_lines))
    # Fixed margins: Matplotlib's layout engine takes longer than all the drawing.
    panels = figure.subplots(2, 2, sharex=True)
    top = 0.965 - 0.034 * legend_lines
    figure.subplots_adjust(left=0.11, right=0.98, bottom=0.09, top=top, wspace=0.32, hspace=0.1)
    for axes, (title, quantity, unit, scale) in zip(panels.ravel(), PANELS, strict=True):
        _panel(axes, view_curves, quantity, unit, scale)
        axes.set(ylabel=title)
    for axes in panels[1]:
        axes.set(xlabel=x_label)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
    return figure


def _panel(axes: Axes, view_curves: Sequence[Curve], quantity: str, unit: str, scale: float) -> None:
    for index, curve in enumerate(view_curves):
        value = curve.values(f"{quantity}_{unit}") * scale
        band = curve.values(f"{quantity}_se_{unit}") * (scale * BAND)
        marker, colour = mark(index)
        axes.plot(curve.x, value, marker + "-", ms=4, color=colour, label=curve.label)
        # The axis of a jitter is logarithmic: its band must stay positive.
        low = np.maximum(value - band, 1e-3 * value) if quantity.endswith("jitter") else value - band
        axes.fill_between(curve.x, low, value + band, color=colour, alpha=0.2, lw=0)
    if quantity.endswith("jitter"):
        axes.set_yscale("log")
        label_decades(axes.yaxis)
    else:
        axes.axhline(0, color="k", lw=0.8, ls="--")


def _mean_and_deviation(curve: Curve, x_label: str) -> Figure:
    """Return mean, standard deviation as bars and the band of the mean, over the target: as Fig. 4."""
    figure = Figure(figsize=(7.2, 3.4))
    figure.subplots_adjust(left=0.1, right=0.98, bottom=0.14, top=0.9, wspace=0.28)
    for axes, title, quantity, unit, scale in zip(
        figure.subplots(1, 2), ("(a) displacement (nm)", "(b) phase (degrees)"), ("amplitude", "phase"),
        ("m", "rad"), (NM, DEGREES), strict=True,
    ):  # fmt: skip
        target = curve.values(f"{quantity}_true_{unit}") * scale
        mean = target + curve.values(f"{quantity}_bias_{unit}") * scale
        jitter = curve.values(f"{quantity}_jitter_{unit}") * scale
        band = curve.values(f"{quantity}_bias_se_{unit}") * (scale * BAND)
        axes.plot(curve.x, target, "k--", lw=1, label="target")
        axes.errorbar(curve.x, mean, jitter, fmt="o-", ms=4, capsize=3, color=MARKS[0][1], label="mean, sd")
        axes.fill_between(curve.x, mean - band, mean + band, color=MARKS[1][1], alpha=0.4, lw=0, label="mean's 2 s.e.")
        axes.set(xlabel=x_label, ylabel=title)
    figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=3, frameon=False)
    return figure
