"""Amplitude and phase over frequency as pictures: mean over repeats or one shot, and ground truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes

from hpe_rig.arrays import FloatArray
from hpe_rig.result.repeats import RepeatMean, setting_of
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.sentence import scale_of
from hpe_rig.result.svg import Colour, Picture, legend, panel, picture
from hpe_rig.result.values import Estimate, ShotResult

MAX_ALT_VALUES = 10
"""Frequencies listed in an alternative text."""


def main_shot(result: ResultData) -> ShotResult:
    """Return the shot that represents ``result`` in a picture: a complete one, of the setting that moves most.

    A setting with repeats moves by its mean.
    """
    means = result.means

    def rank(shot: ShotResult) -> tuple[bool, float]:
        return shot.complete, max((item.amplitude_m for item in means_of(means, shot) or shot.estimates), default=0.0)

    return max(result.shots, key=rank)


def means_of(means: Sequence[RepeatMean], shot: ShotResult) -> list[RepeatMean]:
    """Return those of ``means`` that ``shot`` is one of the repeats of: one for each frequency, or none."""
    setting = setting_of(shot)
    return [mean for mean in means if shot.shot in mean.shots and setting_of(mean) == setting]


def spectrum_pictures(result: ResultData, shot: ShotResult, alone: bool = False) -> tuple[Picture, ...]:
    """Return amplitude and phase over frequency: the mean over the repeats of ``shot``, each repeat as a small mark.

    The shot itself if it has no repeats or is to be drawn ``alone``. Empty without an estimate.
    """
    means = [] if alone else means_of(result.means, shot)
    repeats = [
        item.estimates
        for item in result.shots
        if means and item.shot in means[0].shots and setting_of(item) == setting_of(shot)
    ]
    values = means or shot.estimates
    return tuple(draw(values, repeats) for draw in (_amplitude, _phase) if values)


def _amplitude(estimates: Sequence[Estimate | RepeatMean], repeats: Sequence[Sequence[Estimate]]) -> Picture:
    """Return amplitude over frequency: headline with combined uncertainty, tracked amplitude, and ground truth."""
    figure, axes = panel()
    scale, unit = scale_of(max(item.amplitude_m for item in estimates))
    _plot_repeats(axes, repeats, lambda item: item.amplitude_m / scale)
    frequency_hz = np.array([item.frequency_hz for item in estimates])
    amplitude = np.array([item.amplitude_m for item in estimates]) / scale
    uncertainty = np.array([item.amplitude_uncertainty_m for item in estimates]) / scale
    true = np.array([_or_nan(item.true_amplitude_m) for item in estimates]) / scale
    has_truth = bool(np.isfinite(true).all())
    if has_truth:
        axes.plot(frequency_hz, true, "x", color=Colour.GREY, ms=6, label="true peak displacement")
    if corrected := all(item.corrected for item in estimates):
        tracked = [item.tracked_amplitude_m / scale for item in estimates if isinstance(item, Estimate)]
        # A mean has no tracked values.
        if tracked:
            axes.plot(frequency_hz, tracked, "D", ms=4, mfc="none", color=Colour.BLUE, label="as tracked")
    axes.errorbar(
        frequency_hz, amplitude, 2 * uncertainty, fmt="o", ms=4, color=Colour.ORANGE, capsize=2,
        label="peak displacement, 2 u" if corrected else "as tracked, 2 u",
    )  # fmt: skip
    axes.set(xlabel="vibration frequency (Hz)", ylabel=f"amplitude ({unit})", ylim=(0, None))
    _label_single_frequency(axes, frequency_hz)
    legend(axes, "best")
    pairs = zip(frequency_hz[:MAX_ALT_VALUES], amplitude[:MAX_ALT_VALUES], strict=True)
    alt = (
        f"Amplitude in {unit}: {', '.join(f'{value:.4g} at {hz:g} Hz' for hz, value in pairs)}; standard "
        f"uncertainty {uncertainty.min():.2g} to {uncertainty.max():.2g} {unit}."
    )
    if has_truth:
        ratio = amplitude / np.maximum(true, np.finfo(np.float64).tiny)
        alt += f" The estimates are {ratio.min():.3f} to {ratio.max():.3f} of the true peak displacement."
    return picture(figure, "amplitude", "Amplitude spectrum", alt)


def _phase(estimates: Sequence[Estimate | RepeatMean], repeats: Sequence[Sequence[Estimate]]) -> Picture:
    """Return the headline phase over frequency, unwrapped, with uncertainty and the ground truth of a twin."""
    figure, axes = panel()
    frequency_hz = np.array([item.frequency_hz for item in estimates])
    # Neighbouring harmonics differ by less than half a turn; wrapped phases would hide the trend.
    phase = np.unwrap([item.phase_rad for item in estimates])
    phase_at = dict(zip(frequency_hz.tolist(), phase.tolist(), strict=True))

    def unwrapped_deg(item: Estimate) -> float:
        """Return the phase of a repeat within half a turn of the main curve."""
        centre = phase_at.get(item.frequency_hz, 0.0)
        return math.degrees(centre + math.remainder(item.phase_rad - centre, 2 * math.pi))

    _plot_repeats(axes, repeats, unwrapped_deg)
    uncertainty_deg = np.degrees([item.phase_uncertainty_rad for item in estimates])
    true_rad = phase - np.array(
        [math.remainder(item.phase_rad - _or_nan(item.true_phase_rad), 2 * math.pi) for item in estimates]
    )
    if np.isfinite(true_rad).all():
        axes.plot(frequency_hz, np.degrees(true_rad), "x-", color=Colour.GREY, lw=0.8, label="ground truth")
    axes.errorbar(
        frequency_hz, np.degrees(phase), 2 * uncertainty_deg, fmt="o", ms=4, color=Colour.ORANGE, capsize=2,
        label="estimate, 2 u",
    )  # fmt: skip
    axes.set(xlabel="vibration frequency (Hz)", ylabel="phase (degrees)")
    _label_single_frequency(axes, frequency_hz)
    legend(axes, "best")
    pairs = zip(frequency_hz[:MAX_ALT_VALUES], np.degrees(phase)[:MAX_ALT_VALUES], strict=True)
    alt = (
        f"Phase in degrees: {', '.join(f'{degrees:.2f} at {hz:g} Hz' for hz, degrees in pairs)}; standard uncertainty "
        f"up to {uncertainty_deg.max():.2g} degrees."
    )
    return picture(figure, "phase", "Phase spectrum", alt)


def _label_single_frequency(axes: Axes, frequency_hz: FloatArray) -> None:
    """Label the horizontal axis with the one frequency (frequency,), around which there is nothing."""
    if frequency_hz.size == 1:
        axes.set_xticks(frequency_hz)


def _plot_repeats(axes: Axes, repeats: Sequence[Sequence[Estimate]], value: Callable[[Estimate], float]) -> None:
    points = [(item.frequency_hz, value(item)) for estimates in repeats for item in estimates]
    if points:
        axes.plot(*zip(*points, strict=True), "_", ms=9, color=Colour.PURPLE, label="repeats")


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
