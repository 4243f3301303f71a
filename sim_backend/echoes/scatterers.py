"""Point scatterers around the focus, and how strongly each is seen and moved, eq. (8) and (12)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Beams, Reflector, Scatterers

Floats = NDArray[np.float64]

# N dropped scatterers change an echo by at most N times this, against an echo of order 1 to 10: below 1e-14
# relative in the default scene. (A limit of 1e-6 there changes the echo by 5e-6.)
NEGLIGIBLE_WEIGHT = 1e-15

# Points a side of a plane: exact for polynomials of degree 23 across the beam.
_PLANE_NODES = 12


@dataclass(frozen=True, slots=True)
class ScattererField:
    """Where the scatterers are, relative to the focus, in ascending depth; every array but the first (scatterer,)."""

    offset_m: Floats
    """(scatterer, 3), lateral x, y and axial z, away from the transducer."""
    tracking_weight: Floats
    """I of eq. (8) times reflectivity and, with attenuation, the loss from the focus to its depth."""
    motion_weight: Floats
    """g, the Gaussian of eq. (12): displacement over the focus'."""
    excitation_weight: Floats
    """The excitation beam's pulse-echo weight: g times reflectivity."""


def resolution_cell_m3(tracking_width_m: tuple[float, float, float]) -> float:
    """Return the volume in which the tracking beam I is above -6 dB (1/2): an ellipsoid, half axes T sqrt(2 ln 2)."""
    axis = math.sqrt(2 * math.log(2))
    return 4 / 3 * math.pi * math.prod(width_m * axis for width_m in tracking_width_m)


def scatterer_count(scatterers: Scatterers, beams: Beams) -> int:
    """Return the number of scatterers in the box: ``per_cell`` times the number of resolution cells in it."""
    return round(scatterers.per_cell * math.prod(scatterers.volume_m) / resolution_cell_m3(beams.tracking_width_m))


def gaussian_weight(offset_m: Floats, width_m: tuple[float, float, float]) -> Floats:
    """Return exp(-sum x_i^2 / 2 width_i^2), (scatterer,), for ``offset_m`` (scatterer, 3)."""
    return np.asarray(np.exp(-0.5 * np.square(offset_m / np.array(width_m)).sum(axis=1)))


def noticeable(weight: Floats) -> NDArray[np.bool_]:
    """Return which scatterers matter, (scatterer,)."""
    return np.abs(weight) >= NEGLIGIBLE_WEIGHT


def draw_field(scatterers: Scatterers, beams: Beams, rng: np.random.Generator) -> ScattererField:
    """Return scatterers placed uniformly in the box around the focus, and the reflectors among them."""
    box = np.array(scatterers.volume_m)
    offset_m = rng.uniform(-0.5, 0.5, (scatterer_count(scatterers, beams), 3)) * box
    strength, moves = reflectivity(scatterers, len(offset_m), rng), np.ones(len(offset_m))
    for reflector in scatterers.reflectors:
        place_m, share = reflector_points(reflector, beams)
        offset_m = np.concatenate([offset_m, place_m])
        strength = np.concatenate([strength, share])
        moves = np.concatenate([moves, np.full(len(share), float(reflector.moves))])
    loss = depth_loss(scatterers, offset_m[:, 2])
    return field_at(offset_m, beams, strength if loss is None else strength * loss, moves)


def reflectivity(scatterers: Scatterers, count: int, rng: np.random.Generator) -> Floats:
    """Return the reflectivity of each of ``count`` scatterers; draws nothing where all are 1."""
    if scatterers.reflectivity == "unit":
        return np.ones(count)
    drawn = rng.standard_normal(count)
    return np.sign(drawn) if scatterers.reflectivity == "sign" else drawn


def depth_loss(scatterers: Scatterers, depth_m: Floats) -> Floats | None:
    """Return the two-way loss from the focus to ``depth_m`` beyond it, at the band's centre, or None without any.

    The loss up to the focus, and with it the downshift, is the pulse's (`tracking_pulse.echo_pulse`).
    """
    if scatterers.attenuation_db_per_cm_mhz == 0:
        return None
    decibel = scatterers.attenuation_db_per_cm_mhz * (scatterers.band_centre_hz / 1e6) * 2 * depth_m * 100
    return np.asarray(10 ** (-decibel / 20))


def reflector_points(reflector: Reflector, beams: Beams) -> tuple[Floats, Floats]:
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
    offset_m: Floats, beams: Beams, strength: Floats | None = None, moves: Floats | None = None
) -> ScattererField:
    """Return the field of scatterers at ``offset_m`` (scatterer, 3) from the focus.

    ``strength`` (scatterer,) reflectivity, absent 1; ``moves`` (scatterer,) share in the motion, absent 1.
    """
    # Ascending depth lets the running sum look its samples up in order.
    order = np.argsort(offset_m[:, 2], kind="stable")
    offset_m = offset_m[order]
    strength = np.ones(len(order)) if strength is None else strength[order]
    seen_at_m = offset_m - np.array([*beams.lateral_offset_m, 0.0])
    motion = gaussian_weight(offset_m, beams.motion_width_m())
    return ScattererField(
        offset_m,
        gaussian_weight(seen_at_m, beams.tracking_width_m) * strength,
        motion if moves is None else motion * moves[order],
        gaussian_weight(offset_m, beams.excitation_width_m) * strength,
    )


def depth_delay_s(field: ScattererField, axial_delay: str, sound_speed_m_per_s: float) -> Floats:
    """Return the echo delay of every scatterer at rest, relative to the focus, (scatterer,); zero for ``"none"``."""
    if axial_delay == "none":
        return np.zeros(len(field.offset_m))
    return np.asarray(2 * field.offset_m[:, 2] / sound_speed_m_per_s)
