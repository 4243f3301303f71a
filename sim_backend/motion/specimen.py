"""Displacement at the focus of an incompressible viscoelastic medium under a Gaussian body force.

    drive -> body force f0 exp(-x²/2sx² - y²/2sy² - z²/2sz²) along z -> displacement U at its centre

    U(s) = f0 V / mu(s) * mean over directions of (1 - m²) sqrt(pi/a) (1 + j sqrt(pi) z w(z))
    z = q sqrt(a),    q = j s sqrt(rho / mu(s)),    V = (2 pi)^(-1/2) sx sy sz

    s           complex frequency, 1/s; j w on the imaginary axis
    mu, rho     complex shear modulus, Pa; density, kg/m³
    m           cosine between a direction and the force
    a           half the squared width of the force along the direction, m²
    w           Faddeeva function

The integral over wave numbers is a closed form at every complex s, so only a smooth quadrature over directions remains
(`transfer`). At s = j w it is the frequency response. Summed along a hyperbola in the left half plane
(`sim_backend.motion.inverse_laplace`) it is the response to a step at any time, without period, padding or time step.
Derivation: docs/explanation/medium.md, sections 1 to 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.motion.force import ForcePulses
from sim_backend.motion.inverse_laplace import AXIS_CONTOUR, DEGREES, Panels, panels_of
from sim_backend.motion.sphere import SPHERE_CONTOUR, SPHERE_DEGREES, sphere_force_volume_m3, sphere_response
from sim_backend.settings import BUILT_IN_MEDIA, Specimen, creeps, modulus_of
from sim_backend.wiring import PS_PER_S

Triple = tuple[float, float, float]

# Gauss-Legendre nodes over the cosine of the direction.
_DIRECTION_NODES = 64
# A response has ended when it changes by less than this fraction of the static displacement.
_SETTLING_TOLERANCE = 1e-11
# Times under several pulses that are looked up together, so that they stay in the cache.
_TIMES_PER_CHUNK = 1 << 12
# From this |z| on, a continued fraction of so many terms is as exact as the difference that it replaces (8e-13).
_FAR, _FAR_TERMS = 6.0, 16


def shear_modulus(specimen: Specimen, s_per_s: ComplexArray) -> ComplexArray:
    """Return the complex shear modulus mu(s) in Pa at complex frequencies ``s_per_s``, in their shape.

    Voigt ``mu1 + s mu2``; Maxwell ``s mu1 mu2 / (mu1 + s mu2)``; Zener ``mu1`` parallel to a Maxwell branch of
    ``branch_modulus_pa`` and ``mu2``; power law ``mu1 (s / 2 pi f_r)^p``. All are analytic away from the negative real
    axis. See docs/explanation/medium.md, section 1.
    """
    mu1, mu2 = specimen.shear_modulus_pa, specimen.shear_viscosity_pa_s
    match specimen.medium:
        case "voigt":
            return mu1 + s_per_s * mu2
        case "maxwell":
            return _maxwell_modulus(mu1, mu2, s_per_s)
        case "zener":
            return mu1 + _maxwell_modulus(specimen.branch_modulus_pa, mu2, s_per_s)
        case "power_law":
            relative = s_per_s / (2 * np.pi * specimen.reference_frequency_hz)
            return np.asarray(mu1 * relative**specimen.power)
        case installed:
            return modulus_of(installed, dict(specimen.parameters), s_per_s)


def _maxwell_modulus(modulus_pa: float, viscosity_pa_s: float, s_per_s: ComplexArray) -> ComplexArray:
    # Divided by the modulus, so that neither a stiff spring nor a fast s overflows.
    return np.asarray(s_per_s * viscosity_pa_s / (1 + s_per_s * (viscosity_pa_s / modulus_pa)))


def creeps_for_ever(specimen: Specimen) -> bool:
    """Return whether a constant force moves the medium without end, so that it has no static displacement."""
    if specimen.medium not in BUILT_IN_MEDIA:
        return creeps(specimen.medium)
    return specimen.medium == "maxwell" or (specimen.medium == "power_law" and specimen.power > 0)


def frequency_response(specimen: Specimen, width_m: Triple, frequency_hz: FloatArray) -> ComplexArray:
    """Return displacement over body force at the focus, m per N/m³, complex (frequency,), time factor exp(+jwt).

    ``width_m`` are the sigmas of the force, ``frequency_hz`` (frequency,) >= 0. Raises ``ValueError`` at 0 Hz for a
    medium that creeps without end. See docs/explanation/medium.md, section 2.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=np.float64)
    if creeps_for_ever(specimen) and not frequency_hz.all():
        raise ValueError(
            f"specimen: a {specimen.medium} medium has no displacement at 0 Hz, it creeps without end. "
            "Try: a frequency above 0, or another medium."
        )
    return transfer(specimen, width_m, np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128))


def transfer(specimen: Specimen, width_m: Triple, s_per_s: ComplexArray) -> ComplexArray:
    """Return displacement at the focus over force density, m per N/m³, at complex frequencies s, complex (frequency,).

    ``s_per_s`` (frequency,): s in 1/s, j w for a vibration. ``width_m``: sigmas of the force in x, y, z. The closed
    form is analytic in s, so it holds in the left half plane too, where an inverse Laplace transform needs it. With a
    rigid sphere it is the displacement of the sphere over the body force that represents the same drive.
    """
    modulus = shear_modulus(specimen, s_per_s)
    if specimen.sphere is not None:
        response = sphere_response(specimen.sphere, modulus, specimen.density_kg_per_m3, s_per_s)
        return np.asarray(sphere_force_volume_m3(specimen, specimen.sphere) * response)
    # The response is a mean over the directions of waves. Along each direction the force is a Gaussian of width sigma,
    # given as a = sigma² / 2. The weight of a direction includes the part of the force across it, which makes shear.
    a_m2, weight = _directions(width_m)
    # For shear waves shorter than the force is wide, |q| sqrt(a) is large: inertia reduces the response.
    shear_wavenumber_per_m = 1j * s_per_s * np.sqrt(specimen.density_kg_per_m3 / modulus)
    relative_response = inertia_factor(shear_wavenumber_per_m[:, None] * np.sqrt(a_m2))
    # Integral over wave numbers for a force at rest: of exp(-a k²) from 0 to infinity.
    static_response_per_m = np.sqrt(np.pi / a_m2) / 2
    mean_per_m = relative_response @ (static_response_per_m * weight)
    return np.asarray(force_volume(width_m) / modulus * mean_per_m)


def inertia_factor(z: ComplexArray) -> ComplexArray:
    """Return ``1 + j sqrt(pi) z w(z)``, any shape, to 1e-12 for Im z >= 0: the response over the static response.

    The response is that to a Gaussian force, w the Faddeeva function. The factor is 1 at rest and -1/(2 z²) at large
    |z|, where the two terms cancel, so Laplace's continued fraction replaces their difference. For Im z < 0, w(z) = 2
    exp(-z²) - w(-z), which overflows where the function does. See docs/explanation/medium.md, section 3.
    """
    # Imported here, so that scenes without a specimen do not load it.
    from scipy.special import wofz

    z = np.asarray(z, dtype=np.complex128)
    is_far = np.abs(z) >= _FAR
    factor = np.empty_like(z)
    factor[~is_far] = 1 + 1j * np.sqrt(np.pi) * z[~is_far] * wofz(z[~is_far])
    # The continued fraction from its innermost term; it is even in z, so one sign serves both half planes.
    far = z[is_far]
    fraction = np.zeros_like(far)
    for term in range(_FAR_TERMS, 0, -1):
        fraction = term / 2 / (far - fraction)
    factor[is_far] = -fraction / (far - fraction)
    lower = is_far & (z.imag < 0)
    factor[lower] += 2j * np.sqrt(np.pi) * z[lower] * np.exp(-(z[lower] ** 2))
    return factor


@lru_cache
def legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return ``count`` nodes and weights of Gauss-Legendre quadrature, read-only because all callers share them."""
    node, weight = np.polynomial.legendre.leggauss(count)
    node.flags.writeable = weight.flags.writeable = False
    return node, weight


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Displacement at the focus, m per N/m³, after a unit force is switched on."""

    settling_time_s: float
    """Time after which the displacement is static; for a medium that creeps without end, the end of the table."""
    panels: Panels

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the displacement at ``time_s``, any shape, exactly 0 up to the onset."""
        return self.panels.at(time_s)[..., 0]


@lru_cache(maxsize=8)
def tabulate_step_response(specimen: Specimen, width_m: Triple) -> StepResponse:
    """Return the specimen's displacement after a unit force is switched on, tabulated from 1 ps to 10^4 s.

    ``width_m`` are the sigmas of the force. The relative error is 1e-10, with a sphere 1e-6. Cached, because the checks
    of a plan and the measurement use the same table.
    """
    contour, degrees = (AXIS_CONTOUR, DEGREES) if specimen.sphere is None else (SPHERE_CONTOUR, SPHERE_DEGREES)
    panels = panels_of(lambda s: transfer(specimen, width_m, s)[:, None], contour, degrees)
    return StepResponse(settling_time_s=settling_time_s(specimen, panels), panels=panels)


def settling_time_s(specimen: Specimen, panels: Panels, tolerance: float = _SETTLING_TOLERANCE) -> float:
    """Return the time (s) after a step of force at which every response has reached its static displacement.

    From then on it stays within ``tolerance`` of it, relative to the largest static displacement among the responses in
    ``panels``. The time is the begin of a panel, or the end of the table for a medium that creeps without end.
    """
    if creeps_for_ever(specimen):
        return panels.end_s
    # Responses at the begin of every panel and at the end of the table, where they are static.
    value = panels.at(np.append(panels.begins_s, panels.end_s))
    static = value[-1]
    unsettled = np.abs(value - static).max(axis=1) > tolerance * np.abs(static).max()
    # The panel after the last unsettled one; the end of the table, the last time of ``value``, begins no panel.
    first_static_panel = int(np.flatnonzero(unsettled)[-1]) + 1
    last_panel = len(unsettled) - 2
    return float(panels.begins_s[min(first_static_panel, last_panel)])


def transient_displacement(response: StepResponse, force: ForcePulses, time_ps: Int64Array) -> FloatArray:
    """Return the displacement at the focus at ``time_ps`` (time,) under all ``force`` pulses, m."""
    return transients(response, force, time_ps)[:, 0]


def transients(response: StepResponse, force: ForcePulses, time_ps: Int64Array) -> FloatArray:
    """Return the motion at ``time_ps`` (time,) under all pulses of ``force``, one column for each tabulated response.

    A pulse is a step up and a step down. They cancel once the responses to both have settled, so a pulse is only
    evaluated at the times between its onset and the settling of its end.
    """
    # For each pulse, the range of times between its onset and the settling of its end.
    order = np.argsort(time_ps, kind="stable")
    ascending_ps = time_ps[order]
    settling_ps = math.ceil(response.settling_time_s * PS_PER_S)
    displacement = np.zeros((len(time_ps), response.panels.coefficient.shape[2]))
    first = np.searchsorted(ascending_ps, force.onset_ps)
    last = np.searchsorted(ascending_ps, force.end_ps + settling_ps, side="right")
    # Pulses with any time in that range, in groups that fill a chunk of times.
    active = np.flatnonzero(first < last)
    total = np.cumsum(last[active] - first[active])
    groups = np.split(active, np.flatnonzero(np.diff(total // _TIMES_PER_CHUNK)) + 1) if active.size else ()
    for pulses in groups:
        spans, count = [slice(first[pulse], last[pulse]) for pulse in pulses], last[pulses] - first[pulses]
        # Ages of both steps at all times of all pulses in the group, (step, time).
        edges_ps = np.repeat([force.onset_ps[pulses], force.end_ps[pulses]], count, axis=1)
        age_s = (np.concatenate([ascending_ps[span] for span in spans]) - edges_ps) / PS_PER_S
        up, down = response.panels.at(age_s)
        contribution = np.repeat(force.force_density_n_per_m3[pulses], count)[:, None] * (up - down)
        for span, of_pulse in zip(spans, np.split(contribution, np.cumsum(count)[:-1]), strict=True):
            displacement[span] += of_pulse
    unsorted = np.empty_like(displacement)
    unsorted[order] = displacement
    return unsorted


def force_volume(width_m: Triple) -> float:
    """Return V = (2 pi)^(-1/2) sx sy sz, m³: the volume of a Gaussian of sigmas ``width_m``, over (2 pi)²."""
    return math.prod(width_m) / math.sqrt(2 * math.pi)


def _directions(width_m: Triple) -> tuple[FloatArray, FloatArray]:
    """Return nodes a and weights for averages over wave directions of a Gaussian force, both (direction,).

    a = sigma² / 2, m², is half the variance of the force along the direction. ``width_m``: sigmas of the force in
    x, y, z. A weight includes sin² of the angle between direction and z axis, the fraction of a force along the axis
    that drives shear waves.
    """
    wider_m, narrower_m = max(width_m[:2]), min(width_m[:2])
    # The mean over azimuth converges like ((r - 1)/(r + 1))^2n, with r the ratio of the lateral widths.
    count = 1 if wider_m == narrower_m else 8 * math.ceil(wider_m / narrower_m) + 8
    azimuth = (np.arange(count) + 0.5) * np.pi / (2 * count)
    lateral_m2 = width_m[0] * width_m[0] * np.cos(azimuth) ** 2 + width_m[1] * width_m[1] * np.sin(azimuth) ** 2
    # For each azimuth, `polar_nodes` returns the directions' cosines to the axis (not used), a and weights.
    nodes = [polar_nodes(float(width_m2), width_m[2] ** 2) for width_m2 in lateral_m2]
    return np.concatenate([a for _, a, _ in nodes]), np.concatenate([weight for _, _, weight in nodes]) / count


def polar_nodes(lateral_m2: float, axial_m2: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes of a quadrature over wave directions in a plane through the axis, three arrays (direction,).

    These are the direction's cosine m to the axis, a = sigma² / 2 of a Gaussian force along it, and the weight.
    ``lateral_m2`` and ``axial_m2``: squared sigmas of the force. The weight includes 1 - m² for the divergence-free
    part of the force along the axis, and 2 for the directions of negative m, which contribute equally. See
    docs/explanation/medium.md, section 2.
    """
    node, node_weight = legendre(_DIRECTION_NODES)
    node, node_weight = (node + 1) / 2, node_weight / 2
    # The width as a function of m is sharp for a needle or a disc, and smooth as a function of t, with m = scale sinh t
    # for a force longer than wide and m = scale sin t for a disc. The nodes are values of t / t_max from 0 to 1.
    if axial_m2 > lateral_m2:
        scale = math.sqrt(lateral_m2 / (axial_m2 - lateral_m2))
        t_max = math.asinh(1 / scale)
        m, dm_dnode = scale * np.sinh(t_max * node), scale * t_max * np.cosh(t_max * node)
    elif axial_m2 < lateral_m2:
        scale = 1 / math.sqrt(1 - axial_m2 / lateral_m2)
        t_max = math.asin(1 / scale)
        m, dm_dnode = scale * np.sin(t_max * node), scale * t_max * np.cos(t_max * node)
    else:
        m, dm_dnode = node, np.ones_like(node)
    half_width_m2 = (lateral_m2 * (1 - m**2) + axial_m2 * m**2) / 2
    return m, half_width_m2, 2 * (1 - m**2) * dm_dnode * node_weight
