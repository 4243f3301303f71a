"""Empty run file as bytes: every group, dataset and attribute, before the first record.

The bytes are the first frame of the log of a run (``log.py``); the run file is made from them when the run ends
(``assembly.py``). ``docs/reference/run-file.md`` describes the content of the file.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Capture
from hpe_rig.bench import BenchText, twin_settings
from hpe_rig.plan import Plan
from hpe_rig.result import Provenance
from hpe_rig.scene import Scene, SceneText, printable
from hpe_rig.store.checksum import add_checksums, blank, sealed_file
from hpe_rig.store.datasets import DATASETS, RECORD_AXES, TRUE_HARMONICS
from hpe_rig.store.format import (
    BITSHUFFLE,
    CHUNK_BYTES,
    CONDITION_BYTES,
    FORMAT,
    FORMAT_VERSION,
    RUN_ID_BYTES,
    STAGE_BYTES,
    STAGES,
    STATUS_BYTES,
    StoreError,
    extra,
    versions,
)
from hpe_rig.store.records import MISSING


@dataclass(frozen=True, slots=True)
class Predecessor:
    """Name of the run file that a resumed run continues, and the number of shots copied from it."""

    name: str = ""
    shots: int = 0


def empty_run(
    scene: SceneText,
    bench: BenchText,
    plan: Plan,
    compress: bool = False,
    predecessor: Predecessor | None = None,
    run_id: str = "",
    provenance: Provenance | None = None,
) -> bytes:
    """Return the bytes of a new run file, with all datasets but no records; equal arguments give equal bytes."""
    capture, conditions = plan.shots[0].capture, bench.bench.conditions
    absent = {
        *(["records/monitor"] if capture.monitor_range_v is None else []),
        *(["conditions/before", "conditions/after"] if not conditions else []),
        *(["truth/displacement_m", *TRUE_HARMONICS] if not bench.bench.simulated else []),
        *(["provenance/ended"] if provenance is None else []),
    }
    axes = _axes(scene, bench, plan)
    condition_unit = ", ".join(condition.unit or "1" for condition in conditions)

    def write(file: h5py.File) -> None:
        """Write the content of the file."""
        _write_attributes(file, scene, bench, predecessor or Predecessor(), run_id)
        file["scene"], file["bench"] = _fixed(scene.text), _fixed(bench.text)
        for name in DATASETS:
            if name not in absent:
                _create(file, name, axes, capture, compress)
        _describe_codes(file, capture, bench.bench.digitizer.board_model.code_limits)
        _write_planned_values(file["records"], plan)
        _write_provenance(file, provenance)
        _name_all_axes(file, axes, condition_unit)
        add_checksums(file)

    return sealed_file(write)


def _write_provenance(file: h5py.File, provenance: Provenance | None) -> None:
    """Write when, where and by whom the run was started; a run without ``provenance`` has no such texts."""
    if provenance is not None:
        for name in ("started", "host", "user", "drivers"):
            file[f"provenance/{name}"] = _fixed(printable(getattr(provenance, name)))


def _name_all_axes(file: h5py.File, axes: Mapping[str, NDArray[Any]], condition_unit: str) -> None:
    """Attach to the datasets of the file and of its groups those ``axes`` that they have, and write the units."""
    units = {name.rpartition("/")[2]: layout.unit for name, layout in DATASETS.items()}
    units |= {"before": condition_unit, "after": condition_unit, "burst_length_s": "s"}
    units |= {"lateral_offset_m": "m", "axial_offset_m": "m"}
    for group in (file, *(item for item in file.values() if isinstance(item, h5py.Group))):
        names = [item.name[1:] for item in group.values()]
        used = {axis for name in names if name in DATASETS for axis in DATASETS[name].axes}
        name_axes(group, {axis: values for axis, values in axes.items() if axis in used}, units)
    file["records/sample"].attrs.update({"units": "s", "long_name": "time after the onset of the tracking pulse"})
    if "true_harmonics" in file:
        file["true_harmonics/frequency"].attrs["units"] = "Hz"


def _axes(scene: SceneText, bench: BenchText, plan: Plan) -> dict[str, NDArray[Any]]:
    """Return the values along each axis of a run file by name: numbers, times in s, frequencies in Hz, or names."""
    capture, timeline = plan.shots[0].capture, plan.shots[0].timeline
    return {
        "shot": np.arange(1, len(plan.shots) + 1),
        "pulse": np.arange(capture.record_count),
        "sample": timeline.record_offset_s[0] + np.arange(capture.record_samples) / capture.sample_rate_hz,
        # A sweep may change the frequencies: the axis holds those of the point with the most frequencies.
        "frequency": np.array(max((point.scene.wanted_frequencies_hz for point in scene.scene.points), key=len)),
        "condition": np.array([condition.name for condition in bench.bench.conditions], f"S{CONDITION_BYTES}"),
        "stage": np.array(STAGES, f"S{STAGE_BYTES}"),
    }


def sha256_of_scan(scene: Scene) -> str | None:
    """Return the SHA-256 of the beam scan in ``beams.excitation_scan``, None without one.

    The results depend on the scan, and the run file does not contain it.
    """
    if scene.beams is None or scene.beams.excitation_scan is None:
        return None
    with Path(scene.beams.excitation_scan).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def code_scale_and_offset_v(input_range_v: float, code_limits: tuple[int, int]) -> tuple[float, float]:
    """Return (scale, offset) in V of a digitizer's input: volts = scale * code + offset.

    The highest code is +``input_range_v``, and 0 V lies midway between codes -1 and 0. The lowest of ``code_limits`` is
    ignored, because 16-bit boards do not use it.
    """
    scale = 2 * input_range_v / (2 * code_limits[1] + 1)
    return scale, scale / 2


def _add(group: h5py.Group, name: str, values: Any) -> None:
    """Create dataset ``name`` with ``values`` (any shape but scalar) and HDF5's own checksum."""
    if np.size(values):
        group.create_dataset(name, data=values, chunks=True, fletcher32=True)
    else:
        # HDF5 has no empty chunks.
        group[name] = values


def chunk_records(capture: Capture) -> int:
    """Return the number of records in a chunk of echoes, the piece that HDF5 reads and writes at once."""
    return max(1, min(capture.record_count, math.ceil(CHUNK_BYTES / (2 * capture.record_samples))))


def name_axes(group: h5py.Group, scales: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> None:
    """Attach named axes to every dataset of ``group``, and write their units.

    ``scales``: values along each axis by name, in the order of the axes. ``units``: by dataset; others have the unit 1.
    """
    datasets = [item for item in group.values() if isinstance(item, h5py.Dataset) and item.ndim]
    for name, values in scales.items():
        _add(group, name, values)
    axes = [group[name] for name in scales]
    for name, axis in zip(scales, axes, strict=True):
        axis.make_scale(name)
    for dataset in datasets:
        dataset.attrs["units"] = units.get(dataset.name.rpartition("/")[2], "1")
        for dimension, axis in zip(dataset.dims, axes, strict=False):
            dimension.attach_scale(axis)


def _write_attributes(
    file: h5py.File, scene: SceneText, bench: BenchText, predecessor: Predecessor, run_id: str
) -> None:
    """Write the attributes of the run."""
    attributes = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "title": scene.scene.title,
        "scene_name": scene.name,
        "bench_name": bench.name,
        "simulated": bench.bench.simulated,
        "seed": twin_settings(scene.scene).seed if bench.bench.simulated else -1,
        "predecessor": predecessor.name,
        "predecessor_shots": predecessor.shots,
        **{f"version_{name}": text for name, text in versions().items()},
    }
    if (scan_sha256 := sha256_of_scan(scene.scene)) is not None:
        attributes["scan_sha256"] = scan_sha256
    for name, value in attributes.items():
        # Names may be file names, which can contain any character.
        file.attrs[name] = _fixed(printable(value)) if isinstance(value, str) else value
    file.attrs.create("status", np.bytes_("running"), dtype=f"S{STATUS_BYTES}")
    file.attrs.create("run_id", np.bytes_(run_id.encode("ascii")), dtype=f"S{RUN_ID_BYTES}")


def _fixed(text: str) -> NDArray[Any]:
    """Return ``text`` as UTF-8 of fixed length: a reader can check the length before it reads the text."""
    encoded = text.encode("utf-8")
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def _create(file: h5py.File, name: str, axes: Mapping[str, NDArray[Any]], capture: Capture, compress: bool) -> None:
    """Create dataset ``name`` of the table ``DATASETS``, filled with NaN, zeros, empty texts or ``MISSING``."""
    layout = DATASETS[name]
    dtype, shape = np.dtype(layout.dtype), tuple(axes[axis].size for axis in layout.axes)
    # Groups that HDF5 creates implicitly store the time of creation; then no two files would be equal.
    folder, _, last = name.rpartition("/")
    group = file.require_group(f"/{folder}")
    if 0 in shape or not shape:
        # HDF5 has no empty chunks.
        group[last] = blank(dtype, shape)
        return
    # Marks and trigger times belong to a chunk of echoes: damage of one of them costs the same records.
    by_pulse = (1, chunk_records(capture), shape[-1])[: len(shape)]
    chunks = by_pulse if "pulse" in layout.axes else (1,) if dtype.kind == "S" else True
    is_codes = layout.axes == RECORD_AXES
    fill = MISSING if is_codes else blank(dtype, ()).item()
    options = _filter() if compress and is_codes else {}
    group.create_dataset(last, shape, dtype, chunks=chunks, fillvalue=fill, fletcher32=True, **options)


def _describe_codes(file: h5py.File, capture: Capture, code_limits: tuple[int, int]) -> None:
    """Write how codes are converted to volts: programs that follow the CF conventions convert them, and set NaN."""
    for name, input_range_v in (("echo", capture.input_range_v), ("monitor", capture.monitor_range_v)):
        if input_range_v is not None:
            scale, offset = code_scale_and_offset_v(input_range_v, code_limits)
            lowest, highest = map(np.int16, code_limits)
            attributes = {"scale_factor": scale, "add_offset": offset, "_FillValue": MISSING}
            file[f"records/{name}"].attrs.update(attributes | {"valid_min": lowest, "valid_max": highest})


def _write_planned_values(records: h5py.Group, plan: Plan) -> None:
    """Write the planned values of each shot, (shot,)."""
    shots = plan.shots
    _add(records, "burst_length_s", [shot.timeline.burst_length_s for shot in shots])
    _add(
        records, "force_fraction", [math.nan if shot.force_fraction is None else shot.force_fraction for shot in shots]
    )
    _add(records, "repeat", [shot.repeat for shot in shots])
    for name in ("lateral_offset_m", "axial_offset_m"):
        if any(offsets := [getattr(shot, name) for shot in shots]):
            _add(records, name, offsets)


def _filter() -> Mapping[str, Any]:
    """Return the arguments of ``create_dataset`` for compression by bitshuffle, HDF5's filter from hdf5plugin.

    Raises ``StoreError`` if the package is absent or offers another filter.
    """
    with extra("compression"):
        import hdf5plugin
    filters: Mapping[str, Any] = hdf5plugin.Bitshuffle(cname="lz4")
    if filters["compression"] != BITSHUFFLE:
        raise StoreError(
            f"hdf5plugin offers filter {filters['compression']} instead of bitshuffle, {BITSHUFFLE}. "
            "Try: pip install --upgrade hdf5plugin, or no --compress."
        )
    return filters
