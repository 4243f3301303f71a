"""Result as arrays over (shot, frequency) and (shot, pulse): for the result file and for xarray."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hpe_rig.arrays import FloatArray, Int64Array
from hpe_rig.result.values import Result

if TYPE_CHECKING:
    import xarray

UNITS: Final = {
    "amplitude_m": "m",
    "amplitude_uncertainty_m": "m",
    "phase_rad": "rad",
    "phase_uncertainty_rad": "rad",
    "averaging_factor": "1",
    "speckle_relative": "1",
    "true_amplitude_m": "m",
    "true_phase_rad": "rad",
    "averaging_phase_rad": "rad",
    "aliasing_factor": "1",
    "aliasing_phase_rad": "rad",
    "corrected_amplitude_m": "m",
    "corrected_uncertainty_m": "m",
    "corrected_phase_rad": "rad",
    "corrected_phase_uncertainty_rad": "rad",
    "interval_95_m": "m",
    "interval_95_rad": "rad",
}
"""Quantities of an estimate, each (shot, frequency), with their units."""
MOTION_UNITS: Final = {
    "time_s": "s",
    "displacement_m": "m",
    "displacement_uncertainty_m": "m",
    "model_m": "m",
    "residual_m": "m",
}
"""Quantities of a pulse, each (shot, pulse), with their units."""
SETTING_UNITS: Final = {
    "repeat": "1",
    "burst_length_s": "s",
    "force_fraction": "1",
    "pulse_rate_hz": "Hz",
    "window_length_s": "s",
    "lateral_offset_m": "m",
    "axial_offset_m": "m",
}
"""What was set in each shot, (shot,), with units."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A result as arrays, NaN where a value is unknown.

    ``shot`` (shot,): the shot of each row, one a window; ``frequency_hz`` (shot, frequency), ``frequency`` (frequency,)
    the same where all shots have the same frequencies, else None; ``estimates`` by the names of `UNITS`, each (shot,
    frequency); ``settings`` by those of `SETTING_UNITS`, each (shot,); ``motion`` by those of `MOTION_UNITS`, each
    (shot, pulse), empty where the result holds no displacements.
    """

    shot: Int64Array
    frequency_hz: FloatArray
    frequency: FloatArray | None
    estimates: Mapping[str, FloatArray]
    settings: Mapping[str, FloatArray]
    motion: Mapping[str, FloatArray]


def result_grid(result: Result) -> Grid:
    """Return ``result`` as arrays."""
    rows = [shot.estimates for shot in result.shots]
    most = max((len(row) for row in rows), default=0)

    def table(name: str) -> FloatArray:
        values = [[_number(getattr(each, name)) for each in row] + [math.nan] * (most - len(row)) for row in rows]
        return np.array(values, dtype=np.float64).reshape(len(rows), most)

    frequency_hz = table("frequency_hz")
    alike = bool(len(rows)) and bool((frequency_hz == frequency_hz[0]).all())
    return Grid(
        shot=np.array([shot.shot for shot in result.shots], dtype=np.int64),
        frequency_hz=frequency_hz,
        frequency=frequency_hz[0] if alike else None,
        estimates={name: table(name) for name in UNITS},
        settings={name: np.array([_number(getattr(s, name)) for s in result.shots]) for name in SETTING_UNITS},
        motion=_motion(result),
    )


def _motion(result: Result) -> Mapping[str, FloatArray]:
    motions = [shot.motion for shot in result.shots]
    pulses = max((int(each.pulse.max()) + 1 for each in motions if each is not None and each.pulse.size), default=0)
    if not pulses:
        return {}
    arrays = {name: np.full((len(motions), pulses), math.nan) for name in MOTION_UNITS}
    for row, each in enumerate(motions):
        if each is not None:
            columns = (each.time_s, each.displacement_m, each.uncertainty_m, each.model_m, each.residual_m)
            for array, values in zip(arrays.values(), columns, strict=True):
                array[row, each.pulse] = values
    return arrays


def result_dataset(result: Result) -> xarray.Dataset:
    """Return the arrays as an xarray Dataset with axes, units and what was set in each shot."""
    try:
        import xarray
    except ModuleNotFoundError as error:
        what = 'Result.to_xarray needs xarray, which is not installed. Try: pip install "hpe-rig[frames]".'
        raise ModuleNotFoundError(what, name=error.name) from None

    grid = result_grid(result)
    number = np.arange(1, grid.frequency_hz.shape[1] + 1)
    axis = ("frequency", number, {}) if grid.frequency is None else ("frequency", grid.frequency, {"units": "Hz"})
    coordinates: dict[str, Any] = {"shot": grid.shot, "frequency": axis}
    coordinates |= {name: ("shot", values, {"units": SETTING_UNITS[name]}) for name, values in grid.settings.items()}
    tables = {name: (("shot", "frequency"), values, {"units": UNITS[name]}) for name, values in grid.estimates.items()}
    if grid.frequency is None:
        tables["frequency_hz"] = (("shot", "frequency"), grid.frequency_hz, {"units": "Hz"})
    if grid.motion:
        coordinates["pulse"] = np.arange(grid.motion["time_s"].shape[1])
        motion = {name: (("shot", "pulse"), of, {"units": MOTION_UNITS[name]}) for name, of in grid.motion.items()}
        coordinates["time_s"] = motion.pop("time_s")
        tables |= motion
    names = ("title", "run_file", "estimator", "phase_reference", "status")
    about = {name: getattr(result, name) for name in names} | {"simulated": int(result.simulated)}
    return xarray.Dataset(tables, coordinates, about | {f"note_{name}": note for name, note in result.notes.items()})


def _number(value: float | None) -> float:
    return math.nan if value is None else value
