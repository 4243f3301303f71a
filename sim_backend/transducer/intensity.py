"""Intensity of the push around the focus as a sum of Gaussians, so that closed forms for a Gaussian still apply.

    I(r, z) / I(0, 0) = sum_j sum_i C_ji exp(-r^2 / 2 a_i^2 - (z - z_j)^2 / 2 b^2)

    r, z        distance from the axis and from the focal plane, m
    z_j, b      stations along the beam and their common width, m
    a_i         widths across the beam, m
    C_ji        amplitudes, by least squares weighted with area

Errors of the sum and of the displacement that it causes: docs/explanation/transducer.md, section 3.
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


WIDTH_COUNT = 10
"""Number of widths across the beam."""
MIN_WIDTH, MAX_WIDTH = 0.2, 0.55
"""Smallest width over lambda F / D; largest width over the radius of the beam at the outermost z."""
STATION_STEP = 0.7
"""Distance of stations, and their width along the beam, over the sigma of the axial Gaussian."""
REACH = 4.5
"""Distance along the beam that the force covers, over the same sigma."""
FADE = 0.85
"""Length over which the force fades out at both ends, over the same sigma."""
RIDGE = 1e-6
"""Regularisation, relative to the mean eigenvalue of the normal equations; it keeps the amplitudes of order 1."""
_AXIAL_POINTS, _LATERAL_POINTS = 240, 400


@dataclass(frozen=True, slots=True)
class GaussianSum:
    """A round shape, 1 at the focus, as a sum of Gaussians."""

    lateral_width_m: tuple[float, ...]
    """a_i"""
    axial_width_m: float
    """b"""
    centre_m: tuple[float, ...]
    """z_j"""
    amplitude: tuple[tuple[float, ...], ...]
    """C_ji, one row a centre, one column a width"""

    def at(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return the sum of Gaussians at points (point,) at these distances from the axis and from the focal plane."""
        across = np.exp(-0.5 * np.square(lateral_m[:, None] / np.array(self.lateral_width_m)))
        along = np.exp(-0.5 * np.square((axial_m[:, None] - np.array(self.centre_m)) / self.axial_width_m))
        # p: point, j: position along the axis, i: width across.
        return np.asarray(np.einsum("pj,ji,pi->p", along, np.array(self.amplitude), across))


def push_intensity(settings: SimulationSettings) -> GaussianSum:
    """Return the shape of the push's intensity as a sum of Gaussians.

    It is computed for the aperture at the transducer's resonance, or measured by a scan.
    """
    specimen, scan = settings.specimen or Specimen(), None
    if settings.beams.field == "measured" and settings.beams.excitation_scan is not None:
        # Imported here, so that settings without a scan do not load it.
        from sim_backend.transducer.hydrophone import read_scan

        scan = read_scan(settings.beams.excitation_scan)
    return _fitted_intensity(
        settings.beams.transducer,
        specimen.resonance_hz,
        settings.sound_speed_m_per_s,
        specimen.attenuation_db_per_cm_mhz,
        scan,
    )


@lru_cache(maxsize=8)
def _fitted_intensity(
    transducer: Transducer,
    frequency_hz: float,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float,
    scan: Scan | None,
) -> GaussianSum:
    """Return a sum of Gaussians fitted to the intensity around the focus, relative to that at the focus.

    The intensity is that of a bowl, in a medium with the given attenuation, or of the measured ``scan``.
    """
    # Imported here, so that a Gaussian push does not load them.
    from sim_backend.transducer.hydrophone import round_field
    from sim_backend.transducer.radiation import bowl_pressure, wave_number

    k = wave_number(frequency_hz, sound_speed_m_per_s, attenuation_db_per_cm_mhz)
    sigma_m, reach_m, lateral_reach_m = push_extent(transducer, frequency_hz, sound_speed_m_per_s)
    axial_m = np.linspace(-reach_m, reach_m, _AXIAL_POINTS + 1)
    lateral_m = lateral_reach_m * (np.arange(_LATERAL_POINTS) + 0.5) / _LATERAL_POINTS
    # The intensity at the focus, on the axis, is the unit; the fit omits the axis.
    with_axis_m = np.concatenate([np.zeros(1), lateral_m])
    if scan is None:
        pressure = bowl_pressure(transducer, k, with_axis_m, axial_m)
    else:
        pressure = round_field(scan, k.real, with_axis_m, axial_m)
    intensity = np.square(np.abs(pressure))
    intensity /= intensity[_AXIAL_POINTS // 2, 0]
    narrowest_m = MIN_WIDTH * diffraction_width_m(transducer, frequency_hz, sound_speed_m_per_s)
    widths_m = np.geomspace(narrowest_m, MAX_WIDTH * (transducer.half_aperture * reach_m), WIDTH_COUNT)
    return gaussian_sum(lateral_m, axial_m, intensity[:, 1:], widths_m, STATION_STEP * sigma_m, FADE * sigma_m)


def diffraction_width_m(transducer: Transducer, frequency_hz: float, sound_speed_m_per_s: float) -> float:
    """Return lambda F / D."""
    return sound_speed_m_per_s / frequency_hz * transducer.focal_length_m / transducer.diameter_m


def push_extent(transducer: Transducer, frequency_hz: float, sound_speed_m_per_s: float) -> tuple[float, float, float]:
    """Return the approximate axial sigma of the intensity, and the reach of the force along and across the beam, m.

    Beyond the reach the force is neglected.
    """
    # Intensity FWHM along the axis of a focused piston: 7.1 wavelengths times the f-number squared; 2.3548 sigma.
    f_number = transducer.focal_length_m / transducer.diameter_m
    sigma_m = 7.1 * sound_speed_m_per_s / frequency_hz * f_number**2 / 2.3548
    # Limited to half the focal length, since a weakly focused beam is so long that it reaches the bowl.
    reach_m = min(REACH * sigma_m, 0.5 * transducer.focal_length_m)
    width_m = diffraction_width_m(transducer, frequency_hz, sound_speed_m_per_s)
    # Radius of the cone from the rim to the focus at the outermost depth (``half_aperture`` is radius over distance),
    # with a fifth of it and four diffraction widths as margin. Limited as well for a weakly focused beam.
    lateral_reach_m = 1.2 * transducer.half_aperture * reach_m + 4 * width_m
    return sigma_m, reach_m, min(lateral_reach_m, 0.6 * transducer.focal_length_m)


def gaussian_sum(
    lateral_m: FloatArray, axial_m: FloatArray, value: FloatArray, widths_m: FloatArray, step_m: float, fade_m: float
) -> GaussianSum:
    """Return the sum of Gaussians closest to ``value`` (axial, lateral), faded out over ``fade_m`` at both ends.

    ``widths_m`` (width,) are sigmas across the beam; along it Gaussians of sigma ``step_m`` are ``step_m`` apart. The
    fit minimises the squared error integrated over the volume. ``lateral_m`` is evenly spaced, without 0.
    """
    reach_m = float(np.abs(axial_m).max())
    # Smooth step from the ends.
    position = np.clip((reach_m - np.abs(axial_m)) / fade_m, 0.0, 1.0)
    faded = value * (position**2 * (3 - 2 * position))[:, None]
    count = int(np.ceil(reach_m / step_m))
    centre_m = np.arange(-count, count + 1) * step_m
    # Zeros beyond the ends, over the width of the outermost stations, which would otherwise be undetermined.
    spacing_m = float(axial_m[1] - axial_m[0])
    outside_m = spacing_m * np.arange(1, math.ceil(4 * step_m / spacing_m) + 1)
    axial_m = np.concatenate([axial_m[0] - outside_m[::-1], axial_m, axial_m[-1] + outside_m])
    faded = np.pad(faded, ((len(outside_m), len(outside_m)), (0, 0)))
    # The square root of the area weights the rows of the least-squares problem.
    root_area = np.sqrt(lateral_m)[:, None]
    across = root_area * np.exp(-0.5 * np.square(lateral_m[:, None] / widths_m))
    along = np.exp(-0.5 * np.square((axial_m[:, None] - centre_m) / step_m))
    # Normal equations of a separable fit: one small matrix for each direction.
    amplitude = np.linalg.solve(_regularised(along.T @ along), along.T @ (faded * root_area.T) @ across)
    amplitude = np.linalg.solve(_regularised(across.T @ across), amplitude.T).T
    rows = tuple(tuple(row) for row in amplitude.tolist())
    return GaussianSum(
        lateral_width_m=tuple(widths_m.tolist()),
        axial_width_m=step_m,
        centre_m=tuple(centre_m.tolist()),
        amplitude=rows,
    )


def _regularised(normal: FloatArray) -> FloatArray:
    return np.asarray(normal + RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal)))
