"""The series of `echo_series` by one compiled loop, for studies; without Numba the NumPy form serves.

The same sums, cut at the same tolerance.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim_backend.echoes.pulse import Pulse, angular_rates
from sim_backend.echoes.series import (
    CROSSING_SHARE,
    Resting,
    enough_taylor,
    largest_near,
    largest_size,
    series_tables,
)

Floats = NDArray[np.float64]


@functools.cache
def available() -> bool:
    """Return whether Numba is installed; importing it is left to the first use."""
    return importlib.util.find_spec("numba") is not None


def serves(scene: Resting, pulse: Pulse) -> bool:
    """Return whether the compiled loop covers the case: one shape, evenly spaced frequencies."""
    return len(scene.shape) == 1 and available() and angular_rates(pulse)[1] is not None


def series_fast(
    scene: Resting, pulse: Pulse, sample_time_s: Floats, tolerance: float, out: NDArray[np.floating]
) -> None:
    """Write the same as `echo_series.series` to ``out`` (row, echo, sample), of any float type."""
    tables = series_tables(scene, pulse, sample_time_s, tolerance)
    shape, amplitude_s = scene.shape[0], scene.amplitude_s[:, :, 0]
    farthest_s = largest_size(amplitude_s) * largest_size(shape)
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    crossing = 1 + (2 * farthest_s * (len(sample_time_s) - 1) / duration_s if duration_s > 0 else 0.0)
    bounds = [largest_near(jumps, farthest_s) for jumps in tables.jumps]
    omega, step = angular_rates(pulse)
    # The loop is compiled for this one kind of array.
    made = out if out.dtype == np.float64 and out.flags.c_contiguous else np.empty(out.shape)
    parts = (scene.rest_s, scene.weight, shape, amplitude_s, sample_time_s)
    _loop()(
        scene.row.searchsorted(np.arange(len(amplitude_s) + 1)),
        *(np.ascontiguousarray(part, dtype=np.float64) for part in parts),
        np.array([pulse.start_s, pulse.end_s]),
        omega[0],
        step or 0.0,
        tables.scale,
        tables.turn,
        np.array([order for order, _ in bounds]),
        np.array([largest for _, largest in bounds]),
        tables.taylor,
        enough_taylor(tables.taylor, tables.scale * farthest_s, 1e-3 * tolerance).shape[1],
        farthest_s,
        crossing,
        CROSSING_SHARE * tolerance,
        made,
    )
    if made is not out:
        out[:] = made


@functools.cache
def _loop() -> Callable[..., None]:
    loop: Callable[..., None] = importlib.import_module("sim_backend.echoes.series_numba").rows
    return loop
