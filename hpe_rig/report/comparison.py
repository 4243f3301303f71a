"""Comparison of two runs: settings that differ, results side by side, and how significant each difference is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.bench import settings_differences
from hpe_rig.result import (
    PALETTE,
    RECTIFIED,
    Component,
    Headline,
    RepeatMean,
    Result,
    ShotResult,
    dataclass_schema,
    json_values,
    titled,
    type_schema,
)
from hpe_rig.runs import Run, open_run
from hpe_rig.scene import parse_toml
from hpe_rig.store import read_snapshots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OWN_TO_A_SHOT = ("noise", "trigger jitter", RECTIFIED)
"""Sources of uncertainty that are drawn anew in every shot; others may be the same in both runs, or not."""
UNLIKELY = 0.01

DERIVED = {"amplitude_change": float, "phase_change_rad": float, "verdict": str}

Setting = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class SettingDifference:
    """One setting that is not the same: where it stands, and its value in either run, None where it is absent."""

    where: str
    what: str
    before: Any
    after: Any


@dataclass(frozen=True, slots=True)
class ResultDifference:
    """One frequency at one setting in both runs.

    ``amplitude_m`` and ``phase_rad`` (first, second) with combined standard uncertainties. ``p_all``: probability of as
    large a difference, amplitude and phase together, where nothing differs and all sources of uncertainty are
    independent in the two runs; ``p_noise``: where only noise and trigger jitter are, all else being the same in both:
    the same place, beams and specimen. ``shots`` (first, second), counted from 1.
    """

    setting: str
    shots: tuple[str, str]
    frequency_hz: float
    amplitude_m: tuple[float, float]
    amplitude_uncertainty_m: tuple[float, float]
    phase_rad: tuple[float, float]
    phase_uncertainty_rad: tuple[float, float]
    p_all: float
    p_noise: float

    @property
    def amplitude_change(self) -> float:
        """Second amplitude over the first, less one."""
        return self.amplitude_m[1] / self.amplitude_m[0] - 1 if self.amplitude_m[0] else math.nan

    @property
    def phase_change_rad(self) -> float:
        """Second phase less the first, within half a turn."""
        return math.remainder(self.phase_rad[1] - self.phase_rad[0], 2 * math.pi)

    @property
    def verdict(self) -> str:
        """Whether the two differ, differ only if place, beams and specimen are the same in both, or agree."""
        if self.p_all < UNLIKELY:
            return "differs"
        return "differs if alike" if self.p_noise < UNLIKELY else "agrees"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs beside each other.

    ``origins``: measured, simulated or imported; ``alone`` says which settings only one of them has a result for.
    """

    names: tuple[str, str]
    titles: tuple[str, str]
    origins: tuple[str, str]
    estimators: tuple[str, str]
    settings: tuple[SettingDifference, ...]
    results: tuple[ResultDifference, ...]
    alone: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON has it."""
        tables = asdict(self)
        for row, found in zip(tables["results"], self.results, strict=True):
            row |= {name: getattr(found, name) for name in DERIVED}
        plain: dict[str, Any] = json_values(tables)
        return plain

    def figure(self) -> Figure:
        """Return amplitudes and phases of both runs over frequency with bars of 2 u, and their differences in u."""
        return _figure(self)


def comparison_schema() -> dict[str, Any]:
    """Return the JSON schema of what ``hpe-rig compare --json`` prints."""
    row = dataclass_schema(ResultDifference, **{name: type_schema(kind) for name, kind in DERIVED.items()})
    return titled("Comparison of hpe-rig", dataclass_schema(Comparison, results={"type": "array", "items": row}))


def compare_runs(first: Path, second: Path, estimator: str | None = None) -> Comparison:
    """Return what differs between two runs; results are estimated from the records, by each scene's estimator.

    ``estimator`` in place of these. Repeats are taken as their mean. Raises as ``open_run`` and ``Run.estimate``.
    """
    runs = open_run(first), open_run(second)
    results = runs[0].estimate(estimator), runs[1].estimate(estimator)
    one, other = (_points(result) for result in results)
    pairs, alone = _pairs(one, other, (first.name, second.name))
    return Comparison(
        names=(first.name, second.name),
        titles=(results[0].title, results[1].title),
        origins=(results[0].origin, results[1].origin),
        estimators=(results[0].estimator, results[1].estimator),
        settings=tuple(_settings(*runs)),
        results=tuple(row for setting, (a, b) in pairs for row in _rows(setting, a, b)),
        alone=tuple(alone),
    )


@dataclass(frozen=True, slots=True)
class _Found:
    """One frequency of a setting: value, its uncertainties, and what of them noise alone leaves."""

    shots: str
    value: Headline | RepeatMean
    noise_m: float
    noise_rad: float


def _points(result: Result) -> dict[Setting, dict[float, _Found]]:
    """Return what was found by setting and frequency: the mean over repeats, else the shot's own."""
    points: dict[Setting, dict[float, _Found]] = {}
    for mean in result.means:
        shots, root = f"mean of {len(mean.shots)}", math.sqrt(len(mean.shots))
        found = _Found(shots, mean, mean.amplitude_sd_m / root, mean.phase_sd_rad / root)
        points.setdefault(_setting(mean), {})[mean.frequency_hz] = found
    repeated = set(points)
    for shot in result.shots:
        if (setting := _setting(shot)) not in repeated:
            for each in shot.estimates:
                own = [part for part in each.budget if part.source in OWN_TO_A_SHOT]
                found = _Found(f"{shot.shot + 1}", each.headline, *_combined(own))
                points.setdefault(setting, {}).setdefault(each.frequency_hz, found)
    return points


def _combined(parts: list[Component]) -> tuple[float, float]:
    return math.hypot(*(part.amplitude_m for part in parts)), math.hypot(*(part.phase_rad for part in parts))


def _setting(of: ShotResult | RepeatMean) -> Setting:
    names = ("burst_length_s", "force_fraction", "pulse_rate_hz", "window_length_s", "lateral_offset_m")
    return *((name, getattr(of, name)) for name in (*names, "axial_offset_m")), *of.swept.items()


def _pairs(
    one: Mapping[Setting, Any], other: Mapping[Setting, Any], names: tuple[str, str]
) -> tuple[list[tuple[Setting, tuple[Any, Any]]], list[str]]:
    """Return what is compared: equal settings, or where none is equal and there are as many, in their order."""
    common = [setting for setting in one if setting in other]
    if not common and len(one) == len(other):
        return [(a, (one[a], other[b])) for a, b in zip(one, other, strict=True)], []
    alone = [f"{_words(setting)}: in {names[0]} alone" for setting in one if setting not in other]
    alone += [f"{_words(setting)}: in {names[1]} alone" for setting in other if setting not in one]
    return [(setting, (one[setting], other[setting])) for setting in common], alone


def _rows(setting: Setting, one: Mapping[float, _Found], other: Mapping[float, _Found]) -> Iterator[ResultDifference]:
    for frequency_hz in (hz for hz in one if hz in other):
        a, b = one[frequency_hz], other[frequency_hz]
        all_m = math.hypot(a.value.amplitude_uncertainty_m, b.value.amplitude_uncertainty_m)
        all_rad = math.hypot(a.value.phase_uncertainty_rad, b.value.phase_uncertainty_rad)
        apart_m = b.value.amplitude_m - a.value.amplitude_m
        apart_rad = math.remainder(b.value.phase_rad - a.value.phase_rad, 2 * math.pi)
        yield ResultDifference(
            setting=_words(setting),
            shots=(a.shots, b.shots),
            frequency_hz=frequency_hz,
            amplitude_m=(a.value.amplitude_m, b.value.amplitude_m),
            amplitude_uncertainty_m=(a.value.amplitude_uncertainty_m, b.value.amplitude_uncertainty_m),
            phase_rad=(a.value.phase_rad, b.value.phase_rad),
            phase_uncertainty_rad=(a.value.phase_uncertainty_rad, b.value.phase_uncertainty_rad),
            p_all=_probability(apart_m, all_m, apart_rad, all_rad),
            p_noise=_probability(
                apart_m, math.hypot(a.noise_m, b.noise_m), apart_rad, math.hypot(a.noise_rad, b.noise_rad)
            ),
        )


def _probability(apart_m: float, u_m: float, apart_rad: float, u_rad: float) -> float:
    """Return the probability of as large a chi-square of two degrees of freedom, exp(-chi2 / 2)."""
    chi_square = 0.0
    for apart, u in ((apart_m, u_m), (apart_rad, u_rad)):
        chi_square += (apart / u) ** 2 if u > 0 else math.inf if apart else 0.0
    return math.exp(-chi_square / 2)


def _words(setting: Setting) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in setting if value) or "the only setting"


def _settings(first: Run, second: Run) -> Iterator[SettingDifference]:
    """Yield what differs in scene, bench file and the instruments' settings as read back in the last shot."""
    for where, text in (("scene", "scene_toml"), ("bench file", "bench_toml")):
        one, other = (dict(_flat(parse_toml(getattr(run.stored, text), where))) for run in (first, second))
        for name in dict.fromkeys([*one, *other]):
            if _alone(one.get(name)) != _alone(other.get(name)):
                yield SettingDifference(where, name, one.get(name), other.get(name))
    snapshots = [(read_snapshots(run.path) or ({},))[-1] for run in (first, second)]
    for found in settings_differences(*snapshots):
        what = f"{found.what} ({found.unit})" if found.unit else found.what
        yield SettingDifference(f"set: {found.where}", what, found.before, found.after)


def _alone(value: Any) -> Any:
    """Return the only entry of a list as itself, as a scene takes either."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value of nested tables by its path; a list of plain values is one value."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(inner, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and any(isinstance(each, Mapping | list) for each in value):
        for number, inner in enumerate(value):
            yield from _flat(inner, f"{path}[{number}]")
    else:
        yield path, value if isinstance(value, str | int | float | bool | list) else str(value)


def _figure(found: Comparison) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, height_ratios=(2, 1))
    frequency_hz = np.array([row.frequency_hz for row in found.results])
    # A little apart, so that neither run hides the other.
    aside_hz = 0.006 * (float(np.ptp(frequency_hz)) if frequency_hz.size > 1 else 100.0)
    kinds = (
        ("amplitude_m", "amplitude_uncertainty_m", "amplitude / nm", 1e9),
        ("phase_rad", "phase_uncertainty_rad", "phase / deg", 180 / math.pi),
    )
    for column, (value, u, label, factor) in enumerate(kinds):
        for side, (name, colour, mark) in enumerate(zip(found.names, PALETTE, "os", strict=False)):
            values = [getattr(row, value)[side] * factor for row in found.results]
            bars = [2 * getattr(row, u)[side] * factor for row in found.results]
            panels[0, column].errorbar(
                frequency_hz + (side - 0.5) * aside_hz,
                values,
                bars,
                fmt=mark,
                color=colour,
                label=f"{name}, {found.origins[side]}",
                ms=5,
            )
        apart = [_in_u(getattr(row, value), getattr(row, u), column == 1) for row in found.results]
        panels[1, column].axhspan(-2, 2, color="0.9")
        panels[1, column].plot(frequency_hz, apart, "D", color=PALETTE[2], ms=5)
        panels[0, column].set_ylabel(f"{label}, bars: 2 u")
        panels[1, column].set_ylabel("difference / u")
        panels[1, column].set_xlabel("frequency / Hz")
    if np.unique(frequency_hz).size == 1:
        panels[0, 0].set(xticks=frequency_hz[:1], xlim=(frequency_hz[0] - 5, frequency_hz[0] + 5))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    figure.suptitle(f"{found.names[0]} and {found.names[1]}, estimator {' and '.join(dict.fromkeys(found.estimators))}")
    for panel in panels.flat:
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    return figure


def _in_u(values: tuple[float, float], u: tuple[float, float], angle: bool) -> float:
    apart = math.remainder(values[1] - values[0], 2 * math.pi) if angle else values[1] - values[0]
    return apart / math.hypot(*u) if math.hypot(*u) > 0 else math.nan
