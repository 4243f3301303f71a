"""Point scatterers around the focus, and how strongly each is seen and moved, eq. (8) and (12)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Beams, Scatterers

Floats = NDArray[np.float64]

# N dropped scatterers change an echo by at most N times this, against an echo of order 1 to 10: below 1e-14
# relative in the default scene. (A limit of 1e-6 there changes the echo by 5e-6.)
NEGLIGIBLE_WEIGHT = 1e-15


@dataclass(frozen=True, slots=True)
class ScattererField:
    """Where the scatterers are, relative to the focus, in ascending depth; every array but the first (scatterer,)."""

    offset_m: Floats
    """(scatterer, 3), lateral x, y and axial z, away from the transducer."""
    tracking_weight: Floats
    """I of eq. (8), unity reflectivity."""
    motion_weight: Floats
    """g, the Gaussian of eq. (12): displacement over the focus'; also the excitation beam's pulse-echo weight."""


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
    return weight >= NEGLIGIBLE_WEIGHT


def draw_field(scatterers: Scatterers, beams: Beams, rng: np.random.Generator) -> ScattererField:
    """Return scatterers placed uniformly in the box around the focus."""
    box = np.array(scatterers.volume_m)
    return field_at(rng.uniform(-0.5, 0.5, (scatterer_count(scatterers, beams), 3)) * box, beams)


def field_at(offset_m: Floats, beams: Beams) -> ScattererField:
    """Return the field of scatterers at ``offset_m`` (scatterer, 3) from the focus."""
    # Ascending depth lets the running sum look its samples up in order.
    offset_m = offset_m[np.argsort(offset_m[:, 2], kind="stable")]
    return ScattererField(
        offset_m,
        gaussian_weight(offset_m, beams.tracking_width_m),
        gaussian_weight(offset_m, beams.excitation_width_m),
    )


def depth_delay_s(field: ScattererField, axial_delay: str, sound_speed_m_per_s: float) -> Floats:
    """Return the echo delay of every scatterer at rest, relative to the focus, (scatterer,); zero for ``"none"``."""
    if axial_delay == "none":
        return np.zeros(len(field.offset_m))
    return np.asarray(2 * field.offset_m[:, 2] / sound_speed_m_per_s)
