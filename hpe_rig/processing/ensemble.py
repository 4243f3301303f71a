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

from hpe_rig.processing.echoes import BoolArray, ComplexArray, FloatArray

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

AREA_STEP = 0.05
"""Relative step in the tracking beam's area over which a derivative is taken."""

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
    are computed at once, in the time of the farthest; empty for this one alone.
    """

    force_width_m: Triple
    tracking_width_m: Triple
    axial_spread_m: float
    width_spread: float = 0.3
    lateral_m: float = 0.0
    together_m: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class KnownMedium:
    """Voigt medium known in advance, and standard deviations of the logarithms of its two parameters."""

    shear_modulus_pa: float
    shear_viscosity_pa_s: float
    modulus_spread: float = 0.3
    viscosity_spread: float = 0.5


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
    beams: BeamWidths,
    lowest_hz: float,
    highest_hz: float,
    known: KnownMedium | None = None,
    density_kg_per_m3: float = 1000.0,
    members: int = MEMBERS,
) -> Ensemble:
    """Return the ensemble between two frequencies; of the ``known`` medium alone where there is one.

    The parameters fill their ranges evenly by a low-discrepancy sequence: no chance, hence no seed.
    """
    # What is remembered goes by place: however a caller words its arguments, an ensemble is made once.
    if beams.lateral_m:
        places_m = beams.together_m or (beams.lateral_m,)
        alike = replace(beams, lateral_m=0.0, together_m=places_m)
        return _beside(alike, lowest_hz, highest_hz, known, density_kg_per_m3)[places_m.index(beams.lateral_m)]
    return _on_axis(replace(beams, together_m=()), lowest_hz, highest_hz, known, density_kg_per_m3, members)


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
    from scipy.special import ndtri

    count = max(8, round(NODES_PER_E_FOLD * np.log(highest_hz / lowest_hz)))
    node_hz = _nodes(lowest_hz, highest_hz, count)
    spread = _even_sequence(members, 5)
    s = np.asarray(2j * np.pi * node_hz, np.complex128)
    modulus_pa = _known_modulus(known, s, spread) if known else _modulus(s, spread)
    shear_k2 = -density_kg_per_m3 * s**2 / modulus_pa
    wide, deep = np.exp(beams.width_spread * ndtri(spread[:, 3:5])).T
    lateral, axial = (beams.force_width_m[0] * wide) ** 2, (beams.force_width_m[2] * deep) ** 2
    # Speckle weights by energy, a Gaussian of variance T^2/2 across: a force as much broader, of the same density.
    area, depth = beams.tracking_width_m[0] ** 2 / 2, axial + beams.axial_spread_m**2
    tracked, wider = (displacement(shear_k2, lateral + each, depth) for each in (area, (1 + AREA_STEP) * area))
    found = Ensemble(
        node_hz,
        tracked / modulus_pa,
        displacement(shear_k2, lateral, axial) / modulus_pa,
        (wider - tracked) / np.log1p(AREA_STEP) / modulus_pa,
        np.arange(members) % FAMILIES == 0 if known is None else np.ones(members, bool),
    )
    for array in (found.node_hz, found.tracked, found.peak, found.steepness, found.voigt):
        array.flags.writeable = False
    return found


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
    voigt = np.arange(MEMBERS_BESIDE) % FAMILIES == 0 if known is None else np.ones(MEMBERS_BESIDE, bool)
    return tuple(Ensemble(node_hz, there[0], there[1], there[2], voigt, alone) for there in found)


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
    from hpe_rig.processing.shear_field import focal_motion

    (x, _, z), seen = beams.force_width_m, beams.tracking_width_m[0] ** 2 / 2
    medium = modulus_pa, frequency_hz, density_kg_per_m3, (x, z)
    tracked, by_area, by_place = focal_motion(*medium, x**2 + seen, z**2 + beams.axial_spread_m**2, lateral_m)
    wider, aside = seen * by_area / tracked, np.sqrt(seen) * by_place / tracked
    steep = np.hypot(wider.real, aside.real) + 1j * np.hypot(wider.imag, aside.imag)
    return tracked, focal_motion(*medium, x**2, z**2, lateral_m)[0], tracked * steep


def displacement(
    shear_k2: ComplexArray, lateral: FloatArray, axial: FloatArray, directions: int = DIRECTIONS
) -> ComplexArray:
    """Return the displacement times the modulus but for a real factor, (member, frequency).

    ``shear_k2`` (member, frequency) is the squared wave number, ``lateral`` and ``axial`` (member,) the squared widths
    of the force.
    """
    # Here, as below: a prescribed motion has no medium, and needs no special functions.
    from scipy.special import wofz

    node, weight = np.polynomial.legendre.leggauss(directions)
    # In the variable that makes a needle's spectrum smooth: m = tan(angle) / slope.
    slope = np.sqrt(np.maximum(axial / lateral - 1, 1e-12))[:, None]
    angle = np.arctan(slope) * (node + 1) / 2
    m = np.tan(angle) / slope
    weight = weight * np.arctan(slope) / 2 / (slope * np.cos(angle) ** 2)
    a = (lateral[:, None] * (1 - m**2) + axial[:, None] * m**2) / 2
    q = np.sqrt(shear_k2)
    q = np.where(q.imag < 0, -q, q)[:, :, None]
    waves = np.sqrt(np.pi / a)[:, None] / 2 + 0.5j * np.pi * q * wofz(q * np.sqrt(a)[:, None])
    return np.asarray((waves @ (weight * 2 * (1 - m**2))[:, :, None])[..., 0])


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
