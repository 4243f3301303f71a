"""Ensemble of viscoelastic media: the displacement of each under a Gaussian force, as tracked and at its peak.

Five families of media (``FAMILIES``), their parameters spread evenly over the ranges of soft tissue and phantoms, and
force widths spread about the declared ones. The members are the statistics behind the medium prior. On the force's
axis the displacement has a closed form (``focal_field``); off the axis it is an integral (``shear_field``). A rigid
sphere in the medium moves as a whole. See docs/explanation/medium-prior.md.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium.beam_averaging import BeamWidths, off_axis_motion
from hpe_rig.medium.focal_field import focal_displacement
from hpe_rig.medium.material_laws import LAWS, POWER_REFERENCE_HZ, HarmonicMedium
from hpe_rig.medium.push_force import PushForce, burst_spectrum

MEMBERS = 240
OFF_AXIS_MEMBERS = 60
"""Members off the axis, where each takes some ms."""
FAMILIES = ("voigt", "zener", "power_law", "nearly_elastic", "maxwell")
"""Families of members, assigned cyclically; a nearly elastic medium is Voigt with a low viscosity."""

TRAVELLED_WAVE_MAX_HZ = 8e3
"""Frequency up to which waves reach a point off the axis with a phase that turns too fast to be interpolated.

Above it such waves have decayed, and the response near the force is smooth in frequency."""
SMOOTH_NODES = 16
"""Nodes above that frequency: interpolation error 6e-5 of the members' rms motion."""
NODES_PER_E_FOLD = 6.0
"""Nodes per factor e of frequency: interpolation error 1e-4 of the largest motion."""
SPHERE_NODES_PER_E_FOLD = 12.0
"""As above, for a sphere, which resonates: error 2e-4 of the rms motion in the worst member, 5e-7 in the median."""
SHAPE_NODES, LOSS_NODES = 40, 5
"""Wave numbers and loss angles of the comparison between a force of another shape and a Gaussian.

Interpolation error 5e-4 of the motion (rms), 3e-3 in nearly elastic media."""
MAX_RELATIVE_WAVE_NUMBER = 12.0
"""Wave number times force width above which both forces move the focus in a constant ratio."""


PRIOR_RANGES = {
    "modulus_pa": (1e3, 60e3),
    "viscosity_pa_s": (0.2, 15.0),
    "low_viscosity_pa_s": (0.005, 0.2),
    "maxwell_viscosity_pa_s": (0.5, 50.0),
    "branch_over_modulus": (0.2, 10.0),
    "power": (0.02, 0.6),
}
"""Ranges of the members' parameters."""
PRIOR_POWER_MODULUS_HZ = 200.0
"""Frequency where a power-law member has a modulus in that range; the law states its own at ``POWER_REFERENCE_HZ``."""
VoigtParameters = tuple[float, float]
"""Shear modulus (Pa) and viscosity (Pa s) of a Voigt medium."""
KNOWN_MEDIUM_LOG_SD = (0.3, 0.5)
"""Standard deviations of the logarithms of the parameters of a medium known in advance."""


@dataclass(frozen=True, slots=True)
class RigidSphere:
    """Rigid sphere in the medium: the tonebursts push it, its front echoes, and it moves as a whole."""

    radius_m: float
    density_kg_per_m3: float

    def response(self, modulus_pa: ComplexArray, density_kg_per_m3: float, laplace_per_s: ComplexArray) -> ComplexArray:
        """Return the sphere's displacement over the force on it, m/N, in media of moduli (..., frequency).

        ``laplace_per_s`` (frequency,): complex frequency s of the Laplace transform, j w for vibration. The source is
        Oestreicher's impedance in an incompressible medium: docs/explanation/medium.md, section 8.
        """
        relative_radius = self.radius_m * laplace_per_s * np.sqrt(density_kg_per_m3 / modulus_pa)
        mass_kg = 4 / 3 * np.pi * self.radius_m**3 * self.density_kg_per_m3
        # Force per displacement: of the medium around the sphere, then of the sphere's own inertia.
        medium_n_per_m = 6 * np.pi * self.radius_m * modulus_pa * (1 + relative_radius + relative_radius**2 / 9)
        return np.asarray(1 / (medium_n_per_m + mass_kg * laplace_per_s**2))


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Displacement per unit force of every member, complex (member, node), at ``node_hz`` (node,); read-only.

    ``tracked`` is the mean over tracking beam and gate, ``peak`` the displacement on the beam's axis at the focus, both
    up to one real factor a member. ``steepness`` (effect, member, node) has the effects of speckle: the derivatives of
    ``tracked`` by the logarithm of the tracking beam's area and, off the axis, by the beam's offset over its radius.
    ``voigt`` (member,) marks Voigt media. The first ``harmonic_nodes`` nodes are harmonics and are not interpolated.
    """

    node_hz: FloatArray
    tracked: ComplexArray
    peak: ComplexArray
    steepness: ComplexArray
    voigt: BoolArray
    harmonic_nodes: int = 0

    def interpolation(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the matrix (frequency, node) from responses at the ensemble's nodes to those at ``frequency_hz``.

        The first nodes are harmonics and are used as they are; between the others it interpolates.
        """
        is_harmonic_node = np.isclose(frequency_hz[:, None], self.node_hz[: self.harmonic_nodes])
        smooth_nodes_hz = self.node_hz[self.harmonic_nodes :]
        if not smooth_nodes_hz.size:
            return is_harmonic_node.astype(np.float64)
        matrix = np.zeros((frequency_hz.size, self.node_hz.size))
        matrix[:, : self.harmonic_nodes] = is_harmonic_node
        between = ~is_harmonic_node.any(axis=1)
        matrix[between, self.harmonic_nodes :] = _interpolation(frequency_hz[between], smooth_nodes_hz)
        return matrix

    def driven_spectrum(self, harmonics: int, burst_rate_hz: float, burst_length_s: float) -> ComplexArray:
        """Return the matrix (harmonic, node) from a medium's responses at the nodes to its motion under tonebursts.

        The motion is A exp(j phase) of harmonics 1 to ``harmonics`` of the burst rate. The force is a train of
        rectangular tonebursts, eq. (18) of the paper.
        """
        harmonic = np.arange(1.0, harmonics + 1)
        # Force at every harmonic: a motion A sin(wt + phase) has A exp(j phase) = 2j c, with c the Fourier coefficient
        # of exp(jwt).
        force = 2j * burst_spectrum(harmonic, burst_rate_hz * burst_length_s)
        return np.asarray(force[:, None] * self.interpolation(np.asarray(burst_rate_hz * harmonic)))


@dataclass(frozen=True, slots=True)
class _EnsembleSpec:
    """Specification of an ensemble: range of harmonics, medium, density and number of members.

    ``known_medium`` is None for an ensemble of all ``FAMILIES``.
    """

    lowest_hz: float
    highest_hz: float
    known_medium: VoigtParameters | None
    density_kg_per_m3: float
    members: int

    def nodes(self, per_e_fold: float) -> FloatArray:
        """Return the nodes (node,) over the range of harmonics, Hz: ``per_e_fold`` for each factor e, at least 8."""
        count = max(8, round(float(per_e_fold * np.log(self.highest_hz / self.lowest_hz))))
        return _nodes(self.lowest_hz, self.highest_hz, count)

    def modulus(self, s: ComplexArray) -> ComplexArray:
        """Return the complex modulus (member, frequency) of every medium at complex frequencies ``s`` (frequency,).

        If the scene declares a medium, ``known_medium``, the members are Voigt media near it: modulus and viscosity are
        log-normal about the declared values, with the standard deviations ``KNOWN_MEDIUM_LOG_SD``.
        """
        if self.known_medium is None:
            return prior_modulus(s, self.members)
        from scipy.special import ndtri

        factors = np.exp(ndtri(_even_sequence(self.members, 5)[:, :2]) * KNOWN_MEDIUM_LOG_SD)
        modulus_pa, viscosity_pa_s = self.known_medium
        return np.asarray(modulus_pa * factors[:, :1] + s * (viscosity_pa_s * factors[:, 1:]))

    def are_voigt(self) -> BoolArray:
        """Return which members (member,) are Voigt media: all near a known medium, else those of the first family."""
        return np.ones(self.members, bool) if self.known_medium else np.arange(self.members) % len(FAMILIES) == 0

    def width_factors(self, width_log_sd: float) -> tuple[FloatArray, FloatArray]:
        """Return each member's factors (member,) on the declared widths of the force, across and along the beam.

        They are log-normal with the standard deviation ``width_log_sd``: the widths are not measured in the medium.
        """
        from scipy.special import ndtri

        # The first three coordinates of the sequence vary the medium.
        across, along = np.exp(width_log_sd * ndtri(_even_sequence(self.members, 5)[:, 3:5])).T
        return across, along


def medium_ensemble(
    pushed: BeamWidths | RigidSphere,
    lowest_hz: float,
    highest_hz: float,
    known_medium: VoigtParameters | None = None,
    density_kg_per_m3: float = 1000.0,
    members: int = MEMBERS,
) -> Ensemble:
    """Return the responses of an ensemble of media to a push, between two frequencies: the basis of the medium prior.

    ``pushed``: the medium itself in beams of these widths, or a sphere in it that is tracked as a whole. The media
    cover soft tissue, or are Voigt media near ``known_medium`` if that is given. A low-discrepancy sequence fills the
    parameter ranges evenly, so there is no random seed. ``members``: number of media; off the axis of the push it is
    ``OFF_AXIS_MEMBERS`` instead.
    """
    spec = _EnsembleSpec(lowest_hz, highest_hz, known_medium, density_kg_per_m3, members)
    if isinstance(pushed, RigidSphere):
        return _sphere_ensemble(pushed, spec)
    # The ensembles are cached by their arguments. Arguments that do not matter get one value, so that equal ensembles
    # are computed once.
    if pushed.lateral_offset_m:
        # One computation gives the ensembles of all offsets of the joint fit; the one for this offset is returned.
        offsets_m = pushed.offsets_of_joint_fit_m or (pushed.lateral_offset_m,)
        beams = replace(pushed, lateral_offset_m=0.0, offsets_of_joint_fit_m=offsets_m)
        ensembles = _off_axis_ensembles(beams, replace(spec, members=OFF_AXIS_MEMBERS))
        return ensembles[offsets_m.index(pushed.lateral_offset_m)]
    return _on_axis_ensemble(replace(pushed, offsets_of_joint_fit_m=()), spec)


def _sphere_ensemble(sphere: RigidSphere, spec: _EnsembleSpec) -> Ensemble:
    """Return the ensemble, the responses of all media of the prior, of a rigid ``sphere`` in them.

    Its tracked displacement is its peak displacement, as the sphere moves as a whole.
    """
    node_hz = spec.nodes(SPHERE_NODES_PER_E_FOLD)
    s = np.asarray(2j * np.pi * node_hz, np.complex128)
    response = sphere.response(spec.modulus(s), spec.density_kg_per_m3, s)
    return Ensemble(
        node_hz=node_hz,
        tracked=response,
        peak=response,
        steepness=np.zeros_like(response)[None],
        voigt=spec.are_voigt(),
    )


@functools.lru_cache(maxsize=32)
def _on_axis_ensemble(beams: BeamWidths, spec: _EnsembleSpec) -> Ensemble:
    """Return the responses of the media of ``spec``, tracked on the axis of the force, from a closed form."""
    node_hz = spec.nodes(NODES_PER_E_FOLD)
    modulus_pa = spec.modulus(np.asarray(2j * np.pi * node_hz, np.complex128))
    shear_k2 = HarmonicMedium(node_hz, modulus_pa, spec.density_kg_per_m3).shear_k2
    # Squared widths of each member's force, (member,).
    width_factor, length_factor = spec.width_factors(beams.width_log_sd)
    across_m2 = (beams.force_width_m[0] * width_factor) ** 2
    along_m2 = (beams.force_width_m[2] * length_factor) ** 2
    # Averaging over a tracking beam equals a force that is wider by the variance of the beam's echo energy.
    variance_m2 = beams.tracking_variance_m2
    tracked, by_variance = focal_displacement(shear_k2, across_m2 + variance_m2, along_m2 + beams.depth_sd_m**2)
    peak, _ = focal_displacement(shear_k2, across_m2, along_m2)
    # The area of the tracking beam is proportional to the variance, so this is the derivative by ln(area).
    by_area = variance_m2 * by_variance
    # The factor of a force that is not Gaussian applies to tracked and peak motion: their ratio is the Gaussian's.
    shape_ratio = 1.0 if beams.force is None else _shape_ratio(beams.force, beams, shear_k2, width_factor)
    # The closed form is the displacement times the modulus.
    tracked, peak, by_area = np.stack([tracked, peak, by_area]) * (shape_ratio / modulus_pa)
    ensemble = Ensemble(node_hz=node_hz, tracked=tracked, peak=peak, steepness=by_area[None], voigt=spec.are_voigt())
    # Cached and shared by all callers, hence read-only.
    for array in (node_hz, tracked, peak, by_area, ensemble.voigt):
        array.flags.writeable = False
    return ensemble


def _shape_ratio(force: PushForce, beams: BeamWidths, shear_k2: ComplexArray, width_factor: FloatArray) -> ComplexArray:
    """Return the motion under ``force`` over the motion under a Gaussian force of the widths of ``beams``.

    The ratio is (member, frequency). ``shear_k2`` (member, frequency): squared wave number q^2 = rho w^2 / G of shear
    waves. ``width_factor`` (member,): width of the member's force over that in ``beams``. The ratio depends on two
    numbers: |q| times the force's width, and the loss angle of the modulus, -arg q^2. A wider force therefore has the
    ratio of a proportionally larger |q|. The ratio is computed at Chebyshev nodes in ln |q| and in the loss angle, and
    interpolated between them.
    """
    wave_number, loss_rad = np.sqrt(np.abs(shear_k2)), np.clip(-np.angle(shear_k2), 0.0, np.pi / 2)
    lowest = float(wave_number.min())
    # Above the highest node the ratio is constant.
    highest = min(float(wave_number.max()), MAX_RELATIVE_WAVE_NUMBER / beams.force_width_m[0])
    wave_nodes = _nodes(lowest, highest, SHAPE_NODES)
    loss_nodes = np.pi / 4 * (1 - np.cos(np.linspace(0, np.pi, LOSS_NODES)))
    ratio = _shape_ratio_at_nodes(force, beams, wave_nodes, loss_nodes)
    # Coefficients (wave, loss) of the Chebyshev polynomials, from the values at the nodes. Both variables are scaled to
    # -1 at the lowest and 1 at the highest node.
    wave_basis = chebvander(_log_position(wave_nodes, lowest, highest), SHAPE_NODES - 1)
    loss_basis = chebvander(4 * loss_nodes / np.pi - 1, LOSS_NODES - 1)
    coefficients = np.linalg.solve(loss_basis, np.linalg.solve(wave_basis, ratio).T).T
    # The polynomials at the wave number that corresponds to each member's width, and at its loss angle.
    equivalent_wave_number = np.clip(wave_number * width_factor[:, None], lowest, highest)
    wave_series = chebvander(_log_position(equivalent_wave_number, lowest, highest), SHAPE_NODES - 1)
    loss_series = chebvander(4 * loss_rad / np.pi - 1, LOSS_NODES - 1)
    return np.asarray(np.sum(wave_series @ coefficients * loss_series, axis=-1))


def _shape_ratio_at_nodes(
    force: PushForce, beams: BeamWidths, wave_per_m: FloatArray, loss_rad: FloatArray
) -> ComplexArray:
    """Return the tracked motion under ``force`` over that under a Gaussian force, (wave, loss), on a grid of media.

    The Gaussian has the widths of ``beams``. Its motion has a closed form; the ratio corrects it for the force's shape.
    ``wave_per_m`` (wave,): wave numbers |q| of shear waves. ``loss_rad`` (loss,): loss angles of the modulus.
    """
    from hpe_rig.medium.shear_field import TrackedRegion, shear_motion

    region = TrackedRegion(lateral_m=np.zeros(1), across_m2=beams.tracking_variance_m2, along_m2=beams.depth_sd_m**2)
    wave, loss = np.meshgrid(wave_per_m, loss_rad, indexing="ij")
    # The ratio depends on wave number and loss angle only, so any density and frequency that give these wave numbers
    # will do: 1000 kg/m^3 and 1 Hz. The modulus is rho w^2 / |q|^2 exp(j loss).
    modulus_pa = np.asarray(1000.0 * (2 * np.pi / wave) ** 2 * np.exp(1j * loss), np.complex128).ravel()
    medium = HarmonicMedium(np.ones(modulus_pa.size), modulus_pa)
    shaped, gaussian = (
        shear_motion(medium, shape, region, quick=True).value[:, 0]
        for shape in (force, PushForce.gaussian(beams.force_width_m))
    )
    return np.asarray((shaped / gaussian).reshape(wave.shape))


@functools.lru_cache(maxsize=8)
def _off_axis_ensembles(beams: BeamWidths, spec: _EnsembleSpec) -> tuple[Ensemble, ...]:
    """Return one ensemble, the responses of all media of the prior, for each of ``beams.offsets_of_joint_fit_m``."""
    node_hz, harmonic_nodes = _off_axis_nodes(spec.lowest_hz, spec.highest_hz)
    offsets_m = np.array(beams.offsets_of_joint_fit_m)
    modulus_pa = spec.modulus(np.asarray(2j * np.pi * node_hz, np.complex128))
    width_factor, length_factor = spec.width_factors(beams.width_log_sd)
    # Axes (offset, quantity, member, node). Quantities: tracked motion, peak motion, then the two effects of speckle on
    # the tracked motion, by the tracking beam's area and by its offset.
    motions = np.empty((offsets_m.size, 4, spec.members, node_hz.size), np.complex128)
    # The force is round, so that one width holds across both axes.
    width_m, _, length_m = beams.force_width_m
    member_widths = zip(width_m * width_factor, length_m * length_factor, strict=True)
    for member, (across_m, along_m) in enumerate(member_widths):
        medium = HarmonicMedium(node_hz, modulus_pa[member], spec.density_kg_per_m3)
        member_beams = replace(beams, force_width_m=(across_m, across_m, along_m))
        tracked, peak, steepness = off_axis_motion(medium, member_beams, offsets_m)
        motions[:, :, member] = np.moveaxis(np.stack([tracked, peak, *steepness]), -1, 0)
    # Cached and shared by all callers, hence read-only.
    motions.flags.writeable = False
    return tuple(
        Ensemble(
            node_hz=node_hz,
            tracked=motion[0],
            peak=motion[1],
            steepness=motion[2:],
            voigt=spec.are_voigt(),
            harmonic_nodes=harmonic_nodes,
        )
        for motion in motions
    )


def _off_axis_nodes(lowest_hz: float, highest_hz: float) -> tuple[FloatArray, int]:
    """Return the frequencies (node,) of an off-axis ensemble, Hz, and how many of the first are harmonics.

    Off the axis the response changes fast with frequency at the low harmonics, which are therefore nodes themselves;
    smooth interpolation suffices above ``TRAVELLED_WAVE_MAX_HZ``.
    """
    harmonic_hz = lowest_hz * np.arange(1.0, round(highest_hz / lowest_hz) + 1)
    exact = int(np.sum(harmonic_hz <= TRAVELLED_WAVE_MAX_HZ))
    if harmonic_hz.size - exact <= SMOOTH_NODES:
        return harmonic_hz, harmonic_hz.size
    return np.concatenate([harmonic_hz[:exact], _nodes(harmonic_hz[exact], highest_hz, SMOOTH_NODES)]), exact


def prior_modulus(s: ComplexArray, members: int) -> ComplexArray:
    """Return the complex modulus (member, frequency) of an ensemble of soft media at ``s`` (frequency,).

    ``s`` is the complex frequency, j w for vibration. The material laws of ``FAMILIES`` alternate over the members.
    """
    # Points of the unit cube (member, 5): stiffness, viscosity, third parameter, widths of the force.
    cube = _even_sequence(members, 5)
    modulus = _log_uniform(cube[:, 0], "modulus_pa")
    viscosity, low_viscosity, maxwell_viscosity = (
        _log_uniform(cube[:, 1], f"{family}viscosity_pa_s") for family in ("", "low_", "maxwell_")
    )
    branch = modulus * _log_uniform(cube[:, 2], "branch_over_modulus")
    lowest_power, highest_power = PRIOR_RANGES["power"]
    power = lowest_power + (highest_power - lowest_power) * cube[:, 2]
    # The power law states its modulus at POWER_REFERENCE_HZ, the prior at PRIOR_POWER_MODULUS_HZ: s is scaled.
    power_s = s * (POWER_REFERENCE_HZ / PRIOR_POWER_MODULUS_HZ)
    families = (
        _law_modulus("voigt", s, modulus, viscosity),
        _law_modulus("zener", s, modulus, branch, viscosity),
        _law_modulus("power_law", power_s, modulus, power),
        _law_modulus("voigt", s, modulus, low_viscosity),
        _law_modulus("maxwell", s, modulus, maxwell_viscosity),
    )
    # Material laws alternate over the members.
    return np.asarray(np.choose((np.arange(members) % len(FAMILIES))[:, None], families))


def _law_modulus(name: str, s: ComplexArray, *parameters: FloatArray) -> ComplexArray:
    """Return the complex modulus (member, frequency) of a law with ``parameters``, each (member,)."""
    return LAWS[name].modulus(s, np.stack(parameters, axis=-1))[0]


def _log_uniform(quantile: FloatArray, parameter: str) -> FloatArray:
    """Return values of ``parameter`` at ``quantile`` of a log-uniform distribution over its ``PRIOR_RANGES``."""
    low, high = PRIOR_RANGES[parameter]
    return np.asarray(low * (high / low) ** quantile)


def _even_sequence(count: int, dimensions: int) -> FloatArray:
    """Return points (count, dimension) that fill the unit cube evenly, without randomness: a low-discrepancy sequence.

    They are multiples of 1/g^i, modulo 1, with g^(d+1) = g + 1 for d dimensions.
    """
    g = 1.5
    # Fixed-point iteration of g.
    for _ in range(64):
        g = (1 + g) ** (1 / (dimensions + 1))
    return np.asarray((0.5 + np.outer(np.arange(1, count + 1), g ** -np.arange(1.0, dimensions + 1))) % 1)


def _nodes(lowest: float, highest: float, count: int) -> FloatArray:
    """Return Chebyshev nodes (node,) in the logarithm, both ends included."""
    # From -1 at the lowest to 1 at the highest, as in ``_log_position``.
    position = -np.cos(np.linspace(0, np.pi, count))
    return np.asarray(np.sqrt(lowest * highest) * (highest / lowest) ** (position / 2))


def _interpolation(frequency_hz: FloatArray, node_hz: FloatArray) -> FloatArray:
    """Return the matrix (frequency, node) that interpolates values at ``node_hz`` by a polynomial in log frequency.

    Chebyshev polynomials keep it well conditioned.
    """
    order = node_hz.size - 1
    position, node = (_log_position(hz, node_hz[0], node_hz[-1]) for hz in (frequency_hz, node_hz))
    return np.asarray(np.linalg.solve(chebvander(node, order).T, chebvander(position, order).T).T)


def _log_position(value: FloatArray, lowest: float, highest: float) -> FloatArray:
    """Return the logarithm of ``value``, scaled to -1 at the lowest and 1 at the highest."""
    return np.asarray(2 * np.log(value / lowest) / np.log(highest / lowest) - 1)
