"""Hydrophone scan of a beam, read from HDF5, CSV or MAT, checked, and averaged around the axis to a field P(r, z).

For each point a scan contains ``x_m``, ``y_m``, ``z_m`` from the focus (z away from the transducer), ``pressure_pa``
(amplitude) and optionally ``phase_rad`` of exp(+jwt). Points lie in planes of equal z, each from the axis outwards.
See docs/explanation/transducer.md, section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray

COLUMNS = ("x_m", "y_m", "z_m", "pressure_pa")
PHASE = "phase_rad"
MIN_PLANES, MIN_RADII = 5, 5
FORMATS = {
    ".csv": "a table with commas between columns",
    ".h5": "an HDF5 file",
    ".hdf5": "an HDF5 file",
    ".mat": "a MAT file",
}
MAX_RIM_PRESSURE = 0.25
"""Largest pressure at the outermost points of the focal plane, over its maximum; above it the scan cuts the beam."""
_RESOLUTION_M = 1e-6  # coordinates closer than this are equal


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Points of a scan; every array (point,). Reading an unchanged file again returns the same object."""

    position_m: FloatArray
    """(point, 3) from the focus"""
    pressure_pa: ComplexArray
    """Complex with phase, else real."""
    has_phase: bool


def read_scan(path: str) -> Scan:
    """Return the scan in ``path``. Raises ``ValueError`` with everything that is wrong with it, or with the file."""
    file = Path(path).resolve()
    if not file.is_file():
        raise ValueError(f"the scan {path} does not exist: there is no file {file}")
    status = file.stat()
    return _read_version(path, file, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_version(path: str, file: Path, _modified_ns: int, _size: int) -> Scan:
    """Return the hydrophone scan in ``file``; raise ``ValueError`` with all its mistakes.

    Time of modification and size of the file are part of the cache's key, so that a changed file is read again.
    """
    if file.suffix.lower() not in FORMATS:
        raise ValueError(f"the scan {path} ends in {file.suffix!r}: .csv, .h5, .hdf5 or .mat")
    try:
        columns = _columns(file)
    # The readers of the formats raise many kinds of errors for other files.
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f"the scan {path} cannot be read as {FORMATS[file.suffix.lower()]}: {reason}") from error
    mistakes = _column_mistakes(columns)
    if not mistakes:
        scan = _scan(columns)
        mistakes = _geometry_mistakes(scan)
    if mistakes:
        raise ValueError(
            f"the scan {path}: {'; '.join(mistakes)}. "
            "It must contain x_m, y_m, z_m, pressure_pa and optionally phase_rad"
        )
    return scan


def _column_mistakes(columns: Mapping[str, FloatArray]) -> list[str]:
    """Return the mistakes in the columns of a hydrophone scan, in words."""
    mistakes = [f"{name} is missing" for name in COLUMNS if name not in columns]
    sizes = {name: column.size for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        mistakes.append(f"its columns differ in length: {', '.join(f'{name} {size}' for name, size in sizes.items())}")
    for name, column in columns.items():
        if not np.isfinite(column).all():
            mistakes.append(f"{name} contains a value that is not a finite number")
    if "pressure_pa" in columns and (columns["pressure_pa"] < 0).any():
        mistakes.append("pressure_pa is below 0: give the amplitude, and its sign in phase_rad")
    return mistakes


def round_field(scan: Scan, wave_number_per_m: float, lateral_m: FloatArray, axial_m: FloatArray) -> ComplexArray:
    """Return the measured pressure averaged around the beam's axis, complex (axial, lateral), 1 at the focus.

    The phase of a plane wave along the axis is removed; a scan without phases is treated as a beam with plane wave
    fronts. Cubic splines interpolate between the points of the scan; outside the scan the field is 0. ``lateral_m``
    must begin with 0, since the first column normalises the field.
    """
    from scipy.interpolate import CubicSpline

    planes_m, plane = np.unique(np.round(scan.position_m[:, 2] / _RESOLUTION_M).astype(np.int64), return_inverse=True)
    radius_m = np.hypot(scan.position_m[:, 0], scan.position_m[:, 1])
    # A plane wave has the phase -k z.
    without_phase = scan.pressure_pa * (
        np.exp(1j * wave_number_per_m * scan.position_m[:, 2]) if scan.has_phase else 1.0
    )
    rows = []
    for n in range(len(planes_m)):
        ring_m, mean = _rings(radius_m[plane == n], without_phase[plane == n])
        # Mirror at the axis, across which a round beam is smooth, and interpolate each plane over the radius.
        off_axis = ring_m > _RESOLUTION_M
        spline = CubicSpline(
            np.concatenate([-ring_m[off_axis][::-1], ring_m]), np.concatenate([mean[off_axis][::-1], mean])
        )
        rows.append(np.where(lateral_m <= ring_m[-1], spline(np.minimum(lateral_m, ring_m[-1])), 0.0))
    # Interpolate over depth, and divide by the value on the axis at depth 0.
    depth_m = planes_m * _RESOLUTION_M
    inside = (axial_m >= depth_m[0]) & (axial_m <= depth_m[-1])
    field = CubicSpline(depth_m, np.array(rows))(np.clip(axial_m, depth_m[0], depth_m[-1]))
    field[~inside] = 0.0
    return np.asarray(field / CubicSpline(depth_m, np.array(rows)[:, 0])(0.0))


def _rings(radius_m: FloatArray, pressure: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return the distinct radii of a plane, (ring,), m, and the mean pressure at each."""
    # Radii are equal within the resolution.
    ring, ring_of_point = np.unique(np.round(radius_m / _RESOLUTION_M).astype(np.int64), return_inverse=True)
    total = np.zeros(len(ring), np.complex128)
    np.add.at(total, ring_of_point, pressure)
    return np.asarray(ring * _RESOLUTION_M), total / np.bincount(ring_of_point)


def _scan(columns: Mapping[str, FloatArray]) -> Scan:
    """Return the scan from its columns: positions, and complex pressures, real without a column of phases."""
    position_m = np.stack([columns[name] for name in COLUMNS[:3]], axis=1)
    phase = columns.get(PHASE)
    phasor = 1.0 if phase is None else np.exp(1j * phase)
    return Scan(position_m, np.asarray(columns["pressure_pa"] * phasor, np.complex128), phase is not None)


def _geometry_mistakes(scan: Scan) -> list[str]:
    """Return the reasons why the points of a scan do not determine a field, in words."""
    depth = np.round(scan.position_m[:, 2] / _RESOLUTION_M).astype(np.int64)
    planes = np.unique(depth)
    if len(planes) < MIN_PLANES:
        return [f"its points lie in {len(planes)} planes of equal z_m, a beam needs {MIN_PLANES}"]
    mistakes = []
    if not planes[0] < 0 < planes[-1]:
        mistakes.append("its planes do not reach from before the focus, z_m = 0, to behind it")
    radius_m = np.hypot(scan.position_m[:, 0], scan.position_m[:, 1])
    size = np.abs(scan.pressure_pa)
    focal_plane = planes[np.abs(planes).argmin()]
    focal = depth == focal_plane
    if not size[focal][radius_m[focal] == radius_m[focal].min()].max() > 0:
        mistakes.append("the pressure at the focus is 0")
    for plane in planes:
        in_plane = depth == plane
        rings = np.unique(np.round(radius_m[in_plane] / _RESOLUTION_M).astype(np.int64))
        label = f"the plane at z_m = {plane * _RESOLUTION_M:g}"
        # The first distance must not exceed the mean spacing, or the axis is not covered.
        if len(rings) < MIN_RADII or rings[0] > (rings[-1] - rings[0]) / (len(rings) - 1):
            mistakes.append(
                f"{label} has {len(rings)} distances from the axis, from the axis outwards it needs {MIN_RADII}"
            )
            break
        rim = size[in_plane][radius_m[in_plane] >= 0.95 * radius_m[in_plane].max()].max()
        largest = size[in_plane].max()
        if plane == focal_plane and rim > MAX_RIM_PRESSURE * largest:
            mistakes.append(f"{label} ends where the pressure is {rim / largest:.0%} of its largest: scan a wider area")
    return mistakes


def _columns(path: Path) -> dict[str, FloatArray]:
    """Return the known columns of a hydrophone scan by name, from a CSV, HDF5 or MATLAB file."""
    if not path.stat().st_size:
        raise ValueError("it is empty")
    names = (*COLUMNS, PHASE)
    match path.suffix.lower():
        case ".csv":
            # utf-8-sig: spreadsheets may write a byte-order mark before the first name.
            table: Any = np.genfromtxt(path, delimiter=",", names=True, dtype=np.float64, ndmin=1, encoding="utf-8-sig")
            contents: dict[str, Any] = {name: table[name] for name in table.dtype.names or ()}
        case ".h5" | ".hdf5":
            contents = _hdf5(path)
        case _:
            import h5py
            from scipy.io import loadmat

            # MATLAB's version 7.3 is HDF5.
            contents = _hdf5(path) if h5py.is_hdf5(path) else loadmat(path)
    return {name: np.asarray(contents[name], np.float64).ravel() for name in names if name in contents}


def _hdf5(path: Path) -> dict[str, Any]:
    """Return the datasets of an HDF5 file by name."""
    import h5py

    with h5py.File(path) as file:
        if any(isinstance(file.get(name, getlink=True), h5py.ExternalLink) for name in file):
            raise ValueError("it has links to other files")
        datasets = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
        for name, item in datasets.items():
            if item.is_virtual or item.external:
                raise ValueError(f"/{name} keeps its values in another file")
        return {name: item[()] for name, item in datasets.items()}
