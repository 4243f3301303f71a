"""Displacement around the focus: broader than the force that causes it, and later with distance.

    u(r, t) = sum over modes of shape_i(lateral, axial) * amplitude_i(t)
    U(r, s) = f0 / mu(s) * integral of S(k, r) k² / (k² + rho s² / mu(s)) dk

    k           wave number, 1/m, along a ray in the complex plane
    S(k, r)     spectrum of the force times the wave at point r, summed over directions
    s           complex frequency, 1/s
    mu, rho     complex shear modulus, Pa; density, kg/m³

Medium and force are those of `sim_backend.motion.specimen`. Off the axis the integral over wave numbers has no useful
closed form. The ray keeps clear of the shear pole at every node of the contour in the s plane, also for an elastic
medium. The force is round: a Gaussian of equal lateral widths, or a sum of such Gaussians, with the sum of their
spectra. See docs/explanation/medium.md, section 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from sim_backend.arrays import BoolArray, ComplexArray, FloatArray, Int64Array
from sim_backend.motion.force import ForceScale, force_scale, radiation_force
from sim_backend.motion.inverse_laplace import FIELD_CONTOUR, Contour, Panels, chebyshev_matrix, panels_of
from sim_backend.motion.specimen import (
    StepResponse,
    Triple,
    creeps_for_ever,
    force_volume,
    frequency_response,
    legendre,
    memory_s,
    polar_nodes,
    shear_modulus,
    tabulate_step_response,
    transients,
)
from sim_backend.settings import SimulationSettings, Specimen, Transmitter
from sim_backend.transducer import GaussianSum, push_intensity
from sim_backend.wiring import Bursts

# Angle of the ray: above the contour's 0.35, which keeps the pole behind it, and below pi / 4. Waves grow along the ray
# as exp(|k| r sin(ray)), which costs digits and nodes far from the axis; there both angles are smaller.
_RAY = 0.55
_MAX_GROWTH_EXPONENT = 4.0
# Octaves of |k| up to the highest that matters; the upper ones, with short waves, need more nodes.
_OCTAVES = 21
_NODES_PER_OCTAVE = 12
_NODES_PER_SHORT_WAVE_OCTAVE = 36
_SHORT_WAVE_OCTAVES = 5
# exp(-32) = 1e-14: parts of the spectrum below it are negligible at every point.
_NEGLIGIBLE_EXPONENT = 32.0
# If one of two numbers is 16 times the other, a series in their ratio is exact to 1e-16 after 14 powers.
_DOMINANCE_RATIO, _SERIES_TERMS = 16.0, 14
# Cells of the table of J0 along the ray: length in radians, and nodes in each.
_BESSEL_CELL, _BESSEL_NODES = 0.5, 10
# Chebyshev degrees of the shapes; laterally more if the field extends over many widths of the force.
_LATERAL_DEGREES = 16
_LATERAL_DEGREES_PER_WIDTH = 3.8
_AXIAL_DEGREES = 10
_ASYMMETRIC_AXIAL_DEGREES = 20  # in the depth itself, for a force that differs before and behind the focal plane
# Shear waves have left the force by then: from this time on errors are relative to how far a medium has crept.
_START_OF_CREEP_S = 1e-3

Force = Triple | GaussianSum
"""Shape of the body force: the widths of a Gaussian, or a sum of Gaussians."""


def force_shape(settings: SimulationSettings) -> Force:
    """Return the shape of the push: the Gaussian of the excitation widths, or that of the aperture's intensity."""
    return push_intensity(settings) if settings.beams.field != "gaussian" else settings.beams.excitation_width_m


@dataclass(frozen=True, slots=True)
class FocusField:
    """Step response of the medium in a cylinder or shell around the axis: few shapes and their responses in time."""

    lateral_reach_m: float
    axial_reach_m: float
    response: StepResponse
    """Amplitude of every mode, m per N/m³."""
    shape: FloatArray
    """Chebyshev coefficients of every mode in the squares of both coordinates, (mode, lateral, axial)."""
    lateral_inner_m: float = 0.0
    """Inner radius of the shell."""
    asymmetric: bool = False
    """Whether the field differs before and behind the focal plane; the axial series is then in the depth itself."""

    def shapes(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return the spatial shape of every mode of the motion at points around the focus, (point, mode).

        ``lateral_m``, ``axial_m`` (point,): distance from the axis, and depth. Raises ``ValueError`` outside the
        tabulated region.
        """
        reach, inner = (self.lateral_reach_m, self.axial_reach_m), (self.lateral_inner_m, 0.0)
        outside = lateral_m.size and (lateral_m.max() > reach[0] * 1.0001 or np.abs(axial_m).max() > reach[1] * 1.0001)
        if outside or lateral_m.min(initial=inner[0]) < inner[0] * 0.9999:
            raise ValueError(
                f"a point {lateral_m.max() * 1e3:.3g} mm off the axis and {np.abs(axial_m).max() * 1e3:.3g} mm off the "
                f"focal plane lies outside the tabulated field of {reach[0] * 1e3:.3g} and {reach[1] * 1e3:.3g} mm. "
                "Try: a field that reaches as far as the scatterers."
            )
        # Squared coordinates, mapped from inner edge and reach to -1 and 1; the depth itself for an asymmetric field.
        axes = zip((lateral_m, axial_m), inner, reach, strict=True)
        lateral_position, axial_position = (
            np.clip(2 * (at**2 - low**2) / (high**2 - low**2) - 1, -1.0, 1.0) for at, low, high in axes
        )
        if self.asymmetric:
            axial_position = np.clip(axial_m / self.axial_reach_m, -1.0, 1.0)
        lateral = chebvander(lateral_position, self.shape.shape[1] - 1)
        axial = chebvander(axial_position, self.shape.shape[2] - 1)
        # p: point, m: mode, l and a: lateral and axial Chebyshev degree.
        return np.asarray(np.einsum("pl,mla,pa->pm", lateral, self.shape, axial, optimize=True))


def focus_field(
    specimen: Specimen,
    force: Force,
    lateral_reach_m: float,
    axial_reach_m: float,
    tolerance: float = 1e-5,
    lateral_inner_m: float = 0.0,
) -> FocusField:
    """Return the motion of ``specimen`` around the focus after a step of force, as a few modes: shapes times responses.

    The error is ``tolerance`` of the static displacement at the focus. For a medium that creeps without end the
    tolerance is relative to the displacement so far, or to that after the first millisecond if that is larger. The
    field covers ``lateral_inner_m`` to ``lateral_reach_m`` off the axis. Raises ``ValueError`` for a force of unequal
    lateral widths.
    """
    gaussians = _gaussians(force)
    width_m, _ = _length_scales_m(gaussians)
    lateral_count = max(
        _LATERAL_DEGREES, math.ceil(_LATERAL_DEGREES_PER_WIDTH * (lateral_reach_m - lateral_inner_m) / width_m)
    )
    # Chebyshev points of the squared coordinates, or of the depth itself.
    lateral_m = np.sqrt(lateral_inner_m**2 + (lateral_reach_m**2 - lateral_inner_m**2) * _unit_points(lateral_count))
    asymmetric = any(gaussians.centre_m)
    axial_count = _ASYMMETRIC_AXIAL_DEGREES if asymmetric else _AXIAL_DEGREES
    axial_points = _unit_points(axial_count)
    axial_m = axial_reach_m * (2 * axial_points - 1 if asymmetric else np.sqrt(axial_points))
    spectrum = _Spectrum(gaussians, lateral_m, axial_m)
    panels = panels_of(lambda s: spectrum.transfer(specimen, s), _rotated_contour(spectrum.ray / _RAY))
    # Modes: singular vectors of the matrix of time by point. Few singular values are large.
    degrees, panel_count, points = panels.coefficient.shape
    scale = _error_scale(specimen, panels)[:, None]
    time_modes, size, point_modes = np.linalg.svd((panels.coefficient / scale).reshape(-1, points), full_matrices=False)
    modes = max(1, int(np.count_nonzero(size > 0.1 * tolerance * size[0])))
    responses = Panels((time_modes[:, :modes] * size[:modes]).reshape(degrees, panel_count, modes) * scale)
    # From values at the Chebyshev points of the grid to coefficients, along both axes.
    grid = point_modes[:modes].reshape(modes, lateral_count, axial_count)
    matrices = chebyshev_matrix(lateral_count), chebyshev_matrix(axial_count)
    shape = np.einsum("la,cb,mab->mlc", *matrices, grid, optimize=True)
    # Changes below the tolerance are errors of the quadrature, so a response has ended there.
    response = StepResponse(memory_s(specimen, responses, 0.1 * tolerance), responses)
    return FocusField(
        lateral_reach_m=lateral_reach_m,
        axial_reach_m=axial_reach_m,
        response=response,
        shape=shape,
        lateral_inner_m=lateral_inner_m,
        asymmetric=asymmetric,
    )


def focus_response(specimen: Specimen, force: Force) -> StepResponse:
    """Return the displacement at the focus after a step of force, tabulated over time.

    It is in closed form for a Gaussian force, and to 1e-7 for a sum of Gaussians.
    """
    if isinstance(force, GaussianSum):
        return _sum_response(specimen, force)
    return tabulate_step_response(specimen, force)


@lru_cache(maxsize=8)
def _sum_response(specimen: Specimen, force: GaussianSum) -> StepResponse:
    """Return the displacement at the focus after a step of a force that is a sum of Gaussians, tabulated over time."""
    spectrum = _focus_spectrum(force)
    panels = panels_of(lambda s: spectrum.transfer(specimen, s), _rotated_contour(spectrum.ray / _RAY))
    return StepResponse(memory_s(specimen, panels), panels)


def focus_transfer(specimen: Specimen, force: Force, frequency_hz: FloatArray) -> ComplexArray:
    """Return displacement over body force at the focus, complex (frequency,), for steady vibration."""
    if not isinstance(force, GaussianSum):
        return frequency_response(specimen, force, frequency_hz)
    s = np.asarray(2j * np.pi * np.asarray(frequency_hz), np.complex128)
    return _focus_spectrum(force).transfer(specimen, s)[:, 0]


@lru_cache(maxsize=8)
def _focus_spectrum(force: GaussianSum) -> _Spectrum:
    """Return the spectrum at the focus; cached, since checks need it at every frequency and estimator."""
    return _Spectrum(force, np.zeros(1), np.zeros(1))


def _error_scale(specimen: Specimen, panels: Panels) -> FloatArray:
    """Return the displacement to which errors in each panel of time are relative, (panel,), up to a common factor.

    ``panels``: displacement after a step of force, a Chebyshev series in each interval of time (panel). The scale is
    constant, except for a medium that creeps without end: there it is the displacement so far. Relative to the
    displacement of the last panel, hours later, all motion under a toneburst would be below the tolerance.
    """
    if not creeps_for_ever(specimen):
        return np.ones(panels.coefficient.shape[1])
    # The sum of its coefficients (degree, panel, point) bounds a Chebyshev series; the largest over points so far.
    bound_so_far = np.maximum.accumulate(np.abs(panels.coefficient).sum(axis=0).max(axis=1))
    # Shear waves are still in the force before this time: the scale does not fall below the displacement then.
    smallest = bound_so_far[np.searchsorted(panels.begins_s, _START_OF_CREEP_S) - 1]
    return np.asarray(np.maximum(bound_so_far, smallest) / smallest)


@dataclass(frozen=True, slots=True)
class MediumMotion:
    """Motion of the scatterers by the field of a medium."""

    shape: FloatArray
    """(mode, scatterer)"""
    field: FocusField
    specimen: Specimen
    transmitter: Transmitter
    travel_s: float
    force_scale: ForceScale | None = None

    def amplitudes_m(self, tonebursts: Bursts, time_ps: Int64Array) -> FloatArray:
        """Return the amplitude of every mode at ``time_ps`` (time,) under ``tonebursts``, (time, mode)."""
        return self._transients(self.field.response, tonebursts, time_ps)

    def displacement_m(self, tonebursts: Bursts, time_ps: Int64Array, lateral_m: float) -> FloatArray:
        """Return the displacement in the focal plane, ``lateral_m`` off the axis, at ``time_ps`` (time,), m."""
        shape = self.field.shapes(np.array([abs(lateral_m)]), np.zeros(1))
        # Sum the modes first, so that one response replaces as many as there are modes.
        response = self.field.response
        at_point = StepResponse(response.memory_s, Panels(response.panels.coefficient @ shape.T))
        return self._transients(at_point, tonebursts, time_ps)[:, 0]

    def _transients(self, response: StepResponse, tonebursts: Bursts, time_ps: Int64Array) -> FloatArray:
        """Return the tabulated responses to the force of ``tonebursts`` as they pass, (time, response)."""
        force = radiation_force(tonebursts, self.specimen, self.travel_s, self.transmitter, self.force_scale)
        return transients(response, force, time_ps)


def medium_motion(
    settings: SimulationSettings, offset_m: FloatArray, travel_s: float, lateral_offset_m: float = 0.0
) -> MediumMotion:
    """Return the motion of scatterers at ``offset_m`` (scatterer, 3) from the focus, as modes of the medium's field.

    Needs ``settings.specimen``. ``travel_s``: of a burst to the focus. The field also covers the point
    ``lateral_offset_m`` off the axis.
    """
    specimen = settings.specimen or Specimen()
    lateral_m, axial_m = np.hypot(offset_m[:, 0], offset_m[:, 1]), offset_m[:, 2]
    # At least the widths of the force, so that a single scatterer at the focus has a field to tabulate.
    force = force_shape(settings)
    width_m = _length_scales_m(_gaussians(force))
    point_m = abs(lateral_offset_m)
    lateral_reach_m = max(float(lateral_m.max(initial=point_m)), width_m[0])
    axial_reach_m = max(float(np.abs(axial_m).max(initial=0.0)), width_m[1])
    # Far off the axis only the shell with the scatterers is tabulated; it needs some thickness for a single radius.
    inner_m = float(lateral_m.min(initial=point_m))
    lateral_reach_m = max(lateral_reach_m, inner_m + width_m[0] / 100)
    shell_inner_m = inner_m if inner_m > width_m[0] else 0.0
    field = _cached_field(specimen, force, lateral_reach_m, axial_reach_m, lateral_inner_m=shell_inner_m)
    shape = field.shapes(lateral_m, axial_m).T
    return MediumMotion(
        shape=shape,
        field=field,
        specimen=specimen,
        transmitter=settings.transmitter,
        travel_s=travel_s,
        force_scale=force_scale(settings),
    )


# The field depends only on settings and scatterers, so repeated measurements of a scene share it.
_cached_field = lru_cache(maxsize=8)(focus_field)


def field_transfer(
    specimen: Specimen, force: Force, lateral_m: FloatArray, axial_m: FloatArray, frequency_hz: FloatArray
) -> ComplexArray:
    """Return displacement over body force on a grid, complex (frequency, lateral, axial), m per N/m³.

    The time factor is exp(+jwt).
    """
    s = np.asarray(2j * np.pi * np.asarray(frequency_hz), np.complex128)
    value = _Spectrum(_gaussians(force), lateral_m, axial_m).transfer(specimen, s)
    return value.reshape(len(s), len(lateral_m), len(axial_m))


def _gaussians(force: Force) -> GaussianSum:
    """Return ``force`` as a sum of Gaussians; raise ``ValueError`` for a Gaussian with unequal lateral widths."""
    if isinstance(force, GaussianSum):
        return force
    if not math.isclose(force[0], force[1], rel_tol=1e-12):
        raise ValueError(
            f"the field around the focus needs a round beam, its widths are {force[0]:g} m and {force[1]:g} m. "
            'Try: simulation.specimen.field = "gaussian", or equal excitation widths.'
        )
    # One Gaussian at the focus, with the weight 1.
    width_m, _, length_m = force
    return GaussianSum(lateral_width_m=(width_m,), axial_width_m=length_m, centre_m=(0.0,), amplitude=((1.0,),))


def _length_scales_m(force: GaussianSum) -> tuple[float, float]:
    """Return the lateral and axial lengths over which the force changes: the widths of the narrowest Gaussian."""
    return force.lateral_width_m[0], force.axial_width_m


class _Spectrum:
    """Spectrum of the force at all points, for all wave numbers on the ray; computed once for a geometry."""

    def __init__(self, force: GaussianSum, lateral_m: FloatArray, axial_m: FloatArray) -> None:
        """Compute the spectrum of ``force`` at all points of a grid, for wave numbers along a complex ray."""
        directions = _Directions(force)
        self.ray = _ray_angle(directions, float(lateral_m.max()), float(np.abs(axial_m).max()))
        self._k2, weighted = _ray_spectrum(directions, lateral_m, axial_m, self.ray)
        self._k2_weighted = self._k2[:, None] * weighted

    def transfer(self, specimen: Specimen, s_per_s: ComplexArray) -> ComplexArray:
        """Return the displacement over the force density, (s, point), at complex frequencies ``s_per_s``.

        It is a sum over wave numbers k of k² / (k² + pole), with pole = rho s² / mu, times the spectrum of the force.
        """
        modulus = shear_modulus(specimen, s_per_s)
        pole = specimen.density_kg_per_m3 * s_per_s**2 / modulus
        pole[pole == 0] = np.finfo(np.float64).tiny  # at rest
        response = np.empty((len(pole), self._k2_weighted.shape[1]), np.complex128)
        order = np.argsort(np.abs(pole))
        size, k2_size, power = np.abs(pole)[order], np.abs(self._k2), np.arange(_SERIES_TERMS)
        # Poles of similar size (within a factor of 16) are evaluated together. Wave numbers near them need the fraction
        # itself. If one of the two dominates, the fraction is a power series in their ratio: its sums over wave numbers
        # are then the same for all these poles.
        for poles in np.split(order, np.flatnonzero(np.diff(np.floor(np.log2(size) / 4))) + 1):
            p, smallest, largest = pole[poles], abs(pole[poles[0]]), abs(pole[poles[-1]])
            # The wave numbers ascend along the ray: long waves, near the pole, short waves.
            low, high = np.searchsorted(k2_size, [smallest / _DOMINANCE_RATIO, largest * _DOMINANCE_RATIO])
            short, near, long = self._k2[high:], self._k2[low:high], self._k2[:low]
            # 1 / (k² + p) is the sum of (-p)^n / k²^(n + 1) for short waves and of (-k²)^n / p^(n + 1) for long ones,
            # with powers scaled by the largest and the smallest pole.
            short_sums = (largest / short) ** power[:, None] / short @ self._k2_weighted[high:]
            long_sums = (long / smallest) ** power[:, None] @ self._k2_weighted[:low]
            response[poles] = (
                (1 / (near + p[:, None])) @ self._k2_weighted[low:high]
                + (-p[:, None] / largest) ** power @ short_sums
                + (-smallest / p[:, None]) ** power / p[:, None] @ long_sums
            )
        return np.asarray(response / modulus[:, None])


class _Directions:
    """Spectrum of the force along directions with cosine ``m`` (direction,) to the axis."""

    def __init__(self, force: GaussianSum) -> None:
        """Prepare the spectrum of ``force`` along wave directions: widths, weights and positions of its Gaussians."""
        widths = np.array(force.lateral_width_m)
        # The nodes of the narrowest Gaussian, with the spectrum most concentrated at m = 0, serve all Gaussians.
        self.m, self.min_a_m2, self.weight = polar_nodes(float(widths.min()) ** 2, force.axial_width_m**2)
        # Half the squared width of each Gaussian along each direction, (direction, Gaussian).
        self._a_m2 = (np.outer(1 - self.m**2, widths**2) + (force.axial_width_m * self.m[:, None]) ** 2) / 2
        volumes = [force_volume((width, width, force.axial_width_m)) for width in force.lateral_width_m]
        self._centre_m, self._strength = np.array(force.centre_m), np.array(force.amplitude) * np.array(volumes)
        self.max_centre_m = float(np.abs(self._centre_m).max())

    def spectra(self, k: ComplexArray, selected: BoolArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Return the force's spectrum at wave numbers ``k`` along the ``selected`` directions, (k, direction).

        It has an even part in depth, and an odd part: None if the force is symmetric about the focal plane.
        """
        # (k, direction, width)
        gaussian = np.exp(-(k**2)[:, None, None] * self._a_m2[selected]) * self.weight[selected, None]
        if not self._centre_m.any():
            return np.asarray(gaussian @ self._strength[0]), None
        phase = np.multiply.outer(np.outer(k, self.m[selected]), self._centre_m)
        # j: position along the axis, i: width, k: wave number, m: direction.
        at_centre = np.einsum("ji,kmi->kmj", self._strength, gaussian, optimize=True)
        even, odd = (np.asarray((wave(phase) * at_centre).sum(axis=2)) for wave in (np.cos, np.sin))
        return even, odd

    def reach_m(self, lateral_m: float, axial_m: float) -> FloatArray:
        """Return the largest path along each direction from the force to points within a cylinder, (direction,)."""
        return np.asarray(lateral_m * np.sqrt(1 - self.m**2) + (axial_m + self.max_centre_m) * self.m)


def _ray_angle(directions: _Directions, lateral_reach_m: float, axial_reach_m: float) -> float:
    """Return the angle of the integration ray to the real axis of wave numbers, as large as the reach allows.

    Waves grow along the ray, at any point to at most exp(``_MAX_GROWTH_EXPONENT``).
    """
    reach_m, a_m2 = directions.reach_m(lateral_reach_m, axial_reach_m), directions.min_a_m2
    # exp(|k| r sin(ray) - a |k|² cos(2 ray)) has its maximum at the exponent r² sin(ray)² / (4 a cos(2 ray)).
    largest = float((reach_m**2 / (4 * a_m2)).max())
    return min(_RAY, math.asin(math.sqrt(_MAX_GROWTH_EXPONENT / (largest + 2 * _MAX_GROWTH_EXPONENT))))


def _rotated_contour(angle_ratio: float) -> Contour:
    """Return the field's contour of the inverse Laplace transform with its angle times ``angle_ratio``.

    It is as exact, with more nodes.
    """
    contour = FIELD_CONTOUR
    if angle_ratio == 1.0:
        return contour
    alpha = contour.alpha * angle_ratio
    span = math.acosh(math.cosh(contour.span) * math.sin(contour.alpha) / math.sin(alpha))
    return replace(contour, nodes=math.ceil(contour.nodes / angle_ratio), span=span, alpha=alpha)


def _ray_spectrum(
    directions: _Directions, lateral_m: FloatArray, axial_m: FloatArray, ray: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return k² of the wave numbers, (k,), and their weighted spectrum at every point, (k, point).

    The spectrum S(k, r) of the module's equation is a sum over directions with cosine m to the axis. The wave numbers
    are the nodes of an integral along a ray at the angle ``ray`` to the real axis: k = |k| exp(j ray). On the real axis
    the integral would come near the shear pole k² = -rho s² / mu, which is sharp for weakly damped media. Away from
    the pole the integrand is smooth, so few nodes suffice. The cost: waves grow as exp(|k| reach sin(ray)), and the
    force's spectrum decays as exp(-a |k|² cos(2 ray)), more slowly than on the real axis.
    """
    # Along each direction: cosine to the axis, half the squared width of the narrowest Gaussian (m²), and the longest
    # path from the force to a point.
    m, a_m2, rotation = directions.m, directions.min_a_m2, np.exp(1j * ray)
    reach_m = directions.reach_m(lateral_m.max(), np.abs(axial_m).max())
    # The integral ends where the spectrum is negligible along every direction. Octaves of |k| follow from 0 to there.
    highest = float(_highest_wave_number(a_m2, reach_m, ray).max())
    bessel = _BesselOnRay(rotation, highest * float(lateral_m.max()))
    edges = highest * 2.0 ** np.arange(-_OCTAVES, 1)
    k2, weighted = [], []
    for octave, (low, high) in enumerate(zip([0.0, *edges[:-1]], edges, strict=True)):
        # Gauss-Legendre nodes of the octave: more for short waves, which oscillate over the reach. A ray at a smaller
        # angle is nearer to the pole and needs more nodes, in inverse proportion.
        is_short = octave > _OCTAVES - _SHORT_WAVE_OCTAVES
        count = _NODES_PER_SHORT_WAVE_OCTAVE if is_short else _NODES_PER_OCTAVE
        node, weight = legendre(math.ceil(count * (_RAY / ray)))
        along_ray = (high + low) / 2 + (high - low) / 2 * node
        k = rotation * along_ray
        # Omit directions with a negligible spectrum in the whole octave, where the force is long compared with the
        # wavelength. Bound: the decay exponent at the low edge, where it is least, minus the largest growth exponent,
        # at the high edge.
        min_decay = a_m2 * (low * low * math.cos(2 * ray))
        selected = min_decay - high * reach_m * math.sin(ray) < _NEGLIGIBLE_EXPONENT
        sine, cosine = np.sqrt(1 - m[selected] ** 2)[:, None], m[selected][:, None]
        even, odd = directions.spectra(k, selected)
        # The wave across the axis is J0(k lateral sine), (k, direction, lateral). Along the axis it is a cosine for the
        # even part of the spectrum and a sine for the odd part, (k, direction, axial).
        across = bessel.at(along_ray[:, None, None] * (sine * lateral_m))
        phase = k[:, None, None] * cosine * axial_m
        along = even[:, :, None] * np.cos(phase)
        if odd is not None:
            along += odd[:, :, None] * np.sin(phase)
        # Sum over directions, (k, lateral, axial), then the weight of the quadrature in dk.
        block = np.einsum("kml,kma->kla", across, along, optimize=True)
        k2.append(k**2)
        weighted.append(block.reshape(len(k), -1) * (rotation * (high - low) / 2 * weight)[:, None])
    return np.concatenate(k2), np.concatenate(weighted)


class _BesselOnRay:
    """J0 at distances from 0 along the ray, by a table of polynomials: to 4e-15 of exp(|Im z|).

    It takes a tenth of the time of scipy's jv for complex arguments.
    """

    def __init__(self, rotation: complex, max_distance: float) -> None:
        """Tabulate J0 along a ray in the complex plane: from 0 to ``max_distance`` in the direction ``rotation``."""
        # Imported here, so that scenes without a field do not load it.
        from scipy.special import jv

        # In each cell of distance, a polynomial through the values at Chebyshev nodes.
        node = np.cos((np.arange(_BESSEL_NODES) + 0.5) * np.pi / _BESSEL_NODES)
        middle = (np.arange(int(max_distance / _BESSEL_CELL) + 1) + 0.5) * _BESSEL_CELL
        value = jv(0, rotation * (middle + node[:, None] * _BESSEL_CELL / 2))
        self._polynomial = np.linalg.solve(np.vander(node).astype(np.complex128), value)

    def at(self, distance: FloatArray) -> ComplexArray:
        """Return J0 at ``distance``, any shape, from 0 to ``max_distance``."""
        # J0 is a polynomial in each cell of distance; its variable runs from -1 to 1 over the cell. Horner's rule.
        cell, position = np.divmod(distance / _BESSEL_CELL, 1.0)
        index, position = cell.astype(np.intp), 2 * position - 1
        value = self._polynomial[0][index]
        for row in self._polynomial[1:]:
            value = value * position + row[index]
        return np.asarray(value)


def _highest_wave_number(a_m2: FloatArray, distance_m: FloatArray, ray: float) -> FloatArray:
    """Return |k| beyond which the decay of the force's spectrum dominates the growth of the waves along the ray."""
    decay, growth = a_m2 * math.cos(2 * ray), distance_m * math.sin(ray)
    return np.asarray((growth + np.sqrt(growth**2 + 4 * _NEGLIGIBLE_EXPONENT * decay)) / (2 * decay))


def _unit_points(count: int) -> FloatArray:
    """Return the Chebyshev points of the interval from 0 to 1, (count,)."""
    return np.asarray((chebpts1(count) + 1) / 2)
