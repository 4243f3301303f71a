"""Result file: separate from the run file, so that records are written once and never touched again."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Final

import h5py
import numpy as np
from numpy.typing import NDArray

from hpe_rig.result import Result, ShotResult
from hpe_rig.store.atomic import atomic_file
from hpe_rig.store.checksum import seal
from hpe_rig.store.format import RESULT_FORMAT, StoreError, reason
from hpe_rig.store.layout import LIBVER, name_axes

RESULT_UNITS: Final = {
    "amplitude_m": "m",
    "amplitude_uncertainty_m": "m",
    "phase_rad": "rad",
    "phase_uncertainty_rad": "rad",
    "averaging_factor": "1",
    "speckle_relative": "1",
    "true_amplitude_m": "m",
    "true_phase_rad": "rad",
    "averaging_phase_rad": "rad",
    "corrected_amplitude_m": "m",
    "corrected_uncertainty_m": "m",
    "corrected_phase_rad": "rad",
    "corrected_phase_uncertainty_rad": "rad",
}


def write_result(path: Path, result: Result) -> None:
    """Write ``result`` to ``path``, in place of an earlier result there and of nothing else.

    Group ``results``: one dataset for each quantity of an estimate, float64 (shot, frequency), NaN where unknown. Of
    gates over depth also group ``profile``, the same (shot, depth, frequency), and group ``burst_period`` with
    ``displacement_m`` (shot, depth, time).
    Raises ``StoreError`` if it cannot be written.
    """
    _refuse_foreign(path)
    try:
        # In memory first: an error of the disk must not meet the library, see journal.py.
        with h5py.File("result", "w", driver="core", backing_store=False, libver=LIBVER) as file:
            _write(file, result)
            seal(file)
            file.flush()
            image = file.id.get_file_image()
        with atomic_file(path) as draft, draft.open("xb") as disk:
            disk.write(image)
            disk.flush()
            os.fsync(disk.fileno())
    except (OSError, RuntimeError) as error:
        raise StoreError(
            f"{path} cannot be written ({reason(error)}). The run file is as it was. "
            "Try: make room or a writable folder, then hpe-rig process."
        ) from error


def _write(file: h5py.File, result: Result) -> None:
    file.attrs["format"] = RESULT_FORMAT
    for name in ("title", "run_file", "simulated", "estimator", "phase_reference"):
        file.attrs[name] = getattr(result, name)
    text = json.dumps(result.as_dict()).encode()
    file["json"] = np.array(text, dtype=h5py.string_dtype("utf-8", len(text)))
    rows = [shot.estimates for shot in result.shots]
    group = file.create_group("results")
    for name in RESULT_UNITS:
        values = [[_number(getattr(estimate, name)) for estimate in row] for row in rows]
        group.create_dataset(name, data=values, dtype="f8")
    frequency_hz = np.array([estimate.frequency_hz for estimate in rows[0]])
    shots = np.array([shot.shot for shot in result.shots])
    name_axes(group, {"shot": shots, "frequency": frequency_hz}, RESULT_UNITS)
    group["frequency"].attrs["units"] = "Hz"
    if result.profile:
        _write_profile(file, result, frequency_hz)


def _write_profile(file: h5py.File, result: Result, frequency_hz: NDArray[np.float64]) -> None:
    """Write groups ``profile`` and ``burst_period``; NaN where a shot has no such gate."""
    settings = list(dict.fromkeys(_setting(gate.shot) for gate in result.profile))
    depth_m = np.unique([gate.depth_m for gate in result.profile])
    at = [(settings.index(_setting(gate.shot)), int(np.searchsorted(depth_m, gate.depth_m))) for gate in result.profile]
    scales = {"shot": np.array([shot for shot, _ in settings]), "depth": depth_m}
    group = file.create_group("profile")
    lengths_m = np.full((len(settings), depth_m.size), np.nan)
    for place, gate in zip(at, result.profile, strict=True):
        lengths_m[place] = gate.length_m
    group.create_dataset("gate_length_m", data=lengths_m)
    for name in RESULT_UNITS:
        values = np.full((len(settings), depth_m.size, frequency_hz.size), np.nan)
        for place, gate in zip(at, result.profile, strict=True):
            values[place] = [_number(getattr(estimate, name)) for estimate in gate.shot.estimates]
        group.create_dataset(name, data=values)
    name_axes(group, scales | {"frequency": frequency_hz}, RESULT_UNITS | {"gate_length_m": "m"})
    group["frequency"].attrs["units"], group["depth"].attrs["units"] = "Hz", "m"
    times_s = max((gate.motion_time_s for gate in result.profile), key=len)
    if not times_s:
        return
    group = file.create_group("burst_period")
    moved_m = np.full((len(settings), depth_m.size, len(times_s)), np.nan)
    for place, gate in zip(at, result.profile, strict=True):
        if len(gate.motion_m) == len(times_s):
            moved_m[place] = gate.motion_m
    group.create_dataset("displacement_m", data=moved_m)
    name_axes(group, scales | {"time": np.array(times_s)}, {"displacement_m": "m"})
    group["time"].attrs["units"], group["depth"].attrs["units"] = "s", "m"


def _setting(shot: ShotResult) -> tuple[int, float | None]:
    """Return what a row of the file is of: a shot, and the slow-time window taken of it."""
    return shot.shot, shot.window_length_s


def _refuse_foreign(path: Path) -> None:
    """Raise ``StoreError`` where ``path`` exists and is not a result file."""
    if not path.exists():
        return
    try:
        with h5py.File(path, "r") as file:
            # Results of earlier versions have no attribute ``format``, but these two.
            known = file.attrs.get("format") == RESULT_FORMAT or {"run_file", "estimator"} <= set(file.attrs)
    except (OSError, KeyError, ValueError, RuntimeError):
        known = False
    if not known:
        raise StoreError(
            f"{path} exists and is not a result file of hpe-rig, so it is not replaced. Try: move it away."
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
