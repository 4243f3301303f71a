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
    polar_nodes,
    settling_time_s,
    shear_modulus,
    tabulate_step_response,
    transients,
)
from sim_backend.settings import SimulationSettings, Specimen
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
    """Step response of the medium in a cylinder about the axis: few shapes (modes) and their responses in time."""

    lateral_reach_m: float
    """Outer radius of the cylinder."""
    axial_reach_m: float
    """Largest distance from the focal plane."""
    response: StepResponse
    """Amplitude of every mode, m per N/m³."""
    shape: FloatArray
    """Chebyshev coefficients of every mode in the squares of both coordinates, (mode, lateral, axial)."""
    lateral_inner_m: float = 0.0
    """Inner radius of a hollow cylinder."""
    asymmetric: bool = False
    """Whether the field differs before and behind the focal plane; the axial series is then in the depth itself."""

    def shapes(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return the spatial shape of every mode of the motion at points around the focus, (point, mode).

        ``lateral_m``, ``axial_m`` (point,): distance from the axis, and depth. Raises ``ValueError`` outside the
        tabulated region.
        """
        outer_m, inner_m, depth_m = self.lateral_reach_m, self.lateral_inner_m, self.axial_reach_m
        outside = lateral_m.size and (lateral_m.max() > outer_m * 1.0001 or np.abs(axial_m).max() > depth_m * 1.0001)
        if outside or lateral_m.min(initial=inner_m) < inner_m * 0.9999:
            raise ValueError(
                f"a point {lateral_m.max() * 1e3:.3g} mm off the axis and {np.abs(axial_m).max() * 1e3:.3g} mm off the "
                f"focal plane lies outside the tabulated field of {outer_m * 1e3:.3g} and {depth_m * 1e3:.3g} mm. "
                "Try: a field that reaches as far as the scatterers."
            )
        # The variables of the Chebyshev polynomials, -1 to 1, are the squared coordinates; for an asymmetric field the
        # depth itself.
        lateral_variable = 2 * (lateral_m**2 - inner_m**2) / (outer_m**2 - inner_m**2) - 1
        axial_variable = axial_m / depth_m if self.asymmetric else 2 * axial_m**2 / depth_m**2 - 1
        _, lateral_degrees, axial_degrees = self.shape.shape
        lateral = chebvander(np.clip(lateral_variable, -1.0, 1.0), lateral_degrees - 1)
        axial = chebvander(np.clip(axial_variable, -1.0, 1.0), axial_degrees - 1)
        # p: point, m: mode, l and a: lateral and axial Chebyshev degree.
        return np.asarray(np.einsum("pl,mla,pa->pm", lateral, self.shape, axial, optimize=True))


# The field depends only on settings and scatterers, so repeated measurements of a scene share it.
@lru_cache(maxsize=8)
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
    # Step response at a grid of Chebyshev points of the squared coordinates, or of the depth itself.
    lateral_count = max(
        _LATERAL_DEGREES, math.ceil(_LATERAL_DEGREES_PER_WIDTH * (lateral_reach_m - lateral_inner_m) / width_m)
    )
    lateral_m = np.sqrt(lateral_inner_m**2 + (lateral_reach_m**2 - lateral_inner_m**2) * _unit_points(lateral_count))
    asymmetric = any(gaussians.centre_m)
    axial_count = _ASYMMETRIC_AXIAL_DEGREES if asymmetric else _AXIAL_DEGREES
    axial_points = _unit_points(axial_count)
    axial_m = axial_reach_m * (2 * axial_points - 1 if asymmetric else np.sqrt(axial_points))
    panels = _Spectrum(gaussians, lateral_m, axial_m).step_response(specimen)
    # The matrix of displacement by time (degree and panel) and point, in units of the tolerated error, has few large
    # singular values. They are the modes: the left vectors are responses in time, the right ones shapes in space.
    degrees, panel_count, points = panels.coefficient.shape
    scale = _error_scale(specimen, panels)[:, None]
    in_time, size, in_space = np.linalg.svd((panels.coefficient / scale).reshape(-1, points), full_matrices=False)
    modes = max(1, int(np.count_nonzero(size > 0.1 * tolerance * size[0])))
    responses = Panels((in_time[:, :modes] * size[:modes]).reshape(degrees, panel_count, modes) * scale)
    # From values at the grid to Chebyshev coefficients along both axes. m: mode, l and a: lateral and axial degree,
    # i and j: lateral and axial point.
    values = in_space[:modes].reshape(modes, lateral_count, axial_count)
    matrices = chebyshev_matrix(lateral_count), chebyshev_matrix(axial_count)
    shape = np.einsum("li,aj,mij->mla", *matrices, values, optimize=True)
    # Changes below the tolerance are errors of the quadrature, so a response has ended there.
    response = StepResponse(settling_time_s(specimen, responses, 0.1 * tolerance), responses)
    return FocusField(
        lateral_reach_m=lateral_reach_m,
        axial_reach_m=axial_reach_m,
        response=response,
        shape=shape,
        lateral_inner_m=lateral_inner_m,
        asymmetric=asymmetric,
    )


@lru_cache(maxsize=8)
def focus_response(specimen: Specimen, force: Force) -> StepResponse:
    """Return the displacement at the focus after a step of force, tabulated over time.

    It is in closed form for a Gaussian force, and to 1e-7 for a sum of Gaussians.
    """
    if not isinstance(force, GaussianSum):
        return tabulate_step_response(specimen, force)
    panels = _focus_spectrum(force).step_response(specimen)
    return StepResponse(settling_time_s(specimen, panels), panels)


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
    """Return the scale of the permitted error in each interval of time, (panel,); only ratios between panels matter.

    ``panels``: displacement after a step of force, a Chebyshev series in each panel. The scale is 1, except for a
    medium that creeps without end: there it is the largest displacement so far. If it were the final displacement,
    hours later, the motion during a toneburst would be smaller than the permitted error.
    """
    if not creeps_for_ever(specimen):
        return np.ones(panels.coefficient.shape[1])
    # A Chebyshev series is at most the sum of its coefficients (degree, panel, point). The displacement so far is the
    # largest of these bounds over all points and all panels up to the present one.
    largest_so_far = np.maximum.accumulate(np.abs(panels.coefficient).sum(axis=0).max(axis=1))
    # The scale of the panels before the creep is the displacement at its start.
    at_start = largest_so_far[np.searchsorted(panels.begins_s, _START_OF_CREEP_S) - 1]
    return np.asarray(np.maximum(largest_so_far, at_start) / at_start)


@dataclass(frozen=True, slots=True)
class MediumMotion:
    """Motion of the scatterers by the field of a medium."""

    shape: FloatArray
    """(mode, scatterer)"""
    field: FocusField
    specimen: Specimen
    travel_s: float
    force_scale: ForceScale | None = None

    def amplitudes_m(self, tonebursts: Bursts, time_ps: Int64Array) -> FloatArray:
        """Return the amplitude of every mode at ``time_ps`` (time,) under ``tonebursts``, (time, mode)."""
        return self._transients(self.field.response, tonebursts, time_ps)

    def displacement_m(self, tonebursts: Bursts, time_ps: Int64Array, lateral_m: float) -> FloatArray:
        """Return the displacement in the focal plane, ``lateral_m`` off the axis, at ``time_ps`` (time,), m."""
        # (degree, panel, mode) @ (mode, 1): the step response at the point is the sum of shape times response over the
        # modes. The sum comes first, so that one time course is computed instead of one for each mode.
        shapes_at_point = self.field.shapes(np.array([abs(lateral_m)]), np.zeros(1)).T
        response = self.field.response
        at_point = StepResponse(response.settling_time_s, Panels(response.panels.coefficient @ shapes_at_point))
        return self._transients(at_point, tonebursts, time_ps)[:, 0]

    def _transients(self, response: StepResponse, tonebursts: Bursts, time_ps: Int64Array) -> FloatArray:
        """Return the tabulated responses to the force of ``tonebursts`` as they pass, (time, response)."""
        force = radiation_force(tonebursts, self.specimen, self.travel_s, self.force_scale)
        return transients(response, force, time_ps)


def medium_motion(
    settings: SimulationSettings, offset_m: FloatArray, travel_s: float, lateral_offset_m: float = 0.0
) -> MediumMotion:
    """Return the motion of scatterers at ``offset_m`` (scatterer, 3) from the focus under any train of tonebursts.

    It is a sum of a few modes, each a shape in space times a response in time. ``travel_s``: travel time of a burst to
    the focus. The modes also cover the point ``lateral_offset_m`` off the axis, on the axis of the tracking transducer,
    where the true displacement is stated. Without ``settings.specimen`` the medium is the default ``Specimen``.
    """
    specimen = settings.specimen or Specimen()
    lateral_m, axial_m = np.hypot(offset_m[:, 0], offset_m[:, 1]), offset_m[:, 2]
    force = force_shape(settings)
    # Widths (sigma) of the narrowest Gaussian of the force.
    lateral_width_m, axial_width_m = _length_scales_m(_gaussians(force))
    # Distances from the axis of all scatterers and of the point.
    point_m = abs(lateral_offset_m)
    nearest_m, farthest_m = float(lateral_m.min(initial=point_m)), float(lateral_m.max(initial=point_m))
    # The modes are tabulated in a cylinder out to the farthest scatterer, and at least to one width of the force: for a
    # single scatterer at the focus the cylinder would have no extent.
    outer_m = max(farthest_m, lateral_width_m)
    depth_m = max(float(np.abs(axial_m).max(initial=0.0)), axial_width_m)
    # If all are farther from the axis than one width, a hollow cylinder suffices. Its wall has a minimum thickness,
    # because all may have the same distance.
    inner_m = nearest_m if nearest_m > lateral_width_m else 0.0
    outer_m = max(outer_m, nearest_m + lateral_width_m / 100)
    field = focus_field(specimen, force, outer_m, depth_m, lateral_inner_m=inner_m)
    return MediumMotion(
        shape=field.shapes(lateral_m, axial_m).T,
        field=field,
        specimen=specimen,
        travel_s=travel_s,
        force_scale=force_scale(settings),
    )


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
    """Spectrum of the force times the wave at every point of a grid, for wave numbers along a ray in the complex plane.

    It does not depend on the medium, so it is computed once for a force and a grid.
    """

    def __init__(self, force: GaussianSum, lateral_m: FloatArray, axial_m: FloatArray) -> None:
        """Compute the spectrum S of ``force`` at points with these distances from axis and focal plane."""
        directions = _Directions(force)
        self._ray_rad = _ray_angle(directions, float(lateral_m.max()), float(np.abs(axial_m).max()))
        self._k2, weighted_spectrum = _ray_spectrum(directions, lateral_m, axial_m, self._ray_rad)
        # The factor k² of the integral over wave numbers, U = f0 / mu * integral of S k² / (k² + rho s² / mu) dk.
        self._k2_spectrum = self._k2[:, None] * weighted_spectrum

    def step_response(self, specimen: Specimen) -> Panels:
        """Return the displacement over the force density after a step of force at every point, tabulated over time."""
        return panels_of(lambda s: self.transfer(specimen, s), _rotated_contour(self._ray_rad / _RAY))

    def transfer(self, specimen: Specimen, s_per_s: ComplexArray) -> ComplexArray:
        """Return the displacement over the force density, (s, point), at complex frequencies ``s_per_s``.

        It is the sum of k² S / (k² + p) over wave numbers k, with the force's spectrum S and p = rho s² / mu, over the
        shear modulus mu. Written out it would be a matrix of all p by all k. Instead, if k² or p is far larger than the
        other, 1 / (k² + p) is a power series in their ratio: sums over k are then common to many p.
        """
        modulus = shear_modulus(specimen, s_per_s)
        p = specimen.density_kg_per_m3 * s_per_s**2 / modulus
        p[p == 0] = np.finfo(np.float64).tiny  # at rest
        response = np.empty((len(p), self._k2_spectrum.shape[1]), np.complex128)
        k2_size, power = np.abs(self._k2), np.arange(_SERIES_TERMS)
        # Groups of p of similar size, within a factor of 16, are evaluated together.
        ascending = np.argsort(np.abs(p))
        factor_of_16 = np.floor(np.log2(np.abs(p)[ascending]) / 4)
        for group in np.split(ascending, np.flatnonzero(np.diff(factor_of_16)) + 1):
            p_group, min_p, max_p = p[group], abs(p[group[0]]), abs(p[group[-1]])
            # Wave numbers ascend along the ray: long waves (k² far below p), comparable ones, short waves (far above).
            low, high = np.searchsorted(k2_size, [min_p / _DOMINANCE_RATIO, max_p * _DOMINANCE_RATIO])
            long, comparable, short = self._k2[:low], self._k2[low:high], self._k2[high:]
            # 1 / (k² + p) is the sum of (-p)^n / k²^(n + 1) for short waves and of (-k²)^n / p^(n + 1) for long ones.
            # Powers are scaled by the largest and the smallest p, so that they do not overflow.
            short_sums = (max_p / short) ** power[:, None] / short @ self._k2_spectrum[high:]
            long_sums = (long / min_p) ** power[:, None] @ self._k2_spectrum[:low]
            response[group] = (
                (1 / (comparable + p_group[:, None])) @ self._k2_spectrum[low:high]
                + (-p_group[:, None] / max_p) ** power @ short_sums
                + (-min_p / p_group[:, None]) ** power / p_group[:, None] @ long_sums
            )
        return np.asarray(response / modulus[:, None])


class _Directions:
    """Directions of plane waves, with cosine ``m`` (direction,) to the axis, and the force's spectrum along them."""

    def __init__(self, force: GaussianSum) -> None:
        """Choose directions for ``force``, and prepare widths, volumes and positions of its Gaussians along them."""
        widths = np.array(force.lateral_width_m)
        # Nodes for the narrowest Gaussian, with the spectrum most concentrated at m = 0, serve all Gaussians.
        self.m, self.min_a_m2, self._node_weight = polar_nodes(float(widths.min()) ** 2, force.axial_width_m**2)
        # Along a direction the spectrum of a Gaussian is exp(-a k²), with a half its squared width along the direction,
        # (direction, Gaussian), times its amplitude and volume, (position along the axis, Gaussian).
        self._a_m2 = (np.outer(1 - self.m**2, widths**2) + (force.axial_width_m * self.m[:, None]) ** 2) / 2
        volumes_m3 = [force_volume((width, width, force.axial_width_m)) for width in force.lateral_width_m]
        self._amplitude_m3 = np.array(force.amplitude) * np.array(volumes_m3)
        self._centre_m = np.array(force.centre_m)
        self._max_centre_m = float(np.abs(self._centre_m).max())

    def spectra(self, k: ComplexArray, selected: BoolArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Return the force's spectrum at wave numbers ``k`` along the ``selected`` directions, (k, direction).

        The first value is the part that is even in depth. The second one is the odd part, None if the force is
        symmetric about the focal plane. Both include the weights of the quadrature over directions.
        """
        # Spectrum of a Gaussian at the focus of each lateral width, (k, direction, width).
        gaussian = np.exp(-(k**2)[:, None, None] * self._a_m2[selected]) * self._node_weight[selected, None]
        if not self._centre_m.any():
            return np.asarray(gaussian @ self._amplitude_m3[0]), None
        # Sum over widths i at each position j along the axis; k: wave number, m: direction.
        at_centre = np.einsum("ji,kmi->kmj", self._amplitude_m3, gaussian, optimize=True)
        # A Gaussian at the depth c has the phase k m c: sum cosines for the even part and sines for the odd part.
        phase = np.multiply.outer(np.outer(k, self.m[selected]), self._centre_m)
        even, odd = (np.asarray((wave(phase) * at_centre).sum(axis=2)) for wave in (np.cos, np.sin))
        return even, odd

    def reach_m(self, lateral_m: float, axial_m: float) -> FloatArray:
        """Return the largest path along each direction from the force to points within a cylinder, (direction,)."""
        return np.asarray(lateral_m * np.sqrt(1 - self.m**2) + (axial_m + self._max_centre_m) * self.m)


def _ray_angle(directions: _Directions, lateral_reach_m: float, axial_reach_m: float) -> float:
    """Return the angle (rad) of the ray of complex wave numbers to the real axis, as large as the reach allows.

    Waves grow along the ray until the force's spectrum decays: at any point to at most exp(``_MAX_GROWTH_EXPONENT``).
    """
    reach_m, a_m2 = directions.reach_m(lateral_reach_m, axial_reach_m), directions.min_a_m2
    # At the distance r, exp(|k| r sin(ray) - a |k|² cos(2 ray)) has its maximum over |k| at the exponent
    # g = r² sin(ray)² / (4 a cos(2 ray)). With cos(2 ray) = 1 - 2 sin(ray)², sin(ray)² = g / (r² / 4a + 2 g).
    largest = float((reach_m**2 / (4 * a_m2)).max())
    return min(_RAY, math.asin(math.sqrt(_MAX_GROWTH_EXPONENT / (largest + 2 * _MAX_GROWTH_EXPONENT))))


def _rotated_contour(angle_ratio: float) -> Contour:
    """Return the hyperbola of the inverse Laplace transform for a field, with its angle alpha times ``angle_ratio``.

    A ray of wave numbers at a smaller angle needs a hyperbola at a smaller angle, so that the shear pole stays behind
    it. The hyperbola ends at the same real part, and has more nodes for the same error.
    """
    contour = FIELD_CONTOUR
    if angle_ratio == 1.0:
        return contour
    alpha = contour.alpha * angle_ratio
    # The real part of its end is height (1 - sin(alpha) cosh(span)).
    span = math.acosh(math.cosh(contour.span) * math.sin(contour.alpha) / math.sin(alpha))
    return replace(contour, nodes=math.ceil(contour.nodes / angle_ratio), span=span, alpha=alpha)


def _ray_spectrum(
    directions: _Directions, lateral_m: FloatArray, axial_m: FloatArray, ray_rad: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return nodes k² of an integral over wave numbers, (k,), and the spectrum at every point times their weights.

    The second array is (k, point). The spectrum S(k, r) is that of the force times the wave at point r, summed over
    directions of waves. The integral runs along a ray at the angle ``ray_rad`` to the real axis: k = |k| exp(j ray). On
    the real axis it would come near the shear pole k² = -rho s² / mu, which is sharp for weakly damped media. Away from
    the pole the integrand is smooth, so few nodes suffice. The cost: waves grow as exp(|k| reach sin(ray)), and the
    force's spectrum decays as exp(-a |k|² cos(2 ray)), more slowly than on the real axis.
    """
    # Along each direction: cosine to the axis, half the squared width of the narrowest Gaussian (m²), and the longest
    # path from the force to a point.
    m, a_m2, phasor = directions.m, directions.min_a_m2, np.exp(1j * ray_rad)
    reach_m = directions.reach_m(lateral_m.max(), np.abs(axial_m).max())
    # The integral ends where the spectrum is negligible along every direction. Octaves of |k| follow from 0 to there.
    highest = float(_highest_wave_number(a_m2, reach_m, ray_rad).max())
    bessel = _BesselOnRay(phasor, highest * float(lateral_m.max()))
    edges = highest * 2.0 ** np.arange(-_OCTAVES, 1)
    k2, weighted_spectrum = [], []
    for octave, (low, high) in enumerate(zip([0.0, *edges[:-1]], edges, strict=True)):
        # Gauss-Legendre nodes of the octave: more for short waves, which oscillate over the reach. A ray at a smaller
        # angle is nearer to the pole and needs more nodes, in inverse proportion.
        is_short = octave > _OCTAVES - _SHORT_WAVE_OCTAVES
        count = _NODES_PER_SHORT_WAVE_OCTAVE if is_short else _NODES_PER_OCTAVE
        node, weight = legendre(math.ceil(count * (_RAY / ray_rad)))
        along_ray = (high + low) / 2 + (high - low) / 2 * node
        k = phasor * along_ray
        # Omit directions with a negligible spectrum in the whole octave, where the force is long compared with the
        # wavelength. Bound: the decay exponent at the low edge, where it is least, minus the largest growth exponent,
        # at the high edge.
        min_decay = a_m2 * (low * low * math.cos(2 * ray_rad))
        selected = min_decay - high * reach_m * math.sin(ray_rad) < _NEGLIGIBLE_EXPONENT
        sine, cosine = np.sqrt(1 - m[selected] ** 2)[:, None], m[selected][:, None]
        # The wave across the axis is J0(k lateral sine), (k, direction, lateral). Along the axis it is a cosine for the
        # even part of the spectrum and a sine for the odd part, (k, direction, axial).
        even, odd = directions.spectra(k, selected)
        across = bessel.at(along_ray[:, None, None] * (sine * lateral_m))
        phase = k[:, None, None] * cosine * axial_m
        along = even[:, :, None] * np.cos(phase)
        if odd is not None:
            along += odd[:, :, None] * np.sin(phase)
        # Sum over directions m, (k, lateral, axial), then the weight of the quadrature in dk.
        spectrum = np.einsum("kml,kma->kla", across, along, optimize=True)
        k2.append(k**2)
        weighted_spectrum.append(spectrum.reshape(len(k), -1) * (phasor * (high - low) / 2 * weight)[:, None])
    return np.concatenate(k2), np.concatenate(weighted_spectrum)


class _BesselOnRay:
    """J0 at distances from 0 along the ray, by a table of polynomials: to 4e-15 of exp(|Im z|).

    It takes a tenth of the time of scipy's jv for complex arguments.
    """

    def __init__(self, phasor: complex, max_distance: float) -> None:
        """Tabulate J0 along a ray in the complex plane: from 0 to ``max_distance`` in the direction of ``phasor``."""
        # Imported here, so that scenes without a field do not load it.
        from scipy.special import jv

        # In each cell of distance, a polynomial through the values at Chebyshev nodes.
        node = np.cos((np.arange(_BESSEL_NODES) + 0.5) * np.pi / _BESSEL_NODES)
        middle = (np.arange(int(max_distance / _BESSEL_CELL) + 1) + 0.5) * _BESSEL_CELL
        value = jv(0, phasor * (middle + node[:, None] * _BESSEL_CELL / 2))
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


def _highest_wave_number(a_m2: FloatArray, distance_m: FloatArray, ray_rad: float) -> FloatArray:
    """Return |k| beyond which the force's spectrum times the wave is negligible, for each direction, (direction,).

    It is the root of a |k|² cos(2 ray) - |k| distance sin(ray) = ``_NEGLIGIBLE_EXPONENT``: decay minus growth.
    """
    decay, growth = a_m2 * math.cos(2 * ray_rad), distance_m * math.sin(ray_rad)
    return np.asarray((growth + np.sqrt(growth**2 + 4 * _NEGLIGIBLE_EXPONENT * decay)) / (2 * decay))


def _unit_points(count: int) -> FloatArray:
    """Return the Chebyshev points of the interval from 0 to 1, (count,)."""
    return np.asarray((chebpts1(count) + 1) / 2)
