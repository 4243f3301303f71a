"""Echoes of many scatterer draws, gates or parameter values in one call, a bounded chunk at a time."""

from __future__ import annotations

import functools
import importlib.util
import itertools
from collections.abc import Iterator

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.echoes.colouring import coloured
from sim_backend.echoes.delays import EchoDelays, refuse_aliasing, refuse_misfits, refuse_numbers
from sim_backend.echoes.engine import DEFAULT_TOLERANCE, synthesise
from sim_backend.echoes.exact_sums import blocks
from sim_backend.echoes.pulse import Pulse, angular_rates
from sim_backend.echoes.scatterers import draw_thinned
from sim_backend.echoes.series import MOST_ANGLE_RAD, ScattererRows, largest_angle, series
from sim_backend.settings import SimulationSettings

DRAWS_AT_ONCE = 16
"""Draws of a chunk. Part of what a seed means: each chunk has its own stream of random numbers."""


def batch(
    scene: ScattererRows,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float = DEFAULT_TOLERANCE,
    compiled: bool = True,
) -> FloatArray:
    """Return the echoes of every row of ``scene``, (row, echo, sample); rms error over all within ``tolerance``.

    A row is a draw, a gate (its start subtracted from ``rest_s``) or a parameter value (its own weights or
    ``amplitude_s``). Scatterers must ascend in row and, within one, in delay. ``compiled``: by Numba where it is
    installed and covers the case. Raises ValueError for what is not finite, does not fit or does not ascend, by name.
    """
    sample_time_s = np.asarray(sample_time_s, dtype=np.float64)
    _refuse_unusable(scene, sample_time_s, tolerance)
    refuse_aliasing(pulse, sample_time_s)
    out = np.empty((*scene.amplitude_s.shape[:2], len(sample_time_s)))
    if out.size == 0:
        return out
    if largest_angle(pulse, scene.shape, scene.amplitude_s) <= MOST_ANGLE_RAD:
        _batch_of_series(scene, pulse, sample_time_s, tolerance, out, compiled and compilable(scene, pulse))
    else:
        # Too large a motion for the series: row by row, by whatever the engine finds cheapest.
        begin = scene.row.searchsorted(np.arange(len(scene.amplitude_s) + 1)).tolist()
        for row, (first, last) in enumerate(itertools.pairwise(begin)):
            own = slice(first, last)
            colour = None if scene.colour is None else scene.colour[:, own]
            delays = EchoDelays(scene.rest_s[own], scene.shape[:, own], scene.amplitude_s[row], colour)
            out[row] = synthesise(delays, scene.weight[own], pulse, sample_time_s, tolerance).echo
    return out


def _batch_of_series(
    scene: ScattererRows,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    out: FloatArray,
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
    return len(scene.shape) == 1 and scene.colour is None and numba_installed() and angular_rates(pulse)[1] is not None


def drawn_echoes(
    settings: SimulationSettings,
    displacement_m: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    rng: np.random.Generator,
    draws: int,
    tolerance: float = DEFAULT_TOLERANCE,
    compiled: bool = True,
) -> Iterator[FloatArray]:
    """Yield the noise-free echoes of ``draws`` new draws of scatterers, (up to 16 draws, echo, sample) at a time.

    ``displacement_m`` (echo,) or (draw, echo) at the focus; ``sample_time_s`` (sample,), 0 the arrival of the resting
    focus' echo. Only scatterers that can reach the gate and matter are drawn, binomially many, and the scene's
    reflectors are in every draw. Draw n depends on ``rng``'s seed and n, on the gate, the largest displacement and the
    tolerance, not on the number of draws.
    """
    displacement_m = np.broadcast_to(displacement_m, (draws, displacement_m.shape[-1]))
    amplitude_s = displacement_m[:, :, None] * (2 / settings.sound_speed_m_per_s)
    largest_s = float(np.abs(amplitude_s).max(initial=0.0))
    reach_s = (float(sample_time_s[0]) - pulse.end_s - largest_s, float(sample_time_s[-1]) - pulse.start_s + largest_s)

    def chunk(first: int, stream: np.random.Generator) -> FloatArray:
        field = draw_thinned(settings, reach_s, tolerance, stream, DRAWS_AT_ONCE)
        # A whole chunk always, so that the last one's draws do not depend on how many of them are wanted.
        row = np.minimum(np.arange(first, first + DRAWS_AT_ONCE), draws - 1)
        weight, shape, colour = field.tracking_weight, field.motion_weight, None
        if settings.beams.field != "gaussian":
            beam = coloured(settings, field.offset_m, pulse)
            weight, shape, colour = beam.weight * field.strength, beam.sensed * shape, beam.colour
        scene = ScattererRows(field.row, field.delay_s, weight, shape[None], amplitude_s[row], colour)
        return batch(scene, pulse, sample_time_s, tolerance, compiled)[: draws - first]

    firsts = range(0, draws, DRAWS_AT_ONCE)
    yield from map(chunk, firsts, rng.spawn(len(firsts)))


def _refuse_unusable(scene: ScattererRows, sample_time_s: FloatArray, tolerance: float) -> None:
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
