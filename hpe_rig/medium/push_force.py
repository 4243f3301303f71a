"""Body force of a push around its focus: a Gaussian, or the intensity of a focused aperture as a sum of Gaussians.

    f(r, z) / f0 = sum_j sum_i C_ji exp(-r^2 / 2 a_i^2 - (z - z_j)^2 / 2 b^2)

The aperture is a spherical bowl whose surface moves evenly. Its pressure is the Rayleigh integral, exp(-j k d) / d
summed over the bowl point by point; force goes with the square of it. docs/theory/moduli.md, section "The force of an
aperture".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray

Intensity = Callable[[FloatArray, FloatArray], FloatArray]
"""Over distances from the axis (lateral,) and from the focus (axial,), in any unit: (axial, lateral)."""

NEPER_PER_DB = math.log(10) / 20
TISSUE_DB_PER_CM_MHZ = 0.5
"""Attenuation of soft tissue and phantoms, where nothing is declared."""
WIDTHS = 14
"""Widths across."""
NARROWEST, WIDEST = 0.22, 0.6
"""Smallest width across over lambda F / D; largest over the geometric beam's radius at the outermost station."""
STATION_STEP = 0.5
"""Distance of stations, and their width along the beam, over the Gaussian's sigma along it."""
REACH, REACH_UNCERTAINTY = 4.5, 1.5
"""How far from the focus the force goes, over the same: nobody has said where specimen or absorption end it, which
counts at the lowest rates alone."""
LOSS_UNCERTAINTY = 0.5, 0.1
"""Relative, of the attenuation, where it is not declared and where it is."""
FADING = 0.5
"""Over the same, across which the force fades out there."""
FARTHEST = REACH + REACH_UNCERTAINTY + FADING
"""Over the same, to which the intensity is looked at."""
SIGMAS_A_LENGTH = 7.1 / 2.3548
"""Sigma along the axis of a focused bowl's intensity, over wavelength times the f-number squared."""
REGION, POINTS = 3.5, 100
"""Distance from the axis to which the intensity is matched, over the largest width, and how many places it takes."""
LONGEST_M = 0.1
"""Half of the longest focus that a scan may have."""
RANK = 1e-6
"""Singular values over the largest below which shapes across, or along, are taken for the same."""


@dataclass(frozen=True, slots=True)
class PushForce:
    """Round body force along z, 1 at the focus, as a sum of Gaussians with the sigmas ``across_m`` and ``along_m``.

    ``centre_m`` (station,) from the focus; ``share`` (station, width); ``unsure``: what is not known of the shape, each
    by its name with what one standard uncertainty of it adds to ``share``.
    """

    across_m: tuple[float, ...]
    along_m: float
    centre_m: tuple[float, ...] = (0.0,)
    share: tuple[tuple[float, ...], ...] = ((1.0,),)
    unsure: tuple[tuple[str, tuple[tuple[float, ...], ...]], ...] = ()

    def scaled(self, across: float, along: float) -> PushForce:
        """Return the force that is so many times as wide and as long."""
        wider, farther = (
            tuple(each * by for each in of) for of, by in ((self.across_m, across), (self.centre_m, along))
        )
        return replace(self, across_m=wider, along_m=self.along_m * along, centre_m=farther)

    def changed(self, by: Mapping[str, float]) -> PushForce:
        """Return the force whose ``unsure`` properties are off by so many standard uncertainties."""
        share = np.array(self.share)
        for name, each in self.unsure:
            share = share + by.get(name, 0.0) * np.array(each)
        return replace(self, share=_rows(share))

    def at(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return the force over that at the focus, (axial, lateral)."""
        along = np.exp(-0.5 * ((axial_m[:, None] - np.array(self.centre_m)) / self.along_m) ** 2)
        across = np.exp(-0.5 * (lateral_m / np.array(self.across_m)[:, None]) ** 2)
        return np.asarray(along @ np.array(self.share) @ across)


@lru_cache(maxsize=16)
def aperture_force(
    diameter_m: float,
    focal_length_m: float,
    frequency_hz: float,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float | None = None,
) -> PushForce:
    """Return the force of a focused bowl driven at ``frequency_hz``, to ``REACH`` sigmas along the axis.

    The attenuation is that of soft tissue where it is None. Raises ``ValueError`` for a bowl wider than its sphere.
    """
    if diameter_m >= 2 * focal_length_m:
        raise ValueError(f"a bowl {diameter_m:g} m across cannot focus at {focal_length_m:g} m")
    declared = attenuation_db_per_cm_mhz is not None
    loss_db = TISSUE_DB_PER_CM_MHZ if attenuation_db_per_cm_mhz is None else attenuation_db_per_cm_mhz
    loss_np_per_m = 100 * NEPER_PER_DB * loss_db * frequency_hz * 1e-6
    wave_number = 2 * math.pi * frequency_hz / sound_speed_m_per_s - 1j * loss_np_per_m
    spot_m, f_number = sound_speed_m_per_s / frequency_hz * focal_length_m / diameter_m, focal_length_m / diameter_m
    # at most half of the way to the bowl
    sigma_m = min(SIGMAS_A_LENGTH * spot_m * f_number, focal_length_m / 2 / FARTHEST)

    def intensity(lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        return np.abs(bowl_pressure(diameter_m, focal_length_m, wave_number, lateral_m, axial_m)) ** 2

    return _force_of(intensity, spot_m, f_number, sigma_m, LOSS_UNCERTAINTY[declared] * loss_np_per_m)


@lru_cache(maxsize=16)
def scanned_force(
    intensity: Intensity, frequency_hz: float, attenuation_db_per_cm_mhz: float | None = None
) -> PushForce:
    """Return the force of a beam whose round ``intensity`` was scanned, in any unit, over places off axis and focus.

    The attenuation goes on from the focus both ways; where it is None the scan is taken for what it is in the
    specimen, to half of soft tissue's. Raises ``ValueError`` where the intensity does not fall to a half around the
    focus.
    """
    declared = attenuation_db_per_cm_mhz is not None
    np_per_m = 100 * NEPER_PER_DB * frequency_hz * 1e-6
    loss_np_per_m = np_per_m * (attenuation_db_per_cm_mhz or 0.0)
    focus, away_m = np.zeros(1), np.concatenate([np.zeros(1), np.geomspace(1e-5, LONGEST_M, 2000)])
    across_m = _half_way_m(away_m, lambda at_m: intensity(at_m, focus)[0])
    before_m = _half_way_m(away_m, lambda at_m: intensity(focus, -at_m)[:, 0])
    behind_m = _half_way_m(away_m, lambda at_m: intensity(focus, at_m)[:, 0])
    # of the even bowl whose beam is as wide and as long at half of the intensity: FWHM 1.03 lambda F / D across
    spot_m, sigma_m = 2 * across_m / 1.03, (before_m + behind_m) / 2.3548
    f_number = sigma_m / (SIGMAS_A_LENGTH * spot_m)

    def attenuated(lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        return np.asarray(intensity(lateral_m, axial_m) * np.exp(-2 * loss_np_per_m * axial_m)[:, None])

    unsure = LOSS_UNCERTAINTY[1] * loss_np_per_m if declared else LOSS_UNCERTAINTY[0] * TISSUE_DB_PER_CM_MHZ * np_per_m
    return _force_of(attenuated, spot_m, f_number, sigma_m, unsure)


def _half_way_m(away_m: FloatArray, along: Callable[[FloatArray], FloatArray]) -> float:
    """Return the first of the places at which ``along`` has fallen to half of that at the first of all.

    From near to far: what lies beyond is not asked for, where a bowl's field takes the longest.
    """
    most = along(away_m[:1])[0]
    for part_m in np.array_split(away_m, 20):
        below = np.flatnonzero(along(part_m) < most / 2)
        if below.size:
            return float(part_m[below[0]])
    raise ValueError(f"the intensity does not fall to half of the focus' within {LONGEST_M * 1e3:g} mm of it")


def _force_of(
    intensity: Intensity, spot_m: float, f_number: float, sigma_m: float, loss_uncertainty_np_per_m: float
) -> PushForce:
    """Return the force of a focused beam, ``spot_m`` (lambda F / D) wide and ``sigma_m`` long."""
    from scipy.special import ndtr

    reach_m = FARTHEST * sigma_m
    rim_m = max(reach_m / (2 * f_number), 3 * spot_m)
    across_m = np.geomspace(NARROWEST * spot_m, WIDEST * rim_m, WIDTHS)
    # closer to one another towards the axis, where the beam is narrow
    lateral_m = REGION * WIDEST * rim_m * ((np.arange(POINTS) + 0.5) / POINTS) ** 2
    axial_m = np.linspace(-reach_m, reach_m, 2 * math.ceil(5 * FARTHEST) + 1)
    # nothing worth the time beyond the geometric beam and its edge
    lit_m = lateral_m[lateral_m < 1.3 * rim_m]
    seen = intensity(np.concatenate([np.zeros(1), lit_m]), axial_m)
    value = np.zeros((axial_m.size, lateral_m.size))
    value[:, : lit_m.size] = seen[:, 1:] / seen[axial_m.size // 2, 0]
    step_m = STATION_STEP * sigma_m
    count = math.ceil(reach_m / step_m)
    centre_m = np.asarray(step_m * np.arange(-count, count + 1), np.float64)
    share = _shares(value, lateral_m, axial_m, across_m, centre_m)

    def ended(reach: float) -> FloatArray:
        return np.asarray(ndtr((reach - np.abs(centre_m) / sigma_m) / FADING)[:, None] * share)

    longer = (ended(REACH + REACH_UNCERTAINTY) - ended(REACH - REACH_UNCERTAINTY)) / 2
    # exp(-2 alpha z) over the focus' value, to first order in what alpha is off by
    lossier = -2 * loss_uncertainty_np_per_m * centre_m[:, None] * ended(REACH)
    unsure = ("reach", _rows(longer)), ("loss", _rows(lossier))
    return PushForce(tuple(across_m.tolist()), step_m, tuple(centre_m.tolist()), _rows(ended(REACH)), unsure)


def _shares(
    value: FloatArray, lateral_m: FloatArray, axial_m: FloatArray, across_m: FloatArray, centre_m: FloatArray
) -> FloatArray:
    """Return the shares (station, width) of the Gaussians nearest to ``value`` (axial, lateral) over the volume.

    Beyond the ends of ``axial_m`` nothing is wanted: else Gaussians there would stand for whatever they like.
    """
    step_m, spacing_m = centre_m[1] - centre_m[0], axial_m[1] - axial_m[0]
    beyond = math.ceil(3 * step_m / spacing_m)
    middle = len(axial_m) // 2
    farther_m = spacing_m * np.arange(-beyond - middle, beyond + middle + 1)
    # a ring's area, its places being the denser the nearer to the axis
    area = lateral_m**0.75
    along = np.exp(-0.5 * ((farther_m[:, None] - centre_m) / step_m) ** 2)
    across = area[:, None] * np.exp(-0.5 * (lateral_m[:, None] / across_m) ** 2)
    wanted = np.pad(value, ((beyond, beyond), (0, 0))) * area
    return np.asarray(np.linalg.pinv(along, rcond=RANK) @ wanted @ np.linalg.pinv(across, rcond=RANK).T)


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def bowl_pressure(
    diameter_m: float, focal_length_m: float, wave_number_per_m: complex, lateral_m: FloatArray, axial_m: FloatArray
) -> ComplexArray:
    """Return the Rayleigh integral over a bowl, but for a factor, at places off axis and focus: (axial, lateral).

    A wave's phase turns by k times the difference of its ways over the bowl; both rules resolve that with points to
    spare: 1e-6 of the focus' pressure.
    """
    half_angle = math.asin(diameter_m / 2 / focal_length_m)
    ways_rad = abs(wave_number_per_m) * np.abs(lateral_m).max() * math.sin(half_angle)
    depths_rad = abs(wave_number_per_m) * np.abs(axial_m).max() * (1 - math.cos(half_angle))
    node, weight = np.polynomial.legendre.leggauss(math.ceil((ways_rad + depths_rad) / 2) + 16)
    angle = half_angle * (node + 1) / 2
    turns = math.ceil((ways_rad + 6 * ways_rad ** (1 / 3)) / 2) + 10
    # the trapezoidal rule over a period converges faster than any power; half of it, by symmetry
    turn = (np.arange(turns) + 0.5) * np.pi / turns
    ring_m, height_m = focal_length_m * np.sin(angle), focal_length_m * np.cos(angle)
    found = np.zeros((axial_m.size, lateral_m.size), np.complex128)
    for ring, height, share in zip(ring_m, height_m, weight * ring_m, strict=True):
        beside = ring**2 + lateral_m**2 - 2 * ring * np.outer(np.cos(turn), lateral_m)
        distance_m = np.sqrt(beside[None] + ((height + axial_m) ** 2)[:, None, None])
        found += share * (np.exp(-1j * wave_number_per_m * distance_m) / distance_m).mean(axis=1)
    return found
