"""Hydrophone scan of a beam: read from HDF5, CSV or MAT, checked, and averaged around the axis to a field P(r, z).

A scan names, point by point: ``x_m``, ``y_m``, ``z_m`` from the focus (z away from the transducer), ``pressure_pa``
(amplitude) and, where known, ``phase_rad`` of exp(+jwt). Points lie in planes of equal z, each from the axis outwards.
docs/explanation/transducer.md, section 4.
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
FEWEST_PLANES, FEWEST_RADII = 5, 5
FORMATS = {
    ".csv": "a table with commas between columns",
    ".h5": "an HDF5 file",
    ".hdf5": "an HDF5 file",
    ".mat": "a MAT file",
}
RIM = 0.25
"""Of the plane's largest pressure, which its outermost points must not exceed: else the scan cuts the beam."""
_SAME = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A scan as it was made; every array (point,). A file's scan is the same object until the file changes."""

    place_m: FloatArray
    """(point, 3) from the focus"""
    pressure_pa: ComplexArray
    """With the phase where it is known, else real."""
    has_phase: bool


def read_scan(path: str) -> Scan:
    """Return the scan in ``path``. Raises ``ValueError`` with all that it lacks, or why the file cannot be read."""
    file = Path(path).resolve()
    if not file.is_file():
        raise ValueError(f"the scan {path} is no file here: {file} was looked for")
    found = file.stat()
    return _read_once(path, file, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=8)
def _read_once(path: str, file: Path, _modified_ns: int, _size: int) -> Scan:
    if file.suffix.lower() not in FORMATS:
        raise ValueError(f"the scan {path} ends in {file.suffix!r}: .csv, .h5, .hdf5 or .mat")
    try:
        columns = _columns(file)
    # whatever the readers of three formats make of a file that is none of theirs
    except Exception as error:
        why = str(error) or type(error).__name__
        raise ValueError(f"the scan {path} cannot be read as {FORMATS[file.suffix.lower()]}: {why}") from error
    mistakes = [f"{name} is missing" for name in COLUMNS if name not in columns]
    sizes = {name: each.size for name, each in columns.items()}
    if len(set(sizes.values())) > 1:
        mistakes.append(f"its columns differ in length: {', '.join(f'{name} {size}' for name, size in sizes.items())}")
    mistakes += [
        f"{name} holds a value that is no number" for name, each in columns.items() if not np.isfinite(each).all()
    ]
    if "pressure_pa" in columns and (columns["pressure_pa"] < 0).any():
        mistakes.append("pressure_pa is below 0: an amplitude, with its sign in phase_rad")
    if not mistakes:
        scan = _scan(columns)
        mistakes += _gaps(scan)
    if mistakes:
        raise ValueError(
            f"the scan {path}: {'; '.join(mistakes)}. It holds x_m, y_m, z_m, pressure_pa and maybe phase_rad"
        )
    return scan


def round_field(scan: Scan, wave_number_per_m: float, lateral_m: FloatArray, axial_m: FloatArray) -> ComplexArray:
    """Return the beam averaged around its axis, over the focus', without the plane wave's phase: (axial, lateral).

    Cubic splines between points; 0 beyond them. Without phase a wave front is taken to be plane.
    """
    from scipy.interpolate import CubicSpline

    planes_m, plane = np.unique(np.round(scan.place_m[:, 2] / _SAME).astype(np.int64), return_inverse=True)
    radius_m = np.hypot(scan.place_m[:, 0], scan.place_m[:, 1])
    turned = scan.pressure_pa * (np.exp(1j * wave_number_per_m * scan.place_m[:, 2]) if scan.has_phase else 1.0)
    rows = []
    for n in range(len(planes_m)):
        ring_m, mean = _rings(radius_m[plane == n], turned[plane == n])
        # Mirrored at the axis, across which a round beam is smooth.
        inner = ring_m > _SAME
        across = np.concatenate([-ring_m[inner][::-1], ring_m]), np.concatenate([mean[inner][::-1], mean])
        rows.append(np.where(lateral_m <= ring_m[-1], CubicSpline(*across)(np.minimum(lateral_m, ring_m[-1])), 0.0))
    depth_m = planes_m * _SAME
    inside = (axial_m >= depth_m[0]) & (axial_m <= depth_m[-1])
    field = CubicSpline(depth_m, np.array(rows))(np.clip(axial_m, depth_m[0], depth_m[-1]))
    field[~inside] = 0.0
    return np.asarray(field / CubicSpline(depth_m, np.array(rows)[:, 0])(0.0))


def _rings(radius_m: FloatArray, pressure: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    ring, which = np.unique(np.round(radius_m / _SAME).astype(np.int64), return_inverse=True)
    mean = np.zeros(len(ring), np.complex128)
    np.add.at(mean, which, pressure)
    return np.asarray(ring * _SAME), mean / np.bincount(which)


def _scan(columns: Mapping[str, FloatArray]) -> Scan:
    place_m = np.stack([columns[name] for name in COLUMNS[:3]], axis=1)
    phase = columns.get(PHASE)
    turn = 1.0 if phase is None else np.exp(1j * phase)
    return Scan(place_m, np.asarray(columns["pressure_pa"] * turn, np.complex128), phase is not None)


def _gaps(scan: Scan) -> list[str]:
    """Return what keeps the scan from being a field."""
    depth = np.round(scan.place_m[:, 2] / _SAME).astype(np.int64)
    planes = np.unique(depth)
    if len(planes) < FEWEST_PLANES:
        return [f"its points lie in {len(planes)} planes of equal z_m, a beam needs {FEWEST_PLANES}"]
    found = []
    if not planes[0] < 0 < planes[-1]:
        found.append("its planes do not reach from before the focus, z_m = 0, to behind it")
    radius_m = np.hypot(scan.place_m[:, 0], scan.place_m[:, 1])
    size = np.abs(scan.pressure_pa)
    focal = depth == planes[np.abs(planes).argmin()]
    if not size[focal][radius_m[focal] == radius_m[focal].min()].max() > 0:
        found.append("the pressure at the focus is 0")
    for plane in planes:
        own = depth == plane
        rings = np.unique(np.round(radius_m[own] / _SAME).astype(np.int64))
        at = f"the plane at z_m = {plane * _SAME:g}"
        if len(rings) < FEWEST_RADII or rings[0] * _SAME > (rings[-1] - rings[0]) * _SAME / (len(rings) - 1):
            found.append(
                f"{at} has {len(rings)} distances from the axis, from the axis outwards it needs {FEWEST_RADII}"
            )
            break
        rim = size[own][radius_m[own] >= 0.95 * radius_m[own].max()].max()
        if plane == planes[np.abs(planes).argmin()] and rim > RIM * size[own].max():
            found.append(f"{at} ends where the pressure is {rim / size[own].max():.0%} of its largest: a wider scan")
    return found


def _columns(path: Path) -> dict[str, FloatArray]:
    """Return the named columns of the file, by its suffix."""
    if not path.stat().st_size:
        raise ValueError("it is empty")
    names = (*COLUMNS, PHASE)
    match path.suffix.lower():
        case ".csv":
            # as spreadsheets write it, with a mark of the encoding before the first name, or without
            table: Any = np.genfromtxt(path, delimiter=",", names=True, dtype=np.float64, ndmin=1, encoding="utf-8-sig")
            held: dict[str, Any] = {name: table[name] for name in table.dtype.names or ()}
        case ".h5" | ".hdf5":
            held = _hdf5(path)
        case _:
            import h5py
            from scipy.io import loadmat

            # MATLAB's version 7.3 is HDF5.
            held = _hdf5(path) if h5py.is_hdf5(path) else loadmat(path)
    return {name: np.asarray(held[name], np.float64).ravel() for name in names if name in held}


def _hdf5(path: Path) -> dict[str, Any]:
    import h5py

    with h5py.File(path) as file:
        return {name: each[()] for name, each in file.items() if isinstance(each, h5py.Dataset)}
