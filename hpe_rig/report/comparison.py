"""Comparison of two runs: different settings, results side by side, and the significance of each difference.

For independent errors of standard uncertainties u, with d the difference of the two results:

    X = (d_A)² / (u_A1² + u_A2²) + (d_phi)² / (u_phi1² + u_phi2²)        chi-square of two degrees of freedom
    p = exp(-X / 2)

p_all uses the uncertainties from all sources, p_noise those that are independent between shots.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.bench import settings_differences
from hpe_rig.plan import SAME_TIME_ZERO, time_zero_event
from hpe_rig.result import (
    INDEPENDENT_SOURCES,
    RECTIFIED,
    REPEAT_SETTINGS,
    Estimate,
    RepeatMean,
    Result,
    ShotResult,
    dataclass_schema,
    json_values,
    object_schema,
    titled,
)
from hpe_rig.runs import Run, open_run
from hpe_rig.scene import Scene, parse_toml, plural
from hpe_rig.store import StoreError, read_snapshots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIGNIFICANCE = 0.01
"""Probability of a difference by chance below which the runs differ."""

DERIVED = {
    "setting": str,
    "amplitude_change": float,
    "phase_change_rad": float,
    "amplitude_change_over_u": float,
    "phase_change_over_u": float,
    "verdict": str,
}

Setting = tuple[tuple[str, float | None], ...]
"""Names and values of all settings, in a fixed order."""


@dataclass(frozen=True, slots=True)
class SettingDifference:
    """One different setting: its source and name, and its value in either run, None if absent."""

    where: str
    what: str
    before: Any
    after: Any


@dataclass(frozen=True, slots=True)
class ResultDifference:
    """One frequency at one setting in both runs.

    ``amplitude_m`` and ``phase_rad`` (first, second) with combined standard uncertainties. ``p_all``: probability of an
    equal or larger difference by chance, if all sources of uncertainty are independent in the two runs. ``p_noise``: as
    above, if only noise and trigger jitter are independent, that is for the same position, beams and specimen.
    ``shots`` (first, second), counted from 1. ``settings``: values in the first run by name.
    """

    settings: Mapping[str, float | None]
    shots: tuple[str, str]
    frequency_hz: float
    amplitude_m: tuple[float, float]
    amplitude_uncertainty_m: tuple[float, float]
    phase_rad: tuple[float, float]
    phase_uncertainty_rad: tuple[float, float]
    p_all: float
    p_noise: float

    @property
    def setting(self) -> str:
        """The settings in words."""
        return _setting_text(self.settings)

    def setting_text(self, name: str) -> str:
        """Return the value of the setting ``name`` as text."""
        return _value_text(name, self.settings[name])

    @property
    def amplitude_change(self) -> float:
        """Second amplitude over the first, minus one."""
        return self.amplitude_m[1] / self.amplitude_m[0] - 1 if self.amplitude_m[0] else math.nan

    @property
    def phase_change_rad(self) -> float:
        """Second phase minus the first, in [-pi, pi]."""
        return math.remainder(self.phase_rad[1] - self.phase_rad[0], 2 * math.pi)

    @property
    def amplitude_change_over_u(self) -> float:
        """Difference of the amplitudes over its combined standard uncertainty."""
        return _over_u(self.amplitude_m[1] - self.amplitude_m[0], self.amplitude_uncertainty_m)

    @property
    def phase_change_over_u(self) -> float:
        """Difference of the phases over its combined standard uncertainty."""
        return _over_u(self.phase_change_rad, self.phase_uncertainty_rad)

    @property
    def change_over_u(self) -> float:
        """Difference of amplitude and phase together in standard uncertainties, the root of chi-square."""
        return math.hypot(self.amplitude_change_over_u, self.phase_change_over_u)

    @property
    def verdict(self) -> str:
        """Whether the two differ, differ only if position, beams and specimen are the same, or agree."""
        if self.p_all < SIGNIFICANCE:
            return "differs"
        return "differs if alike" if self.p_noise < SIGNIFICANCE else "agrees"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs side by side.

    ``origins``: measured, simulated or imported. ``alone``: settings for which only one run has a result.
    """

    names: tuple[str, str]
    titles: tuple[str, str]
    origins: tuple[str, str]
    estimators: tuple[str, str]
    settings: tuple[SettingDifference, ...]
    results: tuple[ResultDifference, ...]
    alone: tuple[str, ...]

    def sentence(self) -> str:
        """Return how many results differ, and the largest difference in percent, degrees and u."""
        if not self.results:
            return "no setting and frequency has a result in both"
        verdicts = [row.verdict for row in self.results]
        differing, if_alike = verdicts.count("differs"), verdicts.count("differs if alike")
        largest = max(self.results, key=lambda row: row.change_over_u)
        where = "".join(f", {name} = {largest.setting_text(name)}" for name in self.varied_settings())
        text = (
            f"{_differ(differing, len(verdicts))}; most changed at {largest.frequency_hz:g} Hz{where}: amplitude "
            f"{100 * largest.amplitude_change:+z.1f} %{_in_u(largest.amplitude_change_over_u)}, phase "
            f"{math.degrees(largest.phase_change_rad):+z.2f} deg{_in_u(largest.phase_change_over_u)}"
        )
        if if_alike:
            count_if_alike = _differ(differing + if_alike, len(verdicts))
            text += f". If position, beams and specimen are the same in both runs, {count_if_alike}"
        return text

    def varied_settings(self) -> list[str]:
        """Return the names of the settings that differ between the results."""
        first, *others = (row.settings for row in self.results)
        return [name for name in first if any(settings[name] != first[name] for settings in others)]

    def as_dict(self) -> dict[str, Any]:
        """Return all values in the form of JSON."""
        tables = asdict(self)
        for row, result in zip(tables["results"], self.results, strict=True):
            row |= {name: getattr(result, name) for name in DERIVED}
        plain: dict[str, Any] = json_values(tables)
        return plain

    def figure(self, *, ax: Sequence[Axes] | None = None, figsize: tuple[float, float] = (9.0, 6.5)) -> Figure:
        """Return amplitudes and phases of both runs over frequency with bars of 2 u, and their differences over u.

        ``ax``: four axes, amplitude and phase above their differences; ``figsize`` of a new figure, inches.
        """
        return _figure(self, ax, figsize)


def _in_u(change_over_u: float) -> str:
    return f" ({abs(change_over_u):.1f} u)" if math.isfinite(change_over_u) else " (u is 0)"


def _differ(count: int, total: int) -> str:
    """Return that ``count`` of ``total`` results differ."""
    if not count:
        return "the only result does not differ" if total == 1 else f"none of {total} results differs"
    return f"{count} of {plural(total, 'result')} {'differs' if count == 1 else 'differ'}"


def comparison_schema() -> dict[str, Any]:
    """Return the JSON schema of the output of ``hpe-rig compare --json``."""
    row = dataclass_schema(ResultDifference, **object_schema("", DERIVED)["properties"])
    return titled("Comparison of hpe-rig", dataclass_schema(Comparison, results={"type": "array", "items": row}))


def compare_runs(first: Path, second: Path, estimator: str | None = None) -> Comparison:
    """Return the comparison of two runs, estimated from their records; repeats are averaged.

    ``estimator`` replaces that of each scene. Raises as ``open_run`` and ``Run.estimate``, and ``StoreError`` if the
    phases of the two runs count from different events.
    """
    runs = open_run(first), open_run(second)
    _refuse_unlike_phases(*runs)
    # Estimated again: stored results may come from other versions or estimators.
    results = runs[0].estimate(estimator), runs[1].estimate(estimator)
    pairs, alone = _pairs(_points(results[0]), _points(results[1]), (first.name, second.name))
    return Comparison(
        names=(first.name, second.name),
        titles=(results[0].title, results[1].title),
        origins=(results[0].origin, results[1].origin),
        estimators=(results[0].estimator, results[1].estimator),
        settings=tuple(_settings_differences(*runs)),
        results=tuple(row for setting, (a, b) in pairs for row in _result_differences(setting, a, b)),
        alone=tuple(alone),
    )


def _refuse_unlike_phases(first: Run, second: Run) -> None:
    """Raise ``StoreError`` if the phases of two runs count from different events."""
    events = [time_zero_event(run.scene) for run in (first, second)]
    if events[0] != events[1]:
        raise StoreError(
            f"{first.path.name} and {second.path.name} cannot be compared: their phases count from {events[0]} and "
            f"from {events[1]}. Try: {SAME_TIME_ZERO}."
        )


@dataclass(frozen=True, slots=True)
class _Point:
    """Result at one frequency of a setting, and its independent uncertainties."""

    shots: str
    value: Estimate | RepeatMean
    noise_m: float
    noise_rad: float


Points = dict[Setting, dict[float, _Point]]
"""Results by setting and frequency."""


def _points(result: Result) -> Points:
    """Return the means over repeats, and the shots of settings without repeats."""
    points: Points = {}
    for mean in result.means:
        shots, root = f"mean of {len(mean.shots)}", math.sqrt(len(mean.shots))
        # The scatter of the repeats measures their independent errors.
        point = _Point(shots, mean, mean.amplitude_sd_m / root, mean.phase_sd_rad / root)
        points.setdefault(_setting(mean), {})[mean.frequency_hz] = point
    repeated = set(points)
    for shot in result.shots:
        if (setting := _setting(shot)) not in repeated:
            for estimate in shot.estimates:
                independent = [item for item in estimate.budget if item.source in (*INDEPENDENT_SOURCES, RECTIFIED)]
                noise_m = math.hypot(*(item.amplitude_m for item in independent))
                noise_rad = math.hypot(*(item.phase_rad for item in independent))
                point = _Point(f"{shot.shot}", estimate, noise_m, noise_rad)
                points.setdefault(setting, {}).setdefault(estimate.frequency_hz, point)
    return points


def _setting(result: ShotResult | RepeatMean) -> Setting:
    return *((name, getattr(result, name)) for name in REPEAT_SETTINGS), *result.swept.items()


def _pairs(
    first: Points, second: Points, names: tuple[str, str]
) -> tuple[list[tuple[Setting, tuple[dict[float, _Point], dict[float, _Point]]]], list[str]]:
    """Return the results of equal settings, and the settings of one run only in words.

    Runs with the same number of settings and no equal one are compared in order.
    """
    common = [setting for setting in first if setting in second]
    if not common and len(first) == len(second):
        return [(a, (first[a], second[b])) for a, b in zip(first, second, strict=True)], []
    alone = [f"{_setting_text(dict(setting))}: in {names[0]} alone" for setting in first if setting not in second]
    alone += [f"{_setting_text(dict(setting))}: in {names[1]} alone" for setting in second if setting not in first]
    return [(setting, (first[setting], second[setting])) for setting in common], alone


def _result_differences(
    setting: Setting, first: Mapping[float, _Point], second: Mapping[float, _Point]
) -> Iterator[ResultDifference]:
    for frequency_hz in (hz for hz in first if hz in second):
        a, b = first[frequency_hz], second[frequency_hz]
        # Phases differ modulo a turn.
        difference = (
            b.value.amplitude_m - a.value.amplitude_m,
            math.remainder(b.value.phase_rad - a.value.phase_rad, 2 * math.pi),
        )
        all_sources = (
            math.hypot(a.value.amplitude_uncertainty_m, b.value.amplitude_uncertainty_m),
            math.hypot(a.value.phase_uncertainty_rad, b.value.phase_uncertainty_rad),
        )
        noise = math.hypot(a.noise_m, b.noise_m), math.hypot(a.noise_rad, b.noise_rad)
        yield ResultDifference(
            settings=dict(setting),
            shots=(a.shots, b.shots),
            frequency_hz=frequency_hz,
            amplitude_m=(a.value.amplitude_m, b.value.amplitude_m),
            amplitude_uncertainty_m=(a.value.amplitude_uncertainty_m, b.value.amplitude_uncertainty_m),
            phase_rad=(a.value.phase_rad, b.value.phase_rad),
            phase_uncertainty_rad=(a.value.phase_uncertainty_rad, b.value.phase_uncertainty_rad),
            p_all=_probability(difference, all_sources),
            p_noise=_probability(difference, noise),
        )


def _probability(difference: tuple[float, float], u: tuple[float, float]) -> float:
    """Return exp(-X / 2) of the differences of amplitude and phase with standard uncertainties ``u``."""
    chi_square = 0.0
    for value, uncertainty in zip(difference, u, strict=True):
        chi_square += (value / uncertainty) ** 2 if uncertainty > 0 else math.inf if value else 0.0
    return math.exp(-chi_square / 2)


def _setting_text(settings: Mapping[str, float | None]) -> str:
    texts = [f"{name} = {_value_text(name, value)}" for name, value in settings.items() if value]
    return ", ".join(texts) or "the only setting"


def _value_text(name: str, value: float | None) -> str:
    """Return a value as text; a force follows from the voltage of a generator, which is set with four digits."""
    return format(value or 0.0, ".4g" if name == "force_fraction" else "g")


def _settings_differences(first: Run, second: Run) -> Iterator[SettingDifference]:
    """Yield the differences of scene, bench file, and settings read back from the instruments in the last shot."""
    recordings = [run.bench.recording for run in (first, second)]
    has_bench = [recording is None for recording in recordings]
    files = [("scene", "scene_toml"), ("bench file", "bench_toml")]
    for where, attribute in files if has_bench[0] == has_bench[1] else files[:1]:
        yield from _file_differences(first, second, where, attribute)
    if has_bench[0] != has_bench[1]:
        # An imported recording has no bench of which single settings could differ.
        yield SettingDifference("bench file", "imported from", *(item and item.words for item in recordings))
        return
    snapshots = [(read_snapshots(run.path) or ({},))[-1] for run in (first, second)]
    for item in settings_differences(*snapshots):
        name = f"{item.what} ({item.unit})" if item.unit else item.what
        yield SettingDifference(f"set: {item.where}", name, item.before, item.after)


def _file_differences(first: Run, second: Run, where: str, attribute: str) -> Iterator[SettingDifference]:
    """Yield the differences between the scenes or bench files that the runs store under ``attribute``."""
    before, after = (dict(_flat(parse_toml(getattr(run.stored, attribute), where))) for run in (first, second))
    if where == "scene":
        # A setting that one scene leaves out has its default there.
        before, after = _defaults(first.scene, after) | before, _defaults(second.scene, before) | after
    for name in dict.fromkeys([*before, *after]):
        if _single(before.get(name)) != _single(after.get(name)):
            yield SettingDifference(where, name, before.get(name), after.get(name))


def _defaults(scene: Scene, names: Collection[str]) -> dict[str, Any]:
    """Return the values in ``scene`` of the settings ``names`` by path, without those that it lacks."""
    values = dict(_flat(scene.model_dump(mode="json", exclude_none=True)))
    return {name: values[name] for name in names if name in values}


def _single(value: Any) -> Any:
    """Return the only entry of a list of one: for a scene both mean the same."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value of nested tables by its path; a list of plain values is one value, a cable is another."""
    if isinstance(value, Mapping) and value.keys() >= {"source", "target"}:
        # By its two ends and not its number, so that a removed cable does not change those after it.
        properties = (f"{name} = {item}" for name, item in value.items() if name not in ("source", "target"))
        yield f"cable {value['source']} -> {value['target']}", ", ".join(properties) or "delay_s = 0.0"
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _flat(item, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and any(isinstance(item, Mapping | list) for item in value):
        for number, item in enumerate(value):
            yield from _flat(item, f"{path}[{number}]")
    else:
        yield path, value if isinstance(value, str | int | float | bool | list) else str(value)


def _figure(comparison: Comparison, ax: Sequence[Axes] | None, figsize: tuple[float, float]) -> Figure:
    # Loads Matplotlib, which a printed comparison does not need.
    from hpe_rig.result import PALETTE, figure_panels

    figure, all_panels = figure_panels(2, 2, ax, figsize, sharex=True, height_ratios=(2, 1))
    panels = np.reshape(np.array(all_panels, dtype=object), (2, 2))
    rows = comparison.results
    frequency_hz = np.array([row.frequency_hz for row in rows])
    # Both runs are shifted by this distance from the frequency, so that neither hides the other.
    shift_hz = 0.003 * (float(np.ptp(frequency_hz)) if frequency_hz.size > 1 else 100.0)
    quantities = (
        ("amplitude_m", "amplitude_uncertainty_m", "amplitude_change_over_u", "amplitude / nm", 1e9),
        ("phase_rad", "phase_uncertainty_rad", "phase_change_over_u", "phase / deg", 180 / math.pi),
    )
    for (above, below), (value, u, change, label, factor) in zip(panels.T, quantities, strict=True):
        for run, (name, colour, marker) in enumerate(zip(comparison.names, PALETTE, "os", strict=False)):
            values = [getattr(row, value)[run] * factor for row in rows]
            bars = [2 * getattr(row, u)[run] * factor for row in rows]
            x = frequency_hz + (2 * run - 1) * shift_hz
            text = f"{name}, {comparison.origins[run]}"
            above.errorbar(x, values, bars, fmt=marker, color=colour, label=text, ms=5)
        below.axhspan(-2, 2, color="0.9")
        differences = [getattr(row, change) for row in rows]
        below.plot(frequency_hz, differences, "D", color=PALETTE[2], ms=5)
        above.set_ylabel(f"{label}, bars: 2 u")
        below.set(xlabel="frequency / Hz", ylabel="difference / u")
    if np.unique(frequency_hz).size == 1:
        panels[0, 0].set(xticks=frequency_hz[:1], xlim=(frequency_hz[0] - 5, frequency_hz[0] + 5))
    if ax is None:
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
        estimators = " and ".join(dict.fromkeys(comparison.estimators))
        figure.suptitle(f"{comparison.names[0]} and {comparison.names[1]}, estimator {estimators}", wrap=True)
    else:
        panels[0, 0].legend(frameon=False)
    for panel in panels.flat:
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    return figure


def _over_u(difference: float, u: tuple[float, float]) -> float:
    """Return ``difference`` over the combined ``u`` of the two values."""
    combined = math.hypot(*u)
    if combined > 0:
        return difference / combined
    return math.copysign(math.inf, difference) if difference else 0.0
