"""Point scatterers around the focus, their tracking weights and their motion, eq. (8) and (12) of the paper.

    I_n = R_n exp(-x_n² / 2 T_x² - y_n² / 2 T_y² - z_n² / 2 T_z²)      eq. (8), tracking beam
    g_n =     exp(-x_n² / 2 M_x² - y_n² / 2 M_y² - z_n² / 2 M_z²)      eq. (12), motion

    x_n, y_n, z_n   offset from the focus, m; in eq. (8) from the tracking beam's axis
    R_n             reflectivity
    T, M            standard deviations of tracking beam and motion, m

`draw_field` draws all scatterers of a measurement. `draw_thinned` draws several independent sets, each of only the
scatterers that matter, for studies (docs/explanation/echoes.md, section 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from sim_backend.arrays import BoolArray, FloatArray, Int64Array
from sim_backend.settings import Beams, Reflector, Scatterers, SimulationSettings, scatterer_count

# N scatterers below it change an echo of order 1 to 10 by at most N times this: below 1e-14 in the default scene.
NEGLIGIBLE_WEIGHT = 1e-15

# Points on each side of a plane reflector: exact for polynomials of degree 23 across the beam.
_PLANE_NODES = 12


@dataclass(frozen=True, slots=True)
class ScattererField:
    """Scatterers around the focus in ascending depth; every array but the first (scatterer,)."""

    offset_m: FloatArray
    """(scatterer, 3), lateral x, y and axial z from the focus, z away from the transducer."""
    tracking_weight: FloatArray
    """I of eq. (8) times reflectivity, and with attenuation times the loss from the focus to the scatterer's depth."""
    motion_weight: FloatArray
    """g of eq. (12) of the paper: displacement relative to that of the focus."""
    excitation_weight: FloatArray
    """Pulse-echo weight of the excitation beam times reflectivity."""
    motion_share: FloatArray
    """1 for a scatterer that moves with the medium, 0 for a reflector at rest."""
    reflectivity: FloatArray
    """Reflectivity without any beam."""


def gaussian_weight(offset_m: FloatArray, width_m: tuple[float, float, float]) -> FloatArray:
    """Return exp(-sum x_i^2 / 2 width_i^2), (scatterer,), for ``offset_m`` (scatterer, 3)."""
    return np.asarray(np.exp(-0.5 * np.square(offset_m / np.array(width_m)).sum(axis=1)))


def noticeable(weight: FloatArray) -> BoolArray:
    """Return which scatterers are strong enough to matter, (scatterer,)."""
    return np.abs(weight) >= NEGLIGIBLE_WEIGHT


def draw_field(
    scatterers: Scatterers,
    beams: Beams,
    rng: np.random.Generator,
    lateral_offset_m: float = 0.0,
    rng_of: Callable[[int], np.random.Generator] | None = None,
) -> ScattererField:
    """Return scatterers drawn uniformly in the box around the focus, and the reflectors, with their beam weights.

    The box is centred at ``lateral_offset_m`` along x. The tissue is a row of boxes; box 0, on the axis, is drawn from
    ``rng`` and box n from ``rng_of(n)``, so overlapping positions share scatterers.
    """
    # The box at this offset overlaps one or two boxes of the row.
    box = np.array(scatterers.volume_m)
    first = math.floor(lateral_offset_m / box[0])
    box_indices = [first] if first * box[0] == lateral_offset_m else [first, first + 1]
    box_draws = [_draw_box(scatterers, beams, rng if n == 0 or rng_of is None else rng_of(n)) for n in box_indices]
    offset_m = np.concatenate(
        [in_box_m + np.array([n * box[0], 0, 0]) for n, (in_box_m, _) in zip(box_indices, box_draws, strict=True)]
    )
    inside = np.abs(offset_m[:, 0] - lateral_offset_m) <= box[0] / 2
    offset_m, reflectivity = offset_m[inside], np.concatenate([values for _, values in box_draws])[inside]
    motion_share = np.ones(len(offset_m))
    for reflector in scatterers.reflectors:
        point_m, point_reflectivity = reflector_points(reflector, beams)
        offset_m = np.concatenate([offset_m, point_m])
        reflectivity = np.concatenate([reflectivity, point_reflectivity])
        motion_share = np.concatenate([motion_share, np.full(len(point_m), float(reflector.moves))])
    # The beam of an aperture is computed in the attenuating medium, so it already includes the loss.
    loss = depth_loss(scatterers, offset_m[:, 2]) if beams.field == "gaussian" else None
    return field_at(offset_m, beams, reflectivity if loss is None else reflectivity * loss, motion_share)


def _draw_box(scatterers: Scatterers, beams: Beams, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return offsets from the middle of a box (scatterer, 3), m, and reflectivities (scatterer,)."""
    offset_m = rng.uniform(-0.5, 0.5, (scatterer_count(scatterers, beams), 3)) * np.array(scatterers.volume_m)
    return offset_m, draw_reflectivity(scatterers, len(offset_m), rng)


def draw_reflectivity(scatterers: Scatterers, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the reflectivity of ``count`` scatterers; draws no random number if all are 1."""
    if scatterers.reflectivity == "unit":
        return np.ones(count)
    normal = rng.standard_normal(count)
    return np.sign(normal) if scatterers.reflectivity == "sign" else normal


def depth_loss(scatterers: Scatterers, depth_m: FloatArray) -> FloatArray | None:
    """Return the two-way amplitude factor (scatterer,) of attenuation between the focus and ``depth_m`` beyond it.

    It is that at the band's centre; None without attenuation. `pulse.echo_pulse` includes the loss up to the focus and
    the shift of the centre frequency.
    """
    if scatterers.attenuation_db_per_cm_mhz == 0:
        return None
    loss_db = scatterers.attenuation_db_per_cm_mhz * (scatterers.band_centre_hz / 1e6) * 2 * depth_m * 100
    return np.asarray(10 ** (-loss_db / 20))


def reflector_points(reflector: Reflector, beams: Beams) -> tuple[FloatArray, FloatArray]:
    """Return offsets (point, 3), m, and reflectivities (point,) of the scatterers that represent a reflector.

    The reflectivities of a plane's points add up to an echo of its ``strength`` for the whole plane. The points are the
    Gauss-Hermite nodes of the integral over the tracking beam, so each point may move differently.
    """
    if reflector.kind == "point":
        return np.array([reflector.position_m]), np.array([reflector.strength])
    # Nodes across the tracking beam. The echo model multiplies each point by the beam: the weights are divided by it.
    node, weight = np.polynomial.hermite_e.hermegauss(_PLANE_NODES)
    weight = weight / weight.sum() * np.exp(node**2 / 2)
    (tx, ty, _), (ox, oy) = beams.tracking_width_m, beams.lateral_offset_m
    x, y = np.meshgrid(ox + tx * node, oy + ty * node)
    offset_m = np.stack([x.ravel(), y.ravel(), np.full(x.size, reflector.position_m[2])], axis=1)
    return offset_m, reflector.strength * np.outer(weight, weight).ravel()


def field_at(
    offset_m: FloatArray, beams: Beams, reflectivity: FloatArray | None = None, motion_share: FloatArray | None = None
) -> ScattererField:
    """Return scatterers at ``offset_m`` (scatterer, 3) from the focus, sorted by depth, with their weights.

    The weights are those in the tracking beam, in the excitation beam and in the motion of the medium. ``reflectivity``
    (scatterer,) defaults to 1, as does ``motion_share`` (scatterer,), the fraction of the medium's motion that a
    scatterer follows: 0 for a reflector at rest.
    """
    # Sorted once here, the delays at rest ascend, and the sums over scatterers need not sort them for each echo train.
    order = np.argsort(offset_m[:, 2], kind="stable")
    offset_m = offset_m[order]
    reflectivity = np.ones(len(order)) if reflectivity is None else reflectivity[order]
    motion_share = np.ones(len(order)) if motion_share is None else motion_share[order]
    from_axis_m = offset_m - np.array([*beams.lateral_offset_m, 0.0])
    return ScattererField(
        offset_m=offset_m,
        tracking_weight=gaussian_weight(from_axis_m, beams.tracking_width_m) * reflectivity,
        motion_weight=gaussian_weight(offset_m, beams.motion_width_m()) * motion_share,
        excitation_weight=gaussian_weight(offset_m, beams.excitation_width_m) * reflectivity,
        motion_share=motion_share,
        reflectivity=reflectivity,
    )


def depth_delay_s(field: ScattererField, axial_delay: str, sound_speed_m_per_s: float) -> FloatArray:
    """Return the echo delay at rest relative to the focus, (scatterer,); zero for ``axial_delay`` "none"."""
    if axial_delay == "none":
        return np.zeros(len(field.offset_m))
    return np.asarray(2 * field.offset_m[:, 2] / sound_speed_m_per_s)


@dataclass(frozen=True, slots=True)
class ThinnedDraws:
    """Independent draws of the scatterers that matter, in ascending draw and depth; every array (scatterer,)."""

    row: Int64Array
    """Index of the draw."""
    delay_s: FloatArray
    """At rest, relative to the focus."""
    tracking_weight: FloatArray
    motion_weight: FloatArray
    offset_m: FloatArray
    """(scatterer, 3) from the focus."""
    reflectivity: FloatArray
    """Reflectivity without any beam."""


def draw_thinned(
    settings: SimulationSettings,
    reach_s: tuple[float, float],
    tolerance: float,
    rng: np.random.Generator,
    draws: int,
) -> ThinnedDraws:
    """Return independent draws of scatterers, without those that miss the gate or are too weak for ``tolerance``.

    ``reach_s``: earliest and latest delay of an echo in the gate. Echoes have the same statistics as those of all
    scatterers, but from other random numbers. Reflectors are in every draw.
    """
    scatterers, beams = settings.scatterers, settings.beams
    count = scatterer_count(scatterers, beams)
    # So many weights below the smallest add less than a tenth of the tolerance to the echo of a scatterer in the focus.
    # The beam of an aperture falls off slowly and is computed later: it has no smallest weight.
    min_weight = 0.1 * tolerance / max(1, count) if beams.field == "gaussian" else 0.0
    # Draw only inside the box of scatterers that can matter. Positions are independent, so their number in it is
    # binomial. They are uniform in x and y, and sorted uniform in z.
    low, high = _relevant_box(settings, reach_s, min_weight)
    fraction = min(1.0, math.prod(((high - low) / np.array(scatterers.volume_m)).tolist()))
    counts = rng.binomial(count, fraction, draws)
    row = np.repeat(np.arange(draws), counts)
    z_m = low[2] + (high[2] - low[2]) * _sorted_uniform(counts, rng)
    x_m, y_m = (low[axis] + (high[axis] - low[axis]) * rng.random(len(row)) for axis in (0, 1))
    from_axis_m = (x_m - beams.lateral_offset_m[0], y_m - beams.lateral_offset_m[1], z_m)
    tracking_weight = _gaussian(from_axis_m, beams.tracking_width_m)
    # Remove the weak ones in the corners of the box.
    strong = np.flatnonzero(tracking_weight >= min_weight)
    x_m, y_m, z_m, tracking_weight = x_m[strong], y_m[strong], z_m[strong], tracking_weight[strong]
    reflectivity = draw_reflectivity(scatterers, len(strong), rng)
    loss = depth_loss(scatterers, z_m)
    delay_per_m = 2 / settings.sound_speed_m_per_s if scatterers.axial_delay == "two_way" else 0.0
    scatterer_draws = ThinnedDraws(
        row=row[strong],
        delay_s=delay_per_m * z_m,
        tracking_weight=tracking_weight * reflectivity * (1.0 if loss is None else loss),
        motion_weight=_gaussian((x_m, y_m, z_m), beams.motion_width_m()),
        offset_m=np.stack([x_m, y_m, z_m], axis=1),
        reflectivity=reflectivity,
    )
    return _with_reflectors(scatterer_draws, settings, draws) if scatterers.reflectors else scatterer_draws


def _relevant_box(
    settings: SimulationSettings, reach_s: tuple[float, float], min_weight: float
) -> tuple[FloatArray, FloatArray]:
    """Return two opposite corners (3,), m, of the box outside which no scatterer matters.

    Inside it the echo delay is within ``reach_s`` and the weight in the tracking beam above ``min_weight``.
    """
    scatterers, beams = settings.scatterers, settings.beams
    box = np.array(scatterers.volume_m)
    low, high = -box / 2, box / 2
    # Depths from the delays, and lateral limits from the Gaussian tracking beam.
    if scatterers.axial_delay == "two_way":
        depth_m = np.array(reach_s) * settings.sound_speed_m_per_s / 2
        low[2], high[2] = np.clip(depth_m, low[2], high[2])
    width_m, axis_m = np.array(beams.tracking_width_m), np.array(beams.lateral_offset_m)
    radius_m = width_m[:2] * math.sqrt(-2 * math.log(min_weight)) if min_weight > 0 else np.full(2, math.inf)
    low[:2], high[:2] = np.maximum(low[:2], axis_m - radius_m), np.minimum(high[:2], axis_m + radius_m)
    return low, np.maximum(high, low)


def _with_reflectors(scatterer_draws: ThinnedDraws, settings: SimulationSettings, draws: int) -> ThinnedDraws:
    """Return the draws with the reflectors of the settings added to every draw."""
    only_reflectors = settings.scatterers.model_copy(update={"per_cell": 0.0})
    field = draw_field(only_reflectors, settings.beams, np.random.default_rng(0))
    delay_s = depth_delay_s(field, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
    reflectors = ThinnedDraws(
        row=np.repeat(np.arange(draws), len(field.reflectivity)),
        delay_s=np.tile(delay_s, draws),
        tracking_weight=np.tile(field.tracking_weight, draws),
        motion_weight=np.tile(field.motion_weight, draws),
        offset_m=np.tile(field.offset_m, (draws, 1)),
        reflectivity=np.tile(field.reflectivity, draws),
    )
    both = (scatterer_draws, reflectors)
    row, delay_s = (np.concatenate([getattr(part, name) for part in both]) for name in ("row", "delay_s"))
    order = np.lexsort((delay_s, row))  # by row, then by delay
    names = (item.name for item in fields(ThinnedDraws))
    return ThinnedDraws(*(np.concatenate([getattr(part, name) for part in both])[order] for name in names))


def _gaussian(offset_m: tuple[FloatArray, FloatArray, FloatArray], width_m: tuple[float, float, float]) -> FloatArray:
    """Return exp(-sum x_i^2 / 2 width_i^2) (scatterer,) for offsets x, y, z (scatterer,) from its centre."""
    x, y, z = (np.square(axis_m) * (-0.5 / width**2) for axis_m, width in zip(offset_m, width_m, strict=True))
    return np.asarray(np.exp(x + y + z))


def _sorted_uniform(counts: Int64Array, rng: np.random.Generator) -> FloatArray:
    """Return ``counts`` (draw,) uniform numbers in [0, 1) for each draw, ascending within a draw, without sorting.

    Sums of exponential spacings, divided by the sum with one more spacing, are distributed as sorted uniform numbers.
    """
    spacing = np.cumsum(rng.standard_exponential(int(counts.sum()) + len(counts)))
    last = np.cumsum(counts + 1) - 1
    start = np.concatenate(([0.0], spacing[last[:-1]]))
    inner = np.delete(spacing, last)
    return np.asarray((inner - np.repeat(start, counts)) / np.repeat(spacing[last] - start, counts))
