"""Report of finished studies, ``hpe-rig study NAME --report``: one self-contained page, every figure as SVG and PNG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from hpe_rig.processing import spec_of
from hpe_rig.result import STYLE, Picture, inline, label_decades, mark, picture
from hpe_rig.store import versions
from hpe_rig.study.curve_figures import NM, curve_alt, curve_figure
from hpe_rig.study.map_figures import map_alt, map_figure
from hpe_rig.study.page import Part, render, table
from hpe_rig.study.results import SUMMARY, StudyResult, write_whole
from hpe_rig.study.series import (
    View,
    error_figures,
    is_map,
    refused_words,
    shown,
    spans,
    views,
    warned_words,
    with_error,
)

PNG_DPI = 150
FIGURES = ("amplitude bias (%)", "amplitude jitter (%)", "phase bias (°)", "phase jitter (°)")
LEAD = (
    "Bias and jitter of eq. (14) and (15): mean and standard deviation of the error of amplitude and phase. Bands: two "
    "Monte Carlo standard errors to each side. Physical: every scatterer echoes from its own depth; literal: eq. (11) "
    "as printed, all echoes start at once, scatterers fill the gate; as printed: the same, and the amplitude keeps the "
    "gain of a difference of pulses; one draw: physical, one draw of scatterers for all realisations of noise.",
)


def write_study_report(name: str, results: Sequence[StudyResult], output: Path, lead: Iterable[Part] = ()) -> Path:
    """Write ``output``/NAME.html, ``lead`` first, and the figures beside each study's results; return the page's path.

    Raises ``SettingsError`` where the page cannot be written.
    """
    path = output / f"{name}.html"
    leading = list(lead)
    headline = leading[0].headline if leading else _headline(results)
    parts = [*leading, found_part(results), *(study_part(one, output / one.name) for one in results)]
    parts.append(run_time_part(results))
    facts = {**versions(), "cases computed with": ", ".join(sorted({v for one in results for v in one.versions}))}
    title = results[0].definition.title if len(results) == 1 else f"Parameter studies: {name}"
    write_whole(path, render(title, (headline, *LEAD), parts, facts))
    return path


def _headline(results: Sequence[StudyResult]) -> str:
    """Return what the first study found, by the paper's chain if that took part, in one sentence."""
    one = _first_of_each(results[0])[0]
    bias, jitter, _, phase_jitter = spans(one.rows)
    return (
        f"{one.title}: the amplitude's bias is {bias} %, its jitter {jitter} %, the phase's jitter {phase_jitter} deg "
        f"over {len(one.rows)} cases."
    )


def found_part(results: Sequence[StudyResult]) -> Part:
    """Return bias and jitter of every study, reading and estimator, least to largest over the cases."""
    rows: list[dict[str, Any]] = [
        {"study": result.definition.title, "reading": spelt(one.reading), "estimator": spec_of(one.estimator).label}
        | ({"frequency (Hz)": one.frequency_hz} if len({other.frequency_hz for other in views(result)}) > 1 else {})
        | dict(zip(FIGURES, spans(one.rows), strict=True))
        for result in results
        for one in views(result)
    ]
    columns = dict.fromkeys(name for row in rows for name in row)
    if len(results) == 1:
        del columns["study"]
    rows = [{name: row.get(name) for name in columns} for row in rows]
    caption = "Least to largest over the cases of a study, in % of the true amplitude and in degrees."
    return Part("found-part", "What was found", (), (), (table("found", caption, rows, False),))


def study_part(result: StudyResult, folder: Path) -> Part:
    """Return a study's section; its figures are also written to ``folder`` as SVG and PNG."""
    found = views(result)
    estimators = [one.estimator for one in found]
    # Readings of the same estimator side by side.
    side_by_side = sorted(found, key=lambda one: estimators.index(one.estimator))
    pictures = tuple(_picture(result, one, folder) for one in side_by_side)
    caption = f"{result.definition.title}: every case, with Monte Carlo standard errors."
    every = table(result.name, caption, result.rows, beside=f"{folder.name}/{SUMMARY}", shown=_shown(result))
    return Part(f"{result.name}-part", result.definition.title, _precision(result), pictures, (every,))


def _shown(result: StudyResult) -> list[dict[str, Any]]:
    """Return the cases as a person reads them: axes with their units, bias and jitter in % and degrees."""
    axes = result.definition.axes
    return [
        {axis.name: shown(row[axis.name], axis.unit) for axis in axes}
        | {
            "reading": spelt(row["reading"]),
            "estimator": spec_of(row["estimator"]).label,
            "f (Hz)": row["frequency_hz"],
        }
        | {name: with_error(*found) for name, found in zip(FIGURES, error_figures(row), strict=True)}
        for row in result.rows
    ]


def run_time_part(results: Sequence[StudyResult]) -> Part:
    """Return error against run time: what was reached in what time, and what 100 or 1000 realisations buy."""
    rows = [row for one in results for row in run_times(one)]
    alt = "; ".join(
        f"{row['study']}, {row['reading']}, {row['estimator']}: {row['s.e. of mean from 1000 (nm)']:.2g} nm "
        f"in {row['seconds for 1000']:.3g} s a case"
        for row in rows
    )
    drawn = picture(_run_time_figure(results), "run-time", "Standard error of the mean displacement by case", f"{alt}.")
    words = (
        "Each mark is a case: the standard error of its mean displacement and the processor time it took. The table "
        "scales them to 100 and 1000 realisations: errors with the root of their number, times with it. The mean of "
        "1000 is known 3.2 times better than that of 100, for ten times the time.",
    )
    taken = [
        {
            "study": one.name,
            "cases": len(one.cases),
            "realisations": one.realisations,
            "processor time (s)": one.seconds,
            "peak memory (MiB)": one.peak_memory_mib,
        }
        for one in results
    ]
    tables = (
        table("time-by-study", "Time by study.", taken, False),
        table("realisations", "What realisations buy, medians over a study's cases.", rows, False),
    )
    return Part("run-time-part", "Error against run time", words, (drawn,), tables)


def run_times(result: StudyResult) -> list[dict[str, Any]]:
    """Return medians over cases of errors and seconds for 100 and 1000 realisations, by reading and estimator."""
    out = []
    for one in views(result):
        count = one.values("draws") * one.values("noise")
        seconds = one.values("seconds") / count
        mean_nm, jitter_nm = (one.values(f"amplitude_{name}_se_m") * np.sqrt(count) * NM for name in ("bias", "jitter"))
        row: dict[str, Any] = {"study": result.name, "reading": spelt(one.reading), "estimator": one.estimator}
        for wanted in (100, 1000):
            row[f"s.e. of mean from {wanted} (nm)"] = _median(mean_nm) / math.sqrt(wanted)
            row[f"s.e. of jitter from {wanted} (nm)"] = _median(jitter_nm) / math.sqrt(wanted)
            row[f"seconds for {wanted}"] = float(np.median(seconds)) * wanted
        out.append(row)
    return out


def _picture(result: StudyResult, one: View, folder: Path) -> Picture:
    draw, words = (map_figure, map_alt) if is_map(result) else (curve_figure, curve_alt)
    figure, key = draw(result, one), f"{result.name}-{one.key}"
    folder.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        figure.savefig(folder / f"{key}.png", dpi=PNG_DPI)
        figure.savefig(folder / f"{key}.svg", dpi=PNG_DPI, metadata={"Date": None})
    svg = (folder / f"{key}.svg").read_text(encoding="utf-8")
    alt = words(result, one)
    return Picture(key, one.title, alt, inline(svg, key, one.title, alt))


def _precision(result: StudyResult) -> tuple[str, ...]:
    """Return how well the study knows its means, in words, and which estimates were refused."""
    relative = np.array([row["amplitude_bias_se_m"] / row["amplitude_true_m"] for row in result.rows])
    known = "one draw has no standard error."
    if np.isfinite(relative).any():
        known = (
            f"standard error of the mean displacement {_median(relative) * 100:.2g} % of D_0 (median), at most "
            f"{np.nanmax(relative) * 100:.2g} %."
        )
    words = [
        f"{result.realisations} realisations, {result.rows[0]['draws']} scatterer draws a case with "
        f"{result.rows[0]['noise']} of noise each; {known}"
    ]
    return tuple(filter(None, (*words, refused_words(result.rows), warned_words(result.rows))))


def _median(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """Return the median of what is known; NaN where nothing is: one draw has no standard error."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan


def _run_time_figure(results: Sequence[StudyResult]) -> Figure:
    found = [(place, result.name, one) for place, result in enumerate(results) for one in _first_of_each(result)]
    readings = list(dict.fromkeys(one.reading for _, _, one in found))
    with rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.2), layout="constrained")
        panels = dict(zip(readings, figure.subplots(1, len(readings), sharey=True, squeeze=False)[0], strict=True))
        for place, name, one in found:
            marker, colour = mark(place)
            panels[one.reading].loglog(
                one.values("seconds"), one.values("amplitude_bias_se_m") * NM, marker,
                ms=4, alpha=0.6, rasterized=True, color=colour, label=name,
            )  # fmt: skip
        for reading, axes in panels.items():
            axes.set(xlabel="processor time (s)", title=spelt(reading))
            label_decades(axes.xaxis, most=4)
            label_decades(axes.yaxis)
        panels[readings[0]].set_ylabel("standard error of the mean displacement (nm)")
        figure.legend(
            *panels[readings[0]].get_legend_handles_labels(), loc="outside upper center", ncols=6, frameon=False
        )
        return figure


def spelt(reading: str) -> str:
    """Return the name of a reading as it stands in a sentence."""
    return reading.replace("_", " ")


def _first_of_each(result: StudyResult) -> list[View]:
    """Return one view a reading: of the paper's chain, else of the first estimator."""
    found: dict[str, View] = {}
    for one in views(result):
        if one.reading not in found or spec_of(one.estimator).published:
            found[one.reading] = one
    return list(found.values())
