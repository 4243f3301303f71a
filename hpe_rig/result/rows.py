"""Rows of a result, one a shot and frequency: for CSV, for pandas, for people."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from hpe_rig.result.estimates import Result
from hpe_rig.result.tables import csv_text, text_table

if TYPE_CHECKING:
    import pandas as pd

Value = str | int | float | bool | None


def result_rows(result: Result) -> list[dict[str, Value]]:
    """Return one row a shot and frequency, in SI units with the unit in every name; unknown is None."""
    rows: list[dict[str, Value]] = []
    for shot in result.as_dict()["shots"]:
        of_shot = _single_values(shot)
        rows += [of_shot | _single_values(estimate) for estimate in shot["estimates"]]
    return rows


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


def _single_values(table: dict[str, Any]) -> dict[str, Value]:
    return {name: value for name, value in table.items() if not isinstance(value, dict | list)}


def result_text(result: Result) -> str:
    """Return title, source and a table for people: nm and degrees, a row a shot and frequency."""
    rows = [
        (
            *(f"{shot.shot + 1}", f"{item.frequency_hz:g}"),
            *(f"{item.amplitude_m * 1e9:.4g}", f"{item.amplitude_uncertainty_m * 1e9:.2g}"),
            *(f"{math.degrees(item.phase_rad):.2f}", f"{math.degrees(item.phase_uncertainty_rad):.2g}"),
        )
        for shot in result.shots
        for item in shot.estimates
    ]
    table = text_table(("shot", "f / Hz", "amplitude / nm", "u / nm", "phase / deg", "u / deg"), rows, words=0)
    source = ", ".join(text for text in ("SIMULATED" if result.simulated else "measured", result.run_file) if text)
    return f"{result.title}\n{source}, estimator {result.estimator}\n{table}"
