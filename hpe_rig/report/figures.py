"""Pictures of the report, of one shot and of many: one panel each, so that a page sets them in any number of columns.

Every picture has a title and an alternative text that says in words and numbers what is to be seen. Colours are from
the Okabe-Ito set, safe for colour-blind readers, and never the only thing that tells two curves apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.report.residual_tests import periodogram
from hpe_rig.report.sweep import Sweep, SweepCurve
from hpe_rig.report.views import EchoView, MotionView, grey_limit_v
from hpe_rig.result import BLUE, GREY, ORANGE, SKY, Picture, legend, legend_above, mark, panel, picture, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOM_ABOVE = 1.05
"""Top of an amplitude's axis over the largest, so that its mark is whole."""


def rf_line(view: EchoView) -> Picture:
    """Return one RF line over depth with the gate."""
    figure, axes = panel()
    axes.axvspan(*(edge * 1e3 for edge in view.gate_m), color=SKY, alpha=0.25, lw=0, label="gate")
    for edge_m in view.gate_m:
        axes.axvline(edge_m * 1e3, color=BLUE, lw=0.8, ls="--")
    axes.plot(view.line_depth_m * 1e3, view.line_v * 1e3, color=GREY, lw=0.8)
    axes.set(xlabel="depth (mm)", ylabel="echo (mV)")
    legend(axes, "upper right")
    inside = (view.line_depth_m >= view.gate_m[0]) & (view.line_depth_m <= view.gate_m[1])
    peak_mv = np.abs(view.line_v[inside]).max(initial=0.0) * 1e3
    alt = (
        f"Echo of the first pulse from {view.line_depth_m[0] * 1e3:.2f} to {view.line_depth_m[-1] * 1e3:.2f} mm depth; "
        f"the gate from {view.gate_m[0] * 1e3:.2f} to {view.gate_m[1] * 1e3:.2f} mm is shaded, its largest echo is "
        f"{peak_mv:.3g} mV."
    )
    return picture(figure, "rf", "RF line and gate", alt)


def m_mode(view: EchoView) -> Picture:
    """Return the image of the gate over slow time."""
    figure, axes = panel()
    limit_mv = grey_limit_v(view.image_v) * 1e3
    edges = [0.0, view.image_time_s[-1] * 1e3 or 1.0, view.image_depth_m[-1] * 1e3, view.image_depth_m[0] * 1e3]
    axes.set_facecolor("#E8B0A0")
    image = axes.imshow(
        view.image_v * 1e3,
        aspect="auto",
        cmap="gray",
        vmin=-limit_mv,
        vmax=limit_mv,
        extent=(edges[0], edges[1], edges[2], edges[3]),
        interpolation="nearest",
    )
    bar = figure.colorbar(image)
    bar.set_label("echo (mV)", size=9)
    bar.ax.tick_params(labelsize=9)
    axes.grid(visible=False)
    axes.set(xlabel="slow time after the first pulse (ms)", ylabel="depth (mm)")
    missing = int(np.isnan(view.image_v).all(axis=0).sum())
    alt = (
        f"M-mode image of the gate, {view.image_depth_m[0] * 1e3:.2f} to {view.image_depth_m[-1] * 1e3:.2f} mm deep, "
        f"over {edges[1]:.4g} ms; horizontal stripes are echoes at rest within a wavelength. "
        + (f"{missing} of {view.image_v.shape[1]} columns are missing." if missing else "No column is missing.")
    )
    return picture(figure, "m-mode", "M-mode of the gate", alt)


def displacement(view: MotionView, span_s: float | None, key: str, title: str) -> Picture:
    """Return displacement over time with the fit, the first ``span_s`` of it where given."""
    figure, axes = panel()
    shown = np.ones(view.time_s.size, np.bool_) if span_s is None else view.time_s <= view.time_s[0] + span_s
    time_ms, seen_nm, fitted_nm = (
        values[shown] for values in (view.time_s * 1e3, view.displacement_m * 1e9, view.fitted_m * 1e9)
    )
    middle_nm = float(seen_nm.mean())
    dense = time_ms.size > 400
    axes.plot(*thin(time_ms, seen_nm - middle_nm), ".", ms=2 if dense else 3.5, color=GREY, label="measured")
    axes.plot(*thin(time_ms, fitted_nm - middle_nm), "-", lw=0.9, color=ORANGE, label="fitted harmonics")
    axes.set(xlabel="time after the phase reference (ms)", ylabel="displacement (nm)")
    legend_above(axes)
    alt = (
        f"Displacement over {np.ptp(time_ms):.4g} ms: {seen_nm.size} pulses between {seen_nm.min() - middle_nm:.0f} "
        f"and {seen_nm.max() - middle_nm:.0f} nm; the fitted harmonics follow with "
        f"{np.std(seen_nm - fitted_nm):.3g} nm rms left."
    )
    return picture(figure, key, title, alt)


def residual(view: MotionView) -> tuple[Picture, ...]:
    """Return what is left after the fit: over time and over frequency."""
    left_nm = view.residual_m * 1e9
    figure, axes = panel()
    axes.plot(*thin(view.time_s * 1e3, left_nm), ".", ms=2, color=BLUE)
    axes.set(xlabel="time after the phase reference (ms)", ylabel="residual (nm)")
    alt = f"Residual displacement, {left_nm.std():.3g} nm rms, largest {np.abs(left_nm).max():.3g} nm."
    over_time = picture(figure, "residual", "Residual over time", alt)
    frequency_hz, power = periodogram(view)
    if power.size < 2:
        return (over_time,)
    figure, axes = panel()
    amplitude_nm = 2 * np.sqrt(power) / left_nm.size * 1e9
    expected_nm = 2 * float(np.sqrt(power.mean())) / left_nm.size * 1e9
    axes.plot(*thin(frequency_hz, amplitude_nm), ".", ms=3, color=BLUE, label="a frequency")
    axes.axhline(expected_nm, color=GREY, lw=1, ls="--", label="white: rms")
    axes.set(xlabel="frequency (Hz)", ylabel="residual amplitude (nm)", ylim=(0, None))
    legend_above(axes)
    alt = (
        f"Spectrum of the residual at {power.size} frequencies that were not fitted: {expected_nm:.3g} nm rms, largest "
        f"{amplitude_nm.max():.3g} nm at {frequency_hz[np.argmax(power)]:.4g} Hz."
    )
    return over_time, picture(figure, "residual-spectrum", "Residual over frequency", alt)


def sweep_pictures(sweep: Sweep, most: int = 2) -> tuple[Picture, ...]:
    """Return amplitude and phase over what was varied, for the first ``most`` frequencies."""
    frequencies = list(dict.fromkeys(curve.frequency_hz for curve in sweep.curves))[:most]
    pictures = []
    for frequency_hz in frequencies:
        curves = [curve for curve in sweep.curves if curve.frequency_hz == frequency_hz]
        pictures += [_sweep_amplitude(sweep, curves), _sweep_phase(sweep, curves)]
    return tuple(pictures)


def _sweep_amplitude(sweep: Sweep, curves: Sequence[SweepCurve]) -> Picture:
    figure, axes = panel()
    parts = []
    for place, curve in enumerate(curves):
        marker, colour = mark(place)
        spread = np.nan_to_num(curve.amplitude_sd_m) * 1e9
        axes.errorbar(
            curve.x, curve.amplitude_m * 1e9, spread, fmt=marker, ms=4, capsize=2, color=colour,
            label=curve.group or "mean, sd",
        )  # fmt: skip
        if curve.line is not None:
            ends = np.array([curve.x.min(), curve.x.max()])
            axes.plot(ends, (curve.line.intercept + curve.line.slope * ends) * 1e9, color=colour, lw=0.9)
            parts.append(
                f"{curve.group or 'line'}: slope {curve.line.slope * 1e9:.4g} nm, R2 {curve.line.r_squared:.4f}"
            )
    axes.set(xlabel=sweep.label, ylabel="amplitude (nm)", ylim=(0, ROOM_ABOVE * axes.get_ylim()[1]))
    _scale(axes)
    legend(axes, "best")
    f = curves[0].frequency_hz
    alt = f"Amplitude at {f:g} Hz over {sweep.name}, mean and standard deviation of the repeats. {'; '.join(parts)}."
    return picture(figure, f"sweep-amplitude-{f:g}", f"Amplitude at {f:g} Hz over {sweep.name}", alt)


def _scale(axes: Axes) -> None:
    """Write what was varied with a power of ten in common where its values are as small as gates in metres are."""
    axes.ticklabel_format(axis="x", style="sci", scilimits=(-2, 5))
    axes.locator_params(axis="x", nbins=7)


def _sweep_phase(sweep: Sweep, curves: Sequence[SweepCurve]) -> Picture:
    figure, axes = panel()
    for place, curve in enumerate(curves):
        marker, colour = mark(place)
        spread = np.degrees(np.nan_to_num(curve.phase_sd_rad))
        axes.errorbar(
            curve.x, np.degrees(_continuous(curve)), spread, fmt=marker, ms=4, capsize=2, color=colour,
            label=curve.group or "mean, sd",
        )  # fmt: skip
    axes.set(xlabel=sweep.label, ylabel="phase (degrees)")
    _scale(axes)
    legend(axes, "best")
    f = curves[0].frequency_hz
    low, high = (np.degrees([edge(_continuous(curve)) for curve in curves]) for edge in (np.min, np.max))
    alt = f"Phase at {f:g} Hz over {sweep.name}: between {low.min():.2f} and {high.max():.2f} degrees."
    return picture(figure, f"sweep-phase-{f:g}", f"Phase at {f:g} Hz over {sweep.name}", alt)


def _continuous(curve: SweepCurve) -> FloatArray:
    """Return the phase (point,) without jumps of a turn, followed from the strongest point to both sides.

    From there since a point that drowns in noise may be off by any angle, and whatever follows it with it.
    """
    strongest = int(np.argmax(curve.amplitude_m))
    before = np.unwrap(curve.phase_rad[strongest::-1])[::-1]
    return np.concatenate([before[:-1], np.unwrap(curve.phase_rad[strongest:])])
