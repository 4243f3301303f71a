"""Ensemble of viscoelastic media: how each moves at the focus of a Gaussian radiation force, tracked and at its peak.

Five families of media, their parameters spread evenly over what soft tissue and phantoms show, and force widths spread
about the declared ones. The displacement is a closed form at each wave direction and frequency:

    U = F0 sx^2 sz / (sqrt(2 pi) mu) int_0^1 2 (1 - m^2) [sqrt(pi/a)/2 + j pi q w(q sqrt(a)) / 2] dm,
    a = (sx^2 (1 - m^2) + sz^2 m^2) / 2,   q^2 = rho w^2 / mu,   Im q >= 0,

w() the Faddeeva function, m the cosine of a wave's direction with the beam; time factor exp(+jwt). See
docs/theory/medium-prior.md.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium.push_force import PushForce

Triple = tuple[float, float, float]

MEMBERS = 240
MEMBERS_BESIDE = 60
"""The same beside the push, where a member takes some ms."""
TURNING_HZ = 8e3
"""Frequency up to which a wave that has run turns too fast to be interpolated; beyond, none comes, and what the force
moves by itself is smooth."""
SMOOTH_NODES = 16
"""Frequencies above, from which what is left is interpolated to 6e-5 of the rms motion (rms of the members)."""
FAMILIES = 5
DIRECTIONS = 12
"""Quadrature nodes over wave directions: the displacement is good to 3e-4 of itself, in the paper's beams."""
NODES_PER_E_FOLD = 6.0
"""Frequencies a factor e at which media are evaluated: what lies between is interpolated to 1e-4 of the largest."""
SPHERE_NODES_PER_E_FOLD = 12.0
"""The same of a sphere, which resonates: to 2e-4 of a member's rms motion in the worst of them, 5e-7 in the median."""

SHAPE_NODES, LOSS_NODES = 40, 5
"""Wave numbers and loss angles at which a force that is no Gaussian is compared with one: to 5e-4 of the motion (rms),
to 3e-3 in nearly elastic media."""
LARGEST_WAVE = 12.0
"""Wave number times the force's width from which on both move the focus alike, but for a factor."""

MODULUS_PA = (1e3, 60e3)
VISCOSITY_PA_S = (0.2, 15.0)
LOW_VISCOSITY_PA_S = (0.005, 0.2)
MAXWELL_VISCOSITY_PA_S = (0.5, 50.0)
BRANCH_OVER_MODULUS = (0.2, 10.0)
POWER = (0.02, 0.6)
POWER_REFERENCE_HZ = 200.0
"""Frequency at which a power-law medium has its modulus."""


@dataclass(frozen=True, slots=True)
class BeamWidths:
    """Sigmas of the Gaussian body force and of the tracking beam (x, y, z), m; both round, x counts.

    ``axial_spread_m``: standard deviation of depth in the gate, weighted by echo energy. ``width_spread``: standard
    deviation of the logarithm of the force's widths, which no one has measured in the medium. ``lateral_m``: where the
    tracking beam lies beside the force. ``together_m``: all such places of a run, this one among them, whose ensembles
    are computed at once, in the time of the farthest; empty for this one alone. ``force``: its shape, where it is not
    that Gaussian; on its axis alone.
    """

    force_width_m: Triple
    tracking_width_m: Triple
    axial_spread_m: float
    width_spread: float = 0.3
    lateral_m: float = 0.0
    together_m: tuple[float, ...] = ()
    force: PushForce | None = None


@dataclass(frozen=True, slots=True)
class KnownMedium:
    """Voigt medium known in advance, and standard deviations of the logarithms of its two parameters."""

    shear_modulus_pa: float
    shear_viscosity_pa_s: float
    modulus_spread: float = 0.3
    viscosity_spread: float = 0.5


@dataclass(frozen=True, slots=True)
class RigidSphere:
    """Rigid sphere in the medium, which the tonebursts push and whose front echoes: it moves as a whole."""

    radius_m: float
    density_kg_per_m3: float

    def response(self, modulus_pa: ComplexArray, density_kg_per_m3: float, s_per_s: ComplexArray) -> ComplexArray:
        """Return displacement over force, m/N, of moduli (..., frequency) of the medium at ``s_per_s`` (frequency,).

        Oestreicher's impedance in an incompressible medium: docs/theory/medium.md, section 8.
        """
        wave = self.radius_m * s_per_s * np.sqrt(density_kg_per_m3 / modulus_pa)
        mass_kg = 4 / 3 * np.pi * self.radius_m**3 * self.density_kg_per_m3
        drag = 6 * np.pi * self.radius_m * modulus_pa * (1 + wave + wave**2 / 9)
        return np.asarray(1 / (drag + mass_kg * s_per_s**2))


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Displacement per unit force of every member, complex (member, node), at the frequencies ``node_hz`` (node,).

    ``tracked`` is the mean over the tracking beam and gate, ``peak`` that on its axis at the focus; both but for one
    real factor a member. ``steepness``: how ``tracked`` changes with the logarithm of the tracking beam's area, which
    is what speckle changes; beside the push also with the beam's place. ``voigt`` (member,) tells Voigt media.
    ``alone``: how many nodes, the first, stand for their own frequency alone. Read-only.
    """

    node_hz: FloatArray
    tracked: ComplexArray
    peak: ComplexArray
    steepness: ComplexArray
    voigt: BoolArray
    alone: int = 0

    def interpolation(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the matrix (frequency, node) that takes values at the nodes to ``frequency_hz`` within their range."""
        own = np.isclose(frequency_hz[:, None], self.node_hz[: self.alone])
        between = self.node_hz[self.alone :]
        if not between.size:
            return own.astype(np.float64)
        found = np.zeros((frequency_hz.size, self.node_hz.size))
        found[:, : self.alone] = own
        smooth = ~own.any(axis=1)
        found[smooth, self.alone :] = _interpolation(frequency_hz[smooth], between)
        return found


def medium_ensemble(
    pushed: BeamWidths | RigidSphere,
    lowest_hz: float,
    highest_hz: float,
    known: KnownMedium | None = None,
    density_kg_per_m3: float = 1000.0,
    members: int = MEMBERS,
) -> Ensemble:
    """Return the ensemble between two frequencies; of the ``known`` medium alone where there is one.

    ``pushed``: the medium itself, in beams of these widths, or a sphere in it, of which all of the motion is tracked.
    The parameters fill their ranges evenly by a low-discrepancy sequence: no chance, hence no seed.
    """
    # What is remembered goes by place: however a caller words its arguments, an ensemble is made once.
    if isinstance(pushed, RigidSphere):
        return _of_sphere(pushed, lowest_hz, highest_hz, known, density_kg_per_m3, members)
    if pushed.lateral_m:
        places_m = pushed.together_m or (pushed.lateral_m,)
        alike = replace(pushed, lateral_m=0.0, together_m=places_m)
        return _beside(alike, lowest_hz, highest_hz, known, density_kg_per_m3)[places_m.index(pushed.lateral_m)]
    return _on_axis(replace(pushed, together_m=()), lowest_hz, highest_hz, known, density_kg_per_m3, members)


def _of_sphere(
    sphere: RigidSphere,
    lowest_hz: float,
    highest_hz: float,
    known: KnownMedium | None,
    density_kg_per_m3: float,
    members: int,
) -> Ensemble:
    node_hz = _nodes(lowest_hz, highest_hz, _node_count(lowest_hz, highest_hz, SPHERE_NODES_PER_E_FOLD))
    s, spread = np.asarray(2j * np.pi * node_hz, np.complex128), _even_sequence(members, 5)
    modulus_pa = _known_modulus(known, s, spread) if known else _modulus(s, spread)
    moved = sphere.response(modulus_pa, density_kg_per_m3, s)
    return Ensemble(node_hz, moved, moved, np.zeros_like(moved), _voigt(members, known))


@functools.lru_cache(maxsize=32)
def _on_axis(
    beams: BeamWidths,
    lowest_hz: float,
    highest_hz: float,
    known: KnownMedium | None,
    density_kg_per_m3: float,
    members: int,
) -> Ensemble:
    """Return the ensemble where the tracking beam lies on the force's axis."""
    force = beams.force_width_m, beams.width_spread
    pushed = _pushed(*force, lowest_hz, highest_hz, known, density_kg_per_m3, members)
    # Speckle weights by energy, a Gaussian of variance T^2/2 across: a force as much broader, of the same density.
    area, depth = beams.tracking_width_m[0] ** 2 / 2, pushed.axial + beams.axial_spread_m**2
    tracked, by_area = displacement_and_slope(pushed.shear_k2, pushed.lateral + area, depth)
    # what the force moves over what a Gaussian of its widths moves; the share that is tracked stays the Gaussian's
    shape = 1.0 if beams.force is None else _of_shape(beams, pushed.shear_k2, pushed.wide)
    tracked, peak, change = np.stack([tracked, pushed.peak, area * by_area]) * (shape / pushed.modulus_pa)
    found = Ensemble(pushed.node_hz, tracked, peak, change, _voigt(members, known))
    for array in (found.node_hz, found.tracked, found.peak, found.steepness, found.voigt):
        array.flags.writeable = False
    return found


@dataclass(frozen=True, slots=True)
class _Pushed:
    """Media under Gaussian forces, whatever is tracked of them: complex (member, node), real (member,).

    ``lateral``, ``axial``: squared widths of the force, which is ``wide`` times as wide as declared. ``peak``: times
    the modulus, the motion at the focus.
    """

    node_hz: FloatArray
    modulus_pa: ComplexArray
    shear_k2: ComplexArray
    wide: FloatArray
    lateral: FloatArray
    axial: FloatArray
    peak: ComplexArray


@functools.lru_cache(maxsize=8)
def _pushed(
    force_width_m: Triple,
    width_spread: float,
    lowest_hz: float,
    highest_hz: float,
    known: KnownMedium | None,
    density_kg_per_m3: float,
    members: int,
) -> _Pushed:
    """Return what the ensembles of all gates on the axis have in common."""
    from scipy.special import ndtri

    node_hz = _nodes(lowest_hz, highest_hz, _node_count(lowest_hz, highest_hz, NODES_PER_E_FOLD))
    spread = _even_sequence(members, 5)
    s = np.asarray(2j * np.pi * node_hz, np.complex128)
    modulus_pa = _known_modulus(known, s, spread) if known else _modulus(s, spread)
    shear_k2 = -density_kg_per_m3 * s**2 / modulus_pa
    wide, deep = np.exp(width_spread * ndtri(spread[:, 3:5])).T
    lateral, axial = (force_width_m[0] * wide) ** 2, (force_width_m[2] * deep) ** 2
    peak = displacement(shear_k2, lateral, axial)
    return _Pushed(node_hz, modulus_pa, shear_k2, wide, lateral, axial, peak)


def _of_shape(beams: BeamWidths, shear_k2: ComplexArray, wide: FloatArray) -> ComplexArray:
    """Return the motion under ``beams.force`` over that under the Gaussian, (member, node).

    Both times the modulus hang on the squared wave number alone: on its size, which counts in widths of the force, and
    on its angle, the medium's loss. ``wide`` (member,) times as wide as declared, a force of the same shape meets waves
    that are as much longer.
    """
    wave, angle = np.sqrt(np.abs(shear_k2)), np.clip(-np.angle(shear_k2), 0.0, np.pi / 2)
    lowest, highest = float(wave.min()), min(float(wave.max()), LARGEST_WAVE / beams.force_width_m[0])
    node, loss = _nodes(lowest, highest, SHAPE_NODES), np.pi / 4 * (1 - np.cos(np.linspace(0, np.pi, LOSS_NODES)))
    moved = _shape(replace(beams, together_m=()), tuple(node.tolist()), tuple(loss.tolist()))
    vander = np.polynomial.chebyshev.chebvander
    by_wave = np.linalg.solve(vander(_position(node, lowest, highest), SHAPE_NODES - 1), moved)
    both = np.linalg.solve(vander(4 * loss / np.pi - 1, LOSS_NODES - 1), by_wave.T).T
    place = _position(np.clip(wave * wide[:, None], lowest, highest), lowest, highest)
    across, along = vander(place, SHAPE_NODES - 1) @ both, vander(4 * angle / np.pi - 1, LOSS_NODES - 1)
    return np.asarray(np.sum(across * along, axis=-1))


@functools.lru_cache(maxsize=8)
def _shape(beams: BeamWidths, wave_per_m: tuple[float, ...], loss_rad: tuple[float, ...]) -> ComplexArray:
    """Return the same at wave numbers of these sizes and moduli of these angles, (wave, loss)."""
    from hpe_rig.medium.shear_field import shear_motion

    (x, _, z), tracked = beams.force_width_m, (beams.tracking_width_m[0] ** 2 / 2, beams.axial_spread_m**2)
    wave, loss = np.meshgrid(wave_per_m, loss_rad, indexing="ij")
    # any density and frequency that give these wave numbers
    omega, density = 2 * np.pi, 1000.0
    modulus_pa = np.asarray(density * (omega / wave) ** 2 * np.exp(1j * loss), np.complex128).ravel()
    once_hz = np.ones(modulus_pa.size)
    own, gaussian = (
        shear_motion(modulus_pa, once_hz, density, force, *tracked, np.zeros(1), quick=True).value[:, 0]
        for force in (beams.force, PushForce((x,), z))
        if force is not None
    )
    return np.asarray((own / gaussian).reshape(wave.shape))


@functools.lru_cache(maxsize=8)
def _beside(
    beams: BeamWidths, lowest_hz: float, highest_hz: float, known: KnownMedium | None, density_kg_per_m3: float
) -> tuple[Ensemble, ...]:
    """Return the ensembles at every place (``together_m``) beside the force, by ``focal_motion``."""
    from scipy.special import ndtri

    node_hz, alone = _nodes_beside(lowest_hz, highest_hz)
    spread, places_m = _even_sequence(MEMBERS_BESIDE, 5), np.array(beams.together_m)
    s = np.asarray(2j * np.pi * node_hz, np.complex128)
    modulus_pa = _known_modulus(known, s, spread) if known else _modulus(s, spread)
    wide, deep = np.exp(beams.width_spread * ndtri(spread[:, 3:5])).T
    found = np.empty((places_m.size, 3, MEMBERS_BESIDE, node_hz.size), np.complex128)
    for member, (across_m, along_m) in enumerate(
        zip(beams.force_width_m[0] * wide, beams.force_width_m[2] * deep, strict=True)
    ):
        own = replace(beams, force_width_m=(across_m, across_m, along_m))
        seen = seen_beside(modulus_pa[member], density_kg_per_m3, node_hz, own, places_m)
        found[:, :, member] = np.moveaxis(np.stack(seen), -1, 0)
    found.flags.writeable = False
    voigt = _voigt(MEMBERS_BESIDE, known)
    return tuple(Ensemble(node_hz, there[0], there[1], there[2], voigt, alone) for there in found)


def _voigt(members: int, known: KnownMedium | None) -> BoolArray:
    """Return which members (member,) are Voigt media."""
    return np.arange(members) % FAMILIES == 0 if known is None else np.ones(members, bool)


def _node_count(lowest_hz: float, highest_hz: float, per_e_fold: float) -> int:
    return max(8, round(float(per_e_fold * np.log(highest_hz / lowest_hz))))


def _nodes_beside(lowest_hz: float, highest_hz: float) -> tuple[FloatArray, int]:
    """Return the nodes (node,) beside the push, and how many, the first, are the harmonics up to ``TURNING_HZ``."""
    harmonic_hz = lowest_hz * np.arange(1.0, round(highest_hz / lowest_hz) + 1)
    alone = int(np.sum(harmonic_hz <= TURNING_HZ))
    if harmonic_hz.size - alone <= SMOOTH_NODES:
        return harmonic_hz, harmonic_hz.size
    return np.concatenate([harmonic_hz[:alone], _nodes(harmonic_hz[alone], highest_hz, SMOOTH_NODES)]), alone


def seen_beside(
    modulus_pa: ComplexArray,
    density_kg_per_m3: float,
    frequency_hz: FloatArray,
    beams: BeamWidths,
    lateral_m: FloatArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return tracked and peak displacement and steepness (frequency, place), per body force, beside the push.

    At ``lateral_m`` (place,). Speckle moves the middle of what is tracked as well as its area, each by the same share
    of its radius: the steepness is the root sum of squares of both, real part along the tracked phasor, imaginary
    across.
    """
    from hpe_rig.medium.shear_field import focal_motion

    (x, _, z), seen = beams.force_width_m, beams.tracking_width_m[0] ** 2 / 2
    medium = modulus_pa, frequency_hz, density_kg_per_m3, (x, z)
    tracked, by_area, by_place = focal_motion(*medium, x**2 + seen, z**2 + beams.axial_spread_m**2, lateral_m)
    wider, aside = seen * by_area / tracked, np.sqrt(seen) * by_place / tracked
    steep = np.hypot(wider.real, aside.real) + 1j * np.hypot(wider.imag, aside.imag)
    return tracked, focal_motion(*medium, x**2, z**2, lateral_m)[0], tracked * steep


_legendre = functools.cache(np.polynomial.legendre.leggauss)
"""Nodes and weights of Gauss's quadrature, by their number."""


def displacement(
    shear_k2: ComplexArray, lateral: FloatArray, axial: FloatArray, directions: int = DIRECTIONS
) -> ComplexArray:
    """Return the displacement times the modulus but for a real factor, (member, frequency).

    ``shear_k2`` (member, frequency) is the squared wave number, ``lateral`` and ``axial`` (member,) the squared widths
    of the force.
    """
    q, root_a, w, weight, _ = _waves(shear_k2, lateral, axial, directions)
    return _sum(np.sqrt(np.pi) / 2 / root_a + 0.5j * np.pi * q * w, weight)


def displacement_and_slope(
    shear_k2: ComplexArray, lateral: FloatArray, axial: FloatArray, directions: int = DIRECTIONS
) -> tuple[ComplexArray, ComplexArray]:
    """Return ``displacement`` and its derivative by ``lateral``, (member, frequency)."""
    q, root_a, w, weight, transverse = _waves(shear_k2, lateral, axial, directions)
    still, moving = np.sqrt(np.pi) / 2 / root_a, 0.5j * np.pi * q * w
    # by a, with w'(z) = 2j / sqrt(pi) - 2 z w(z); da / d lateral = transverse / 2
    by_a = -still * (0.5 / root_a**2 + q**2) - q**2 * moving
    return _sum(still + moving, weight), _sum(by_a, weight * transverse / 2)


def _waves(
    shear_k2: ComplexArray, lateral: FloatArray, axial: FloatArray, directions: int
) -> tuple[ComplexArray, FloatArray, ComplexArray, FloatArray, FloatArray]:
    """Return q, sqrt(a) and w(q sqrt(a)) of the waves in each direction, their weights in the integral, and 1 - m^2.

    The first three broadcast to (member, frequency, direction), the others are (member, direction).
    """
    # Here, as below: a prescribed motion has no medium, and needs no special functions.
    from scipy.special import wofz

    node, weight = _legendre(directions)
    # In the variable that makes a needle's spectrum smooth: m = tan(angle) / slope.
    slope = np.sqrt(np.maximum(axial / lateral - 1, 1e-12))[:, None]
    angle = np.arctan(slope) * (node + 1) / 2
    m = np.tan(angle) / slope
    weight = weight * np.arctan(slope) / 2 / (slope * np.cos(angle) ** 2)
    root_a = np.sqrt((lateral[:, None] * (1 - m**2) + axial[:, None] * m**2) / 2)[:, None]
    q = np.sqrt(shear_k2)
    q = np.where(q.imag < 0, -q, q)[:, :, None]
    return q, root_a, wofz(q * root_a), weight * 2 * (1 - m**2), 1 - m**2


def _sum(waves: ComplexArray, weight: FloatArray) -> ComplexArray:
    """Return the sum over directions, (member, frequency)."""
    return np.asarray((waves @ weight[:, :, None])[..., 0])


def _modulus(s: ComplexArray, spread: FloatArray) -> ComplexArray:
    """Return the complex modulus (member, frequency): Voigt, Zener, power law, nearly elastic, Maxwell in turn."""
    modulus = _log_even(spread[:, 0], MODULUS_PA)[:, None]
    viscosity = _log_even(spread[:, 1], VISCOSITY_PA_S)[:, None]
    low_viscosity = _log_even(spread[:, 1], LOW_VISCOSITY_PA_S)[:, None]
    fluid_viscosity = _log_even(spread[:, 1], MAXWELL_VISCOSITY_PA_S)[:, None]
    branch = modulus * _log_even(spread[:, 2], BRANCH_OVER_MODULUS)[:, None]
    power = (POWER[0] + (POWER[1] - POWER[0]) * spread[:, 2])[:, None]
    families = (
        modulus + s * viscosity,
        modulus + s * viscosity / (1 + s * viscosity / branch),
        modulus * (s / (2 * np.pi * POWER_REFERENCE_HZ)) ** power,
        modulus + s * low_viscosity,
        s * fluid_viscosity / (1 + s * fluid_viscosity / modulus),
    )
    return np.asarray(np.choose((np.arange(len(spread)) % FAMILIES)[:, None], families))


def _known_modulus(known: KnownMedium, s: ComplexArray, spread: FloatArray) -> ComplexArray:
    from scipy.special import ndtri

    scale = np.exp(ndtri(spread[:, :2]) * [known.modulus_spread, known.viscosity_spread])
    return np.asarray(known.shear_modulus_pa * scale[:, :1] + s * (known.shear_viscosity_pa_s * scale[:, 1:]))


def _log_even(share: FloatArray, limits: tuple[float, float]) -> FloatArray:
    return np.asarray(limits[0] * (limits[1] / limits[0]) ** share)


def _even_sequence(count: int, dimensions: int) -> FloatArray:
    """Return points (count, dimension) that fill the unit cube: multiples of 1/g^i, g^(d+1) = g + 1, modulo 1."""
    g = 1.5
    for _ in range(64):
        g = (1 + g) ** (1 / (dimensions + 1))
    return np.asarray((0.5 + np.outer(np.arange(1, count + 1), g ** -np.arange(1.0, dimensions + 1))) % 1)


def _nodes(lowest_hz: float, highest_hz: float, count: int) -> FloatArray:
    """Return Chebyshev nodes (node,) of the logarithm of frequency, both ends among them."""
    place = -np.cos(np.linspace(0, np.pi, count))
    return np.asarray(np.sqrt(lowest_hz * highest_hz) * (highest_hz / lowest_hz) ** (place / 2))


def _interpolation(frequency_hz: FloatArray, node_hz: FloatArray) -> FloatArray:
    """Return the matrix (frequency, node) of the polynomial in the logarithm of frequency through the nodes."""
    order = node_hz.size - 1
    position, node = (_position(each, node_hz[0], node_hz[-1]) for each in (frequency_hz, node_hz))
    chebyshev = np.polynomial.chebyshev.chebvander
    return np.asarray(np.linalg.solve(chebyshev(node, order).T, chebyshev(position, order).T).T)


def _position(frequency_hz: FloatArray, lowest_hz: float, highest_hz: float) -> FloatArray:
    """Return frequencies from -1 at the lowest to 1 at the highest, by their logarithm."""
    return np.asarray(2 * np.log(frequency_hz / lowest_hz) / np.log(highest_hz / lowest_hz) - 1)
