"""Series of a study's rows: views, curves over the last axis, maps over the last two, and their texts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import spec_of
from hpe_rig.result import with_u
from hpe_rig.scene import Axis
from hpe_rig.study.results import StudyResult

StudyRow = dict[str, Any]

READINGS = {
    "physical": "physical",
    "literal": "eq. (11) read literally",
    "as_printed": "eq. (11) literally, with the gain of the difference",
    "one_draw": "one draw of scatterers",
}
"""Names of the readings in titles."""
MIN_MAP_VALUES = 5
"""Minimum number of values of each of the last two axes for a map."""


@dataclass(frozen=True, slots=True)
class View:
    """The rows of one reading, estimator and frequency."""

    reading: str
    estimator: str
    frequency_hz: float
    rows: tuple[StudyRow, ...]
    names_frequency: bool = False
    """Whether the title states the frequency: the study has several."""

    @property
    def key(self) -> str:
        """Id of the view in file names and pages."""
        return f"{self.reading}-{self.estimator}-{self.frequency_hz:g}"

    @property
    def title(self) -> str:
        """Title of the view's figure."""
        frequency = f", {self.frequency_hz:g} Hz" if self.names_frequency else ""
        return f"{READINGS[self.reading]}, {spec_of(self.estimator).label}{frequency}"

    def values(self, column: str) -> FloatArray:
        """Return a column, (row,)."""
        return np.array([row[column] for row in self.rows], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Curve:
    """Rows along the last axis, at fixed values of the outer axes."""

    label: str
    x: FloatArray
    rows: tuple[StudyRow, ...]

    def values(self, column: str) -> FloatArray:
        """Return a column, (row,)."""
        return np.array([row[column] for row in self.rows], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class MapTable:
    """Every numeric column (y, x) over the last two axes, at fixed values of the outer axes."""

    outer_values: tuple[Any, ...]
    x: FloatArray
    y: FloatArray
    columns: dict[str, FloatArray]


def views(result: StudyResult) -> list[View]:
    """Return every reading, estimator and frequency, in the order of the rows."""
    groups: dict[tuple[str, str, float], list[StudyRow]] = {}
    for row in result.rows:
        groups.setdefault((row["reading"], row["estimator"], row["frequency_hz"]), []).append(row)
    several = len({frequency_hz for *_, frequency_hz in groups}) > 1
    return [View(*key, tuple(rows), several) for key, rows in groups.items()]


def paper_view(result: StudyResult, reading: str) -> View | None:
    """Return the first view of the paper's chain in that reading; None if the study has none."""
    candidates = (item for item in views(result) if item.reading == reading and spec_of(item.estimator).published)
    return next(candidates, None)


def axis_label(axis: Axis) -> str:
    """Return the label of a figure's axis: name and unit."""
    return f"{axis.name} ({axis.unit})" if axis.unit else axis.name


def is_map(result: StudyResult) -> bool:
    """Return whether the last two axes have enough numbers for a map."""
    last_axes = result.definition.sweep_axes[-2:]
    return len(last_axes) == 2 and all(
        len(axis) >= MIN_MAP_VALUES and axis.name != "SNR" and are_numbers(axis.labels) for axis in last_axes
    )


def are_numbers(values: Sequence[Any]) -> bool:
    """Return whether all values are numbers."""
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def curves(result: StudyResult, view: View) -> list[Curve]:
    """Return the curves of a view over the last axis; over the index if its values are no numbers."""
    *outer_axes, last_axis = result.definition.sweep_axes
    values = last_axis.labels
    x = np.array(values if are_numbers(values) else range(len(values)), dtype=np.float64)
    view_curves = []
    for outer_values in itertools.product(*(axis.labels for axis in outer_axes)):
        rows = _rows_at(view, outer_axes, outer_values)
        if len(rows) == len(x):
            view_curves.append(Curve(coordinates_text(outer_axes, outer_values), x, tuple(rows)))
    return view_curves


def maps(result: StudyResult, view: View) -> Iterator[MapTable]:
    """Yield the map of a view over the last two axes for each combination of the outer axes."""
    *outer_axes, x_axis, y_axis = result.definition.sweep_axes
    x, y = (np.array(axis.labels, dtype=np.float64) for axis in (x_axis, y_axis))
    names = [name for name, value in view.rows[0].items() if isinstance(value, float)]
    for outer_values in itertools.product(*(axis.labels for axis in outer_axes)):
        # Rows have the last axis fastest: (x, y), transposed to (y, x) for the drawing.
        rows = _rows_at(view, outer_axes, outer_values)
        columns = {name: np.array([row[name] for row in rows]).reshape(len(x), len(y)).T for name in names}
        yield MapTable(outer_values, x, y, columns)


def _rows_at(view: View, axes: Sequence[Axis], values: Sequence[Any]) -> list[StudyRow]:
    return [row for row in view.rows if all(row[axis.name] == v for axis, v in zip(axes, values, strict=True))]


def coordinates_text(axes: Sequence[Axis], values: Sequence[Any]) -> str:
    """Return the values of ``axes`` in words: D_0 = 500 nm, SNR = 20 dB."""
    return ", ".join(f"{axis.name} = {value_text(v, axis.unit)}" for axis, v in zip(axes, values, strict=True))


def value_text(value: Any, unit: str) -> str:
    """Return a value with its unit and a prefix."""
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
    quantities = (("amplitude", "m", percent), ("phase", "rad", degrees))
    return [
        (row[f"{quantity}_{name}_{unit}"] * scale, row[f"{quantity}_{name}_se_{unit}"] * scale)
        for quantity, unit, scale in quantities
        for name in ("bias", "jitter")
    ]


def refused_text(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the number of refused estimates and its consequence for bias and jitter; "" if there are none."""
    refused = sum(row["refused"] for row in rows)
    if not refused:
        return ""
    return (
        f"{refused} estimates were refused. Bias and jitter exclude them and all others of the same draw of scatterers."
    )


def warned_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return how many estimates are of shots with warnings, and the worst case; "" if there are none."""
    worst = max(rows, key=lambda row: row.get("warned", 0), default={})
    warned = sum(row.get("warned", 0) for row in rows)
    if not warned:
        return ""
    total = sum(row["draws"] * row["noise"] for row in rows)
    return (
        f"{warned} of {total} estimates are of shots with warnings. The worst case has {worst['warned']} of "
        f"{worst['draws'] * worst['noise']}, at {worst['frequency_hz']:g} Hz with {worst['estimator']}. Bias and "
        "jitter include them; run that case to read the warnings."
    )


def spans(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the range of each of `error_figures` over ``rows``; a dash if no value is finite."""
    texts = []
    for values in zip(*([value for value, _ in error_figures(row)] for row in rows), strict=True):
        finite = [value for value in values if math.isfinite(value)]
        low, high = (f"{edge(finite):.3g}" if finite else "–" for edge in (min, max))
        texts.append(low if low == high else f"{low} to {high}")
    return texts


def with_error(value: float, standard_error: float) -> str:
    """Return a value and its standard error; the value alone without one."""
    if not 0 < standard_error < math.inf:
        return f"{value:.4g}"
    return with_u(value, standard_error).replace("+-", "±")
