"""Echoes of many scatterer draws, gates or parameter values in one call, with bounded memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.echoes.aperture import BeamResponse, beam_response
from sim_backend.echoes.delays import EchoDelays, check_sample_rate
from sim_backend.echoes.engine import DEFAULT_TOLERANCE, synthesise
from sim_backend.echoes.exact_sums import blocks
from sim_backend.echoes.pulse import Pulse
from sim_backend.echoes.scatterers import draw_thinned
from sim_backend.echoes.series import ScattererRows, series, series_terms, shape_angles_rad
from sim_backend.settings import SimulationSettings

DRAWS_AT_ONCE = 16
"""Draws in a chunk. Each chunk has its own stream of random numbers, so another value changes the draws of a seed."""


def batch(
    scatterer_rows: ScattererRows, pulse: Pulse, sample_time_s: FloatArray, tolerance: float = DEFAULT_TOLERANCE
) -> FloatArray:
    """Return the echoes of many independent sets of scatterers at once, (row, echo, sample).

    A row is a draw, a gate (its start subtracted from ``rest_s``) or a parameter value (its own weights or
    ``amplitude_s``). The rms error of all is within ``tolerance``. Scatterers must ascend in row and within a row in
    delay. Raises ValueError for samples too far apart for the pulse.
    """
    sample_time_s = np.asarray(sample_time_s, dtype=np.float64)
    check_sample_rate(pulse, sample_time_s)
    out = np.empty((*scatterer_rows.amplitude_s.shape[:2], len(sample_time_s)))
    if out.size == 0:
        return out
    angles_rad = shape_angles_rad(pulse, scatterer_rows.shape, scatterer_rows.amplitude_s)
    if tolerance > 0 and series_terms(angles_rad, tolerance) is not None:
        for block in blocks(sample_time_s, pulse):
            series(scatterer_rows, pulse, sample_time_s[block], tolerance, out[:, :, block])
        return out
    # The motion is too large for the series: row by row.
    for row, (first, last) in enumerate(itertools.pairwise(scatterer_rows.row_bounds)):
        scatterers = slice(first, last)
        response = None if scatterer_rows.response is None else scatterer_rows.response[:, scatterers]
        delays = EchoDelays(
            scatterer_rows.rest_s[scatterers],
            scatterer_rows.shape[:, scatterers],
            scatterer_rows.amplitude_s[row],
            response,
        )
        out[row] = synthesise(delays, scatterer_rows.weight[scatterers], pulse, sample_time_s, tolerance).echo
    return out


def drawn_echoes(
    settings: SimulationSettings,
    displacement_m: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    rng: np.random.Generator,
    draws: int,
    tolerance: float = DEFAULT_TOLERANCE,
) -> Iterator[FloatArray]:
    """Yield the noise-free echoes of ``draws`` new draws of scatterers, (up to 16 draws, echo, sample) at a time.

    ``displacement_m`` (echo,) or (draw, echo) at the focus; ``sample_time_s`` (sample,), 0 is the arrival of the echo
    of the resting focus. Only scatterers that can reach the gate and matter are drawn; the settings' reflectors are in
    every draw. Draw n depends on the seed of ``rng``, n, the gate, the largest displacement and the tolerance, not on
    the number of draws.
    """
    displacement_m = np.broadcast_to(displacement_m, (draws, displacement_m.shape[-1]))
    amplitude_s = displacement_m[:, :, None] * (2 / settings.sound_speed_m_per_s)
    largest_s = float(np.abs(amplitude_s).max(initial=0.0))
    reach_s = (float(sample_time_s[0]) - pulse.end_s - largest_s, float(sample_time_s[-1]) - pulse.start_s + largest_s)
    chunk_starts = range(0, draws, DRAWS_AT_ONCE)
    for first, chunk_rng in zip(chunk_starts, rng.spawn(len(chunk_starts)), strict=True):
        # Always draw a whole chunk, so that the last draws do not depend on their number.
        field = draw_thinned(settings, reach_s, tolerance, chunk_rng, DRAWS_AT_ONCE)
        row = np.minimum(np.arange(first, first + DRAWS_AT_ONCE), draws - 1)
        beam = BeamResponse(field.tracking_weight)
        if settings.beams.field != "gaussian":
            beam = beam_response(settings, field.offset_m, pulse)
            beam = replace(beam, weight=beam.weight * field.reflectivity)
        shape = field.motion_weight if beam.delay_ratio is None else beam.delay_ratio * field.motion_weight
        rows = ScattererRows(field.row, field.delay_s, beam.weight, shape[None], amplitude_s[row], beam.response)
        yield batch(rows, pulse, sample_time_s, tolerance)[: draws - first]
