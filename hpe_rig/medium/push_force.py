"""Body force of a push around its focus: a Gaussian, or the intensity of a focused aperture as a sum of Gaussians.

    f(r, z) / f0 = sum_j sum_i C_ji exp(-r^2 / 2 a_i^2 - (z - z_j)^2 / 2 b^2)

a_i are widths across, common to all stations z_j along the axis; b is the length of every Gaussian, C_ji its weight.

The aperture is a spherical bowl with uniform surface velocity. Its pressure is the Rayleigh integral: exp(-j k d) / d
integrated over the bowl, d the distance. The force is proportional to the squared pressure. Derivation:
docs/explanation/moduli.md, section "The force of an aperture".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray

Intensity = Callable[[FloatArray, FloatArray], FloatArray]
"""Intensity (axial, lateral), in any unit, at distances from the axis (lateral,) and from the focus (axial,), m."""
Weights = tuple[tuple[float, ...], ...]
"""Weights of the Gaussians, (station, width)."""

NEPER_PER_DB = math.log(10) / 20
TISSUE_DB_PER_CM_MHZ = 0.5
"""Attenuation of soft tissue and phantoms, used if none is declared."""
LOSS_UNCERTAINTY_DECLARED, LOSS_UNCERTAINTY_DEFAULT = 0.1, 0.5
"""Relative uncertainty of the attenuation."""
FWHM_PER_SIGMA = 2.3548

WIDTHS = 14
"""Number of widths across."""
NARROWEST, WIDEST = 0.22, 0.6
"""Smallest width over lambda F / D; largest width over the radius of the geometric beam at the outermost station."""
STATION_STEP = 0.5
"""Distance of stations, and length b of their Gaussians, over the sigma of the beam along its axis."""
REACH, REACH_UNCERTAINTY = 4.5, 1.5
"""Distance from the focus to the end of the force, over the same sigma.

Specimen and absorption end it at an unknown distance, which matters at the lowest frequencies only."""
FADE_LENGTH = 0.5
"""Length over which the force fades out there, over the same sigma."""
MAX_REACH = REACH + REACH_UNCERTAINTY + FADE_LENGTH
"""Distance from the focus to the end of the fitted region, over the same sigma."""
SIGMA_PER_FOCAL_LENGTH = 7.1 / FWHM_PER_SIGMA
"""Sigma along the axis of a focused bowl's intensity, over lambda (F / D)^2."""
FIT_RADIUS, FIT_POINTS = 3.5, 100
"""Radius to which the intensity is fitted, over the largest width, and the number of points on it."""
MAX_HALF_FOCUS_M = 0.1
"""Largest half width of a scanned focus at half its intensity."""
RANK_TOLERANCE = 1e-6
"""Relative singular value below which the Gaussians across, or along, count as linearly dependent."""


@dataclass(frozen=True, slots=True)
class PushForce:
    """Round body force along z, 1 at the focus, as a sum of Gaussians with the sigmas ``across_m`` and ``along_m``.

    ``centre_m`` (station,) counts from the focus; ``weights`` is (station, width). ``weight_changes`` names the
    uncertain properties of the shape, each with the change of ``weights`` by one standard uncertainty.
    """

    across_m: tuple[float, ...]
    along_m: float
    centre_m: tuple[float, ...] = (0.0,)
    weights: Weights = ((1.0,),)
    weight_changes: tuple[tuple[str, Weights], ...] = ()

    @classmethod
    def gaussian(cls, width_m: tuple[float, float, float]) -> PushForce:
        """Return a Gaussian force of sigmas ``width_m`` (x, y, z); it is round, so x counts."""
        return cls(width_m[:1], width_m[2])

    @property
    def is_gaussian(self) -> bool:
        """Whether the force is one Gaussian at the focus."""
        return len(self.centre_m) == 1

    def scaled(self, width_factor: float, length_factor: float) -> PushForce:
        """Return the force scaled across the beam by ``width_factor`` and along it by ``length_factor``."""
        return replace(
            self,
            across_m=tuple(width * width_factor for width in self.across_m),
            along_m=self.along_m * length_factor,
            centre_m=tuple(centre * length_factor for centre in self.centre_m),
        )

    def changed(self, deviations: Mapping[str, float]) -> PushForce:
        """Return the force with its uncertain properties changed by ``deviations`` (name: standard uncertainties)."""
        weights = np.array(self.weights)
        for name, change in self.weight_changes:
            weights = weights + deviations.get(name, 0.0) * np.array(change)
        return replace(self, weights=_rows(weights))


def burst_spectrum(frequency: FloatArray, burst_length: float) -> ComplexArray:
    """Return the Fourier transform (frequency,) of a rectangular burst of area 1 that begins at time zero.

    ``frequency`` in Hz and ``burst_length`` in s, or in units of the burst rate and of its period.
    """
    return np.asarray(np.sinc(frequency * burst_length) * np.exp(-1j * np.pi * frequency * burst_length))


@lru_cache(maxsize=16)
def aperture_force(
    diameter_m: float,
    focal_length_m: float,
    frequency_hz: float,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float | None = None,
) -> PushForce:
    """Return the force of a focused bowl driven at ``frequency_hz``, as a sum of Gaussians.

    It is proportional to the intensity at each point. The default attenuation is that of soft tissue. Raises
    ``ValueError`` for a bowl wider than its sphere.
    """
    if diameter_m >= 2 * focal_length_m:
        raise ValueError(f"a bowl {diameter_m:g} m across cannot focus at {focal_length_m:g} m")
    loss_db, loss_uncertainty = TISSUE_DB_PER_CM_MHZ, LOSS_UNCERTAINTY_DEFAULT
    if attenuation_db_per_cm_mhz is not None:
        loss_db, loss_uncertainty = attenuation_db_per_cm_mhz, LOSS_UNCERTAINTY_DECLARED
    loss_np_per_m = 100 * NEPER_PER_DB * loss_db * frequency_hz * 1e-6
    wave_number = 2 * math.pi * frequency_hz / sound_speed_m_per_s - 1j * loss_np_per_m
    f_number = focal_length_m / diameter_m
    spot_m = sound_speed_m_per_s / frequency_hz * focal_length_m / diameter_m
    # The fitted region ends ``MAX_REACH`` axial sigmas from the focus, at most half-way to the bowl.
    axial_sigma_m = min(SIGMA_PER_FOCAL_LENGTH * spot_m * f_number, focal_length_m / 2 / MAX_REACH)

    def intensity(lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        return np.abs(bowl_pressure(diameter_m, focal_length_m, wave_number, lateral_m, axial_m)) ** 2

    return _fitted_force(intensity, spot_m, f_number, axial_sigma_m, loss_uncertainty * loss_np_per_m)


@lru_cache(maxsize=16)
def scanned_force(
    intensity: Intensity, frequency_hz: float, attenuation_db_per_cm_mhz: float | None = None
) -> PushForce:
    """Return the force of a beam with the scanned round ``intensity``, as a sum of Gaussians.

    The scan is attenuated along the axis in both directions from the focus. Without a declared attenuation the scan
    counts as measured in the specimen, with an uncertainty of half of soft tissue's attenuation. Raises ``ValueError``
    if the intensity does not fall to a half around the focus.
    """
    np_per_m = 100 * NEPER_PER_DB * frequency_hz * 1e-6
    loss_np_per_m = np_per_m * (attenuation_db_per_cm_mhz or 0.0)
    loss_uncertainty = LOSS_UNCERTAINTY_DECLARED * loss_np_per_m
    if attenuation_db_per_cm_mhz is None:
        loss_uncertainty = LOSS_UNCERTAINTY_DEFAULT * TISSUE_DB_PER_CM_MHZ * np_per_m
    focus, distance_m = np.zeros(1), np.concatenate([np.zeros(1), np.geomspace(1e-5, MAX_HALF_FOCUS_M, 2000)])
    across_m = _half_intensity_m(distance_m, lambda at_m: intensity(at_m, focus)[0])
    before_m = _half_intensity_m(distance_m, lambda at_m: intensity(focus, -at_m)[:, 0])
    behind_m = _half_intensity_m(distance_m, lambda at_m: intensity(focus, at_m)[:, 0])
    # The uniform bowl with the same half-intensity width (1.03 lambda F / D) and length.
    spot_m, sigma_m = 2 * across_m / 1.03, (before_m + behind_m) / FWHM_PER_SIGMA
    f_number = sigma_m / (SIGMA_PER_FOCAL_LENGTH * spot_m)

    def attenuated(lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        return np.asarray(intensity(lateral_m, axial_m) * np.exp(-2 * loss_np_per_m * axial_m)[:, None])

    return _fitted_force(attenuated, spot_m, f_number, sigma_m, loss_uncertainty)


def _half_intensity_m(distance_m: FloatArray, profile: Callable[[FloatArray], FloatArray]) -> float:
    """Return the first of the rising ``distance_m`` with an intensity below half of that at the first distance.

    ``profile`` gives the intensity at distances. It is evaluated from near to far in blocks and stops early: far points
    of a bowl's field are the slowest.
    """
    peak = profile(distance_m[:1])[0]
    for block_m in np.array_split(distance_m, 20):
        below = np.flatnonzero(profile(block_m) < peak / 2)
        if below.size:
            return float(block_m[below[0]])
    raise ValueError(f"the intensity does not fall to half of the focus' within {MAX_HALF_FOCUS_M * 1e3:g} mm of it")


def _fitted_force(
    intensity: Intensity, spot_m: float, f_number: float, sigma_m: float, loss_uncertainty_np_per_m: float
) -> PushForce:
    """Return the force with the shape of ``intensity``, as a sum of Gaussians with several widths along the axis.

    ``spot_m`` is lambda F / D, ``sigma_m`` the sigma of the beam along its axis. The force has two uncertain
    properties: the distance from the focus where specimen and absorption end it, and the attenuation.
    """
    from scipy.special import ndtr

    # Ends of the fitted region along the axis, and radius of the geometric beam there.
    reach_m = MAX_REACH * sigma_m
    rim_m = max(reach_m / (2 * f_number), 3 * spot_m)
    across_m = np.geomspace(NARROWEST * spot_m, WIDEST * rim_m, WIDTHS)
    # Radii that grow as the square of their index: denser towards the axis, where the beam is narrow.
    lateral_m = FIT_RADIUS * WIDEST * rim_m * ((np.arange(FIT_POINTS) + 0.5) / FIT_POINTS) ** 2
    axial_m = np.linspace(-reach_m, reach_m, 2 * math.ceil(5 * MAX_REACH) + 1)
    # Outside the geometric beam and its edge the intensity counts as zero, which saves most of the time.
    inside_m = lateral_m[lateral_m < 1.3 * rim_m]
    # The point on the axis is added to divide by the intensity at the focus, in the middle of ``axial_m``.
    sampled = intensity(np.concatenate([np.zeros(1), inside_m]), axial_m)
    relative = np.zeros((axial_m.size, lateral_m.size))
    relative[:, : inside_m.size] = sampled[:, 1:] / sampled[axial_m.size // 2, 0]
    # Stations along the axis; their distance is also the sigma along the axis of every Gaussian.
    step_m = STATION_STEP * sigma_m
    count = math.ceil(reach_m / step_m)
    centre_m = np.asarray(step_m * np.arange(-count, count + 1), np.float64)
    weights = _fitted_weights(relative, lateral_m, axial_m, across_m, centre_m)

    def ending_at(reach: float) -> FloatArray:
        """Return the weights (station, width) of the force that fades out at ``reach`` sigmas from the focus."""
        return np.asarray(ndtr((reach - np.abs(centre_m) / sigma_m) / FADE_LENGTH)[:, None] * weights)

    # Changes of the weights by one standard uncertainty of the end and of the attenuation alpha. The intensity is
    # attenuated by exp(-2 alpha z) relative to the focus; its change is of first order in the error of alpha.
    change_by_reach = (ending_at(REACH + REACH_UNCERTAINTY) - ending_at(REACH - REACH_UNCERTAINTY)) / 2
    change_by_loss = -2 * loss_uncertainty_np_per_m * centre_m[:, None] * ending_at(REACH)
    weight_changes = ("reach", _rows(change_by_reach)), ("loss", _rows(change_by_loss))
    return PushForce(
        across_m=tuple(across_m.tolist()),
        along_m=step_m,
        centre_m=tuple(centre_m.tolist()),
        weights=_rows(ending_at(REACH)),
        weight_changes=weight_changes,
    )


def _fitted_weights(
    intensity: FloatArray, lateral_m: FloatArray, axial_m: FloatArray, across_m: FloatArray, centre_m: FloatArray
) -> FloatArray:
    """Return the weights (station, width) of the sum of Gaussians closest to ``intensity`` (axial, lateral).

    The squared difference, integrated over the volume, is smallest. A Gaussian is centred on the axis at one of
    ``centre_m`` (station,) and has one of the sigmas ``across_m`` (width,) across; its sigma along the axis is the
    distance of two stations. ``axial_m``: an odd number of points, evenly spaced about the focus at 0. ``lateral_m``:
    radii in proportion to the square of a half-integer index.
    """
    station_step_m, spacing_m = centre_m[1] - centre_m[0], axial_m[1] - axial_m[0]
    # Zeros are appended at both ends of the axis, because Gaussians there would be undetermined.
    padding = math.ceil(3 * station_step_m / spacing_m)
    middle = len(axial_m) // 2
    padded_m = spacing_m * np.arange(-padding - middle, padding + middle + 1)
    # A ring's area is in proportion to radius times ring width. For quadratic spacing the width is in proportion to
    # radius^0.5, hence the area to radius^1.5. Least squares need its square root.
    root_area = lateral_m**0.75
    # Intensity = along @ weights @ across': a separable problem, solved by one pseudoinverse on either side.
    along = np.exp(-0.5 * ((padded_m[:, None] - centre_m) / station_step_m) ** 2)
    across = root_area[:, None] * np.exp(-0.5 * (lateral_m[:, None] / across_m) ** 2)
    target = np.pad(intensity, ((padding, padding), (0, 0))) * root_area
    return np.asarray(
        np.linalg.pinv(along, rcond=RANK_TOLERANCE) @ target @ np.linalg.pinv(across, rcond=RANK_TOLERANCE).T
    )


def _rows(matrix: FloatArray) -> Weights:
    """Return the rows of ``matrix`` as tuples, which are hashable."""
    return tuple(tuple(row) for row in matrix.tolist())


def bowl_pressure(
    diameter_m: float, focal_length_m: float, wave_number_per_m: complex, lateral_m: FloatArray, axial_m: FloatArray
) -> ComplexArray:
    """Return the pressure of a uniformly vibrating bowl up to a factor, (axial, lateral): its Rayleigh integral.

    ``lateral_m`` and ``axial_m`` count from the axis and the focus. The nodes resolve the phase k d over the bowl (d:
    distance from source to point) with a margin: error 1e-6 of the pressure at the focus.
    """
    # Largest phase differences over the bowl, across and along the beam. Gauss-Legendre quadrature over the rings needs
    # half a node per radian, and a margin.
    half_angle = math.asin(diameter_m / 2 / focal_length_m)
    lateral_phase_rad = abs(wave_number_per_m) * np.abs(lateral_m).max() * math.sin(half_angle)
    axial_phase_rad = abs(wave_number_per_m) * np.abs(axial_m).max() * (1 - math.cos(half_angle))
    nodes, weights = np.polynomial.legendre.leggauss(math.ceil((lateral_phase_rad + axial_phase_rad) / 2) + 16)
    angles = half_angle * (nodes + 1) / 2
    # Both halves of a turn contribute equally, by symmetry. n azimuths in one half integrate Bessel orders below 2 n
    # exactly; those of a phase x are negligible above about x + 6 x^(1/3).
    azimuth_count = math.ceil((lateral_phase_rad + 6 * lateral_phase_rad ** (1 / 3)) / 2) + 10
    azimuths = (np.arange(azimuth_count) + 0.5) * np.pi / azimuth_count
    # Sum over rings of the bowl of exp(-j k d) / d, with d the distance from source to point, (axial, source, lateral).
    rings_m, heights_m = focal_length_m * np.sin(angles), focal_length_m * np.cos(angles)
    pressure = np.zeros((axial_m.size, lateral_m.size), np.complex128)
    for ring, height, ring_weight in zip(rings_m, heights_m, weights * rings_m, strict=True):
        squared_radius = ring**2 + lateral_m**2 - 2 * ring * np.outer(np.cos(azimuths), lateral_m)
        distance_m = np.sqrt(squared_radius[None] + ((height + axial_m) ** 2)[:, None, None])
        pressure += ring_weight * (np.exp(-1j * wave_number_per_m * distance_m) / distance_m).mean(axis=1)
    return pressure
