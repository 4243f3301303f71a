"""A result as a notebook shows it: a figure and a table in HTML, drawn with nothing but text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from hpe_rig.result.palette import PALETTE

WIDTH, HEIGHT, MARGIN = 420, 150, 48
MOST_SHOTS = 6
COLUMNS = (
    ("frequency_hz", "f / Hz", 1.0, "g"),
    ("amplitude_m", "amplitude / nm", 1e9, ".4g"),
    ("amplitude_uncertainty_m", "u / nm", 1e9, ".2g"),
    ("phase_rad", "phase / deg", 180 / math.pi, ".2f"),
    ("phase_uncertainty_rad", "u / deg", 180 / math.pi, ".2g"),
)

Row = Mapping[str, Any]


def result_html(result: Mapping[str, Any]) -> str:
    """Return HTML of a result's plain values (``Result.as_dict``): where from, figure, table, warnings."""
    shots = result["shots"]
    source = "SIMULATED" if result["simulated"] else "measured"
    parts = [
        f"<p><b>{escape(result['title'])}</b><br>{source}, {escape(result['run_file'])}, {result['estimator']}</p>"
    ]
    parts += [
        _panel(shots, "amplitude_m", "amplitude / nm", 1e9),
        _panel(shots, "phase_rad", "phase / deg", 180 / math.pi),
    ]
    parts += [_table(shot) for shot in shots[:MOST_SHOTS]]
    if len(shots) > MOST_SHOTS:
        parts.append(f"<p>and {len(shots) - MOST_SHOTS} more shots</p>")
    warnings = [*result["warnings"], *(text for shot in shots for text in shot["warnings"])]
    parts += [f"<p><b>WARNING</b> {escape(text)}</p>" for text in warnings]
    return "\n".join(parts)


def _table(shot: Row) -> str:
    head = "".join(f"<th>{title}</th>" for _, title, _, _ in COLUMNS)
    body = "".join(f"<tr>{''.join(_cells(row))}</tr>" for row in shot["estimates"])
    return (
        f"<table><caption>shot {shot['shot'] + 1}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _cells(row: Row) -> Iterator[str]:
    for name, _, factor, form in COLUMNS:
        value = row[name]
        yield f"<td>{'-' if value is None else format(value * factor, form)}</td>"


def _panel(shots: Sequence[Row], name: str, title: str, factor: float) -> str:
    """Return one diagram over frequency, with bars of twice the standard uncertainty."""
    drawn = [_points(shot, name, factor) for shot in shots[:MOST_SHOTS]]
    points = [point for line in drawn for point in line]
    if not points:
        return ""
    low = min(0.0, *(value - bar for _, value, bar in points))
    high = max(0.0, *(value + bar for _, value, bar in points))
    span = (high - low) or 1.0
    most_hz = max(frequency for frequency, _, _ in points) * 1.05

    def x(frequency: float) -> float:
        return MARGIN + frequency / most_hz * (WIDTH - MARGIN - 10)

    def y(value: float) -> float:
        return 10 + (high - value) / span * (HEIGHT - 40)

    marks = [
        f'<path d="M{x(f):.1f} {y(value - bar):.1f}V{y(value + bar):.1f}" stroke="{colour}"/>'
        f'<circle cx="{x(f):.1f}" cy="{y(value):.1f}" r="3" fill="{colour}"/>'
        for line, colour in zip(drawn, PALETTE, strict=False)
        for f, value, bar in line
    ]
    axes = f'<path d="M{MARGIN} 10V{HEIGHT - 30}M{MARGIN} {y(0):.1f}H{WIDTH - 10}" stroke="#444"/>'
    words = [
        f'<text x="{MARGIN - 4}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.3g}</text>' for value in (low, high)
    ]
    words += [f'<text x="{WIDTH - 10}" y="{HEIGHT - 4}" text-anchor="end">{most_hz / 1.05:g} Hz</text>']
    words += [f'<text x="{MARGIN}" y="{HEIGHT - 4}">{title}, bars: 2 u</text>']
    label = escape(f"{title} against frequency of {len(drawn)} shots")
    return (
        f'<svg role="img" aria-label="{label}" width="{WIDTH}" height="{HEIGHT}" font-size="11" '
        f'style="background:#fff">{axes}{"".join(marks)}{"".join(words)}</svg>'
    )


def _points(shot: Row, name: str, factor: float) -> list[tuple[float, float, float]]:
    uncertainty = name.replace("_m", "_uncertainty_m").replace("_rad", "_uncertainty_rad")
    return [
        (row["frequency_hz"], row[name] * factor, 2 * (row[uncertainty] or 0.0) * factor)
        for row in shot["estimates"]
        if row[name] is not None
    ]
