"""Pictures of many shots: amplitude and phase over what was varied."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hpe_rig.report.svg import Picture, legend, mark, panel, picture
from hpe_rig.report.sweep import Curve, Sweep


def sweep_pictures(sweep: Sweep, most: int = 2) -> tuple[Picture, ...]:
    """Return amplitude and phase over what was varied, for the first ``most`` frequencies."""
    frequencies = list(dict.fromkeys(curve.frequency_hz for curve in sweep.curves))[:most]
    pictures = []
    for frequency_hz in frequencies:
        curves = [curve for curve in sweep.curves if curve.frequency_hz == frequency_hz]
        pictures += [_sweep_amplitude(sweep.label, curves), _sweep_phase(sweep.label, curves)]
    return tuple(pictures)


def _sweep_amplitude(label: str, curves: Sequence[Curve]) -> Picture:
    figure, axes = panel()
    parts = []
    for place, curve in enumerate(curves):
        marker, colour = mark(place)
        spread = np.nan_to_num(curve.amplitude_sd_m) * 1e9
        axes.errorbar(
            curve.x, curve.amplitude_m * 1e9, spread, fmt=marker, ms=4, capsize=2, color=colour,
            label=curve.group or "mean, sd",
        )  # fmt: skip
        if curve.line is not None and not label.startswith("repeat"):
            ends = np.array([curve.x.min(), curve.x.max()])
            axes.plot(ends, (curve.line.intercept + curve.line.slope * ends) * 1e9, color=colour, lw=0.9)
            parts.append(
                f"{curve.group or 'line'}: slope {curve.line.slope * 1e9:.4g} nm, R2 {curve.line.r_squared:.4f}"
            )
    axes.set(xlabel=label, ylabel="amplitude (nm)", ylim=(0, None))
    legend(axes, "best")
    f = curves[0].frequency_hz
    alt = f"Amplitude at {f:g} Hz over {label}, mean and standard deviation of the repeats. {'; '.join(parts)}."
    return picture(figure, f"sweep-amplitude-{f:g}", f"Amplitude at {f:g} Hz over {label}", alt)


def _sweep_phase(label: str, curves: Sequence[Curve]) -> Picture:
    figure, axes = panel()
    for place, curve in enumerate(curves):
        marker, colour = mark(place)
        spread = np.degrees(np.nan_to_num(curve.phase_sd_rad))
        axes.errorbar(
            curve.x, np.degrees(_continuous(curve)), spread, fmt=marker, ms=4, capsize=2, color=colour,
            label=curve.group or "mean, sd",
        )  # fmt: skip
    axes.set(xlabel=label, ylabel="phase (degrees)")
    legend(axes, "best")
    f = curves[0].frequency_hz
    low, high = (np.degrees([edge(_continuous(curve)) for curve in curves]) for edge in (np.min, np.max))
    alt = f"Phase at {f:g} Hz over {label}: between {low.min():.2f} and {high.max():.2f} degrees."
    return picture(figure, f"sweep-phase-{f:g}", f"Phase at {f:g} Hz over {label}", alt)


def _continuous(curve: Curve) -> NDArray[np.float64]:
    """Return the phase (point,) without jumps of a turn, followed from the strongest point to both sides.

    From there since a point that drowns in noise may be off by any angle, and whatever follows it with it.
    """
    strongest = int(np.argmax(curve.amplitude_m))
    before = np.unwrap(curve.phase_rad[strongest::-1])[::-1]
    return np.concatenate([before[:-1], np.unwrap(curve.phase_rad[strongest:])])
