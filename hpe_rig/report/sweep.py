"""Curves of many shots: what was varied, means over repeats, and over the force a straight line through them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.result import Headline, ShotResult

FORCE = "force F / F_0"
PROPORTIONAL = (FORCE, "excitation.force_fraction")
"""Axes that a straight line is fitted over."""


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line y = intercept + slope x by least squares, with standard uncertainties (NaN: too few points)."""

    slope: float
    slope_u: float
    intercept: float
    intercept_u: float
    r_squared: float


@dataclass(frozen=True, slots=True)
class SweepCurve:
    """One frequency's headline amplitude and phase over what was varied, repeats averaged.

    ``x``, means and standard deviations over repeats (point,), deviations NaN where a point has one repeat only;
    ``line`` goes through every shot: over the force, whose motion it is in proportion to; None over anything else, and
    where fewer than two values of x were measured.
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
        """What was varied, without its unit."""
        return self.label.partition(" (")[0]

    @property
    def is_linear(self) -> bool:
        """Whether the motion is in proportion to what was varied."""
        return self.label in PROPORTIONAL


def make_sweep(shots: Sequence[ShotResult]) -> Sweep | None:
    """Return the curves of ``shots``; None for a single shot."""
    if len(shots) < 2:
        return None
    for name in shots[0].swept:
        if len({shot.swept[name] for shot in shots}) > 1:
            groups = [", ".join([*_others(shot, name, shots), _place(shot, shots)]).strip(", ") for shot in shots]
            return _sweep(name, shots, [shot.swept[name] for shot in shots], groups)
    for label, places_m in (
        ("place beside the push (mm)", [shot.lateral_offset_m for shot in shots]),
        ("place along the beam (mm)", [shot.axial_offset_m for shot in shots]),
    ):
        if len(set(places_m)) > 1:
            return _sweep(label, shots, [place_m * 1e3 for place_m in places_m], [_setting(s, shots) for s in shots])
    if len({shot.force_fraction for shot in shots}) > 1:
        forces = [shot.force_fraction for shot in shots]
        return _sweep(FORCE, shots, forces, [_setting(shot, shots) for shot in shots])
    lengths = [_length(shot) for shot in shots]
    if len({shot.pulse_rate_hz for shot in shots}) > 1:
        return _sweep("pulse rate f_prf (Hz)", shots, [shot.pulse_rate_hz for shot in shots], lengths)
    if len({shot.window_length_s for shot in shots}) > 1:
        windows_ms = [None if shot.window_length_s is None else shot.window_length_s * 1e3 for shot in shots]
        return _sweep("window T_s (ms)", shots, windows_ms, lengths)
    if len(set(lengths)) > 1:
        lengths_us = [(shot.burst_length_s or 0.0) * 1e6 for shot in shots]
        return _sweep("burst length T_b (us)", shots, lengths_us, [""] * len(shots))
    return _sweep("repeat", shots, [float(shot.repeat + 1) for shot in shots], [""] * len(shots))


def fit_line(x: FloatArray, y: FloatArray) -> Line | None:
    """Return the least-squares line through (x, y), both (point,); None where x has fewer than two values.

    Uncertainties come from 1 - R^2, so of points that leave a line by less than 1e-8 of their range they are rounding.
    """
    if x.size == 0 or not np.ptp(x) > 0:
        return None
    # Here: it takes half a second to load, and few reports are of a sweep.
    from scipy.stats import linregress

    found = linregress(x, y)
    # Two points leave no residual to take an uncertainty from, for which scipy states 0.
    slope_u, intercept_u = (found.stderr, found.intercept_stderr) if x.size > 2 else (math.nan, math.nan)
    r_squared = float(found.rvalue) ** 2 if np.ptp(y) > 0 else math.nan
    return Line(float(found.slope), float(slope_u), float(found.intercept), float(intercept_u), r_squared)


def _length(shot: ShotResult) -> str:
    return "" if shot.burst_length_s is None else f"T_b = {shot.burst_length_s * 1e6:g} us"


def _setting(shot: ShotResult, shots: Sequence[ShotResult]) -> str:
    """Return what else than the force was varied, in words."""
    words = [_length(shot)]
    if len({each.pulse_rate_hz for each in shots}) > 1:
        words.append(f"f_prf = {shot.pulse_rate_hz or 0:g} Hz")
    if len({each.window_length_s for each in shots}) > 1:
        words.append(f"T_s = {(shot.window_length_s or 0) * 1e3:g} ms")
    return ", ".join(word for word in words if word)


def _others(shot: ShotResult, name: str, shots: Sequence[ShotResult]) -> Iterator[str]:
    """Yield what other axes are at, where they do not move with the axis ``name``."""
    along = {(each.swept[name], *each.swept.values()) for each in shots}
    for other, value in shot.swept.items():
        pairs = {(each.swept[name], each.swept[other]) for each in shots}
        # Taken together with the axis it has one value at each of its values, and says nothing new.
        if other != name and len(pairs) > len({first for first, *_ in along}):
            yield f"{other} = {value:g}"


def _place(shot: ShotResult, shots: Sequence[ShotResult]) -> str:
    """Return in words what is varied besides the axes."""
    words = []
    if len({each.lateral_offset_m for each in shots}) > 1:
        words.append(f"x = {shot.lateral_offset_m * 1e3:g} mm")
    if len({each.axial_offset_m for each in shots}) > 1:
        words.append(f"z = {shot.axial_offset_m * 1e3:g} mm")
    if len({each.force_fraction for each in shots}) > 1:
        words.append(f"F = {shot.force_fraction or 0:g} F_0")
    if len({each.burst_length_s for each in shots}) > 1:
        words.append(_length(shot))
    if len({each.window_length_s for each in shots}) > 1:
        words.append(f"T_s = {(shot.window_length_s or 0) * 1e3:g} ms")
    return ", ".join(words)


def _sweep(label: str, shots: Sequence[ShotResult], x: Sequence[float | None], groups: Sequence[str]) -> Sweep:
    places = np.array([math.nan if value is None else value for value in x], dtype=np.float64)
    names = list(dict.fromkeys(groups))
    # An axis that moves the wanted frequencies leaves a curve the shots that have its frequency.
    frequencies_hz = dict.fromkeys(estimate.frequency_hz for shot in shots for estimate in shot.estimates)
    curves = []
    for frequency_hz, name in itertools.product(frequencies_hz, names):
        own = [
            (estimate.headline, x)
            for shot, group, x in zip(shots, groups, places, strict=True)
            for estimate in shot.estimates
            if group == name and estimate.frequency_hz == frequency_hz
        ]
        if own:
            headlines, along = [headline for headline, _ in own], np.array([x for _, x in own])
            curves.append(_curve(frequency_hz, name, headlines, along, label in PROPORTIONAL))
    return Sweep(label, tuple(curves))


def _curve(frequency_hz: float, group: str, found: Sequence[Headline], x: FloatArray, linear: bool) -> SweepCurve:
    amplitude = np.array([headline.amplitude_m for headline in found])
    phase = np.array([headline.phase_rad for headline in found])
    values = np.unique(x)
    each = [x == value for value in values]
    amplitudes = [_spread(amplitude[here]) for here in each]
    phases = [_circular(phase[here]) for here in each]
    return SweepCurve(
        frequency_hz=frequency_hz,
        group=group,
        x=values,
        amplitude_m=np.array([mean for mean, _ in amplitudes]),
        amplitude_sd_m=np.array([sd for _, sd in amplitudes]),
        phase_rad=np.array([mean for mean, _ in phases]),
        phase_sd_rad=np.array([sd for _, sd in phases]),
        repeats=max(int(here.sum()) for here in each),
        line=fit_line(x, amplitude) if linear else None,
    )


def _spread(values: FloatArray) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1)) if values.size > 1 else math.nan


def _circular(phase: FloatArray) -> tuple[float, float]:
    """Return circular mean and standard deviation about it; a plain mean fails where phases pass half a turn."""
    mean = float(np.angle(np.exp(1j * phase).mean()))
    away = np.angle(np.exp(1j * (phase - mean)))
    return mean, float(np.sqrt(away @ away / (phase.size - 1))) if phase.size > 1 else math.nan
