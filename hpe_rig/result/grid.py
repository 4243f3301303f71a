"""Result as arrays over (shot, frequency) and (shot, pulse), for the result file and for xarray."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from hpe_rig.arrays import FloatArray, Int64Array
from hpe_rig.result.covariance import PARTS, covariance_grid, covariance_of
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.tables import package_of_extra

if TYPE_CHECKING:
    import xarray

UNITS: Final = {
    "amplitude_m": "m",
    "amplitude_uncertainty_m": "m",
    "phase_rad": "rad",
    "phase_uncertainty_rad": "rad",
    "interval_95_m": "m",
    "interval_95_rad": "rad",
    "tracked_amplitude_m": "m",
    "tracked_amplitude_uncertainty_m": "m",
    "tracked_phase_rad": "rad",
    "tracked_phase_uncertainty_rad": "rad",
    "averaging_factor": "1",
    "speckle_relative": "1",
    "true_amplitude_m": "m",
    "true_phase_rad": "rad",
    "averaging_phase_rad": "rad",
    "aliasing_factor": "1",
    "aliasing_phase_rad": "rad",
}
"""Quantities of an estimate, each (shot, frequency), and their units."""
MOTION_UNITS: Final = {
    "time_s": "s",
    "displacement_m": "m",
    "displacement_uncertainty_m": "m",
    "model_m": "m",
    "residual_m": "m",
}
"""Quantities of a pulse, each (shot, pulse), and their units."""
SETTING_UNITS: Final = {
    "repeat": "1",
    "burst_length_s": "s",
    "force_fraction": "1",
    "pulse_rate_hz": "Hz",
    "window_length_s": "s",
    "lateral_offset_m": "m",
    "axial_offset_m": "m",
}
"""Settings of a shot, each (shot,), and their units."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A result as arrays; NaN for unknown values.

    ``shot`` (shot,): number of the shot in each row, from 1; a shot has one row for each window. ``frequency_hz``
    (shot, frequency); ``frequency`` (frequency,) if all shots have the same frequencies, else None. ``estimates``: by
    the names of `UNITS`, each (shot, frequency). ``settings``: by the names of `SETTING_UNITS`, each (shot,).
    ``motion``: by the names of `MOTION_UNITS`, each (shot, pulse); empty without stored displacements.
    """

    shot: Int64Array
    frequency_hz: FloatArray
    frequency: FloatArray | None
    estimates: Mapping[str, FloatArray]
    settings: Mapping[str, FloatArray]
    motion: Mapping[str, FloatArray]


def result_grid(result: ResultData) -> Grid:
    """Return ``result`` as arrays."""
    rows = [shot.estimates for shot in result.shots]
    count = max((len(row) for row in rows), default=0)

    def table(name: str) -> FloatArray:
        values = [[_number(getattr(item, name)) for item in row] + [math.nan] * (count - len(row)) for row in rows]
        return np.array(values, dtype=np.float64).reshape(len(rows), count)

    frequency_hz = table("frequency_hz")
    same_frequencies = bool(len(rows)) and bool((frequency_hz == frequency_hz[0]).all())
    return Grid(
        shot=np.array([shot.shot for shot in result.shots], dtype=np.int64),
        frequency_hz=frequency_hz,
        frequency=frequency_hz[0] if same_frequencies else None,
        estimates={name: table(name) for name in UNITS},
        settings={
            # As in every table, repeats count from 1.
            name: np.array([_number(getattr(shot, name)) for shot in result.shots]) + (name == "repeat")
            for name in SETTING_UNITS
        },
        motion=_motion(result),
    )


def _motion(result: ResultData) -> Mapping[str, FloatArray]:
    motions = [shot.motion for shot in result.shots]
    # Pulses are columns by their number in the shot; excluded ones stay NaN.
    pulses = max((int(item.pulse.max()) + 1 for item in motions if item is not None and item.pulse.size), default=0)
    if not pulses:
        return {}
    arrays = {name: np.full((len(motions), pulses), math.nan) for name in MOTION_UNITS}
    for row, item in enumerate(motions):
        if item is not None:
            columns = (item.time_s, item.displacement_m, item.uncertainty_m, item.model_m, item.residual_m)
            for array, values in zip(arrays.values(), columns, strict=True):
                array[row, item.pulse] = values
    return arrays


def result_dataset(result: ResultData) -> xarray.Dataset:
    """Return the arrays as an xarray Dataset with axes, units and the settings of each shot."""
    dataset = package_of_extra("xarray", "Result.to_xarray").Dataset
    # Shots with different frequencies share no frequency axis: it then counts the harmonics.
    grid = result_grid(result)
    number = np.arange(1, grid.frequency_hz.shape[1] + 1)
    axis = ("frequency", number, {}) if grid.frequency is None else ("frequency", grid.frequency, {"units": "Hz"})
    coordinates: dict[str, Any] = {"shot": grid.shot, "frequency": axis}
    coordinates |= {name: ("shot", values, {"units": SETTING_UNITS[name]}) for name, values in grid.settings.items()}
    for condition in result.conditions:
        # A shot of the result has one value: the mean of the readings before and after it.
        means = np.array([np.mean(shot.conditions[condition.name]) for shot in result.shots])
        coordinates[f"condition_{condition.name}"] = ("shot", means, {"units": condition.unit})
    tables: dict[str, Any] = {
        name: (("shot", "frequency"), values, {"units": UNITS[name]}) for name, values in grid.estimates.items()
    }
    if grid.frequency is None:
        tables["frequency_hz"] = (("shot", "frequency"), grid.frequency_hz, {"units": "Hz"})
    if grid.motion:
        coordinates["pulse"] = np.arange(grid.motion["time_s"].shape[1])
        motion = {
            name: (("shot", "pulse"), values, {"units": MOTION_UNITS[name]}) for name, values in grid.motion.items()
        }
        coordinates["time_s"] = motion.pop("time_s")
        tables |= motion
    if result.has_covariance:
        covariance = covariance_grid(covariance_of([result.shots]))
        coordinates |= {name: (dims, values) for name, (dims, values, unit) in covariance.items() if not unit}
        tables |= {name: (dims, values, {"units": unit}) for name, (dims, values, unit) in covariance.items() if unit}
        coordinates["part"] = list(PARTS)
    names = ("title", "run_file", "estimator", "phase_reference", "status")
    attributes = {name: getattr(result, name) for name in names} | {"simulated": int(result.simulated)}
    attributes |= {f"note_{name}": note for name, note in result.notes.items()}
    return cast("xarray.Dataset", dataset(tables, coordinates, attributes))


def _number(value: float | None) -> float:
    return math.nan if value is None else value
