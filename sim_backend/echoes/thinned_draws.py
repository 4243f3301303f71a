"""Several draws of scatterers at once, each of those alone that can matter: for studies that need speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.echoes.scatterers import depth_delay_s, depth_loss, draw_field, reflectivity, scatterer_count
from sim_backend.settings import SimulationSettings

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ThinnedDraws:
    """Several independent draws, each of the scatterers that matter alone; every array (scatterer,).

    In ascending draw and, within one, depth.
    """

    row: NDArray[np.int64]
    """Which draw."""
    delay_s: Floats
    """At rest, relative to the focus."""
    tracking_weight: Floats
    motion_weight: Floats


def draw_thinned(
    settings: SimulationSettings,
    reach_s: tuple[float, float],
    tolerance: float,
    rng: np.random.Generator,
    draws: int,
) -> ThinnedDraws:
    """Return draws of the scatterers whose delay lies within ``reach_s`` and whose weight matters to ``tolerance``.

    Scatterers are independent, so that many of the box's N fall into a smaller box with a binomial number: the
    statistics of the echoes are those of `draw_field`, the random numbers are not. Reflectors are in every draw.
    """
    scatterers, beams = settings.scatterers, settings.beams
    box = np.array(scatterers.volume_m)
    low, high = -box / 2, box / 2
    if scatterers.axial_delay == "two_way":
        depth_m = np.array(reach_s) * settings.sound_speed_m_per_s / 2
        low[2], high[2] = np.clip(depth_m, low[2], high[2])
    total = scatterer_count(scatterers, beams)
    # N weights below this add less than a tenth of the tolerance to an echo whose rms is 1, of one scatterer in focus.
    limit = 0.1 * tolerance / max(1, total)
    width_m = np.array(beams.tracking_width_m)
    farthest_m = width_m[:2] * math.sqrt(-2 * math.log(limit)) if limit > 0 else np.full(2, math.inf)
    axis_m = np.array(beams.lateral_offset_m)
    low[:2], high[:2] = np.maximum(low[:2], axis_m - farthest_m), np.minimum(high[:2], axis_m + farthest_m)
    high = np.maximum(high, low)
    count = rng.binomial(total, min(1.0, math.prod(((high - low) / box).tolist())), draws)
    row = np.repeat(np.arange(draws), count)
    z_m = low[2] + (high[2] - low[2]) * _ascending(count, rng)
    x_m, y_m = (low[axis] + (high[axis] - low[axis]) * rng.random(len(row)) for axis in (0, 1))
    seen_at_m = (x_m - beams.lateral_offset_m[0], y_m - beams.lateral_offset_m[1], z_m)
    tracking = _gaussian(seen_at_m, beams.tracking_width_m)
    kept = np.flatnonzero(tracking >= limit)
    z_m, tracking = z_m[kept], tracking[kept]
    moved = _gaussian((x_m[kept], y_m[kept], z_m), beams.motion_width_m())
    strength = tracking if scatterers.reflectivity == "unit" else tracking * reflectivity(scatterers, len(kept), rng)
    loss = depth_loss(scatterers, z_m)
    two_way = 2 / settings.sound_speed_m_per_s if scatterers.axial_delay == "two_way" else 0.0
    drawn = ThinnedDraws(row[kept], two_way * z_m, strength if loss is None else strength * loss, moved)
    return _with_reflectors(drawn, settings, draws) if scatterers.reflectors else drawn


def _with_reflectors(drawn: ThinnedDraws, settings: SimulationSettings, draws: int) -> ThinnedDraws:
    fixed = draw_field(
        settings.scatterers.model_copy(update={"per_cell": 0.0}), settings.beams, np.random.default_rng(0)
    )
    delay_s = depth_delay_s(fixed, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
    row = np.concatenate([drawn.row, np.repeat(np.arange(draws), len(delay_s))])
    delay_s, tracking, moved = (
        np.concatenate([some, np.tile(every, draws)])
        for some, every in (
            (drawn.delay_s, delay_s),
            (drawn.tracking_weight, fixed.tracking_weight),
            (drawn.motion_weight, fixed.motion_weight),
        )
    )
    order = np.lexsort((delay_s, row))
    return ThinnedDraws(row[order], delay_s[order], tracking[order], moved[order])


def _gaussian(place_m: tuple[Floats, Floats, Floats], width_m: tuple[float, float, float]) -> Floats:
    x, y, z = (np.square(at_m) * (-0.5 / width**2) for at_m, width in zip(place_m, width_m, strict=True))
    return np.asarray(np.exp(x + y + z))


def _ascending(count: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """Return ``count`` (draw,) uniform numbers in [0, 1) for each draw, in ascending order within it: no sorting.

    Sums of exponential spacings over the sum of one spacing more are distributed as sorted uniform numbers.
    """
    spacing = np.cumsum(rng.standard_exponential(int(count.sum()) + len(count)))
    last = np.cumsum(count + 1) - 1
    begin = np.concatenate(([0.0], spacing[last[:-1]]))
    inner = np.delete(spacing, last)
    return np.asarray((inner - np.repeat(begin, count)) / np.repeat(spacing[last] - begin, count))
