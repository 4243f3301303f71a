"""Empty run file as bytes: every group, dataset and attribute, before the first record.

The bytes are the first frame of the log of a run (``log.py``); the run file is made from them when the run ends
(``assembly.py``). ``docs/reference/run-file.md`` describes the content of the file.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Capture
from hpe_rig.bench import BenchText, Condition, twin_settings
from hpe_rig.plan import Plan
from hpe_rig.result import Provenance
from hpe_rig.scene import Scene, SceneText, printable
from hpe_rig.store.checksum import add_checksums, seal_heap
from hpe_rig.store.format import (
    BITSHUFFLE,
    CHUNK_BYTES,
    CONDITION_BYTES,
    FORMAT,
    FORMAT_VERSION,
    ROW_CHUNK,
    RUN_ID_BYTES,
    SNAPSHOT_BYTES,
    STAGE_BYTES,
    STAGES,
    STATUS_BYTES,
    TIME_BYTES,
    UNTRUSTED_BYTES,
    StoreError,
    extra,
    versions,
)
from hpe_rig.store.records import MISSING

LIBVER = ("v110", "v110")
"""Readable with HDF5 1.10 and later."""
TRUE_HARMONICS = ("in_phase_m", "quadrature_m")
"""A cos(phase) and A sin(phase) of the true displacement at the focus, datasets of group ``true_harmonics``."""


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
    with h5py.File("empty", "w", driver="core", backing_store=False, libver=LIBVER) as file:
        _write_header(file, scene, bench, plan, predecessor or Predecessor())
        file.attrs.create("run_id", np.bytes_(run_id.encode("ascii")), dtype=f"S{RUN_ID_BYTES}")
        if (scan_sha256 := sha256_of_scan(scene.scene)) is not None:
            file.attrs["scan_sha256"] = _fixed(scan_sha256)
        _create_records(file, plan, bench.bench.digitizer.board_model.code_limits, compress)
        times = file.create_group("run_time")
        _add(times, "run_time_s", np.full(len(STAGES), math.nan))
        name_axes(times, {"stage": np.array(STAGES, f"S{STAGE_BYTES}")}, {"run_time_s": "s"})
        if bench.bench.simulated:
            ground_truth = file.create_group("truth")
            _create_rows(ground_truth, "displacement_m", plan, np.dtype("<f8"), math.nan)
            name_axes(ground_truth, _shot_and_pulse(plan), {"displacement_m": "m"})
            # A sweep may change the frequencies: the axis holds those of the point with the most frequencies.
            frequencies_hz = max((point.scene.wanted_frequencies_hz for point in scene.scene.points), key=len)
            _create_true_harmonics(file, len(plan.shots), frequencies_hz)
        if bench.bench.conditions:
            _create_conditions(file, len(plan.shots), bench.bench.conditions)
        if provenance is not None:
            _create_provenance(file, provenance)
        add_checksums(file)
        seal_heap(file)
        file.flush()
        file_bytes: bytes = file.id.get_file_image()
    return file_bytes


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


def _write_header(file: h5py.File, scene: SceneText, bench: BenchText, plan: Plan, predecessor: Predecessor) -> None:
    """Write the attributes and texts of the run, and create the datasets of text by shot.

    ``snapshot``: the instruments' settings in each shot. ``untrusted``: why a shot cannot be relied on.
    ``changed_settings``: differences of the settings after a shot from those before it.
    """
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
    }
    for name, value in (attributes | {f"version_{name}": text for name, text in versions().items()}).items():
        # Names may be file names, which can contain any character.
        file.attrs[name] = _fixed(printable(value)) if isinstance(value, str) else value
    file.attrs.create("status", np.bytes_("running"), dtype=f"S{STATUS_BYTES}")
    file["scene"], file["bench"] = _fixed(scene.text), _fixed(bench.text)
    sizes = {"snapshot": SNAPSHOT_BYTES, "untrusted": UNTRUSTED_BYTES, "changed_settings": UNTRUSTED_BYTES}
    for name, size in sizes.items():
        file.create_dataset(name, len(plan.shots), f"S{size}", chunks=(1,), fletcher32=True)
    name_axes(file, {"shot": np.arange(1, len(plan.shots) + 1)}, {})


def _fixed(text: str) -> NDArray[Any]:
    """Return ``text`` as UTF-8 of fixed length: a reader can check the length before it reads the text."""
    encoded = text.encode("utf-8")
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def _shot_and_pulse(plan: Plan) -> dict[str, NDArray[Any]]:
    return {"shot": np.arange(1, len(plan.shots) + 1), "pulse": np.arange(plan.shots[0].capture.record_count)}


def _create_rows(group: h5py.Group, name: str, plan: Plan, dtype: np.dtype[Any], fill: float) -> None:
    """Create dataset ``name`` (shot, pulse), filled with ``fill``."""
    shape = (len(plan.shots), plan.shots[0].capture.record_count)
    # Marks and trigger times belong to a chunk of echoes: damage of one of them costs the same records.
    chunks = (1, chunk_records(plan.shots[0].capture) if group.name == "/records" else min(shape[1], ROW_CHUNK))
    group.create_dataset(name, shape, dtype, chunks=chunks, fillvalue=fill, fletcher32=True)


def _create_true_harmonics(file: h5py.File, shots: int, frequencies_hz: Sequence[float]) -> None:
    """Create datasets for the simulated harmonics (shot, frequency), NaN until the simulation provides them."""
    group = file.create_group("true_harmonics")
    for name in TRUE_HARMONICS:
        _add(group, name, np.full((shots, len(frequencies_hz)), math.nan))
    axes = {"shot": np.arange(1, shots + 1), "frequency": np.array(frequencies_hz)}
    name_axes(group, axes, dict.fromkeys(TRUE_HARMONICS, "m"))
    group["frequency"].attrs["units"] = "Hz"


def _create_conditions(file: h5py.File, shots: int, conditions: Sequence[Condition]) -> None:
    """Create the conditions before and after each shot, (shot, condition), NaN until they are read."""
    group, units = file.create_group("conditions"), ", ".join(condition.unit or "1" for condition in conditions)
    for name in ("before", "after"):
        _add(group, name, np.full((shots, len(conditions)), math.nan))
    names = np.array([condition.name for condition in conditions], f"S{CONDITION_BYTES}")
    name_axes(group, {"shot": np.arange(1, shots + 1), "condition": names}, {"before": units, "after": units})


def _create_codes(
    group: h5py.Group, name: str, input_range_v: float, code_limits: tuple[int, int], plan: Plan, compress: bool
) -> None:
    """Create dataset ``name`` (shot, pulse, sample) of one input's digitizer codes, with their conversion to volts.

    Each chunk, the piece that HDF5 reads and writes at once, holds whole records of one shot.
    """
    capture = plan.shots[0].capture
    shape = (len(plan.shots), capture.record_count, capture.record_samples)
    chunks, filters = (1, chunk_records(capture), shape[2]), _filter() if compress else {}
    echo = group.create_dataset(name, shape, "<i2", chunks=chunks, fillvalue=MISSING, fletcher32=True, **filters)
    # CF conventions: programs that follow them convert codes to volts and missing records to NaN.
    scale, offset = code_scale_and_offset_v(input_range_v, code_limits)
    echo.attrs.update({"scale_factor": scale, "add_offset": offset, "_FillValue": MISSING})
    lowest, highest = map(np.int16, code_limits)
    echo.attrs.update({"valid_min": lowest, "valid_max": highest})


def _create_provenance(file: h5py.File, provenance: Provenance) -> None:
    """Write start, host, user and driver versions of the run; its end is written later."""
    group = file.create_group("provenance")
    for name in ("started", "host", "user", "drivers"):
        group[name] = _fixed(printable(getattr(provenance, name)))
    # Written at the end of the run.
    group["ended"] = np.zeros((), f"S{TIME_BYTES}")


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


def _create_records(file: h5py.File, plan: Plan, code_limits: tuple[int, int], compress: bool) -> None:
    """Create the group ``records``: echoes, monitor records, and values by pulse and by shot, with axes and units."""
    shots, capture = plan.shots, plan.shots[0].capture
    group = file.create_group("records")
    _create_codes(group, "echo", capture.input_range_v, code_limits, plan, compress)
    if capture.monitor_range_v is not None:
        _create_codes(group, "monitor", capture.monitor_range_v, code_limits, plan, compress)
    _create_rows(group, "recorded", plan, np.dtype("u1"), 0)
    _create_rows(group, "trigger_time_s", plan, np.dtype("<f8"), math.nan)
    _create_rows(group, "pulse_onset_s", plan, np.dtype("<f8"), math.nan)
    # Planned values and flags of each shot.
    _add(group, "burst_length_s", [shot.timeline.burst_length_s for shot in shots])
    # Filled in when the settings of a shot are read back from the generator.
    _add(group, "force_set", np.full(len(shots), math.nan))
    forces = [math.nan if shot.force_fraction is None else shot.force_fraction for shot in shots]
    _add(group, "force_fraction", forces)
    _add(group, "repeat", [shot.repeat for shot in shots])
    for name in ("lateral_offset_m", "axial_offset_m"):
        if any(offsets := [getattr(shot, name) for shot in shots]):
            _add(group, name, offsets)
    _add(group, "shot_complete", np.zeros(len(shots), np.uint8))
    _add(group, "clipped", np.zeros(len(shots), np.uint8))
    # Axes of all datasets: shot, pulse, and time within a record.
    sample_s = shots[0].timeline.record_offset_s[0] + np.arange(capture.record_samples) / capture.sample_rate_hz
    units = {"echo": "V", "monitor": "V", "trigger_time_s": "s", "pulse_onset_s": "s", "burst_length_s": "s"}
    name_axes(group, {**_shot_and_pulse(plan), "sample": sample_s}, units)
    group["sample"].attrs.update({"units": "s", "long_name": "time after the onset of the tracking pulse"})
