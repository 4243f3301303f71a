"""Displacement around the focus, in time: broader than the force that causes it, and later the farther out.

    u(r, t) = sum over modes of shape_i(lateral, axial) * amplitude_i(t)

The same medium and force as `sim_backend.motion.specimen`, off the axis, where the integral over wave numbers k has no
closed form worth its price. It runs along a ray in the complex k plane instead: clear of the shear pole at every node
of the hyperbola in the s plane, an elastic medium's included. The force is round: a Gaussian of equal lateral widths,
or a sum of such, whose spectrum is the sum of theirs. docs/theory/medium.md, section 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from sim_backend.arrays import BoolArray, ComplexArray, FloatArray, Int64Array
from sim_backend.motion.force import Share, force_share, radiation_force
from sim_backend.motion.inverse_laplace import FIELD_CONTOUR, Contour, Panels, panels_of
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

# The ray's angle: more than the hyperbola's 0.35, behind which the pole hides, and less than pi / 4. Waves grow along
# it as exp(|k| r sin(ray)), which costs digits and nodes far from the axis: there both turn towards the real one.
_RAY = 0.55
_LARGEST_GROWTH_EXPONENT = 4.0
# |k| up to the highest that matters, octave by octave: the uppermost five, whose waves turn fast, with more nodes.
_OCTAVES = 21
_NODES_AN_OCTAVE = 12
_NODES_WHERE_WAVES_ARE_SHORT = 36
_SHORT_OCTAVES = 5
# exp(-32) = 1e-14: a share of the spectrum below that puts nothing into any point.
_NEGLIGIBLE_EXPONENT = 32.0
# Of two numbers, one this many times the other: the series in their ratio is over, to 1e-16, after so many powers.
_OUTWEIGHS, _TERMS = 16.0, 14
# Of the table of J0 along the ray.
_CELL, _CELL_NODES = 0.5, 10
# Chebyshev degrees of the shapes; laterally more where the field reaches over many widths of the force.
_LATERAL_DEGREES = 16
_LATERAL_DEGREES_A_WIDTH = 3.8
_AXIAL_DEGREES = 10
# From about when on errors count against how far a medium has crept: shear waves have then left the force.
_CREEP_S = 1e-3
_UNEVEN_DEGREES = 20
"""Of a force that is not the same before and behind the focal plane, in the depth itself instead of its square."""

Force = Triple | GaussianSum
"""Shape of the body force: a Gaussian's widths, or a sum of Gaussians."""


def force_shape(settings: SimulationSettings) -> Force:
    """Return the shape of the push: the Gaussian of the excitation widths, or that of the aperture's intensity."""
    return push_intensity(settings) if settings.beams.field != "gaussian" else settings.beams.excitation_width_m


@dataclass(frozen=True, slots=True)
class FocusField:
    """The medium's step response in a cylinder around the focus, as few shapes, each with its own course in time.

    Of a place beside the axis it is a shell, from ``lateral_inner_m`` outwards.
    """

    lateral_reach_m: float
    axial_reach_m: float
    response: StepResponse
    """Amplitude of every mode, m per N/m^3."""
    shape: FloatArray
    """Chebyshev coefficients of every mode in the squares of both coordinates, (mode, lateral, axial)."""
    lateral_inner_m: float = 0.0
    uneven: bool = False
    """Whether they are in the depth itself: the field differs before and behind the focal plane."""

    def shapes(self, lateral_m: FloatArray, axial_m: FloatArray) -> FloatArray:
        """Return every mode's shape at points (point,), distances from axis and focal plane: (point, mode)."""
        reach, inner = (self.lateral_reach_m, self.axial_reach_m), (self.lateral_inner_m, 0.0)
        outside = lateral_m.size and (lateral_m.max() > reach[0] * 1.0001 or np.abs(axial_m).max() > reach[1] * 1.0001)
        if outside or lateral_m.min(initial=inner[0]) < inner[0] * 0.9999:
            raise ValueError(
                f"a point {lateral_m.max() * 1e3:.3g} mm off the axis and {np.abs(axial_m).max() * 1e3:.3g} mm off the "
                f"focal plane lies outside the tabulated field of {reach[0] * 1e3:.3g} and {reach[1] * 1e3:.3g} mm. "
                "Try: a field that reaches as far as the scatterers."
            )
        # Squared, from the inner edge (0) to the reach (1), then led to the -1 to 1 of the polynomials.
        squares = zip((lateral_m, axial_m), inner, reach, strict=True)
        places = [np.clip(2 * (at**2 - least**2) / (most**2 - least**2) - 1, -1.0, 1.0) for at, least, most in squares]
        if self.uneven:
            places[1] = np.clip(axial_m / self.axial_reach_m, -1.0, 1.0)
        rows = chebvander(places[0], self.shape.shape[1] - 1)
        columns = chebvander(places[1], self.shape.shape[2] - 1)
        return np.asarray(np.einsum("pl,mla,pa->pm", rows, self.shape, columns, optimize=True))


def focus_field(
    specimen: Specimen,
    force: Force,
    lateral_reach_m: float,
    axial_reach_m: float,
    tolerance: float = 1e-5,
    lateral_inner_m: float = 0.0,
) -> FocusField:
    """Return the field of ``specimen`` around the focus, good to ``tolerance`` of the static displacement there.

    Of a medium that creeps for ever: of what it has moved so far, or in the first millisecond where that is more.
    From ``lateral_inner_m`` off the axis to ``lateral_reach_m``.

    Raises ``ValueError`` for a force of unequal lateral widths.
    """
    shape = _gaussians(force)
    across = max(
        _LATERAL_DEGREES,
        math.ceil(_LATERAL_DEGREES_A_WIDTH * (lateral_reach_m - lateral_inner_m) / _scale(shape)[0]),
    )
    lateral_m = np.sqrt(lateral_inner_m**2 + (lateral_reach_m**2 - lateral_inner_m**2) * _nodes(across))
    uneven = any(shape.centre_m)
    along = _UNEVEN_DEGREES if uneven else _AXIAL_DEGREES
    axial_m = axial_reach_m * (2 * _nodes(along) - 1 if uneven else np.sqrt(_nodes(along)))
    spectrum = _Spectrum(shape, lateral_m, axial_m)
    panels = panels_of(lambda s: spectrum.transfer(specimen, s), _turned(FIELD_CONTOUR, spectrum.ray / _RAY))
    # A matrix of courses in time by points in space: its singular vectors are the modes, few of which are large.
    degrees, count, points = panels.coefficient.shape
    worth = _worth(specimen, panels)[:, None]
    left, size, right = np.linalg.svd((panels.coefficient / worth).reshape(-1, points), full_matrices=False)
    modes = max(1, int(np.count_nonzero(size > 0.1 * tolerance * size[0])))
    courses = (left[:, :modes] * size[:modes]).reshape(degrees, count, modes) * worth
    # From values at the grid's Chebyshev points to coefficients, along both axes.
    grid = right[:modes].reshape(modes, across, along)
    series = np.einsum("la,mab,cb->mlc", _to_series(across), grid, _to_series(along), optimize=True)
    # What is left of a response below the tolerance is the quadrature's: a pulse is over by then.
    memory = memory_s(specimen, Panels(courses), 0.1 * tolerance)
    response = StepResponse(memory, Panels(courses))
    return FocusField(lateral_reach_m, axial_reach_m, response, series, lateral_inner_m, uneven)


def focus_response(specimen: Specimen, force: Force) -> StepResponse:
    """Return the step response at the focus: of a Gaussian in closed form, of a sum of them to 1e-7 of itself."""
    return (
        _kept_sum_response(specimen, force)
        if isinstance(force, GaussianSum)
        else tabulate_step_response(specimen, force)
    )


@lru_cache(maxsize=8)
def _kept_sum_response(specimen: Specimen, force: GaussianSum) -> StepResponse:
    spectrum = _focus_spectrum(force)
    panels = panels_of(lambda s: spectrum.transfer(specimen, s), _turned(FIELD_CONTOUR, spectrum.ray / _RAY))
    return StepResponse(memory_s(specimen, panels), panels)


def focus_transfer(specimen: Specimen, force: Force, frequency_hz: FloatArray) -> ComplexArray:
    """Return displacement at the focus over body force there, complex (frequency,), as `frequency_response` does."""
    if not isinstance(force, GaussianSum):
        return frequency_response(specimen, force, frequency_hz)
    s = np.asarray(2j * np.pi * np.asarray(frequency_hz), np.complex128)
    return _focus_spectrum(force).transfer(specimen, s)[:, 0]


@lru_cache(maxsize=8)
def _focus_spectrum(force: GaussianSum) -> _Spectrum:
    """Kept: a plan's checks ask for the motion of the focus at every frequency and estimator."""
    return _Spectrum(force, np.zeros(1), np.zeros(1))


def _worth(specimen: Specimen, panels: Panels) -> FloatArray:
    """Return the displacement that an error counts against in every panel (panel,), but for a common factor."""
    if not creeps_for_ever(specimen):
        return np.ones(panels.coefficient.shape[1])
    # In hours a medium creeps so far that all its motion under a toneburst would be less than the tolerance.
    farthest = np.maximum.accumulate(np.abs(panels.coefficient).sum(axis=0).max(axis=1))
    least = farthest[np.searchsorted(panels.begins_s, _CREEP_S) - 1]
    return np.asarray(np.maximum(farthest, least) / least)


@dataclass(frozen=True, slots=True)
class MediumMotion:
    """The field's modes at the scatterers, and what drives them."""

    shape: FloatArray
    """(mode, scatterer)"""
    field: FocusField
    specimen: Specimen
    transmitter: Transmitter
    travel_s: float
    share: Share | None = None

    def amplitudes_m(self, tonebursts: Bursts, time_ps: Int64Array) -> FloatArray:
        """Return every mode's amplitude at ``time_ps`` (time,) under ``tonebursts``: (time, mode)."""
        force = radiation_force(tonebursts, self.specimen, self.travel_s, self.transmitter, self.share)
        return transients(self.field.response, force, time_ps)

    def displacement_m(self, tonebursts: Bursts, time_ps: Int64Array, lateral_m: float) -> FloatArray:
        """Return the displacement beside the focus at ``time_ps`` (time,)."""
        shape = self.field.shapes(np.array([abs(lateral_m)]), np.zeros(1))
        # one response in place of as many as there are modes: the table is summed over them first
        response = self.field.response
        there = StepResponse(response.memory_s, Panels(response.panels.coefficient @ shape.T))
        force = radiation_force(tonebursts, self.specimen, self.travel_s, self.transmitter, self.share)
        return transients(there, force, time_ps)[:, 0]


def medium_motion(
    settings: SimulationSettings, offset_m: FloatArray, travel_s: float, beside_m: float = 0.0
) -> MediumMotion:
    """Return the motion of scatterers at ``offset_m`` (scatterer, 3) from the focus, and of a point beside it.

    Needs ``settings.specimen``; ``beside_m`` is that point's distance from the axis.
    """
    specimen = settings.specimen or Specimen()
    lateral_m, axial_m = np.hypot(offset_m[:, 0], offset_m[:, 1]), offset_m[:, 2]
    # At least the force's own widths, so that a single scatterer at the focus leaves a field to tabulate.
    force = force_shape(settings)
    width_m = _scale(_gaussians(force))
    reach_m = [
        max(float(np.abs(at).max(initial=least)), width)
        for at, least, width in ((lateral_m, abs(beside_m), width_m[0]), (axial_m, 0.0, width_m[1]))
    ]
    # Far beside the axis only the shell that holds scatterers is tabulated.
    inner_m = float(lateral_m.min(initial=abs(beside_m)))
    # a shell of some thickness, though every scatterer be as far from the axis as the tracking beam
    reach_m[0] = max(reach_m[0], inner_m + width_m[0] / 100)
    field = _kept_field(specimen, force, *reach_m, lateral_inner_m=inner_m if inner_m > width_m[0] else 0.0)
    shape = field.shapes(lateral_m, axial_m).T
    return MediumMotion(shape, field, specimen, settings.transmitter, travel_s, force_share(settings))


# Of the settings and the draw of scatterers alone: repeated measurements of one scene share it.
_kept_field = lru_cache(maxsize=8)(focus_field)


def field_transfer(
    specimen: Specimen, force: Force, lateral_m: FloatArray, axial_m: FloatArray, frequency_hz: FloatArray
) -> ComplexArray:
    """Return displacement over body force on a grid, (frequency, lateral, axial), m per N/m^3, factor exp(+jwt)."""
    s = np.asarray(2j * np.pi * np.asarray(frequency_hz), np.complex128)
    value = _Spectrum(_gaussians(force), lateral_m, axial_m).transfer(specimen, s)
    return value.reshape(len(s), len(lateral_m), len(axial_m))


def _gaussians(force: Force) -> GaussianSum:
    """Return the force as a sum of Gaussians. Raises ``ValueError`` for one of unequal lateral widths."""
    if isinstance(force, GaussianSum):
        return force
    if not math.isclose(force[0], force[1], rel_tol=1e-12):
        raise ValueError(
            f"the field around the focus needs a round beam, its widths are {force[0]:g} m and {force[1]:g} m. "
            'Try: simulation.specimen.field = "gaussian", or equal excitation widths.'
        )
    return GaussianSum((force[0],), force[2], (0.0,), ((1.0,),))


def _scale(force: GaussianSum) -> tuple[float, float]:
    """Return over what lengths the force changes, across and along: those of the Gaussian, or of the narrowest."""
    return force.lateral_width_m[0], force.axial_width_m


class _Spectrum:
    """What the force's spectrum puts into every point from every wave number on the ray: computed once a geometry."""

    def __init__(self, force: GaussianSum, lateral_m: FloatArray, axial_m: FloatArray) -> None:
        directions = _Directions(force)
        self.ray = _ray(directions, float(lateral_m.max()), float(np.abs(axial_m).max()))
        self._k2, into = _ray_spectrum(directions, lateral_m, axial_m, self.ray)
        self._k2_into = self._k2[:, None] * into

    def transfer(self, specimen: Specimen, s_per_s: ComplexArray) -> ComplexArray:
        """Return the displacement at every point, (s, point)."""
        modulus = shear_modulus(specimen, s_per_s)
        pole = specimen.density_kg_per_m3 * s_per_s**2 / modulus
        # at rest too
        pole[pole == 0] = np.finfo(np.float64).tiny
        displaced = np.empty((len(pole), self._k2_into.shape[1]), np.complex128)
        order = np.argsort(np.abs(pole))
        size, length2, power = np.abs(pole)[order], np.abs(self._k2), np.arange(_TERMS)
        # k^2 / (k^2 + pole): of poles of one size the fraction hangs on both where wave numbers are near; where one of
        # the two outweighs the other it is a power series in their ratio, whose sums over wave numbers serve all poles.
        for poles in np.split(order, np.flatnonzero(np.diff(np.floor(np.log2(size) / 4))) + 1):
            p, least, most = pole[poles], abs(pole[poles[0]]), abs(pole[poles[-1]])
            # the wave numbers grow along the ray
            low, high = np.searchsorted(length2, [least / _OUTWEIGHS, most * _OUTWEIGHS])
            short, near, long = self._k2[high:], self._k2[low:high], self._k2[:low]
            by_short = (most / short) ** power[:, None] / short @ self._k2_into[high:]
            by_long = (long / least) ** power[:, None] @ self._k2_into[:low]
            displaced[poles] = (
                (1 / (near + p[:, None])) @ self._k2_into[low:high]
                + (-p[:, None] / most) ** power @ by_short
                + (-least / p[:, None]) ** power / p[:, None] @ by_long
            )
        return np.asarray(displaced / modulus[:, None])


class _Directions:
    """The force's spectrum along each direction of a wave, whose cosine with the axis is ``m`` (direction,)."""

    def __init__(self, force: GaussianSum) -> None:
        widths = np.array(force.lateral_width_m)
        # The nodes of the narrowest Gaussian, whose spectrum is the most crowded at m = 0, serve all.
        self.m, self.least, self.share = polar_nodes(float(widths.min()) ** 2, force.axial_width_m**2)
        self._half = (np.outer(1 - self.m**2, widths**2) + (force.axial_width_m * self.m[:, None]) ** 2) / 2
        volumes = [force_volume((width, width, force.axial_width_m)) for width in force.lateral_width_m]
        self._centre_m, self._strength = np.array(force.centre_m), np.array(force.share) * np.array(volumes)
        self.farthest_m = float(np.abs(self._centre_m).max())

    def spectra(self, k: ComplexArray, seen: BoolArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Return its even and odd part along the directions ``seen``, (k, direction); None: it has no odd one."""
        # (k, direction, width)
        spread = np.exp(-(k**2)[:, None, None] * self._half[seen]) * self.share[seen, None]
        if not self._centre_m.any():
            return np.asarray(spread @ self._strength[0]), None
        turn = np.multiply.outer(np.outer(k, self.m[seen]), self._centre_m)
        at_centre = np.einsum("ji,kmi->kmj", self._strength, spread, optimize=True)
        return np.asarray((np.cos(turn) * at_centre).sum(axis=2)), np.asarray((np.sin(turn) * at_centre).sum(axis=2))


def _ray(directions: _Directions, lateral_reach_m: float, axial_reach_m: float) -> float:
    """Return the angle up to which waves along the ray grow at most to ``_LARGEST_GROWTH_EXPONENT`` in any point."""
    m, a = directions.m, directions.least
    reach_m = lateral_reach_m * np.sqrt(1 - m**2) + (axial_reach_m + directions.farthest_m) * m
    # exp(|k| r sin(ray) - a |k|^2 cos(2 ray)) is largest at r^2 sin(ray)^2 / (4 a cos(2 ray))
    most = float((reach_m**2 / (4 * a)).max())
    return min(_RAY, math.asin(math.sqrt(_LARGEST_GROWTH_EXPONENT / (most + 2 * _LARGEST_GROWTH_EXPONENT))))


def _turned(contour: Contour, share: float) -> Contour:
    """Return a hyperbola with this share of the angle, as exact: it passes its poles nearer, with more nodes."""
    if share == 1.0:
        return contour
    alpha = contour.alpha * share
    span = math.acosh(math.cosh(contour.span) * math.sin(contour.alpha) / math.sin(alpha))
    return replace(contour, nodes=math.ceil(contour.nodes / share), span=span, alpha=alpha)


def _ray_spectrum(
    directions: _Directions, lateral_m: FloatArray, axial_m: FloatArray, ray: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return the squares of the wave numbers, (k,), and their weighted share in every point, (k, point)."""
    m, a = directions.m, directions.least
    turn, finer = np.exp(1j * ray), _RAY / ray
    reach_m = lateral_m.max() * np.sqrt(1 - m**2) + (np.abs(axial_m).max() + directions.farthest_m) * m
    highest = float(_highest(a, reach_m, ray).max())
    bessel = _BesselOnRay(turn, highest * float(lateral_m.max()))
    edges = highest * 2.0 ** np.arange(-_OCTAVES, 1)
    k2, into = [], []
    for octave, (low, high) in enumerate(zip([0.0, *edges[:-1]], edges, strict=True)):
        short = octave > _OCTAVES - _SHORT_OCTAVES
        count = _NODES_WHERE_WAVES_ARE_SHORT if short else _NODES_AN_OCTAVE
        node, weight = legendre(math.ceil(count * finer))
        along_ray = (high + low) / 2 + (high - low) / 2 * node
        k = turn * along_ray
        # Directions in which the force is too long for these wave numbers put nothing into any point.
        fall = a * (low * low * math.cos(2 * ray))
        seen = fall - high * reach_m * math.sin(ray) < _NEGLIGIBLE_EXPONENT
        sine, cosine = np.sqrt(1 - m[seen] ** 2)[:, None], m[seen][:, None]
        even, odd = directions.spectra(k, seen)
        # (k, direction, lateral) and (k, direction, axial): the wave across the axis and along it.
        across = bessel.at(along_ray[:, None, None] * (sine * lateral_m))
        phase = k[:, None, None] * cosine * axial_m
        along = even[:, :, None] * np.cos(phase)
        if odd is not None:
            along += odd[:, :, None] * np.sin(phase)
        # Summed over directions: what these wave numbers put into every point, (k, lateral, axial).
        block = np.einsum("kml,kma->kla", across, along, optimize=True)
        k2.append(k**2)
        into.append(block.reshape(len(k), -1) * (turn * (high - low) / 2 * weight)[:, None])
    return np.concatenate(k2), np.concatenate(into)


class _BesselOnRay:
    """J0 at distances from 0 along the ray, by a polynomial in each cell of a table: to 4e-15 of exp(|Im z|).

    One cell is half a radian long; jv of complex arguments takes ten times as long as its polynomial.
    """

    def __init__(self, turn: complex, farthest: float) -> None:
        # Here, so that what needs no field does not load it.
        from scipy.special import jv

        node = np.cos((np.arange(_CELL_NODES) + 0.5) * np.pi / _CELL_NODES)
        middle = (np.arange(int(farthest / _CELL) + 1) + 0.5) * _CELL
        value = jv(0, turn * (middle + node[:, None] * _CELL / 2))
        self._polynomial = np.linalg.solve(np.vander(node).astype(np.complex128), value)

    def at(self, distance: FloatArray) -> ComplexArray:
        """Return J0 at ``distance``, any shape, from 0 to ``farthest``."""
        cell, place = np.divmod(distance / _CELL, 1.0)
        here, place = cell.astype(np.intp), 2 * place - 1
        value = self._polynomial[0][here]
        for row in self._polynomial[1:]:
            value = value * place + row[here]
        return np.asarray(value)


def _highest(a: FloatArray, distance_m: FloatArray, ray: float) -> FloatArray:
    """Return |k| where the force's spectrum, which falls, outweighs the waves, which grow along the ray off it."""
    fall, growth = a * math.cos(2 * ray), distance_m * math.sin(ray)
    return np.asarray((growth + np.sqrt(growth**2 + 4 * _NEGLIGIBLE_EXPONENT * fall)) / (2 * fall))


def _nodes(count: int) -> FloatArray:
    """Return Chebyshev's points of 0 to 1, (count,)."""
    return np.asarray((np.cos((np.arange(count) + 0.5) * np.pi / count) + 1) / 2)


def _to_series(count: int) -> FloatArray:
    """Return the matrix from values at `_nodes` to Chebyshev coefficients, (degree, node)."""
    series = np.cos(np.outer(np.arange(count), (np.arange(count) + 0.5) * np.pi / count)) * (2 / count)
    series[0] /= 2
    return np.asarray(series)
