"""Page of completed studies, ``hpe-rig study NAME --report``; every figure is also written as SVG and PNG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import spec_of
from hpe_rig.report import PageSection, page_table, render_sections
from hpe_rig.result import STYLE, Picture, figure_bytes, inline, label_decades, mark, picture
from hpe_rig.store import make_folder, versions, write_file
from hpe_rig.study.curve_figures import NM, curve_alt, curve_figure
from hpe_rig.study.map_figures import map_alt, map_figure
from hpe_rig.study.results import SUMMARY_FILE, StudyResult
from hpe_rig.study.series import (
    View,
    error_figures,
    is_map,
    refused_text,
    spans,
    value_text,
    views,
    warned_text,
    with_error,
)

PNG_DPI = 150
ERROR_COLUMNS = ("amplitude bias (%)", "amplitude jitter (%)", "phase bias (°)", "phase jitter (°)")
INTRODUCTION = (
    "Bias and jitter, eq. (14) and (15), are mean and standard deviation of the error of amplitude and phase. Bands "
    "span two Monte Carlo standard errors to each side.",
    "Readings of the paper. Physical: every scatterer echoes from its own depth. Literal: eq. (11) as printed; all "
    "echoes start at once, and scatterers fill the gate. As printed: literal, and the amplitude keeps the gain of a "
    "difference of pulses. One draw: physical, with one draw of scatterers for all realisations of noise.",
)


def write_study_report(
    name: str, results: Sequence[StudyResult], output: Path, leading_sections: Iterable[PageSection] = ()
) -> Path:
    """Write ``output``/NAME.html, and the figures into each study's folder; return the page's path.

    ``leading_sections`` precede the others. Raises ``SettingsError`` if the page cannot be written.
    """
    path = output / f"{name}.html"
    leading = list(leading_sections)
    headline = leading[0].headline if leading else _headline(results)
    sections = [
        *leading,
        overview_section(results),
        *(study_section(result, output / result.name) for result in results),
        run_time_section(results),
    ]
    computed_with = sorted({version for result in results for version in result.versions})
    facts = {**versions(), "cases computed with": ", ".join(computed_with)}
    title = results[0].definition.title if len(results) == 1 else f"Parameter studies: {name}"
    make_folder(path.parent)
    write_file(path, render_sections(title, (headline, *INTRODUCTION), sections, facts))
    return path


def _headline(results: Sequence[StudyResult]) -> str:
    """Return the first study's bias and jitter in one sentence: its first reading, the estimator of smallest error."""
    all_views = views(results[0])
    view = min((view for view in all_views if view.reading == all_views[0].reading), key=_largest_error)
    bias, jitter, _, phase_jitter = spans(view.rows)
    return (
        f"{view.title}: over {len(view.rows)} cases the amplitude has a bias of {bias} % and a jitter of {jitter} %, "
        f"and the phase a jitter of {phase_jitter} deg."
    )


def _largest_error(view: View) -> float:
    """Return the largest root mean square error of the amplitude over the cases, in %; infinite if none is finite."""
    errors = [math.hypot(bias, jitter) for (bias, _), (jitter, _), *_ in map(error_figures, view.rows)]
    return max((error for error in errors if math.isfinite(error)), default=math.inf)


def overview_section(results: Sequence[StudyResult]) -> PageSection:
    """Return the ranges of bias and jitter over the cases, by study, reading and estimator."""
    rows: list[dict[str, Any]] = [
        ({"study": result.definition.title} if len(results) > 1 else {})
        | {"reading": reading_text(view.reading), "estimator": spec_of(view.estimator).label}
        | ({"frequency (Hz)": view.frequency_hz} if len({item.frequency_hz for item in views(result)}) > 1 else {})
        | dict(zip(ERROR_COLUMNS, spans(view.rows), strict=True))
        for result in results
        for view in views(result)
    ]
    columns = dict.fromkeys(name for row in rows for name in row)
    rows = [{name: row.get(name) for name in columns} for row in rows]
    caption = "Smallest to largest value over the cases of a study, in % of the true amplitude and in degrees."
    return PageSection("overview-section", "Overview", tables=(page_table("overview", caption, rows, folded=False),))


def study_section(result: StudyResult, folder: Path) -> PageSection:
    """Return a study's section; its figures are also written to ``folder`` as SVG and PNG."""
    study_views = views(result)
    estimators = [view.estimator for view in study_views]
    # Readings of the same estimator are neighbours.
    by_estimator = sorted(study_views, key=lambda view: estimators.index(view.estimator))
    table = page_table(
        result.name,
        f"{result.definition.title}: every case, with Monte Carlo standard errors.",
        result.rows,
        csv_path=f"{folder.name}/{SUMMARY_FILE}",
        display_rows=_display_rows(result),
    )
    return PageSection(
        key=f"{result.name}-section",
        title=result.definition.title,
        paragraphs=_precision(result),
        pictures=tuple(_picture(result, view, folder) for view in by_estimator),
        tables=(table,),
    )


def _display_rows(result: StudyResult) -> list[dict[str, Any]]:
    """Return the cases for display: axes with their units, bias and jitter in % and degrees."""
    return [
        {axis.name: value_text(row[axis.name], axis.unit) for axis in result.definition.sweep_axes}
        | {
            "reading": reading_text(row["reading"]),
            "estimator": spec_of(row["estimator"]).label,
            "f (Hz)": row["frequency_hz"],
        }
        | {name: with_error(*value) for name, value in zip(ERROR_COLUMNS, error_figures(row), strict=True)}
        for row in result.rows
    ]


def run_time_section(results: Sequence[StudyResult]) -> PageSection:
    """Return error against run time: each case's, and those of 100 and 1000 realisations."""
    rows = [row for result in results for row in run_times(result)]
    alt = "; ".join(
        f"{row['study']}, {row['reading']}, {row['estimator']}: {row['s.e. of mean from 1000 (nm)']:.2g} nm "
        f"in {row['seconds for 1000']:.3g} s a case"
        for row in rows
    )
    title = "Standard error of the mean displacement by case"
    figure = picture(_run_time_figure(results), "run-time", title, f"{alt}.")
    paragraphs = (
        "Each mark is a case: the standard error of its mean displacement, and its processor time. The table scales "
        "them to 100 and 1000 realisations: the error falls with the root of their number, the time grows with the "
        "number. The mean of 1000 has a 3.2 times smaller error than that of 100, at ten times the time.",
    )
    times = [
        {
            "study": result.name,
            "cases": len(result.cases),
            "realisations": result.realisations,
            "processor time (s)": result.seconds,
            "peak memory (MiB)": result.peak_memory_mib,
        }
        for result in results
    ]
    tables = (
        page_table("time-by-study", "Time by study.", times, folded=False),
        page_table(
            "realisations", "Error and time by number of realisations, medians over the cases.", rows, folded=False
        ),
    )
    return PageSection("run-time-section", "Error against run time", paragraphs, (figure,), tables)


def run_times(result: StudyResult) -> list[dict[str, Any]]:
    """Return median errors and seconds for 100 and 1000 realisations, by reading and estimator."""
    rows = []
    for view in views(result):
        count = view.values("draws") * view.values("noise")
        seconds = view.values("seconds") / count
        # The standard error of one realisation.
        mean_nm, jitter_nm = (
            view.values(f"amplitude_{name}_se_m") * np.sqrt(count) * NM for name in ("bias", "jitter")
        )
        row: dict[str, Any] = {"study": result.name, "reading": reading_text(view.reading), "estimator": view.estimator}
        for realisations in (100, 1000):
            row[f"s.e. of mean from {realisations} (nm)"] = _finite_median(mean_nm) / math.sqrt(realisations)
            row[f"s.e. of jitter from {realisations} (nm)"] = _finite_median(jitter_nm) / math.sqrt(realisations)
            row[f"seconds for {realisations}"] = float(np.median(seconds)) * realisations
        rows.append(row)
    return rows


def _picture(result: StudyResult, view: View, folder: Path) -> Picture:
    draw, alt_text = (map_figure, map_alt) if is_map(result) else (curve_figure, curve_alt)
    figure, key = draw(result, view), f"{result.name}-{view.key}"
    make_folder(folder)
    contents = dict[str, bytes]()
    for suffix in (".png", ".svg"):
        path = folder / f"{key}{suffix}"
        with rc_context(STYLE):
            contents[suffix] = figure_bytes(figure, path, PNG_DPI, adaptive=False)
        write_file(path, contents[suffix])
    alt = alt_text(result, view)
    return Picture(key, view.title, alt, inline(contents[".svg"].decode(), key, view.title, alt))


def _precision(result: StudyResult) -> tuple[str, ...]:
    """Return the standard errors of the study's means in words, and the numbers of refused and warned estimates."""
    relative = np.array([row["amplitude_bias_se_m"] / row["amplitude_true_m"] for row in result.rows])
    precision = "one draw has no standard error."
    if np.isfinite(relative).any():
        precision = (
            f"the standard error of the mean displacement is {_finite_median(relative) * 100:.2g} % of D_0 (median), "
            f"at most {np.nanmax(relative) * 100:.2g} %."
        )
    first = result.rows[0]
    text = (
        f"{result.realisations} realisations, {first['draws']} scatterer draws a case with {first['noise']} of noise "
        f"each; {precision}"
    )
    return tuple(filter(None, (text, refused_text(result.rows), warned_text(result.rows))))


def _finite_median(values: FloatArray) -> float:
    """Return the median of the finite values, NaN without any: one draw has no standard error."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def _run_time_figure(results: Sequence[StudyResult]) -> Figure:
    points = [(index, result.name, view) for index, result in enumerate(results) for view in _main_views(result)]
    readings = list(dict.fromkeys(view.reading for _, _, view in points))
    with rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.2), layout="constrained")
        panels = dict(zip(readings, figure.subplots(1, len(readings), sharey=True, squeeze=False)[0], strict=True))
        for index, name, view in points:
            marker, colour = mark(index)
            panels[view.reading].loglog(
                view.values("seconds"), view.values("amplitude_bias_se_m") * NM, marker,
                ms=4, alpha=0.6, rasterized=True, color=colour, label=name,
            )  # fmt: skip
        for reading, axes in panels.items():
            axes.set(xlabel="processor time (s)", title=reading_text(reading))
            label_decades(axes.xaxis, most=4)
            label_decades(axes.yaxis)
        first_panel = panels[readings[0]]
        first_panel.set_ylabel("standard error of the mean displacement (nm)")
        figure.legend(*first_panel.get_legend_handles_labels(), loc="outside upper center", ncols=6, frameon=False)
        return figure


def reading_text(reading: str) -> str:
    """Return the name of a reading within a sentence."""
    return reading.replace("_", " ")


def _main_views(result: StudyResult) -> list[View]:
    """Return one view for each reading: of the paper's chain, else of the first estimator."""
    by_reading: dict[str, View] = {}
    for view in views(result):
        if view.reading not in by_reading or spec_of(view.estimator).published:
            by_reading[view.reading] = view
    return list(by_reading.values())
