"""Rows of a result, one a shot and frequency: for CSV, for pandas, for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.tables import csv_text, text_table
from hpe_rig.result.values import Headline, Result

if TYPE_CHECKING:
    import pandas as pd

Value = str | int | float | bool | None
FIRST = (
    "frequency_hz",
    "corrected_amplitude_m",
    "corrected_uncertainty_m",
    "corrected_phase_rad",
    "corrected_phase_uncertainty_rad",
)


def result_rows(result: Result) -> list[dict[str, Value]]:
    """Return one row a shot and frequency, in SI units with the unit in every name; unknown is None.

    The headline stands first, the components of its uncertainty and the scene's notes last. Where there are gates over
    depth, a row a gate, shot and frequency follows, with ``gate_depth_m`` and ``gate_length_m``, None in the others.
    """
    notes: dict[str, Value] = {f"note_{name.replace(' ', '_')}": note for name, note in result.notes.items()}
    tables = result.as_dict()
    gates: list[dict[str, Any]] = tables.get("profile", [])
    none: dict[str, Value] = {"gate_depth_m": None, "gate_length_m": None} if gates else {}
    seen = [(none, shot) for shot in tables["shots"]]
    seen += [({"gate_depth_m": gate["depth_m"], "gate_length_m": gate["length_m"]}, gate["shot"]) for gate in gates]
    rows: list[dict[str, Value]] = []
    for gate, shot in seen:
        of_shot = _single_values(shot) | shot["swept"] | gate
        rows += [of_shot | _estimate_row(estimate) | notes for estimate in shot["estimates"]]
    if not gates:
        return rows
    names = dict.fromkeys(name for row in rows for name in row)
    return [{name: row.get(name) for name in names} for row in rows]


def _estimate_row(estimate: dict[str, Any]) -> dict[str, Value]:
    values, row = _single_values(estimate), dict[str, Value]()
    for each in estimate["components"]:
        name = each["source"].replace(" ", "_")
        row |= {f"u_{name}_m": each["amplitude_m"], f"u_{name}_rad": each["phase_rad"]}
    return {name: values[name] for name in FIRST} | values | row


def result_csv(result: Result) -> str:
    """Return the rows as CSV with a header; unknown is empty, numbers keep every digit."""
    return csv_text(result_rows(result))


def result_frame(result: Result) -> pd.DataFrame:
    """Return the rows as a pandas frame, title, estimator and ``simulated`` among its ``attrs``."""
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        what = 'Result.to_frame needs pandas, which is not installed. Try: pip install "hpe-rig[frames]".'
        raise ModuleNotFoundError(what, name=error.name) from None

    frame = pd.DataFrame(result_rows(result))
    frame.attrs.update({name: getattr(result, name) for name in ("title", "run_file", "estimator", "simulated")})
    return frame


def _text_row(shots: str, frequency_hz: float, value: Headline | RepeatMean) -> tuple[str, ...]:
    return (
        *(shots, f"{frequency_hz:g}"),
        *(f"{value.amplitude_m * 1e9:.4g}", f"{value.amplitude_uncertainty_m * 1e9:.2g}"),
        *(f"{math.degrees(value.phase_rad):.2f}", f"{math.degrees(value.phase_uncertainty_rad):.2g}"),
    )


def _numbers(shots: Sequence[int]) -> str:
    return f"{shots[0] + 1}" if len(shots) == 1 else f"mean of {len(shots)} from {shots[0] + 1}"


def _single_values(table: dict[str, Any]) -> dict[str, Value]:
    return {name: value for name, value in table.items() if not isinstance(value, dict | list)}


def result_text(result: Result) -> str:
    """Return title, source and a table for people: nm and degrees of the headline, a row a shot and frequency.

    Means over repeats stand first, each with the shots that it is of.
    """
    means = [_text_row(_numbers(mean.shots), mean.frequency_hz, mean) for mean in result.means]
    rows = [
        _text_row(_numbers([shot.shot]) + (" UNTRUSTED" if shot.untrusted else ""), item.frequency_hz, item.headline)
        for shot in result.shots
        for item in shot.estimates
    ]
    peak = all(item.headline.corrected for shot in result.shots for item in shot.estimates)
    headers = ("shot", "f / Hz", f"{'peak' if peak else 'amplitude'} / nm", "u / nm", "phase / deg", "u / deg")
    table = text_table(headers, [*means, *rows], words=0)
    source = ", ".join(text for text in (result.origin, result.run_file) if text)
    return f"{result.title}\n{source}, estimator {result.estimator}\n{table}"
