"""Rows of a result, one for each shot and frequency: CSV, pandas frame and printed table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.tables import csv_text, package_of_extra, text_table
from hpe_rig.result.values import Estimate

if TYPE_CHECKING:
    import pandas as pd

Value = str | int | float | bool | None
FIRST_COLUMNS = (
    "frequency_hz",
    "amplitude_m",
    "amplitude_uncertainty_m",
    "phase_rad",
    "phase_uncertainty_rad",
    "corrected",
)


def result_rows(result: ResultData) -> list[dict[str, Value]]:
    """Return one row for each shot and frequency, in SI units with the unit in every name; None for unknown values.

    The headline comes first; the components of its uncertainty and the scene's notes come last. Gates over depth add a
    row for each gate, shot and frequency with ``gate_depth_m`` and ``gate_length_m``, which are None in other rows.
    """
    notes: dict[str, Value] = {f"note_{name.replace(' ', '_')}": note for name, note in result.notes.items()}
    tables = result.as_dict()
    gates: list[dict[str, Any]] = tables.get("profile", [])
    no_gate: dict[str, Value] = {"gate_depth_m": None, "gate_length_m": None} if gates else {}
    shots = [(no_gate, shot) for shot in tables["shots"]]
    shots += [({"gate_depth_m": gate["depth_m"], "gate_length_m": gate["length_m"]}, gate["shot"]) for gate in gates]
    rows: list[dict[str, Value]] = []
    for gate, shot in shots:
        settings = _single_values(shot) | shot["swept"] | _condition_cells(shot["conditions"]) | gate
        rows += [settings | _estimate_row(estimate) | notes for estimate in shot["estimates"]]
    if not gates:
        return rows
    # Rows of shots and of gates must have the same columns.
    names = dict.fromkeys(name for row in rows for name in row)
    return [{name: row.get(name) for name in names} for row in rows]


def _condition_cells(conditions: dict[str, Sequence[Value]]) -> dict[str, Value]:
    """Return the conditions of a shot, before and after it, by the names of their columns."""
    pairs = [(name, zip(("before", "after"), values, strict=True)) for name, values in conditions.items()]
    return {f"condition_{name}_{when}": value for name, readings in pairs for when, value in readings}


def _estimate_row(estimate: dict[str, Any]) -> dict[str, Value]:
    values, row = _single_values(estimate), dict[str, Value]()
    for component in estimate["components"]:
        name = component["source"].replace(" ", "_")
        row |= {f"u_{name}_m": component["amplitude_m"], f"u_{name}_rad": component["phase_rad"]}
    return {name: values[name] for name in FIRST_COLUMNS} | values | row


def result_csv(result: ResultData) -> str:
    """Return the rows as CSV with a header; numbers keep every digit, unknown values are empty."""
    return csv_text(result_rows(result))


def result_frame(result: ResultData) -> pd.DataFrame:
    """Return the rows as a pandas frame; ``attrs`` hold title, run file, estimator and ``simulated``."""
    frame: pd.DataFrame = package_of_extra("pandas", "Result.to_frame").DataFrame(result_rows(result))
    frame.attrs.update({name: getattr(result, name) for name in ("title", "run_file", "estimator", "simulated")})
    return frame


def _text_row(shots: str, value: Estimate | RepeatMean) -> tuple[str, ...]:
    return (
        *(shots, f"{value.frequency_hz:g}"),
        *(f"{value.amplitude_m * 1e9:.4g}", f"{value.amplitude_uncertainty_m * 1e9:.2g}"),
        *(f"{math.degrees(value.phase_rad):.2f}", f"{math.degrees(value.phase_uncertainty_rad):.2g}"),
    )


def _shots_text(shots: Sequence[int]) -> str:
    return f"{shots[0]}" if len(shots) == 1 else f"mean of {len(shots)} from {shots[0]}"


def _single_values(table: dict[str, Any]) -> dict[str, Value]:
    return {name: value for name, value in table.items() if not isinstance(value, dict | list)}


def result_text(result: ResultData) -> str:
    """Return title, source and a printed table: the headlines in nm and degrees, means over repeats first."""
    means = [_text_row(_shots_text(mean.shots), mean) for mean in result.means]
    rows = [
        _text_row(_shots_text([shot.shot]) + (" UNTRUSTED" if shot.untrusted else ""), item)
        for shot in result.shots
        for item in shot.estimates
    ]
    peak = all(item.corrected for shot in result.shots for item in shot.estimates)
    headers = ("shot", "f / Hz", f"{'peak' if peak else 'amplitude'} / nm", "u / nm", "phase / deg", "u / deg")
    table = text_table(headers, [*means, *rows], words=0)
    source = ", ".join(text for text in (result.origin, result.run_file) if text)
    return f"{result.title}\n{source}, estimator {result.estimator}\n{table}"
