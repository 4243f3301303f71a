"""HTML of a result for a notebook: headline, source, figures, tables and warnings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from itertools import groupby

from hpe_rig.result.print_symbols import symbols
from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.result_data import ResultData, shot_warnings
from hpe_rig.result.sentence import headline_sentence
from hpe_rig.result.spectra import main_shot, means_of, spectrum_pictures
from hpe_rig.result.svg import image
from hpe_rig.result.values import Estimate

MAX_SHOTS = 6
COLUMNS = (
    ("amplitude_m", "{} / nm", 1e9, ".4g"),
    ("amplitude_uncertainty_m", "u / nm", 1e9, ".2g"),
    ("phase_rad", "phase / deg", 180 / math.pi, ".2f"),
    ("phase_uncertainty_rad", "u / deg", 180 / math.pi, ".2g"),
)


def result_html(result: ResultData) -> str:
    """Return self-contained HTML with the tables of the first ``MAX_SHOTS`` shots."""
    source = ", ".join(text for text in (_origin(result), result.run_file, result.estimator) if text)
    lead = "<br>".join([f"<b>{symbols(headline_sentence(result))}</b>", symbols(result.title), escape(source)])
    blocks = [f"<p>{lead}</p>", _spectra(result)]
    for shots, means in groupby(result.means, key=lambda mean: mean.shots):
        blocks.append(_table(f"mean of {len(shots)} repeats from shot {shots[0]} on", list(means)))
    for shot in result.shots[:MAX_SHOTS]:
        blocks.append(_table(f"shot {shot.shot}", shot.estimates))
    if len(result.shots) > MAX_SHOTS:
        blocks.append(f"<p>and {len(result.shots) - MAX_SHOTS} more shots</p>")
    # Warnings come last, after the numbers that they concern.
    warnings = (*result.warnings, *shot_warnings(result.shots))
    return "\n".join([*blocks, *(f"<p><b>WARNING</b> {symbols(text)}</p>" for text in warnings)])


def _origin(result: ResultData) -> str:
    return result.origin + (f", simulated specimen: {result.simulated_specimen}" if result.simulated_specimen else "")


def _spectra(result: ResultData) -> str:
    """Return the report's two spectra, of the main shot."""
    shot = main_shot(result)
    if not shot.estimates:
        return ""
    means = means_of(result.means, shot)
    caption = f"mean of {len(means[0].shots)} repeats and each repeat" if means else f"shot {shot.shot}"
    return "".join([*(image(spectrum) for spectrum in spectrum_pictures(result, shot)), f"<p>{caption}; bars: 2 u</p>"])


def _table(caption: str, rows: Sequence[Estimate | RepeatMean]) -> str:
    name = "peak" if all(value.corrected for value in rows) else "amplitude"
    titles = ("f / Hz", *(title.format(name) for _, title, _, _ in COLUMNS))
    head = "".join(f"<th>{title}</th>" for title in titles)
    body = "".join(f"<tr><td>{value.frequency_hz:g}</td>{_cells(value)}</tr>" for value in rows)
    return f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cells(value: Estimate | RepeatMean) -> str:
    values = ((getattr(value, name) * factor, form) for name, _, factor, form in COLUMNS)
    return "".join(f"<td>{format(value, form) if math.isfinite(value) else '-'}</td>" for value, form in values)
