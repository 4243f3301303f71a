"""Work-precision of the echo engine: relative error against run time, every evaluation, scenes small to large."""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray, IndexArray
from hpe_rig.result import csv_text, label_decades, mark
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.validation.accuracy.work_precision import file_mistakes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sim_backend.echoes import EchoDelays, Method, Pulse


TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
SCATTERERS = (100, 1_000, 10_000, 100_000, 1_000_000)
ECHOES = (10, 100, 1_000, 10_000)

_SAMPLES = 130
_SAMPLE_PERIOD_S = 1e-8
_SOUND_SPEED_M_PER_S = 1540.0
_AMPLITUDE_M = 1e-6
_CHECKED_ECHOES = 6
# Rough seconds a scatterer and echo, to know what to leave out before it is run.
_DIRECT_PAIR_S, _EXACT_PAIR_S = 6e-6, 2.5e-7
CHOSEN = "engine"
"""Among the evaluations: whichever the engine takes where it is only told the tolerance."""
REFERENCE = "direct"
"""Among the evaluations: the double sum as written, which the engine never takes."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One evaluation of one scene."""

    scatterers: int
    echoes: int
    samples: int
    evaluation: str
    """By name, or ``engine``: the one it takes."""
    method: str
    """What was run."""
    tolerance: float
    terms: int
    """Terms of the series; 0 for an exact sum."""
    error: float
    """Rms difference from the direct sum over its rms, in up to 6 of the echoes."""
    time_s: float
    """Median."""
    displacement_error_m: float
    """What that error is as motion: error times c / (4 pi f)."""
    cores: int


def measurements(
    scatterers: tuple[int, ...] = SCATTERERS,
    echoes: tuple[int, ...] = ECHOES,
    tolerances: tuple[float, ...] = TOLERANCES,
    longest_s: float = 5.0,
    seed: int = 0,
) -> Iterator[Measurement]:
    """Yield every evaluation of every scene that is expected to take at most ``longest_s``.

    Scene: Table I's pulse, gate and 1 um of 20 pulses a cycle; the density of its scatterers grows with their number.
    """
    for count in scatterers:
        for echo_count in echoes:
            yield from _of_scene(count, echo_count, tolerances, longest_s, seed)


def _of_scene(
    count: int, echoes: int, tolerances: tuple[float, ...], longest_s: float, seed: int
) -> Iterator[Measurement]:
    from sim_backend.echoes import direct_sum, method_times_s, synthesise

    delays, weight, pulse, gate_s = _scene(count, echoes, seed)
    checked = np.unique(np.linspace(0, echoes - 1, _CHECKED_ECHOES).astype(int))
    exact = _reference(delays, weight, pulse, gate_s, checked)
    most_s, cores = min(0.3, longest_s / 10), os.cpu_count() or 1

    def row(name: str, method: str, tolerance: float, terms: int, echo: FloatArray, time_s: float) -> Measurement:
        error = float(np.sqrt(np.mean(np.square(echo[checked] - exact)) / np.mean(np.square(exact))))
        moved_m = float(error * _SOUND_SPEED_M_PER_S / (4 * np.pi * 9.0e6))
        return Measurement(count, echoes, _SAMPLES, name, method, tolerance, terms, error, time_s, moved_m, cores)

    def measured(method: Method | None, tolerance: float) -> Measurement:
        made = synthesise(delays, weight, pulse, gate_s, tolerance, method)
        time_s = median_s(lambda: synthesise(delays, weight, pulse, gate_s, tolerance, method), most_s)
        return row(method or CHOSEN, made.method, tolerance, made.terms, made.echo, time_s)

    if count * echoes * _DIRECT_PAIR_S <= longest_s:
        delay_s = delays.delay_s()
        time_s = median_s(lambda: direct_sum(delay_s, weight, pulse, gate_s), most_s)
        yield row(REFERENCE, REFERENCE, 0.0, 0, direct_sum(delay_s, weight, pulse, gate_s), time_s)
    if count * echoes * _EXACT_PAIR_S <= longest_s:
        yield measured("running_sum", 0.0)
    for tolerance in tolerances:
        times_s = method_times_s(delays, pulse, gate_s, tolerance)
        for method, time_s in times_s.items():
            if method != "running_sum" and time_s <= longest_s:
                yield measured(method, tolerance)
        if min(times_s.values()) <= longest_s:
            yield measured(None, tolerance)


def share_chosen_well(rows: list[Measurement], factor: float = 2.0) -> tuple[int, int]:
    """Return in how many cases the engine's choice took at most ``factor`` of the fastest evaluation's time, of all."""
    chosen = [row for row in rows if row.evaluation == CHOSEN]
    well = 0
    for row in chosen:
        rivals = [
            other.time_s
            for other in rows
            if (other.scatterers, other.echoes) == (row.scatterers, row.echoes)
            and other.tolerance in (0.0, row.tolerance)
        ]
        well += row.time_s <= factor * min(rivals)
    return well, len(chosen)


def _reference(
    delays: EchoDelays, weight: FloatArray, pulse: Pulse, gate_s: FloatArray, checked: IndexArray
) -> FloatArray:
    """Return the direct sum, or where that is too long the exact running sum, which equals it to 1e-13."""
    from sim_backend.echoes import direct_sum, running_sum

    delay_s = delays.rest_s + delays.amplitude_s[checked] @ delays.shape
    exact = direct_sum if len(weight) <= 10_000 else running_sum
    return exact(delay_s, weight, pulse, gate_s)


def _scene(count: int, echoes: int, seed: int) -> tuple[EchoDelays, FloatArray, Pulse, FloatArray]:
    from sim_backend.echoes import EchoDelays, depth_delay_s, field_at, hann_pulse
    from sim_backend.settings import Beams, Scatterers

    scatterers = Scatterers()
    place = np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)) * np.array(scatterers.volume_m)
    field = field_at(place, Beams())
    displacement_m = _AMPLITUDE_M * np.sin(2 * np.pi * np.arange(echoes) / 20 + 0.1)
    gate_s = np.asarray((np.arange(_SAMPLES) - (_SAMPLES - 1) / 2) * _SAMPLE_PERIOD_S, dtype=np.float64)
    rest_s = depth_delay_s(field, scatterers.axial_delay, _SOUND_SPEED_M_PER_S)
    amplitude_s = displacement_m[:, None] * (2 / _SOUND_SPEED_M_PER_S)
    delays = EchoDelays(rest_s, field.motion_weight[None], amplitude_s)
    return delays, field.tracking_weight, hann_pulse(9.0e6, scatterers.bandwidth), gate_s


def median_s(run: Callable[[], object], most_s: float) -> float:
    """Return the median run time of 1 to 15 runs that together take about ``most_s``, after one that warms up."""
    run()
    taken: list[float] = []
    while len(taken) < 15 and (not taken or sum(taken) < most_s):
        begin = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken)


def write_accuracy(
    output: Path | None,
    figure: Path | None,
    largest: int,
    most_echoes: int,
    longest_s: float,
    show: Callable[[str], None],
) -> None:
    """Measure and write table and figure; without a file for the table ``show`` gets it.

    What was measured until an interruption is written. Raises SettingsError with everything that is wrong with the
    options, before anything is measured.
    """
    _refuse_mistakes(output, figure, largest, most_echoes, longest_s)
    scatterers = tuple(count for count in SCATTERERS if count <= largest)
    echoes = tuple(count for count in ECHOES if count <= most_echoes)
    rows: list[Measurement] = []
    try:
        rows.extend(measurements(scatterers, echoes, longest_s=longest_s))
    finally:
        if output is not None:
            output.write_text(as_text(rows, output.suffix), encoding="utf-8")
            show(f"{output}: {len(rows)} measurements")
    well, of_all = share_chosen_well(rows)
    if output is None:
        show(as_text(rows, ".csv").rstrip())
    else:
        show(f"the engine's choice took at most twice the fastest evaluation's time in {well} of {of_all} cases")
    if figure is not None:
        write_figure(rows, figure)
        show(f"{figure}")


def _refuse_mistakes(
    output: Path | None, figure: Path | None, largest: int, most_echoes: int, longest_s: float
) -> None:
    found = file_mistakes(output, figure)
    for option, value, least in (("--largest", largest, SCATTERERS[0]), ("--most-echoes", most_echoes, ECHOES[0])):
        if value < least:
            found.append(Mistake(option, f"{value} leaves no scene to measure", f"{least} or more"))
    if not longest_s > 0:
        found.append(Mistake("--longest-s", f"{longest_s} s leaves nothing to measure", "a time above 0"))
    if found:
        raise SettingsError("accuracy echo", found)


def as_text(rows: list[Measurement], suffix: str) -> str:
    """Return the table as ``.csv`` or ``.json``; raises ValueError for another suffix."""
    if suffix == ".json":
        return json.dumps([asdict(row) for row in rows], indent=1) + "\n"
    if suffix != ".csv":
        raise ValueError(f"{suffix!r} is no table format here: end the file's name in .csv or .json")
    return csv_text(rows)


def write_figure(rows: list[Measurement], path: Path) -> None:
    """Write error against run time, a panel a number of scatterers, and the engine's run time against both numbers."""
    from matplotlib.figure import Figure

    counts = sorted({row.scatterers for row in rows})
    figure = Figure(figsize=(max(7.0, 3.2 * len(counts)), 7.2), layout="constrained")
    (above,), (below,) = figure.subfigures(2, 1, squeeze=False)
    panels = above.subplots(1, len(counts), sharey=True, squeeze=False)[0]
    for panel, count in zip(panels, counts, strict=True):
        _draw_work([row for row in rows if row.scatterers == count], panel)
        panel.set(xscale="log", yscale="log", xlabel="run time (s)", title=f"{count:.0e} scatterers")
    panels[0].set_ylabel("relative rms error")
    above.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    for panel, (along, other) in zip(
        below.subplots(1, 2, sharey=True), (("scatterers", "echoes"), ("echoes", "scatterers")), strict=True
    ):
        _draw_cost(rows, panel, along, other)
    for panel in figure.get_axes():
        panel.grid(alpha=0.3)
        label_decades(panel.xaxis)
        label_decades(panel.yaxis)
    cores = rows[0].cores if rows else 0
    figure.suptitle(f"Echoes of {_SAMPLES} samples; darker is more echoes; {cores} cores, one used")
    figure.savefig(path)


def _draw_work(rows: list[Measurement], panel: Axes) -> None:
    echoes = sorted({row.echoes for row in rows})
    for kind_place, kind in enumerate(("direct", "running_sum", "series")):
        marker, colour = mark(kind_place)
        for place, echo_count in enumerate(echoes):
            some = [row for row in rows if (row.evaluation, row.echoes) == (kind, echo_count)]
            shade, label = 0.35 + 0.65 * (place + 1) / len(echoes), kind if place == 0 else None
            times, errors = [row.time_s for row in some], [max(row.error, 1e-17) for row in some]
            panel.plot(times, errors, marker=marker, color=colour, alpha=shade, ms=4, lw=0.8, label=label)
    chosen = [row for row in rows if row.evaluation == CHOSEN]
    times, errors = [row.time_s for row in chosen], [max(row.error, 1e-17) for row in chosen]
    panel.plot(times, errors, "k.", ms=3, label="the engine's choice")


def _draw_cost(rows: list[Measurement], panel: Axes, along: str, other: str) -> None:
    tolerance = 1e-8
    some = [row for row in rows if row.evaluation == CHOSEN and row.tolerance == tolerance]
    for value in sorted({getattr(row, other) for row in some}):
        line = sorted((getattr(row, along), row.time_s) for row in some if getattr(row, other) == value)
        panel.plot(*zip(*line, strict=True), marker="o", ms=4, lw=0.8, label=f"{value:.0e} {other}")
    panel.set(xscale="log", yscale="log", xlabel=along, ylabel="run time (s)", title=f"The engine at {tolerance:g}")
    if some:
        panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.1), ncols=3, frameon=False, fontsize=7)
