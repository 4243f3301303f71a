"""Pictures of a run's page, one panel each, for one shot and for a sweep.

Every picture has a title and an alternative text with its main numbers. Markers distinguish curves without colours too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.report.residual_tests import periodogram
from hpe_rig.report.sweep import Sweep, SweepCurve
from hpe_rig.report.views import EchoView, MotionView, grey_limit_v
from hpe_rig.result import Colour, Picture, legend, mark, panel, picture, scale_of, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADROOM = 1.05
"""Upper limit of an amplitude axis over the largest value, so that its marker is not cut."""


def rf_line(view: EchoView) -> Picture:
    """Return one RF line over depth, with the gate shaded."""
    figure, axes = panel()
    axes.axvspan(*(edge * 1e3 for edge in view.gate_m), color=Colour.SKY, alpha=0.25, lw=0, label="gate")
    for edge_m in view.gate_m:
        axes.axvline(edge_m * 1e3, color=Colour.BLUE, lw=0.8, ls="--")
    scale, unit = scale_of(float(np.abs(view.line_v).max(initial=0.0)), "V")
    axes.plot(view.line_depth_m * 1e3, view.line_v / scale, color=Colour.GREY, lw=0.8)
    axes.set(xlabel="depth (mm)", ylabel=f"echo ({unit})")
    legend(axes, "upper right")
    inside = (view.line_depth_m >= view.gate_m[0]) & (view.line_depth_m <= view.gate_m[1])
    peak = np.abs(view.line_v[inside]).max(initial=0.0) / scale
    alt = (
        f"Echo of the first pulse from {view.line_depth_m[0] * 1e3:.2f} to {view.line_depth_m[-1] * 1e3:.2f} mm depth; "
        f"the gate from {view.gate_m[0] * 1e3:.2f} to {view.gate_m[1] * 1e3:.2f} mm is shaded, its largest echo is "
        f"{peak:.3g} {unit}."
    )
    return picture(figure, "rf", "RF line and gate", alt)


def m_mode(view: EchoView) -> Picture:
    """Return the gate over slow time as a grey image."""
    figure, axes = panel()
    # Symmetrical about zero, so that zero is medium grey.
    limit_v = grey_limit_v(view.image_v)
    scale, unit = scale_of(limit_v, "V")
    limit = limit_v / scale
    end_ms = view.image_time_s[-1] * 1e3 or 1.0
    axes.set_facecolor("#E8B0A0")
    image = axes.imshow(
        view.image_v / scale,
        aspect="auto",
        cmap="gray",
        vmin=-limit,
        vmax=limit,
        extent=(0.0, end_ms, view.image_depth_m[-1] * 1e3, view.image_depth_m[0] * 1e3),
        interpolation="nearest",
    )
    # The wider fraction leaves room for labels of four digits.
    bar = figure.colorbar(image, fraction=0.2)
    bar.set_label(f"echo ({unit})", size=9)
    bar.ax.tick_params(labelsize=9)
    axes.grid(visible=False)
    axes.set(xlabel="slow time after the first pulse (ms)", ylabel="depth (mm)")
    missing = int(np.isnan(view.image_v).all(axis=0).sum())
    alt = (
        f"M-mode image of the gate, {view.image_depth_m[0] * 1e3:.2f} to {view.image_depth_m[-1] * 1e3:.2f} mm deep, "
        f"over {end_ms:.4g} ms; horizontal stripes are echoes that move by less than a wavelength. "
        + (f"{missing} of {view.image_v.shape[1]} columns are missing." if missing else "No column is missing.")
    )
    return picture(figure, "m-mode", "M-mode of the gate", alt)


def displacement(view: MotionView, span_s: float | None, key: str, title: str) -> Picture:
    """Return displacement and fit over time; ``span_s`` limits them to the first seconds."""
    figure, axes = panel()
    mask = np.ones(view.time_s.size, np.bool_) if span_s is None else view.time_s <= view.time_s[0] + span_s
    # The displacement has an arbitrary constant: its mean is removed.
    mean_m = float(view.displacement_m[mask].mean())
    scale, unit = scale_of(float(np.abs(view.displacement_m[mask] - mean_m).max()))
    time_ms = view.time_s[mask] * 1e3
    measured, fitted = ((values[mask] - mean_m) / scale for values in (view.displacement_m, view.fitted_m))
    marker_size = 2 if time_ms.size > 400 else 3.5
    axes.plot(*thin(time_ms, measured), ".", ms=marker_size, color=Colour.GREY, label="measured")
    axes.plot(*thin(time_ms, fitted), "-", lw=0.9, color=Colour.ORANGE, label="fitted harmonics")
    axes.set(xlabel="time after the phase reference (ms)", ylabel=f"displacement ({unit})")
    legend(axes, "above")
    alt = (
        f"Displacement over {np.ptp(time_ms):.4g} ms: {measured.size} pulses between "
        f"{measured.min():.0f} and {measured.max():.0f} {unit}; the residual of the "
        f"fitted harmonics is {np.std(measured - fitted):.3g} {unit} rms."
    )
    return picture(figure, key, title, alt)


def residual_pictures(view: MotionView) -> tuple[Picture, ...]:
    """Return the residual of the fit over time and over frequency."""
    scale, unit = scale_of(float(np.abs(view.residual_m).max()))
    residual = view.residual_m / scale
    figure, axes = panel()
    axes.plot(*thin(view.time_s * 1e3, residual), ".", ms=2, color=Colour.BLUE)
    axes.set(xlabel="time after the phase reference (ms)", ylabel=f"residual ({unit})")
    alt = f"Residual displacement, {residual.std():.3g} {unit} rms, largest {np.abs(residual).max():.3g} {unit}."
    over_time = picture(figure, "residual", "Residual over time", alt)
    # Too few pulses have no frequency outside the fit.
    frequency_hz, power = periodogram(view)
    if power.size < 2:
        return (over_time,)
    figure, axes = panel()
    # A sinusoid of amplitude A has the power (A N / 2)² in its bin.
    factor = 2 / (residual.size * scale)
    amplitude, expected = factor * np.sqrt(power), factor * float(np.sqrt(power.mean()))
    axes.plot(*thin(frequency_hz, amplitude), ".", ms=3, color=Colour.BLUE, label="residual")
    axes.axhline(expected, color=Colour.GREY, lw=1, ls="--", label="rms of white noise")
    axes.set(xlabel="frequency (Hz)", ylabel=f"residual amplitude ({unit})", ylim=(0, None))
    legend(axes, "above")
    alt = (
        f"Spectrum of the residual at {power.size} frequencies outside the fit: {expected:.3g} {unit} rms, largest "
        f"{amplitude.max():.3g} {unit} at {frequency_hz[np.argmax(power)]:.4g} Hz."
    )
    return over_time, picture(figure, "residual-spectrum", "Residual over frequency", alt)


def sweep_pictures(sweep: Sweep, most: int = 2) -> tuple[Picture, ...]:
    """Return amplitude and phase over the varied quantity, for the first ``most`` frequencies."""
    frequencies = list(dict.fromkeys(curve.frequency_hz for curve in sweep.curves))[:most]
    pictures = []
    for frequency_hz in frequencies:
        curves = [curve for curve in sweep.curves if curve.frequency_hz == frequency_hz]
        pictures += [_sweep_amplitude(sweep, curves), _sweep_phase(sweep, curves)]
    return tuple(pictures)


def _sweep_amplitude(sweep: Sweep, curves: Sequence[SweepCurve]) -> Picture:
    figure, axes = panel()
    descriptions = []
    for index, curve in enumerate(curves):
        _plot_curve(axes, index, curve, curve.amplitude_m * 1e9, np.nan_to_num(curve.amplitude_sd_m) * 1e9)
        if curve.line is not None:
            ends = np.array([curve.x.min(), curve.x.max()])
            axes.plot(ends, (curve.line.intercept + curve.line.slope * ends) * 1e9, color=mark(index)[1], lw=0.9)
            descriptions.append(
                f"{curve.group or 'line'}: slope {curve.line.slope * 1e9:.4g} nm, R2 {curve.line.r_squared:.4f}"
            )
    axes.set(xlabel=sweep.label, ylabel="amplitude (nm)", ylim=(0, HEADROOM * axes.get_ylim()[1]))
    _format_x_axis(axes)
    legend(axes, "best")
    hz = curves[0].frequency_hz
    alt = (
        f"Amplitude at {hz:g} Hz over {sweep.name}, mean and standard deviation of the repeats. "
        f"{'; '.join(descriptions)}."
    )
    return picture(figure, f"sweep-amplitude-{hz:g}", f"Amplitude at {hz:g} Hz over {sweep.name}", alt)


def _plot_curve(axes: Axes, index: int, curve: SweepCurve, mean: FloatArray, sd: FloatArray) -> None:
    """Draw means with bars of one standard deviation in the colour of curve number ``index``."""
    marker, colour = mark(index)
    label = curve.group or ("mean, sd" if sd.any() else "each shot")
    axes.errorbar(curve.x, mean, sd, fmt=marker, ms=4, capsize=2, color=colour, label=label)


def _format_x_axis(axes: Axes) -> None:
    """Use a common power of ten for very small and very large values, and at most seven labels."""
    axes.ticklabel_format(axis="x", style="sci", scilimits=(-2, 5))
    axes.locator_params(axis="x", nbins=7)


def _sweep_phase(sweep: Sweep, curves: Sequence[SweepCurve]) -> Picture:
    figure, axes = panel()
    for index, curve in enumerate(curves):
        sd_deg = np.degrees(np.nan_to_num(curve.phase_sd_rad))
        _plot_curve(axes, index, curve, np.degrees(_unwrapped(curve)), sd_deg)
    axes.set(xlabel=sweep.label, ylabel="phase (degrees)")
    _format_x_axis(axes)
    legend(axes, "best")
    hz = curves[0].frequency_hz
    low, high = (np.degrees([edge(_unwrapped(curve)) for curve in curves]) for edge in (np.min, np.max))
    alt = f"Phase at {hz:g} Hz over {sweep.name}: between {low.min():.2f} and {high.max():.2f} degrees."
    return picture(figure, f"sweep-phase-{hz:g}", f"Phase at {hz:g} Hz over {sweep.name}", alt)


def _unwrapped(curve: SweepCurve) -> FloatArray:
    """Return the phase (point,) unwrapped from the strongest point to both sides.

    A point within the noise may have any phase; unwrapping across it from one end would shift all points after it.
    """
    strongest = int(np.argmax(curve.amplitude_m))
    before = np.unwrap(curve.phase_rad[strongest::-1])[::-1]
    return np.concatenate([before[:-1], np.unwrap(curve.phase_rad[strongest:])])
