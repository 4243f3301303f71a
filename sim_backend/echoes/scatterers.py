"""Point scatterers around the focus, and how strongly each is seen and moved, eq. (8) and (12).

Drawn one by one for a measurement (`draw_field`), or several draws at once of those alone that matter, for studies that
need speed (`draw_thinned`; docs/theory/echoes.md, section 6).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import BoolArray, FloatArray, Int64Array
from sim_backend.settings import Beams, Reflector, Scatterers, SimulationSettings, scatterer_count

# N dropped scatterers change an echo by at most N times this, against an echo of order 1 to 10: below 1e-14
# relative in the default scene. (A limit of 1e-6 there changes the echo by 5e-6.)
NEGLIGIBLE_WEIGHT = 1e-15

# Points a side of a plane: exact for polynomials of degree 23 across the beam.
_PLANE_NODES = 12


@dataclass(frozen=True, slots=True)
class ScattererField:
    """Where the scatterers are, relative to the focus, in ascending depth; every array but the first (scatterer,)."""

    offset_m: FloatArray
    """(scatterer, 3), lateral x, y and axial z, away from the transducer."""
    tracking_weight: FloatArray
    """I of eq. (8) times reflectivity and, with attenuation, the loss from the focus to its depth."""
    motion_weight: FloatArray
    """g, the Gaussian of eq. (12): displacement over the focus'."""
    excitation_weight: FloatArray
    """The excitation beam's pulse-echo weight: g times reflectivity."""
    moves: FloatArray
    """Share in the medium's motion: 0 of a reflector that stands still."""
    strength: FloatArray
    """Reflectivity, without any beam."""


def gaussian_weight(offset_m: FloatArray, width_m: tuple[float, float, float]) -> FloatArray:
    """Return exp(-sum x_i^2 / 2 width_i^2), (scatterer,), for ``offset_m`` (scatterer, 3)."""
    return np.asarray(np.exp(-0.5 * np.square(offset_m / np.array(width_m)).sum(axis=1)))


def noticeable(weight: FloatArray) -> BoolArray:
    """Return which scatterers matter, (scatterer,)."""
    return np.abs(weight) >= NEGLIGIBLE_WEIGHT


def draw_field(
    scatterers: Scatterers,
    beams: Beams,
    rng: np.random.Generator,
    beside_m: float = 0.0,
    rng_of: Callable[[int], np.random.Generator] | None = None,
) -> ScattererField:
    """Return scatterers placed uniformly in the box around the focus, and the reflectors among them.

    Where the box stands ``beside_m`` off the axis along x, the tissue is a row of boxes, the one on the axis drawn from
    ``rng``, the n-th beside it from ``rng_of(n)``: places that share tissue share its scatterers.
    """
    box = np.array(scatterers.volume_m)
    first = math.floor(beside_m / box[0])
    row = [first] if first * box[0] == beside_m else [first, first + 1]
    drawn = [_drawn_box(scatterers, beams, rng if n == 0 or rng_of is None else rng_of(n)) for n in row]
    offset_m = np.concatenate([each + np.array([n * box[0], 0, 0]) for n, (each, _) in zip(row, drawn, strict=True)])
    inside = np.abs(offset_m[:, 0] - beside_m) <= box[0] / 2
    offset_m, strength = offset_m[inside], np.concatenate([each for _, each in drawn])[inside]
    moves = np.ones(len(offset_m))
    for reflector in scatterers.reflectors:
        place_m, share = reflector_points(reflector, beams)
        offset_m = np.concatenate([offset_m, place_m])
        strength = np.concatenate([strength, share])
        moves = np.concatenate([moves, np.full(len(share), float(reflector.moves))])
    # An aperture's beam is computed in the medium that attenuates.
    loss = depth_loss(scatterers, offset_m[:, 2]) if beams.field == "gaussian" else None
    return field_at(offset_m, beams, strength if loss is None else strength * loss, moves)


def _drawn_box(scatterers: Scatterers, beams: Beams, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return places in a box around its middle (scatterer, 3), and reflectivities (scatterer,)."""
    offset_m = rng.uniform(-0.5, 0.5, (scatterer_count(scatterers, beams), 3)) * np.array(scatterers.volume_m)
    return offset_m, reflectivity(scatterers, len(offset_m), rng)


def reflectivity(scatterers: Scatterers, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the reflectivity of each of ``count`` scatterers; draws nothing where all are 1."""
    if scatterers.reflectivity == "unit":
        return np.ones(count)
    drawn = rng.standard_normal(count)
    return np.sign(drawn) if scatterers.reflectivity == "sign" else drawn


def depth_loss(scatterers: Scatterers, depth_m: FloatArray) -> FloatArray | None:
    """Return the two-way loss from the focus to ``depth_m`` beyond it, at the band's centre, or None without any.

    The loss up to the focus, and with it the downshift, is the pulse's (`pulse.echo_pulse`).
    """
    if scatterers.attenuation_db_per_cm_mhz == 0:
        return None
    decibel = scatterers.attenuation_db_per_cm_mhz * (scatterers.band_centre_hz / 1e6) * 2 * depth_m * 100
    return np.asarray(10 ** (-decibel / 20))


def reflector_points(reflector: Reflector, beams: Beams) -> tuple[FloatArray, FloatArray]:
    """Return offsets (point, 3) and reflectivities (point,) of a reflector.

    A plane is the Gauss-Hermite rule of its integral over the tracking beam; its motion varies across it as the
    excitation beam does.
    """
    if reflector.kind == "point":
        return np.array([reflector.position_m]), np.array([reflector.strength])
    node, share = np.polynomial.hermite_e.hermegauss(_PLANE_NODES)
    share = share / share.sum() * np.exp(node**2 / 2)
    (tx, ty, _), (ox, oy) = beams.tracking_width_m, beams.lateral_offset_m
    x, y = np.meshgrid(ox + tx * node, oy + ty * node)
    offset_m = np.stack([x.ravel(), y.ravel(), np.full(x.size, reflector.position_m[2])], axis=1)
    return offset_m, reflector.strength * np.outer(share, share).ravel()


def field_at(
    offset_m: FloatArray, beams: Beams, strength: FloatArray | None = None, moves: FloatArray | None = None
) -> ScattererField:
    """Return the field of scatterers at ``offset_m`` (scatterer, 3) from the focus.

    ``strength`` (scatterer,) reflectivity, absent 1; ``moves`` (scatterer,) share in the motion, absent 1.
    """
    # Ascending depth lets the running sum look its samples up in order.
    order = np.argsort(offset_m[:, 2], kind="stable")
    offset_m = offset_m[order]
    strength = np.ones(len(order)) if strength is None else strength[order]
    moves = np.ones(len(order)) if moves is None else moves[order]
    seen_at_m = offset_m - np.array([*beams.lateral_offset_m, 0.0])
    motion = gaussian_weight(offset_m, beams.motion_width_m())
    return ScattererField(
        offset_m,
        gaussian_weight(seen_at_m, beams.tracking_width_m) * strength,
        motion * moves,
        gaussian_weight(offset_m, beams.excitation_width_m) * strength,
        moves,
        strength,
    )


def depth_delay_s(field: ScattererField, axial_delay: str, sound_speed_m_per_s: float) -> FloatArray:
    """Return the echo delay of every scatterer at rest, relative to the focus, (scatterer,); zero for ``"none"``."""
    if axial_delay == "none":
        return np.zeros(len(field.offset_m))
    return np.asarray(2 * field.offset_m[:, 2] / sound_speed_m_per_s)


@dataclass(frozen=True, slots=True)
class ThinnedDraws:
    """Several independent draws, each of the scatterers that matter alone; every array (scatterer,).

    In ascending draw and, within one, depth.
    """

    row: Int64Array
    """Which draw."""
    delay_s: FloatArray
    """At rest, relative to the focus."""
    tracking_weight: FloatArray
    motion_weight: FloatArray
    offset_m: FloatArray
    """(scatterer, 3) from the focus."""
    strength: FloatArray
    """Reflectivity, without any beam."""

    def of(self, part: Int64Array) -> ThinnedDraws:
        """Return the same of some scatterers."""
        return ThinnedDraws(*(getattr(self, name)[part] for name in self.__slots__))


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
    if beams.field != "gaussian":
        # An aperture's beam falls off slowly and is not known here.
        limit = 0.0
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
    x_m, y_m, z_m, tracking = x_m[kept], y_m[kept], z_m[kept], tracking[kept]
    moved = _gaussian((x_m, y_m, z_m), beams.motion_width_m())
    strength = reflectivity(scatterers, len(kept), rng)
    loss = depth_loss(scatterers, z_m)
    tracking = tracking * strength if loss is None else tracking * strength * loss
    two_way = 2 / settings.sound_speed_m_per_s if scatterers.axial_delay == "two_way" else 0.0
    drawn = ThinnedDraws(row[kept], two_way * z_m, tracking, moved, np.stack([x_m, y_m, z_m], axis=1), strength)
    return _with_reflectors(drawn, settings, draws) if scatterers.reflectors else drawn


def _with_reflectors(drawn: ThinnedDraws, settings: SimulationSettings, draws: int) -> ThinnedDraws:
    fixed = draw_field(
        settings.scatterers.model_copy(update={"per_cell": 0.0}), settings.beams, np.random.default_rng(0)
    )
    delay_s = depth_delay_s(fixed, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
    delay_s, tracking, moved, strength = (
        np.tile(each, draws) for each in (delay_s, fixed.tracking_weight, fixed.motion_weight, fixed.strength)
    )
    row = np.repeat(np.arange(draws), len(fixed.strength))
    many = ThinnedDraws(row, delay_s, tracking, moved, np.tile(fixed.offset_m, (draws, 1)), strength)
    both = ThinnedDraws(*(np.concatenate([getattr(each, name) for each in (drawn, many)]) for name in drawn.__slots__))
    return both.of(np.lexsort((both.delay_s, both.row)))


def _gaussian(place_m: tuple[FloatArray, FloatArray, FloatArray], width_m: tuple[float, float, float]) -> FloatArray:
    x, y, z = (np.square(at_m) * (-0.5 / width**2) for at_m, width in zip(place_m, width_m, strict=True))
    return np.asarray(np.exp(x + y + z))


def _ascending(count: Int64Array, rng: np.random.Generator) -> FloatArray:
    """Return ``count`` (draw,) uniform numbers in [0, 1) for each draw, in ascending order within it: no sorting.

    Sums of exponential spacings over the sum of one spacing more are distributed as sorted uniform numbers.
    """
    spacing = np.cumsum(rng.standard_exponential(int(count.sum()) + len(count)))
    last = np.cumsum(count + 1) - 1
    begin = np.concatenate(([0.0], spacing[last[:-1]]))
    inner = np.delete(spacing, last)
    return np.asarray((inner - np.repeat(begin, count)) / np.repeat(spacing[last] - begin, count))
