"""Curves of a run over its varied quantity: means over repeats, and straight lines over the force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result import Estimate, ShotResult, force_format

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


@dataclass(frozen=True, slots=True)
class _Setting:
    """A setting that may differ between shots: label of its axis, attribute, scale, and text in the name of a curve."""

    label: str
    attribute: str
    scale: float
    form: str

    def value(self, shot: ShotResult) -> float | None:
        value: float | None = getattr(shot, self.attribute)
        return None if value is None else value * self.scale

    def text(self, shot: ShotResult, format_of_force: str = "") -> str:
        value = self.value(shot)
        return "" if value is None else self.form.format(value, force=format_of_force)

    def varies(self, shots: Sequence[ShotResult]) -> bool:
        return len({self.value(shot) for shot in shots}) > 1


LATERAL = _Setting("lateral offset (mm)", "lateral_offset_m", 1e3, "x = {:g} mm")
AXIAL = _Setting("axial offset (mm)", "axial_offset_m", 1e3, "z = {:g} mm")
FORCE_FRACTION = _Setting(FORCE, "force_fraction", 1.0, "F = {:{force}} F_0")
PULSE_RATE = _Setting("pulse rate f_prf (Hz)", "pulse_rate_hz", 1.0, "f_prf = {:g} Hz")
WINDOW = _Setting("window T_s (ms)", "window_length_s", 1e3, "T_s = {:g} ms")
BURST_LENGTH = _Setting("burst length T_b (us)", "burst_length_s", 1e6, "T_b = {:g} us")

AXES: tuple[tuple[_Setting, tuple[_Setting, ...]], ...] = (
    (LATERAL, (PULSE_RATE, WINDOW)),
    (AXIAL, (PULSE_RATE, WINDOW)),
    (FORCE_FRACTION, (PULSE_RATE, WINDOW)),
    (PULSE_RATE, ()),
    (WINDOW, ()),
)
"""Settings that make an axis, and the settings that group its curves; the first setting that varies applies.

The burst length always groups curves."""
GROUPS_OF_AXIS = (LATERAL, AXIAL, FORCE_FRACTION, BURST_LENGTH, WINDOW)
"""Settings that group the curves over an axis of the scene's sweep."""


def make_sweep(shots: Sequence[ShotResult]) -> Sweep | None:
    """Return the curves of ``shots`` over the first quantity that varies; None for a single shot."""
    if len(shots) < 2:
        return None
    # An axis of the scene's sweep has priority over settings that vary in every scene.
    for name in shots[0].swept:
        if len({shot.swept[name] for shot in shots}) > 1:
            pairs = zip(_other_axes(name, shots), _texts(GROUPS_OF_AXIS, shots), strict=True)
            groups = [_joined(*texts) for texts in pairs]
            return _sweep(name, shots, [shot.swept[name] for shot in shots], groups)
    for axis, grouping in AXES:
        if axis.varies(shots):
            groups = [
                _joined(BURST_LENGTH.text(shot), text)
                for shot, text in zip(shots, _texts(grouping, shots), strict=True)
            ]
            return _sweep(axis.label, shots, [axis.value(shot) for shot in shots], groups)
    # Nothing else varies: one curve over the burst lengths, or over the repeats.
    if BURST_LENGTH.varies(shots):
        return _sweep(BURST_LENGTH.label, shots, [BURST_LENGTH.value(shot) for shot in shots], [""] * len(shots))
    return _sweep("repeat", shots, [shot.repeat + 1.0 for shot in shots], [""] * len(shots))


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


def _joined(*texts: str) -> str:
    return ", ".join(text for text in texts if text)


def _texts(settings: Sequence[_Setting], shots: Sequence[ShotResult]) -> list[str]:
    """Return for each shot those of ``settings`` that vary over ``shots``, in words."""
    varied, format_of_force = [setting for setting in settings if setting.varies(shots)], force_format(shots)
    return [_joined(*(setting.text(shot, format_of_force) for setting in varied)) for shot in shots]


def _other_axes(name: str, shots: Sequence[ShotResult]) -> list[str]:
    """Return for each shot the values of the other axes of the sweep, except those that follow the axis ``name``."""
    axis_values = {shot.swept[name] for shot in shots}
    # An axis combined by zip has one value at each value of ``name``, so it does not distinguish curves.
    axes = [
        axis
        for axis in shots[0].swept
        if axis != name and len({(shot.swept[name], shot.swept[axis]) for shot in shots}) > len(axis_values)
    ]
    return [_joined(*(f"{axis} = {shot.swept[axis]:g}" for axis in axes)) for shot in shots]


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
