"""Series of a study's rows, curves and maps: which axis runs along, which ones tell them apart, and in what unit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import spec_of
from hpe_rig.study.definition import Axis
from hpe_rig.study.results import StudyResult

StudyRow = dict[str, Any]

READINGS = {
    "physical": "physical",
    "literal": "eq. (11) read literally",
    "as_printed": "eq. (11) literally, gain of the difference left in",
    "one_draw": "one draw of scatterers",
}
"""What a reader calls the readings of the paper."""
LEAST_OF_A_MAP = 5
"""Values of an axis from which two axes make a map."""


@dataclass(frozen=True, slots=True)
class View:
    """One reading, estimator and frequency of a study."""

    reading: str
    estimator: str
    frequency_hz: float
    rows: tuple[StudyRow, ...]

    @property
    def key(self) -> str:
        """The view's name in an id."""
        return f"{self.reading}-{self.estimator}-{self.frequency_hz:g}"

    @property
    def title(self) -> str:
        """What a reader calls it."""
        return f"{READINGS[self.reading]}, {spec_of(self.estimator).label}"

    def values(self, column: str) -> FloatArray:
        """Return a column, (row,)."""
        return np.array([row[column] for row in self.rows], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Curve:
    """Rows along one axis, the values of the others fixed."""

    label: str
    x: FloatArray
    rows: tuple[StudyRow, ...]

    def values(self, column: str) -> FloatArray:
        """Return a column, (point,)."""
        return np.array([row[column] for row in self.rows], dtype=np.float64)


def views(result: StudyResult) -> list[View]:
    """Return every reading, estimator and frequency, in the order of the rows."""
    found: dict[tuple[str, str, float], list[StudyRow]] = {}
    for row in result.rows:
        found.setdefault((row["reading"], row["estimator"], row["frequency_hz"]), []).append(row)
    return [View(*key, tuple(rows)) for key, rows in found.items()]


def view(result: StudyResult, reading: str) -> View | None:
    """Return the first view of the paper's chain in that reading; None where the study has none."""
    ours = (one for one in views(result) if one.reading == reading and spec_of(one.estimator).published)
    return next(ours, None)


def axis_label(axis: Axis) -> str:
    """Return what stands at an axis of a figure."""
    return f"{axis.name} ({axis.unit})" if axis.unit else axis.name


def is_map(result: StudyResult) -> bool:
    """Return whether the last two axes have numbers enough for a map."""
    last = result.definition.axes[-2:]
    return len(last) == 2 and all(
        len(axis.values()) >= LEAST_OF_A_MAP and axis.name != "SNR" and numbers(axis.values()) for axis in last
    )


def numbers(values: Sequence[Any]) -> bool:
    """Return whether all values are numbers."""
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def curves(result: StudyResult, one: View) -> list[Curve]:
    """Return the curves of a view over the last axis; over its places where that axis holds no numbers."""
    *outer, along = result.definition.axes
    given = along.values()
    x = np.array(given if numbers(given) else range(len(given)), dtype=np.float64)
    found = []
    for values in itertools.product(*(axis.values() for axis in outer)):
        rows = _rows_at(one, outer, values)
        label = ", ".join(f"{a.name} = {shown(v, a.unit)}" for a, v in zip(outer, values, strict=True))
        if len(rows) == len(x):
            found.append(Curve(label, x, tuple(rows)))
    return found


def maps(
    result: StudyResult, one: View
) -> Iterator[tuple[tuple[Any, ...], FloatArray, FloatArray, dict[str, FloatArray]]]:
    """Yield (outer values, x (x,), y (y,), every numeric column (y, x)) for each value of the outer axes."""
    *outer, across, up = result.definition.axes
    x, y = (np.array(axis.values(), dtype=np.float64) for axis in (across, up))
    columns = [name for name, value in one.rows[0].items() if isinstance(value, float)]
    for values in itertools.product(*(axis.values() for axis in outer)):
        rows = _rows_at(one, outer, values)
        tables = {name: np.array([row[name] for row in rows]).reshape(len(x), len(y)).T for name in columns}
        yield values, x, y, tables


def _rows_at(one: View, axes: Sequence[Axis], values: Sequence[Any]) -> list[StudyRow]:
    return [row for row in one.rows if all(row[axis.name] == v for axis, v in zip(axes, values, strict=True))]


def shown(value: Any, unit: str) -> str:
    """Return a value with its unit as a person writes it."""
    if not isinstance(value, int | float):
        return str(value)
    if unit == "m":
        return f"{value * 1e9:g} nm" if abs(value) < 5e-5 else f"{value * 1e3:g} mm"
    if unit == "Hz" and abs(value) >= 1e3:
        return f"{value / 1e6:g} MHz" if abs(value) >= 1e6 else f"{value / 1e3:g} kHz"
    return f"{value:g} {unit}".rstrip()


def error_figures(row: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return bias and jitter of amplitude, in %, and of phase, in degrees, each with its Monte Carlo standard error."""
    percent, degrees = 100 / (row["amplitude_true_m"] or math.nan), math.degrees(1)
    names = (("amplitude", "m", percent), ("phase", "rad", degrees))
    return [
        (row[f"{of}_{name}_{unit}"] * scale, row[f"{of}_{name}_se_{unit}"] * scale)
        for of, unit, scale in names
        for name in ("bias", "jitter")
    ]


def refused_words(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return how many estimates were refused, and what that leaves out of bias and jitter; "" where none was."""
    refused = sum(row["refused"] for row in rows)
    if not refused:
        return ""
    return f"{refused} estimates were refused: they are left out, with all others of the same scatterers and case."


def warned_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return how many estimates are of shots that the result warns of, and where; "" where none is."""
    counts = [(row.get("warned", 0), row) for row in rows]
    warned, (most, worst) = sum(count for count, _ in counts), max(counts, key=lambda each: each[0], default=(0, {}))
    if not warned:
        return ""
    of = sum(row["draws"] * row["noise"] for row in rows)
    share = f"{most} of {worst['draws'] * worst['noise']} at {worst['frequency_hz']:g} Hz with {worst['estimator']}"
    return (
        f"{warned} of {of} estimates are of shots with warnings, at most {share} in one case: they count, and a run of "
        "that case says which warnings."
    )


def spans(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the least and the largest of each of `error_figures` over ``rows``; a dash where none is known."""
    found = []
    for values in zip(*([value for value, _ in error_figures(row)] for row in rows), strict=True):
        known = [value for value in values if math.isfinite(value)]
        low, high = (f"{edge(known):.3g}" if known else "–" for edge in (min, max))
        found.append(low if low == high else f"{low} to {high}")
    return found


def with_error(value: float, se: float) -> str:
    """Return a value and its standard error, both to the error's second digit."""
    if not 0 < se < math.inf:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(se)))
    return f"{value:.{digits}f} ± {se:.{digits}f}"
