"""Intensity of the push around the focus as a sum of Gaussians, so that all that follows from one stays closed.

    I(r, z) / I(0, 0) = sum_j sum_i C_ji exp(-r^2 / 2 a_i^2 - (z - z_j)^2 / 2 b^2)

Stations z_j along the beam, widths a_i across it, least squares in between, weighted by area. How well the sum and the
displacement that it causes match: docs/explanation/transducer.md, section 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.settings import SimulationSettings, Specimen, Transducer

if TYPE_CHECKING:
    from sim_backend.transducer.hydrophone import Scan


WIDTHS = 10
"""Widths across."""
NARROWEST, WIDEST = 0.2, 0.55
"""Smallest width across over the diffraction width lambda F / D; largest over the beam's radius at the outermost z."""
STATION_STEP = 0.7
"""Distance of stations, and their width along the beam, over the axial Gaussian's sigma."""
REACH = 4.5
"""How far along the beam the force is followed, over the same."""
EDGE = 0.85
"""Over the same, across which it is faded out there."""
RIDGE = 1e-6
"""Of the mean eigenvalue of the normal equations: keeps the shares of order 1."""
_AXIAL_POINTS, _LATERAL_POINTS = 240, 400


@dataclass(frozen=True, slots=True)
class GaussianSum:
    """A round shape around the focus, 1 at it, as a sum of Gaussians."""

    lateral_width_m: tuple[float, ...]
    """a_i"""
    axial_width_m: float
    """b"""
    centre_m: tuple[float, ...]
    """z_j"""
    amplitude: tuple[tuple[float, ...], ...]
    """C, one row a centre, one column a width"""

    def at(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return the sum at places (place,) off the axis and the focal plane: (place,)."""
        across = np.exp(-0.5 * np.square(lateral_m[:, None] / np.array(self.lateral_width_m)))
        along = np.exp(-0.5 * np.square((axial_m[:, None] - np.array(self.centre_m)) / self.axial_width_m))
        return np.asarray(np.einsum("pj,ji,pi->p", along, np.array(self.amplitude), across))


def push_intensity(settings: SimulationSettings) -> GaussianSum:
    """Return the shape of the push's intensity: that of the aperture at the specimen's resonance, or as measured."""
    specimen, scan = settings.specimen or Specimen(), None
    if settings.beams.field == "measured" and settings.beams.excitation_scan is not None:
        # here, so that what has no scan loads none of it
        from sim_backend.transducer.hydrophone import read_scan

        scan = read_scan(settings.beams.excitation_scan)
    return _kept(
        settings.beams.transducer,
        specimen.resonance_hz,
        settings.sound_speed_m_per_s,
        specimen.attenuation_db_per_cm_mhz,
        scan,
    )


@lru_cache(maxsize=8)
def _kept(
    transducer: Transducer,
    frequency_hz: float,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float,
    scan: Scan | None,
) -> GaussianSum:
    # here, so that a Gaussian push, which is the sum of one, loads none of it
    from sim_backend.transducer.hydrophone import round_field
    from sim_backend.transducer.radiation import bowl_pressure, wave_number

    k = wave_number(frequency_hz, sound_speed_m_per_s, attenuation_db_per_cm_mhz)
    sigma_m, reach_m, across_m = push_extent(transducer, frequency_hz, sound_speed_m_per_s)
    axial_m = np.linspace(-reach_m, reach_m, _AXIAL_POINTS + 1)
    lateral_m = across_m * (np.arange(_LATERAL_POINTS) + 0.5) / _LATERAL_POINTS
    places_m = np.concatenate([np.zeros(1), lateral_m])
    if scan is None:
        pressure = bowl_pressure(transducer, k, places_m, axial_m)
    else:
        pressure = round_field(scan, k.real, places_m, axial_m)
    intensity = np.square(np.abs(pressure))
    intensity /= intensity[_AXIAL_POINTS // 2, 0]
    wide = transducer.half_aperture * reach_m
    widths_m = np.geomspace(
        NARROWEST * diffraction_width_m(transducer, frequency_hz, sound_speed_m_per_s), WIDEST * wide, WIDTHS
    )
    return gaussian_sum(lateral_m, axial_m, intensity[:, 1:], widths_m, STATION_STEP * sigma_m, EDGE * sigma_m)


def diffraction_width_m(transducer: Transducer, frequency_hz: float, sound_speed_m_per_s: float) -> float:
    """Return lambda F / D."""
    return sound_speed_m_per_s / frequency_hz * transducer.focal_length_m / transducer.diameter_m


def push_extent(transducer: Transducer, frequency_hz: float, sound_speed_m_per_s: float) -> tuple[float, float, float]:
    """Return about the axial sigma of the intensity, and how far the force is followed along and across the beam."""
    # Intensity FWHM along the axis of a focused piston: 7.1 wavelengths times the f-number squared.
    f_number = transducer.focal_length_m / transducer.diameter_m
    sigma_m = 7.1 * sound_speed_m_per_s / frequency_hz * f_number**2 / 2.3548
    reach_m = min(REACH * sigma_m, 0.5 * transducer.focal_length_m)
    across_m = 1.2 * transducer.half_aperture * reach_m + 4 * diffraction_width_m(
        transducer, frequency_hz, sound_speed_m_per_s
    )
    return sigma_m, reach_m, min(across_m, 0.6 * transducer.focal_length_m)


def gaussian_sum(
    lateral_m: FloatArray, axial_m: FloatArray, value: FloatArray, widths_m: FloatArray, step_m: float, edge_m: float
) -> GaussianSum:
    """Return the sum of Gaussians nearest to ``value`` (axial, lateral), faded out over ``edge_m`` at both ends.

    ``widths_m`` (width,) across; ``step_m`` both the distance of the stations and their width. What is fitted is the
    square of the error, integrated over the volume. ``lateral_m`` evenly spaced, without 0.
    """
    reach_m = float(np.abs(axial_m).max())
    inside = np.clip((reach_m - np.abs(axial_m)) / edge_m, 0.0, 1.0)
    faded = value * (inside**2 * (3 - 2 * inside))[:, None]
    count = int(np.ceil(reach_m / step_m))
    centre_m = np.arange(-count, count + 1) * step_m
    # Beyond the ends nothing, as far as the outermost stations reach: else they would stand for whatever they like.
    spacing_m = float(axial_m[1] - axial_m[0])
    beyond_m = spacing_m * np.arange(1, math.ceil(4 * step_m / spacing_m) + 1)
    axial_m = np.concatenate([axial_m[0] - beyond_m[::-1], axial_m, axial_m[-1] + beyond_m])
    faded = np.pad(faded, ((len(beyond_m), len(beyond_m)), (0, 0)))
    area = np.sqrt(lateral_m)[:, None]
    across = area * np.exp(-0.5 * np.square(lateral_m[:, None] / widths_m))
    along = np.exp(-0.5 * np.square((axial_m[:, None] - centre_m) / step_m))
    # Normal equations of a separable fit: one small matrix for each direction.
    share = np.linalg.solve(_ridged(along.T @ along), along.T @ (faded * area.T) @ across)
    share = np.linalg.solve(_ridged(across.T @ across), share.T).T
    rows = tuple(tuple(row) for row in share.tolist())
    return GaussianSum(tuple(widths_m.tolist()), step_m, tuple(centre_m.tolist()), rows)


def _ridged(normal: FloatArray) -> FloatArray:
    return np.asarray(normal + RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal)))
