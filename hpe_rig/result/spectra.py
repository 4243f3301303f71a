"""Amplitude and phase over frequency as pictures: one shot beside ground truth and the repeats of its setting."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes

from hpe_rig.result.svg import BLUE, GREY, ORANGE, PURPLE, Picture, legend, panel, picture
from hpe_rig.result.values import Estimate, Result, ShotResult


def shown_shot(result: Result) -> ShotResult:
    """Return the shot that stands for ``result`` in a picture: of the complete ones that which moves most."""
    return max(result.shots, key=lambda item: (item.complete, max((e.amplitude_m for e in item.estimates), default=0)))


def repeats_of(result: Result, shown: ShotResult) -> list[tuple[Estimate, ...]]:
    """Return the estimates of the other shots of the setting of ``shown``."""
    alike = {shot for mean in result.means if shown.shot in mean.shots for shot in mean.shots} - {shown.shot}
    same = [each for each in result.shots if each.window_length_s == shown.window_length_s]
    return [each.estimates for each in same if each.shot in alike]


def amplitude_spectrum(estimates: Sequence[Estimate], repeats: Sequence[Sequence[Estimate]] = ()) -> Picture:
    """Return amplitude over frequency: the headline with its combined uncertainty, as tracked, and the ground truth.

    ``repeats``: the other shots of the same setting, a small mark each.
    """
    figure, axes = panel()
    _repeats(axes, repeats, lambda each: each.headline.amplitude_m * 1e9)
    frequency_hz = np.array([item.frequency_hz for item in estimates])
    amplitude_nm = np.array([item.headline.amplitude_m for item in estimates]) * 1e9
    uncertainty_nm = np.array([item.headline.amplitude_uncertainty_m for item in estimates]) * 1e9
    true_nm = np.array([_or_nan(item.true_amplitude_m) for item in estimates]) * 1e9
    known = bool(np.isfinite(true_nm).all())
    if known:
        axes.plot(frequency_hz, true_nm, "x", color=GREY, ms=6, label="true peak displacement")
    if corrected := all(item.headline.corrected for item in estimates):
        tracked_nm = np.array([item.amplitude_m for item in estimates]) * 1e9
        axes.plot(frequency_hz, tracked_nm, "D", ms=4, mfc="none", color=BLUE, label="as tracked")
    axes.errorbar(
        frequency_hz, amplitude_nm, 2 * uncertainty_nm, fmt="o", ms=4, color=ORANGE, capsize=2,
        label="peak displacement, 2 u" if corrected else "as tracked, 2 u",
    )  # fmt: skip
    axes.set(xlabel="vibration frequency (Hz)", ylabel="amplitude (nm)", ylim=(0, None))
    legend(axes, "best")
    pairs = ", ".join(f"{a:.4g} at {f:g} Hz" for f, a in zip(frequency_hz[:10], amplitude_nm[:10], strict=True))
    alt = f"Amplitude in nm: {pairs}; standard uncertainty {uncertainty_nm.min():.2g} to {uncertainty_nm.max():.2g} nm."
    if known:
        ratio = amplitude_nm / np.maximum(true_nm, np.finfo(np.float64).tiny)
        alt += f" The estimates are {ratio.min():.3f} to {ratio.max():.3f} of the true peak displacement."
    return picture(figure, "amplitude", "Amplitude spectrum", alt)


def phase_spectrum(estimates: Sequence[Estimate], repeats: Sequence[Sequence[Estimate]] = ()) -> Picture:
    """Return the headline's phase over frequency, unwrapped, with uncertainty and, on the twin, ground truth.

    ``repeats``: the other shots of the same setting, a small mark each.
    """
    figure, axes = panel()
    frequency_hz = np.array([item.frequency_hz for item in estimates])
    phase = np.unwrap([item.headline.phase_rad for item in estimates])
    near = dict(zip(frequency_hz.tolist(), phase.tolist(), strict=True))

    def beside(each: Estimate) -> float:
        """Return the phase within half a turn of the shown shot's."""
        centre = near.get(each.frequency_hz, 0.0)
        return math.degrees(centre + math.remainder(each.headline.phase_rad - centre, 2 * math.pi))

    _repeats(axes, repeats, beside)
    uncertainty_deg = np.degrees([item.headline.phase_uncertainty_rad for item in estimates])
    truth = phase - np.array([_or_nan(item.corrected_phase_error_rad) for item in estimates])
    if np.isfinite(truth).all():
        axes.plot(frequency_hz, np.degrees(truth), "x-", color=GREY, lw=0.8, label="ground truth")
    axes.errorbar(
        frequency_hz, np.degrees(phase), 2 * uncertainty_deg, fmt="o", ms=4, color=ORANGE, capsize=2,
        label="estimate, 2 u",
    )  # fmt: skip
    axes.set(xlabel="vibration frequency (Hz)", ylabel="phase (degrees)")
    legend(axes, "best")
    pairs = ", ".join(f"{p:.2f} at {f:g} Hz" for f, p in zip(frequency_hz[:10], np.degrees(phase)[:10], strict=True))
    largest = uncertainty_deg.max()
    alt = f"Phase in degrees: {pairs}; standard uncertainty up to {largest:.2g} degrees."
    return picture(figure, "phase", "Phase spectrum", alt)


def _repeats(axes: Axes, repeats: Sequence[Sequence[Estimate]], value: Callable[[Estimate], float]) -> None:
    found = [(each.frequency_hz, value(each)) for shot in repeats for each in shot]
    if found:
        axes.plot(*zip(*found, strict=True), "_", ms=9, color=PURPLE, label="other repeats")


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
