"""Conditions of a run, such as the temperature of the water: their range over all shots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class ConditionSummary:
    """A condition over all readings before and after the shots of a run, in ``unit``.

    ``limits``: those of the bench file in words, "" without any. ``not_read``: number of failed readings. The other
    values are NaN if every reading failed.
    """

    name: str
    unit: str
    limits: str
    lowest: float
    highest: float
    mean: float
    not_read: int

    @property
    def cells(self) -> Mapping[str, str]:
        """The values as text, by the headers of a table."""
        return {
            "condition": f"{self.name} ({self.unit})" if self.unit else self.name,
            **{header: _digits(getattr(self, header)) for header in ("lowest", "highest", "mean")},
            "limits": self.limits or "-",
            "not read": f"{self.not_read}",
        }


def _digits(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.5g}"


def condition_summary(name: str, unit: str, limits: str, readings: FloatArray) -> ConditionSummary:
    """Return the summary of a condition from its ``readings`` (shot, 2), NaN if not read."""
    values = readings[np.isfinite(readings)]
    if not values.size:
        return ConditionSummary(name, unit, limits, math.nan, math.nan, math.nan, readings.size)
    lowest, highest, mean = float(values.min()), float(values.max()), float(values.mean())
    return ConditionSummary(name, unit, limits, lowest, highest, mean, readings.size - values.size)
