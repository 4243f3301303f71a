"""HTML of a result, as a notebook shows it: where from, figure, table, warnings."""

from __future__ import annotations

import base64
import io
import math
from html import escape

from hpe_rig.result.estimates import Estimate, Result, ShotResult, shot_warnings
from hpe_rig.result.figure import result_figure

MOST_SHOTS = 6
COLUMNS = (
    ("frequency_hz", "f / Hz", 1.0, "g"),
    ("amplitude_m", "amplitude / nm", 1e9, ".4g"),
    ("amplitude_uncertainty_m", "u / nm", 1e9, ".2g"),
    ("phase_rad", "phase / deg", 180 / math.pi, ".2f"),
    ("phase_uncertainty_rad", "u / deg", 180 / math.pi, ".2g"),
)


def result_html(result: Result) -> str:
    """Return HTML that needs nothing else: source, figure, tables of the first ``MOST_SHOTS`` shots, warnings."""
    source = ", ".join(text for text in (_origin(result), result.run_file, result.estimator) if text)
    parts = [f"<p><b>{escape(result.title)}</b><br>{escape(source)}</p>", _image(result)]
    parts += [_table(shot) for shot in result.shots[:MOST_SHOTS]]
    if len(result.shots) > MOST_SHOTS:
        parts.append(f"<p>and {len(result.shots) - MOST_SHOTS} more shots</p>")
    warnings = (*result.warnings, *shot_warnings(result.shots))
    return "\n".join([*parts, *(f"<p><b>WARNING</b> {escape(text)}</p>" for text in warnings)])


def _origin(result: Result) -> str:
    words = "SIMULATED" if result.simulated else "measured"
    return words + (f", simulated specimen: {result.simulated_specimen}" if result.simulated_specimen else "")


def _image(result: Result) -> str:
    """Return the figure as an image of its own: inline drawings of one page would share their ids."""
    drawing = io.BytesIO()
    result_figure(result).savefig(drawing, format="svg")
    data = base64.b64encode(drawing.getvalue()).decode("ascii")
    label = f"amplitude and phase over frequency of {len(result.shots)} shots"
    return f'<img alt="{label}" src="data:image/svg+xml;base64,{data}">'


def _table(shot: ShotResult) -> str:
    head = "".join(f"<th>{title}</th>" for _, title, _, _ in COLUMNS)
    body = "".join(f"<tr>{_cells(estimate)}</tr>" for estimate in shot.estimates)
    caption = f"<caption>shot {shot.shot + 1}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cells(estimate: Estimate) -> str:
    values = ((getattr(estimate, name) * factor, form) for name, _, factor, form in COLUMNS)
    return "".join(f"<td>{format(value, form) if math.isfinite(value) else '-'}</td>" for value, form in values)
