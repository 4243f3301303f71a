"""Figures of a result for papers and notebooks: one curve for each setting, means over repeats where there are any.

    spectrum      amplitude and phase over frequency, one curve for each setting
    drive         amplitude and phase over the relative force, one curve for each frequency
    distance      amplitude and phase over the lateral offset, one curve for each frequency
    profile       amplitude and phase over depth, one curve for each frequency and shot
    displacement  displacement and fitted harmonics of one shot over time

Sizes, fonts and lines follow ``matplotlib.rcParams``. Curves differ in colour,
and without it in marker and line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hpe_rig.arrays import FloatArray
from hpe_rig.result.figure_kind import FigureKind
from hpe_rig.result.panels import figure_panels
from hpe_rig.result.repeats import RepeatMean, setting_of
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.setting_text import setting_table
from hpe_rig.result.spectra import main_shot
from hpe_rig.result.svg import MARKS, Colour, Picture, legend, mark, panel, picture, thin
from hpe_rig.result.values import Estimate, ShotResult

KINDS: tuple[FigureKind, ...] = get_args(FigureKind)
LINES = ((":", "full"), ("--", "none"), ("-.", "left"), ("-", "top"))
"""Line style and filled part of the marker, for each round of the markers."""
MAX_PHASE_UNCERTAINTY_RAD = math.pi / 2
"""Larger uncertainties leave a phase undetermined: two of them are half a turn, and the phase is not drawn."""
CHARACTER_IN, KEY_IN, LINE_IN = 0.075, 0.45, 0.17
"""Width of a character of the legend, of a marker with its margins, and height of a line, inches at 8 points."""

Points = dict[float, Estimate | RepeatMean]
"""Results by frequency (Hz), or by another quantity."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve: values of the horizontal axis (point,), in the unit of its label, and the results there."""

    label: str
    x: tuple[float, ...]
    values: tuple[Estimate | RepeatMean, ...]


def result_figure(
    result: ResultData,
    kind: FigureKind = "spectrum",
    *,
    frequencies_hz: Sequence[float] | None = None,
    ax: Axes | Sequence[Axes] | None = None,
    figsize: tuple[float, float] | None = None,
) -> Figure:
    """Return the figure ``kind`` of ``result``; the module lists what each kind draws.

    ``frequencies_hz``: frequencies to draw, None for all. ``ax``: axes to draw on, one for "displacement", else two
    for amplitude and phase; None makes a new figure of ``figsize``, in inches. Without ``figsize`` it is as wide as
    ``rcParams`` state, and higher by its legend. Bars are two standard uncertainties. Raises ``ValueError`` if the kind
    is unknown or the result lacks its data.
    """
    if kind not in KINDS:
        raise ValueError(f"no kind of figure is called {kind!r}; try one of {', '.join(KINDS)}")
    figure, axes = figure_panels(1 if kind == "displacement" else 2, 1, ax, figsize, sharex=True)
    if result.origin != "measured":
        # Simulated and measured data must not be confused; papers have their titles in the caption.
        axes[0].set_title(result.origin.split()[0], loc="right", fontsize="small")
    if kind == "displacement":
        _draw_displacement(result, axes[0])
        return figure
    x_label, all_curves = _CURVES[kind](result, lambda hz: frequencies_hz is None or hz in frequencies_hz)
    curves = [curve for curve in all_curves if len(curve.x) > (0 if kind == "spectrum" else 1)]
    if not curves:
        raise ValueError(
            f"the figure {kind!r} needs results at two values of: {x_label}; this result has fewer"
            if all_curves or frequencies_hz is None
            else f"the result has none of the frequencies {', '.join(f'{hz:g}' for hz in frequencies_hz)} Hz"
        )
    _draw_curves(curves, x_label, *axes)
    if len(curves) > 1:
        _add_legend(figure, axes[0], outside=ax is None, grow=ax is None and figsize is None)
    return figure


def setting_pictures(result: ResultData) -> tuple[Picture, ...]:
    """Return amplitude and phase over frequency, one curve for each of 2 to 8 settings; empty for other numbers."""
    x_label, curves = _spectra(result, lambda _hz: True)
    if not 1 < len(curves) <= len(MARKS):
        return ()
    panels = {"amplitude": panel(), "phase": panel()}
    _draw_curves(curves, x_label, *(axes for _, axes in panels.values()))
    pictures = []
    for quantity, (figure, axes) in panels.items():
        axes.set_xlabel(x_label)
        legend(axes, "best", handles=panels["amplitude"][1].get_legend_handles_labels())
        alt = (
            f"{quantity.title()} over frequency, a curve for each setting: {'; '.join(item.label for item in curves)}."
        )
        pictures.append(picture(figure, f"{quantity}-settings", f"{quantity.title()} spectrum of each setting", alt))
    return tuple(pictures)


def _draw_curves(curves: Sequence[Curve], x_label: str, amplitude: Axes, phase: Axes) -> None:
    """Draw amplitude and phase of ``curves`` with bars of 2 u, without phases that are undetermined."""
    for number, curve in enumerate(curves):
        marker, colour = mark(number)
        line, filled = LINES[number // len(MARKS) % len(LINES)]
        style: Any = {"marker": marker, "fillstyle": filled, "color": colour, "linestyle": line}
        style |= {"markersize": 4, "capsize": 1.5}
        amplitude_nm = [item.amplitude_m * 1e9 for item in curve.values]
        bars_nm = [2e9 * item.amplitude_uncertainty_m for item in curve.values]
        amplitude.errorbar(curve.x, amplitude_nm, yerr=bars_nm, label=curve.label, **style)
        u_rad = np.array([item.phase_uncertainty_rad for item in curve.values])
        resolved = u_rad < MAX_PHASE_UNCERTAINTY_RAD
        if resolved.any():
            phase_rad = np.array([item.phase_rad for item in curve.values])[resolved]
            phase_deg = np.degrees(_continuous(phase_rad, int(u_rad[resolved].argmin())))
            phase.errorbar(np.array(curve.x)[resolved], phase_deg, yerr=2 * np.degrees(u_rad[resolved]), **style)
    amplitude.set_ylabel("amplitude (nm)")
    amplitude.set_ylim(bottom=0)
    phase.set(xlabel=x_label, ylabel="phase (deg)")


def _continuous(phase_rad: FloatArray, start: int) -> FloatArray:
    """Return phases (point,) without jumps of a turn, unwrapped to both sides of the point ``start``.

    The first phase is within half a turn of zero.
    """
    before = np.unwrap(phase_rad[start::-1])[::-1]
    unwrapped = np.concatenate([before[:-1], np.unwrap(phase_rad[start:])])
    return np.asarray(unwrapped - 2 * math.pi * np.round(unwrapped[0] / (2 * math.pi)))


def _add_legend(figure: Figure, axes: Axes, *, outside: bool, grow: bool) -> None:
    """Add the legend of ``axes``: below the panels if ``outside``, and then ``grow`` the figure by its height."""
    handles, labels = axes.get_legend_handles_labels()
    if not outside:
        axes.legend(fontsize="small", frameon=False)
        return
    width_in, height_in = figure.get_size_inches()
    columns = max(1, int(width_in / (CHARACTER_IN * max(map(len, labels)) + KEY_IN)))
    if grow:
        figure.set_figheight(height_in + LINE_IN * math.ceil(len(labels) / columns))
    figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, fontsize="small", frameon=False, columnspacing=1.0
    )


def _draw_displacement(result: ResultData, axes: Axes) -> None:
    """Draw displacement, mean removed, and fitted harmonics of the shot with the largest motion."""
    motion = main_shot(result).motion if result.shots else None
    if motion is None:
        raise ValueError("the result holds no displacement over time; try: estimate the run file again")
    mean_m = np.nanmean(motion.displacement_m)
    for values_m, style, colour in (
        (motion.displacement_m, ".", Colour.GREY),
        (motion.model_m, "-", Colour.ORANGE),
    ):
        valid = np.isfinite(values_m)
        x, y = thin(motion.time_s[valid] * 1e3, (values_m[valid] - mean_m) * 1e9)
        axes.plot(x, y, style, color=colour, markersize=2, linewidth=0.8)
    axes.set(xlabel="time (ms)", ylabel="displacement (nm)")


FrequencyFilter = Callable[[float], bool]
"""Whether a frequency, Hz, is drawn."""


def _spectra(result: ResultData, is_drawn: FrequencyFilter) -> tuple[str, list[Curve]]:
    """Return one curve over frequency for each setting."""
    items = _curve_items(result, is_drawn)
    labels = _labels([item for item, _ in items])
    curves = [_curve(label, points) for label, (_, points) in zip(labels, items, strict=True)]
    return "frequency (Hz)", curves


def _over_setting(
    name: str, x_label: str, factor: float
) -> Callable[[ResultData, FrequencyFilter], tuple[str, list[Curve]]]:
    """Return the function that yields curves over the setting ``name``, one for each frequency and other settings."""

    def curves(result: ResultData, is_drawn: FrequencyFilter) -> tuple[str, list[Curve]]:
        points: dict[str, Points] = {}
        items = _curve_items(result, is_drawn)
        labels = _labels([item for item, _ in items], without=name)
        for (item, values), label in zip(items, labels, strict=True):
            for hz, value in values.items():
                if (x := getattr(item, name)) is not None:
                    points.setdefault(_with_frequency(hz, label), {})[x * factor] = value
        return x_label, [_curve(label, values) for label, values in points.items()]

    return curves


def _profiles(result: ResultData, is_drawn: FrequencyFilter) -> tuple[str, list[Curve]]:
    """Return curves over depth, one for each frequency and shot."""
    points: dict[str, Points] = {}
    shots = {(*setting_of(gate.shot), gate.shot.index): gate.shot for gate in result.profile}
    labels = dict(zip(shots, _labels(list(shots.values())), strict=True))
    for gate in result.profile:
        label = labels[(*setting_of(gate.shot), gate.shot.index)]
        for item in gate.shot.estimates:
            if is_drawn(item.frequency_hz):
                of_curve = points.setdefault(_with_frequency(item.frequency_hz, label), {})
                of_curve[gate.depth_m * 1e3] = item
    return "depth (mm)", [_curve(label, values) for label, values in points.items()]


_CURVES: Mapping[FigureKind, Callable[[ResultData, FrequencyFilter], tuple[str, list[Curve]]]] = {
    "spectrum": _spectra,
    "drive": _over_setting("force_fraction", "force relative to the full force", 1.0),
    "distance": _over_setting("lateral_offset_m", "lateral offset (mm)", 1e3),
    "profile": _profiles,
}


def _curve(label: str, points: Points) -> Curve:
    x = tuple(sorted(points))
    return Curve(label, x, tuple(points[value] for value in x))


def _with_frequency(frequency_hz: float, label: str) -> str:
    return f"{frequency_hz:g} Hz, {label}" if label else f"{frequency_hz:g} Hz"


def _curve_items(result: ResultData, is_drawn: FrequencyFilter) -> list[tuple[ShotResult | RepeatMean, Points]]:
    """Return each setting's mean over repeats, else its shots, with their values by frequency."""
    means: dict[tuple[float | None, ...], list[RepeatMean]] = {}
    for mean in result.means:
        means.setdefault(setting_of(mean), []).append(mean)
    items: list[tuple[ShotResult | RepeatMean, Points]] = []
    for shot in result.shots:
        of_setting = means.get(setting_of(shot))
        if of_setting is None:
            items.append((shot, {item.frequency_hz: item for item in shot.estimates}))
        elif shot.shot == of_setting[0].shots[0]:
            items.append((of_setting[0], {mean.frequency_hz: mean for mean in of_setting}))
    filtered = [(item, {hz: value for hz, value in points.items() if is_drawn(hz)}) for item, points in items]
    return [(item, points) for item, points in filtered if points]


def _labels(items: Sequence[ShotResult | RepeatMean], without: str = "") -> list[str]:
    """Return the settings that differ between ``items``, except ``without``; shot numbers where none differs."""
    tables = setting_table(items)
    varied = [name for name in (tables[0] if tables else ()) if name != without and len({t[name] for t in tables}) > 1]
    labels = [", ".join(table[name] for name in varied if table[name]) for table in tables]
    if without or len(set(labels)) == len(labels):
        return labels
    numbers = [f"shot {item.shot}" if isinstance(item, ShotResult) else "mean" for item in items]
    return [", ".join(filter(None, pair)) for pair in zip(labels, numbers, strict=True)]
