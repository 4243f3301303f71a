"""Result file, separate from the run file: the run file never changes after the run."""

from __future__ import annotations

import json
import threading
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import FloatArray
from hpe_rig.result import MOTION_UNITS, PARTS, UNITS, Covariance, Result, ShotResult, covariance_grid, result_grid
from hpe_rig.store.atomic import atomic_file, synchronise
from hpe_rig.store.checksum import kind_of, sealed_file
from hpe_rig.store.foreign_hdf5 import InvalidContentError, open_bounded
from hpe_rig.store.format import RESULT_FORMAT, RESULT_VERSION, StoreError, reason
from hpe_rig.store.layout import name_axes
from hpe_rig.store.task import make_or_undo


def write_result(path: Path, result: Result, run_digest: str = "") -> None:
    """Write ``result`` to ``path``; replace an earlier result but no other file. ``run_digest``: of its run.

    Group ``results``: one dataset for each quantity of an estimate, float64 (shot, frequency), NaN if unknown.
    Group ``motion``: displacement, its uncertainty, model and residual of every pulse, float64 (shot, pulse).
    Group ``covariance``: complex values with the influences of all sources of uncertainty.
    With gates over depth also group ``profile``, as ``results`` but (shot, depth, frequency), and group
    ``burst_period`` with ``displacement_m`` (shot, depth, time).
    Raises ``StoreError`` if the file cannot be written or the disk does not respond for a minute; an earlier result
    stays unchanged then.
    """
    try:
        image = sealed_file(partial(_write, result=result, run_digest=run_digest))
        make_or_undo(partial(_replace, path, image), lambda _: None)
    except (OSError, RuntimeError) as error:
        raise StoreError(
            f"{path} cannot be written ({reason(error)}). The run file is as it was. "
            "Try: make room or a writable folder, then hpe-rig process."
        ) from error


def _replace(path: Path, image: bytes, cancelled: threading.Event) -> None:
    """Write the bytes ``image`` to ``path`` atomically, unless ``cancelled`` says that the program no longer waits."""
    _refuse_foreign(path)
    with atomic_file(path) as file:
        file.write(image)
        synchronise(file)
        if cancelled.is_set():
            raise InterruptedError


def _write(file: h5py.File, result: Result, run_digest: str) -> None:
    """Write the result into the HDF5 file: as JSON, and its estimates, motion and depth profile with axes."""
    file.attrs["format"] = RESULT_FORMAT
    file.attrs["version"] = RESULT_VERSION
    file.attrs["run_digest"] = np.bytes_(run_digest)
    for name in ("title", "run_file", "simulated", "estimator", "phase_reference"):
        file.attrs[name] = getattr(result, name)
    text = json.dumps(result.as_dict()).encode()
    file["json"] = np.array(text, dtype=h5py.string_dtype("utf-8", len(text)))
    grid = result_grid(result)
    group = file.create_group("results")
    for name, values in grid.estimates.items():
        group.create_dataset(name, data=values, dtype="f8")
    if grid.frequency is None:
        # A sweep changes the frequencies: the axis is their number, from 1.
        group["frequency_hz"] = grid.frequency_hz
    axis = np.arange(1.0, grid.frequency_hz.shape[1] + 1) if grid.frequency is None else grid.frequency
    name_axes(group, {"shot": grid.shot, "frequency": axis}, {**UNITS, "frequency_hz": "Hz"})
    group["frequency"].attrs["units"] = "1" if grid.frequency is None else "Hz"
    if grid.motion:
        motion = file.create_group("motion")
        for name, values in grid.motion.items():
            motion[name] = values
        pulses = np.arange(grid.motion["time_s"].shape[1])
        name_axes(motion, {"shot": grid.shot, "pulse": pulses}, MOTION_UNITS)
        motion["time_s"].attrs["long_name"] = f"time of the motion at the gate, {result.phase_reference}"
        tracked = {shot.motion.tracked_by for shot in result.shots if shot.motion is not None}
        motion.attrs["tracked_by"] = ", ".join(sorted(tracked))
    if result.has_covariance:
        _write_covariance(file, result)
    if result.profile:
        _write_profile(file, result, axis)


def _write_covariance(file: h5py.File, result: Result) -> None:
    """Write group ``covariance``: the arrays of the result's ``Covariance``, each with its axes."""
    covariance = result.covariance()
    group = file.create_group("covariance")
    arrays = covariance_grid(covariance) | {"frequency_hz": (("shot", "frequency"), covariance.frequency_hz, "Hz")}
    _, frequencies, columns = covariance.influence_m.shape
    scales: dict[str, NDArray[Any]] = {
        "shot": covariance.shot,
        "part": np.array(PARTS),
        "frequency": np.arange(1.0, frequencies + 1),
        "column": np.arange(columns),
    }
    for name, values in scales.items():
        group[name] = _with_text(values)
        group[name].make_scale(name)
    for name, (dimensions, values, unit) in arrays.items():
        group[name] = _with_text(values)
        group[name].attrs["units"] = unit or "1"
        for axis, dimension in zip(group[name].dims, dimensions, strict=True):
            axis.attach_scale(group[dimension])


def _with_text(values: NDArray[Any]) -> NDArray[Any]:
    """Return ``values``, text as UTF-8 of fixed length."""
    if values.dtype.kind != "U":
        return values
    encoded = np.char.encode(values, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


def read_covariance(path: Path | str) -> Covariance:
    """Return the complex values and their covariance from the result file at ``path``, as ``Result.covariance()``.

    Raises ``StoreError`` if the file cannot be read or is older than group ``covariance``.
    """
    names = "shot", "frequency_hz", "phasor_m", "influence_m", "variable", "source", "common_to", "degrees_of_freedom"
    try:
        with open_bounded(Path(path)) as file:
            group = file["covariance"]
            counted_from = 0 if file.attrs.get("version", 1) < RESULT_VERSION else 1
            arrays = {
                name: group[name].asstr()[()] if group[name].dtype.kind == "S" else group[name][()] for name in names
            }
        for name in ("phasor_m", "influence_m"):
            arrays[name] = arrays[name][..., 0] + 1j * arrays[name][..., 1]
        if arrays["influence_m"].shape[:-1] != arrays["phasor_m"].shape:
            raise InvalidContentError("its values and their influences differ in shape")
        arrays["shot"] = arrays["shot"] + 1 - counted_from
        texts = {name: tuple(arrays[name].tolist()) for name in ("source", "common_to")}
        return Covariance(**(arrays | texts))
    except (OSError, KeyError, ValueError, TypeError, IndexError, RuntimeError, InvalidContentError) as error:
        raise StoreError(
            f"{path}: no covariance can be read ({reason(error)}). It is no result file, or one of an earlier version. "
            "Try: hpe-rig process with the run file, which writes the result file again."
        ) from error


def _write_profile(file: h5py.File, result: Result, frequency_hz: FloatArray) -> None:
    """Write group ``profile`` (estimates over depth) and group ``burst_period`` (mean motion over a burst period).

    Rows are shots and slow-time windows, columns depths. NaN for shots without a gate at a depth. ``frequency_hz``:
    values of the frequency axis. An entry of ``result.profile`` is the result of one gate of one shot and window.
    """
    rows = list(dict.fromkeys(_row_key(gate.shot) for gate in result.profile))
    depth_m = np.unique([gate.depth_m for gate in result.profile])
    # Row (shot and slow-time window) and column (depth) of each gate.
    cells = [(rows.index(_row_key(gate.shot)), int(np.searchsorted(depth_m, gate.depth_m))) for gate in result.profile]
    scales = {"shot": np.array([shot for shot, _ in rows]), "depth": depth_m}
    group = file.create_group("profile")
    lengths_m = np.full((len(rows), depth_m.size), np.nan)
    for cell, gate in zip(cells, result.profile, strict=True):
        lengths_m[cell] = gate.length_m
    group.create_dataset("gate_length_m", data=lengths_m)
    for name in UNITS:
        values = np.full((len(rows), depth_m.size, frequency_hz.size), np.nan)
        for cell, gate in zip(cells, result.profile, strict=True):
            estimates = [getattr(estimate, name) for estimate in gate.shot.estimates]
            values[cell][: len(estimates)] = [np.nan if value is None else value for value in estimates]
        group.create_dataset(name, data=values)
    name_axes(group, scales | {"frequency": frequency_hz}, {**UNITS, "gate_length_m": "m"})
    group["depth"].attrs["units"] = "m"
    group["frequency"].attrs["units"] = file["results/frequency"].attrs["units"]
    times_s = max((gate.motion_time_s for gate in result.profile), key=len)
    if not times_s:
        return
    group = file.create_group("burst_period")
    displacement_m = np.full((len(rows), depth_m.size, len(times_s)), np.nan)
    for cell, gate in zip(cells, result.profile, strict=True):
        if len(gate.motion_m) == len(times_s):
            displacement_m[cell] = gate.motion_m
    group.create_dataset("displacement_m", data=displacement_m)
    name_axes(group, scales | {"time": np.array(times_s)}, {"displacement_m": "m"})
    group["time"].attrs["units"], group["depth"].attrs["units"] = "s", "m"


def _row_key(shot: ShotResult) -> tuple[int, float | None]:
    """Return the shot's number and the length of its slow-time window, which identify a row of the profile."""
    return shot.shot, shot.window_length_s


def _refuse_foreign(path: Path) -> None:
    """Raise ``StoreError`` if ``path`` exists and is not a result file."""
    if path.exists() and kind_of(path) != "result":
        raise StoreError(
            f"{path} exists and is not a result file of hpe-rig, so it is not replaced. Try: move it away."
        )
