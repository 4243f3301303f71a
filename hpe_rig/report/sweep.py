"""Curves of a run over its varied quantity: means over repeats, and straight lines over the force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result import Estimate, ShotResult, setting_table

FORCE = "force F / F_0"
PROPORTIONAL = (FORCE, "excitation.force_fraction")
"""Axes over which the motion is proportional and a straight line is fitted."""


@dataclass(frozen=True, slots=True)
class Line:
    """Least-squares line y = intercept + slope x with standard uncertainties, NaN for two points."""

    slope: float
    slope_u: float
    intercept: float
    intercept_u: float
    r_squared: float


@dataclass(frozen=True, slots=True)
class SweepCurve:
    """Amplitude and phase of one frequency over the varied quantity, averaged over repeats.

    ``x``, means and standard deviations over repeats (point,); a deviation is NaN for a single repeat. ``line`` fits
    every shot over the force; None over other quantities, and for fewer than two values of x.
    """

    frequency_hz: float
    group: str
    x: FloatArray
    amplitude_m: FloatArray
    amplitude_sd_m: FloatArray
    phase_rad: FloatArray
    phase_sd_rad: FloatArray
    repeats: int
    line: Line | None


@dataclass(frozen=True, slots=True)
class Sweep:
    """The curves of a run; ``label`` names the axis with its unit."""

    label: str
    curves: tuple[SweepCurve, ...]

    @property
    def name(self) -> str:
        """Name of the axis without its unit."""
        return self.label.partition(" (")[0]

    @property
    def is_linear(self) -> bool:
        """Whether the motion is proportional to the varied quantity."""
        return self.label in PROPORTIONAL


AXES = {
    "lateral_offset_m": ("lateral offset (mm)", 1e3),
    "axial_offset_m": ("axial offset (mm)", 1e3),
    "force_fraction": (FORCE, 1.0),
    "pulse_rate_hz": ("pulse rate f_prf (Hz)", 1.0),
    "window_length_s": ("window T_s (ms)", 1e3),
    "burst_length_s": ("burst length T_b (us)", 1e6),
}
"""Label and scale of the settings that make an axis; the first that varies applies."""


def make_sweep(shots: Sequence[ShotResult]) -> Sweep | None:
    """Return the curves of ``shots`` over the first quantity that varies; None for a single shot."""
    if len(shots) < 2:
        return None
    # An axis of the scene's sweep has priority over settings that vary in every scene.
    candidates: list[tuple[str, Sequence[float | None]]] = [
        *((name, [shot.swept[name] for shot in shots]) for name in shots[0].swept),
        *((label, [_scaled(getattr(shot, name), scale) for shot in shots]) for name, (label, scale) in AXES.items()),
        ("repeat", [shot.repeat + 1.0 for shot in shots]),
    ]
    label, x = next((candidate for candidate in candidates if len(set(candidate[1])) > 1), candidates[-1])
    return _sweep(label, shots, x, [""] * len(shots) if label == "repeat" else _groups(shots, x))


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


def _groups(shots: Sequence[ShotResult], x: Sequence[float | None]) -> list[str]:
    """Return for each shot the settings, in words, that vary between shots with an equal value in ``x`` (shot,)."""
    tables = setting_table(shots)
    # A setting that follows the axis has one text at each of its values, so it does not distinguish curves.
    axis_values = len(set(x))
    names = [
        name
        for name in tables[0]
        if len({(value, table[name]) for value, table in zip(x, tables, strict=True)}) > axis_values
    ]
    return [", ".join(table[name] for name in names if table[name]) for table in tables]


def fit_line(x: FloatArray, y: FloatArray) -> Line | None:
    """Return the least-squares line through (x, y), both (point,); None for fewer than two values of x.

    The uncertainties come from 1 - R²: for residuals below 1e-8 of the range they are rounding errors.
    """
    if x.size == 0 or not np.ptp(x) > 0:
        return None
    # Imported here: it takes half a second, and few reports have a sweep.
    from scipy.stats import linregress

    fit = linregress(x, y)
    # Two points have no residual; SciPy then states an uncertainty of 0.
    slope_u, intercept_u = (fit.stderr, fit.intercept_stderr) if x.size > 2 else (math.nan, math.nan)
    r_squared = float(fit.rvalue) ** 2 if np.ptp(y) > 0 else math.nan
    return Line(float(fit.slope), float(slope_u), float(fit.intercept), float(intercept_u), r_squared)


def _sweep(label: str, shots: Sequence[ShotResult], x: Sequence[float | None], groups: Sequence[str]) -> Sweep:
    x_values = np.array([math.nan if value is None else value for value in x], dtype=np.float64)
    # If an axis changes the wanted frequencies, a curve contains the shots that have its frequency.
    frequencies_hz = dict.fromkeys(estimate.frequency_hz for shot in shots for estimate in shot.estimates)
    curves = []
    for frequency_hz, group in itertools.product(frequencies_hz, dict.fromkeys(groups)):
        points = [
            (estimate, x_value)
            for shot, shot_group, x_value in zip(shots, groups, x_values, strict=True)
            for estimate in shot.estimates
            if shot_group == group and estimate.frequency_hz == frequency_hz
        ]
        if points:
            estimates, x_points = [estimate for estimate, _ in points], np.array([x for _, x in points])
            curves.append(_curve(frequency_hz, group, estimates, x_points, label in PROPORTIONAL))
    return Sweep(label, tuple(curves))


def _curve(frequency_hz: float, group: str, estimates: Sequence[Estimate], x: FloatArray, linear: bool) -> SweepCurve:
    amplitude = np.array([item.amplitude_m for item in estimates])
    phase = np.array([item.phase_rad for item in estimates])
    # One point for each value of x: the mean over its repeats.
    values = np.unique(x)
    masks = [x == value for value in values]
    amplitudes = [amplitude[mask] for mask in masks]
    phases = [_circular_mean_and_sd(phase[mask]) for mask in masks]
    return SweepCurve(
        frequency_hz=frequency_hz,
        group=group,
        x=values,
        amplitude_m=np.array([repeats.mean() for repeats in amplitudes]),
        amplitude_sd_m=np.array([repeats.std(ddof=1) if repeats.size > 1 else math.nan for repeats in amplitudes]),
        phase_rad=np.array([mean for mean, _ in phases]),
        phase_sd_rad=np.array([sd for _, sd in phases]),
        repeats=max(int(mask.sum()) for mask in masks),
        line=fit_line(x, amplitude) if linear else None,
    )


def _circular_mean_and_sd(phase: FloatArray) -> tuple[float, float]:
    """Return circular mean and standard deviation about it; phases may wrap."""
    mean = float(np.angle(np.exp(1j * phase).mean()))
    deviation = np.angle(np.exp(1j * (phase - mean)))
    return mean, float(np.sqrt(deviation @ deviation / (phase.size - 1))) if phase.size > 1 else math.nan
