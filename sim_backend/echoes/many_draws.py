"""Echoes of many scatterer draws, gates or parameter values in one call, a bounded chunk at a time."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sim_backend.echoes.delays import EchoDelays, refuse_aliasing, refuse_misfits, refuse_numbers
from sim_backend.echoes.engine import DEFAULT_TOLERANCE, synthesise
from sim_backend.echoes.exact_sums import blocks
from sim_backend.echoes.pulse import Pulse, angular_rates
from sim_backend.echoes.scatterers import draw_thinned
from sim_backend.echoes.series import MOST_ANGLE_RAD, ScattererRows, largest_angle, series
from sim_backend.settings import SimulationSettings

Floats = NDArray[np.float64]

DRAWS_AT_ONCE = 16
"""Draws of a chunk. Part of what a seed means: each chunk has its own stream of random numbers."""

_COARSEST_FLOAT32_TOLERANCE = 3e-7


def batch(
    scene: ScattererRows,
    pulse: Pulse,
    sample_time_s: Floats,
    tolerance: float = DEFAULT_TOLERANCE,
    dtype: DTypeLike = np.float64,
    compiled: bool = True,
) -> NDArray[np.floating]:
    """Return the echoes of every row of ``scene``, (row, echo, sample); rms error over all within ``tolerance``.

    A row is a draw, a gate (its start subtracted from ``rest_s``) or a parameter value (its own weights or
    ``amplitude_s``). Scatterers must ascend in row and, within one, in delay. ``compiled``: by Numba where it is
    installed and covers the case. Raises ValueError for what is not finite, does not fit or does not ascend, by name,
    and for float32 with a tolerance that its rounding does not allow.
    """
    sample_time_s = np.asarray(sample_time_s, dtype=np.float64)
    _refuse_unusable(scene, sample_time_s, tolerance)
    refuse_aliasing(pulse, sample_time_s)
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise ValueError(f"dtype {np.dtype(dtype)} cannot hold echoes: take float64 or float32")
    if np.dtype(dtype) == np.float32 and tolerance < _COARSEST_FLOAT32_TOLERANCE:
        raise ValueError(
            f"float32 rounds at 6e-8 and cannot keep a tolerance of {tolerance:.3g}: take float64 or a tolerance of "
            f"{_COARSEST_FLOAT32_TOLERANCE:.0e} or more"
        )
    out = np.empty((*scene.amplitude_s.shape[:2], len(sample_time_s)), dtype=dtype)
    if out.size == 0:
        return out
    if largest_angle(pulse, scene.shape, scene.amplitude_s) <= MOST_ANGLE_RAD:
        _batch_of_series(scene, pulse, sample_time_s, tolerance, out, compiled and compilable(scene, pulse))
    else:
        for row, own in enumerate(
            np.split(np.arange(len(scene.row)), scene.row.searchsorted(np.arange(1, len(scene.amplitude_s))))
        ):
            motion = EchoDelays(scene.rest_s[own], scene.shape[:, own], scene.amplitude_s[row])
            out[row] = synthesise(motion, scene.weight[own], pulse, sample_time_s, tolerance).echo
    return out


def _batch_of_series(
    scene: ScattererRows,
    pulse: Pulse,
    sample_time_s: Floats,
    tolerance: float,
    out: NDArray[np.floating],
    compiled: bool,
) -> None:
    for part in blocks(sample_time_s, pulse):
        if compiled:
            from sim_backend.echoes.series_numba import compiled_series

            compiled_series(scene, pulse, sample_time_s[part], tolerance, out[:, :, part])
        else:
            out[:, :, part] = series(scene, pulse, sample_time_s[part], tolerance)


@functools.cache
def numba_installed() -> bool:
    """Return whether Numba is installed; importing it is left to the first use."""
    return importlib.util.find_spec("numba") is not None


def compilable(scene: ScattererRows, pulse: Pulse) -> bool:
    """Return whether the compiled loop covers the case: one shape, evenly spaced frequencies."""
    return len(scene.shape) == 1 and numba_installed() and angular_rates(pulse)[1] is not None


def drawn_echoes(
    settings: SimulationSettings,
    displacement_m: Floats,
    pulse: Pulse,
    sample_time_s: Floats,
    rng: np.random.Generator,
    draws: int,
    tolerance: float = DEFAULT_TOLERANCE,
    threads: int = 1,
    dtype: DTypeLike = np.float64,
    compiled: bool = True,
) -> Iterator[NDArray[np.floating]]:
    """Yield the noise-free echoes of ``draws`` new draws of scatterers, (up to 16 draws, echo, sample) at a time.

    ``displacement_m`` (echo,) or (draw, echo) at the focus; ``sample_time_s`` (sample,), 0 the arrival of the resting
    focus' echo. Only scatterers that can reach the gate and matter are drawn, binomially many, and the scene's
    reflectors are in every draw. Draw n depends on ``rng``'s seed and n, on the gate, the largest displacement and the
    tolerance, not on the number of draws or threads. ``threads`` chunks at a time.
    """
    displacement_m = np.broadcast_to(displacement_m, (draws, displacement_m.shape[-1]))
    amplitude_s = displacement_m[:, :, None] * (2 / settings.sound_speed_m_per_s)
    largest_s = float(np.abs(amplitude_s).max(initial=0.0))
    reach_s = (float(sample_time_s[0]) - pulse.end_s - largest_s, float(sample_time_s[-1]) - pulse.start_s + largest_s)

    def chunk(first: int, stream: np.random.Generator) -> NDArray[np.floating]:
        field = draw_thinned(settings, reach_s, tolerance, stream, DRAWS_AT_ONCE)
        # A whole chunk always, so that the last one's draws do not depend on how many of them are wanted.
        row = np.minimum(np.arange(first, first + DRAWS_AT_ONCE), draws - 1)
        scene = ScattererRows(
            field.row, field.delay_s, field.tracking_weight, field.motion_weight[None], amplitude_s[row]
        )
        return batch(scene, pulse, sample_time_s, tolerance, dtype, compiled)[: draws - first]

    firsts = range(0, draws, DRAWS_AT_ONCE)
    streams = rng.spawn(len(firsts))
    if threads == 1:
        yield from map(chunk, firsts, streams)
        return
    # A few chunks ahead of the reader, never all of them.
    with ThreadPoolExecutor(threads) as pool:
        jobs = iter(zip(firsts, streams, strict=True))
        waiting = [pool.submit(chunk, *job) for job in islice(jobs, 2 * threads)]
        while waiting:
            done = waiting.pop(0).result()
            waiting += [pool.submit(chunk, *job) for job in islice(jobs, 1)]
            yield done


def _refuse_unusable(scene: ScattererRows, sample_time_s: Floats, tolerance: float) -> None:
    axes = {
        "rest_s": "scatterer",
        "weight": "scatterer",
        "shape": "shape, scatterer",
        "amplitude_s": "row, echo, shape",
    }
    named = {name: getattr(scene, name) for name in axes}
    refuse_misfits(named | {"row": scene.row}, axes | {"row": "scatterer"})
    refuse_numbers(named, sample_time_s, tolerance)
    if len(scene.row) == 0:
        return
    step, rows = np.diff(scene.row), len(scene.amplitude_s)
    if scene.row[0] < 0 or scene.row[-1] >= rows or (step < 0).any() or (np.diff(scene.rest_s)[step == 0] < 0).any():
        raise ValueError(
            f"row must ascend from 0 to less than the {rows} rows of amplitude_s and rest_s within each row: order the "
            "scatterers by numpy.lexsort((rest_s, row))"
        )
