"""The HDF5 run file: scene and bench verbatim, settings as read back, records with their axes, status.

Layout, format version 1::

    /                      attributes: format, format_version, title, simulated, status, versions, commit, seed
    /scene, /bench         TOML text; /snapshot (shot,) JSON of the settings read back
    /records               echo (shot, pulse, sample) int16 with scale_factor and add_offset to volts,
                           trigger_time_s and pulse_onset_s (shot, pulse); clipped (shot,) 1 where the input left its
                           range; scales shot, pulse, sample
    /truth                 displacement_m (shot, pulse), simulated runs only
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import RecordBlock, Setting
from hpe_rig.bench_file import BenchText
from hpe_rig.plan import Plan, Shot
from hpe_rig.records import MISSING, ShotRecords, pulse_index
from hpe_rig.result import Result
from hpe_rig.scene import SceneText

FORMAT = "hpe_rig run"
FORMAT_VERSION = 1


class StoreError(Exception):
    """A run file that cannot be written or read; says which, why and what to try."""


def versions() -> dict[str, str]:
    """Return the versions that shaped the numbers, and the commit the package was built from where it is known."""
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "h5py")}
    try:
        own = metadata.version("hpe-rig")
    except metadata.PackageNotFoundError:
        own = "not installed"
    commit = own.partition("+g")[2].partition(".")[0] or "unknown"
    return {"hpe_rig": own, "commit": commit, "python": platform.python_version(), **packages}


def free_path(stem: str, folder: Path) -> Path:
    """Return ``folder/stem.h5``, or the first numbered name after it that does not exist."""
    path, number = folder / f"{stem}.h5", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.h5", number + 1
    return path


class RunWriter:
    """An open run file; records are appended as they arrive, the status says how it ended."""

    def __init__(self, path: Path, scene: SceneText, bench: BenchText, plan: Plan) -> None:
        """Create ``path``; raise ``StoreError`` if it exists or cannot be written."""
        try:
            self._file = h5py.File(path, "x")
        except FileExistsError:
            raise StoreError(f"{path} exists and is never overwritten. Try: another --output, or remove it.") from None
        except OSError as error:
            raise StoreError(f"{path} cannot be created ({error}). Try: another folder with --output.") from None
        self._first_trigger_s: dict[int, float] = {}
        _write_header(self._file, scene, bench, plan)
        self._records = _create_records(self._file, plan)

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failed = "failed" if kind is not None and issubclass(kind, Exception) else "aborted"
        self._file.attrs["status"] = "complete" if kind is None else failed
        self._file.close()

    def append(self, shot: Shot, block: RecordBlock) -> None:
        """Write the records of ``block`` to their pulses' places."""
        if not block.codes.size:
            return
        first_s = self._first_trigger_s.setdefault(shot.index, float(block.trigger_time_s[0]))
        index = pulse_index(block, first_s, shot)
        kept = index >= 0
        echo = self._records["echo"]
        echo.attrs["scale_factor"], echo.attrs["add_offset"] = block.volts_per_code, block.volts_offset
        echo[shot.index, index[kept]] = block.codes[kept]
        self._records["trigger_time_s"][shot.index, index[kept]] = block.trigger_time_s[kept]

    def settings(self, shot: Shot, settings: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the instruments' settings as read back for ``shot``."""
        self._file["snapshot"][shot.index] = json.dumps(settings, sort_keys=True)

    def truth(self, shot: Shot, displacement_m: NDArray[np.float64]) -> None:
        """Write the true displacement at the focus for each record of ``shot``, shape (record,)."""
        valid = np.flatnonzero(np.isfinite(self._records["trigger_time_s"][shot.index]))
        self._file["truth/displacement_m"][shot.index, valid] = displacement_m[: valid.size]

    def clipped(self, shot: Shot, clipped: bool) -> None:
        """Write whether the digitizer's input left its range during ``shot``."""
        self._records["clipped"][shot.index] = clipped

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        self._file.flush()


@dataclass(frozen=True, slots=True)
class StoredRun:
    """What a run file holds; ``true_displacement_m`` (shot, pulse) is None for a real bench.

    ``clipped`` are the indices of the shots during which the digitizer's input left its range.
    """

    path: Path
    scene_name: str
    scene_toml: str
    bench_name: str
    bench_toml: str
    simulated: bool
    status: str
    records: tuple[ShotRecords, ...]
    true_displacement_m: NDArray[np.float64] | None
    clipped: tuple[int, ...] = ()


def read_run(path: Path) -> StoredRun:
    """Return the run in ``path``; raise ``StoreError`` where it is no readable run file of a known version."""
    try:
        with h5py.File(path, "r") as file:
            _check_format(file, path)
            return _stored_run(file, path)
    except (OSError, KeyError, ValueError) as error:
        raise StoreError(f"{path} is not a readable run file ({error}). Try: a file written by hpe-rig run.") from None


def read_snapshots(path: Path) -> tuple[Mapping[str, Mapping[str, Setting]], ...]:
    """Return each acquired shot's settings as read back, by role; raise ``StoreError`` as ``read_run`` does."""
    try:
        with h5py.File(path, "r") as file:
            _check_format(file, path)
            texts = [text for text in file["snapshot"].asstr()[()] if text]
    except (OSError, KeyError, ValueError) as error:
        raise StoreError(f"{path} is not a readable run file ({error}). Try: a file written by hpe-rig run.") from None
    return tuple(json.loads(text) for text in texts)


def _check_format(file: h5py.File, path: Path) -> None:
    if file.attrs.get("format") != FORMAT:
        raise StoreError(f"{path} is not a run file of hpe-rig. Try: a file written by hpe-rig run.")
    version = int(file.attrs["format_version"])
    if version > FORMAT_VERSION:
        raise StoreError(
            f"{path} has format version {version}, this program reads up to {FORMAT_VERSION}. Try: a newer hpe-rig."
        )


def _stored_run(file: h5py.File, path: Path) -> StoredRun:
    group = file["records"]
    echo = group["echo"]
    scale, offset = float(echo.attrs["scale_factor"]), float(echo.attrs["add_offset"])
    records = tuple(
        ShotRecords(echo[shot], group["trigger_time_s"][shot], scale, offset) for shot in range(echo.shape[0])
    )
    simulated = bool(file.attrs["simulated"])
    return StoredRun(
        path=path,
        scene_name=str(file.attrs["scene_name"]),
        scene_toml=file["scene"].asstr()[()],
        bench_name=str(file.attrs["bench_name"]),
        bench_toml=file["bench"].asstr()[()],
        simulated=simulated,
        status=str(file.attrs["status"]),
        records=records,
        true_displacement_m=file["truth/displacement_m"][()] if simulated else None,
        clipped=tuple(int(shot) for shot in np.flatnonzero(group["clipped"][()])) if "clipped" in group else (),
    )


def _write_header(file: h5py.File, scene: SceneText, bench: BenchText, plan: Plan) -> None:
    simulation = scene.scene.simulation or {}
    attributes = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "title": scene.scene.title,
        "scene_name": scene.name,
        "bench_name": bench.name,
        "simulated": bench.bench.simulated,
        "seed": simulation.get("seed", 1) if bench.bench.simulated else -1,
        "status": "running",
    }
    file.attrs.update(attributes | {f"version_{name}": text for name, text in versions().items()})
    file["scene"], file["bench"] = scene.text, bench.text
    file.create_dataset("snapshot", len(plan.shots), h5py.string_dtype())
    _name_axes(file, {"shot": np.arange(len(plan.shots))}, {})


def _create_records(file: h5py.File, plan: Plan) -> h5py.Group:
    shots, capture = plan.shots, plan.shots[0].capture
    shape = (len(shots), capture.record_count, capture.record_samples)
    group = file.create_group("records")
    # The CF names: readers that know them turn codes into volts and missing records into NaN by themselves.
    pulses_a_chunk = max(1, min(capture.record_count, math.ceil(1e6 / (2 * capture.record_samples))))
    group.create_dataset("echo", shape, "i2", chunks=(1, pulses_a_chunk, shape[2]), fillvalue=MISSING)
    group["echo"].attrs.update({"scale_factor": np.nan, "add_offset": np.nan, "_FillValue": MISSING})
    group.create_dataset("trigger_time_s", shape[:2], "f8", fillvalue=np.nan)
    group["pulse_onset_s"] = np.stack([shot.timeline.pulse_onset_s for shot in shots])
    group["burst_length_s"] = [shot.timeline.burst_length_s for shot in shots]
    group["force_fraction"] = [math.nan if shot.force_fraction is None else shot.force_fraction for shot in shots]
    group["repeat"] = [shot.repeat for shot in shots]
    group["clipped"] = np.zeros(len(shots), np.int8)
    sample_s = plan.shots[0].timeline.record_offset_s[0] + np.arange(shape[2]) / capture.sample_rate_hz
    units = {"echo": "V", "trigger_time_s": "s", "pulse_onset_s": "s", "burst_length_s": "s"}
    _name_axes(group, {"shot": np.arange(shape[0]), "pulse": np.arange(shape[1]), "sample": sample_s}, units)
    group["sample"].attrs.update({"units": "s", "long_name": "time after the onset of the tracking pulse"})
    if file.attrs["simulated"]:
        truth = file.create_group("truth")
        truth.create_dataset("displacement_m", shape[:2], "f8", fillvalue=np.nan)
        _name_axes(truth, {"shot": np.arange(shape[0]), "pulse": np.arange(shape[1])}, {"displacement_m": "m"})
    return group


def _name_axes(group: h5py.Group, scales: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> None:
    """Give every dataset of ``group`` its units and, axis by axis in this order, the named scales."""
    datasets = [item for item in group.values() if isinstance(item, h5py.Dataset) and item.ndim]
    for name, values in scales.items():
        group[name] = values
        group[name].make_scale(name)
    for dataset in datasets:
        dataset.attrs["units"] = units.get(dataset.name.rpartition("/")[2], "1")
        for axis, name in zip(range(dataset.ndim), scales, strict=False):
            dataset.dims[axis].attach_scale(group[name])


def result_path(run_path: Path, estimator: str) -> Path:
    """Return the path of the result file beside a run file."""
    return run_path.with_name(f"{run_path.stem}.{estimator}.h5")


def write_result(path: Path, result: Result) -> None:
    """Write ``result`` to ``path``, replacing an earlier result there; raise ``StoreError`` if it cannot be written.

    Group ``results``: one dataset an estimate's value, dimensions shot and frequency, NaN where a value is unknown.
    """
    rows = [shot.estimates for shot in result.shots]
    try:
        with h5py.File(path, "w") as file:
            for name in ("title", "run_file", "simulated", "estimator", "phase_reference"):
                file.attrs[name] = getattr(result, name)
            file["json"] = json.dumps(result.as_dict())
            group = file.create_group("results")
            for name in _RESULT_UNITS:
                values = [[_number(getattr(estimate, name)) for estimate in row] for row in rows]
                group.create_dataset(name, data=values, dtype="f8")
            frequency_hz = np.array([estimate.frequency_hz for estimate in rows[0]])
            shots = np.array([shot.shot for shot in result.shots])
            _name_axes(group, {"shot": shots, "frequency": frequency_hz}, _RESULT_UNITS)
            group["frequency"].attrs["units"] = "Hz"
    except OSError as error:
        raise StoreError(f"{path} cannot be written ({error}). Try: a folder that is writable.") from None


_RESULT_UNITS = {
    "amplitude_m": "m",
    "amplitude_uncertainty_m": "m",
    "phase_rad": "rad",
    "phase_uncertainty_rad": "rad",
    "averaging_factor": "1",
    "speckle_relative": "1",
    "true_amplitude_m": "m",
    "true_phase_rad": "rad",
}


def _number(value: float | None) -> float:
    return math.nan if value is None else value
