"""Displacement at the focus of an incompressible viscoelastic medium under a Gaussian body force.

    drive -> body force f0 exp(-x^2/2sx^2 - y^2/2sy^2 - z^2/2sz^2) along z -> displacement u at its centre

The medium has density rho and complex shear modulus mu(s), s = j w. The integral over wave numbers is a closed form at
every complex s, which leaves one smooth quadrature over directions (`transfer`). On s = j w that is the frequency
response; summed along a hyperbola in the left half plane (`sim_backend.motion.inverse_laplace`) it is the response to a
step, at any time, without period, padding or time step. Derived in docs/theory/medium.md, sections 1 to 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.motion.force import ForcePulses
from sim_backend.motion.inverse_laplace import AXIS_CONTOUR, Panels, panels_of
from sim_backend.motion.sphere import SPHERE_CONTOUR, SPHERE_DEGREES, sphere_response, sphere_share
from sim_backend.settings import OWN_MEDIA, Specimen, creeps, modulus_of
from sim_backend.wiring import PS_PER_S

Triple = tuple[float, float, float]

_DIRECTION_NODES = 64
# Relative to the static displacement: below this a response has ended.
_FORGOTTEN = 1e-11
# Times under several pulses whose responses are looked up together: they stay in the processor's cache.
_TIMES_AT_ONCE = 1 << 12
# |z| from which the continued fraction, so many terms deep, is as exact as the difference it replaces (8e-13).
_FAR, _FAR_TERMS = 6.0, 16


def shear_modulus(specimen: Specimen, s_per_s: ComplexArray) -> ComplexArray:
    """Return the modulus mu(s) in Pa, shape of ``s_per_s``; analytic off the negative real axis, so also in time.

    Voigt ``mu1 + s mu2``; Maxwell ``s mu1 mu2 / (mu1 + s mu2)``; Zener ``mu1`` beside a Maxwell branch of
    ``branch_modulus_pa`` and ``mu2``; power law ``mu1 (s / 2 pi f_r)^p``. docs/theory/medium.md, section 1.
    """
    mu1, mu2 = specimen.shear_modulus_pa, specimen.shear_viscosity_pa_s
    match specimen.medium:
        case "voigt":
            return mu1 + s_per_s * mu2
        case "maxwell":
            return _branch(mu1, mu2, s_per_s)
        case "zener":
            return mu1 + _branch(specimen.branch_modulus_pa, mu2, s_per_s)
        case "power_law":
            relative = s_per_s / (2 * np.pi * specimen.reference_frequency_hz)
            return np.asarray(mu1 * relative**specimen.power)
        case foreign:
            return modulus_of(foreign, dict(specimen.parameters), s_per_s)


def _branch(modulus_pa: float, viscosity_pa_s: float, s_per_s: ComplexArray) -> ComplexArray:
    # Divided through by the modulus: neither a stiff spring nor a fast s overflows.
    return np.asarray(s_per_s * viscosity_pa_s / (1 + s_per_s * (viscosity_pa_s / modulus_pa)))


def creeps_for_ever(specimen: Specimen) -> bool:
    """Return whether a constant force moves the medium without end: it has no static displacement."""
    if specimen.medium not in OWN_MEDIA:
        return creeps(specimen.medium)
    return specimen.medium == "maxwell" or (specimen.medium == "power_law" and specimen.power > 0)


def frequency_response(specimen: Specimen, width_m: Triple, frequency_hz: FloatArray) -> ComplexArray:
    """Return displacement at the focus over body force there, m per N/m^3, complex (frequency,), time factor exp(+jwt).

    ``width_m`` the sigmas of the force, ``frequency_hz`` (frequency,) >= 0. Raises ``ValueError`` at 0 Hz for a medium
    that creeps for ever. docs/theory/medium.md, section 2.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=np.float64)
    if creeps_for_ever(specimen) and not frequency_hz.all():
        raise ValueError(
            f"specimen: a {specimen.medium} medium has no displacement at 0 Hz, it creeps without end. "
            "Try: a frequency above 0, or another medium."
        )
    return transfer(specimen, width_m, np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128))


def transfer(specimen: Specimen, width_m: Triple, s_per_s: ComplexArray) -> ComplexArray:
    """Return the same at complex frequencies ``s_per_s`` (frequency,), continued into the left half plane.

    Of a rigid sphere, whose force stands for the body force, its own displacement. Of the medium:

    ``U = f0 (2 pi)^(-1/2) sx sy sz / mu(s) * mean over directions of (1 - m^2) sqrt(pi/a) (1 + j sqrt(pi) z w(z))``,
    z = q sqrt(a), q = j s sqrt(rho / mu(s)), a half the squared width of the force along the direction.
    """
    modulus = shear_modulus(specimen, s_per_s)
    if specimen.sphere is not None:
        moved = sphere_response(specimen.sphere, modulus, specimen.density_kg_per_m3, s_per_s)
        return np.asarray(sphere_share(specimen, specimen.sphere) * moved)
    a, share = _directions(width_m)
    q = 1j * s_per_s * np.sqrt(specimen.density_kg_per_m3 / modulus)
    # (frequency, direction) @ (direction,): what each direction adds when at rest, times its share of inertia.
    moved = inertia_factor(q[:, None] * np.sqrt(a)) @ (np.sqrt(np.pi / a) / 2 * share)
    return np.asarray(force_volume(width_m) / modulus * moved)


def inertia_factor(z: ComplexArray) -> ComplexArray:
    """Return ``1 + j sqrt(pi) z w(z)``, any shape, to 1e-12 for Im z >= 0; w is the Faddeeva function.

    What remains of a Gaussian source's static response once inertia counts: 1 at rest, -1/(2 z^2) far out. There the
    two terms cancel, so Laplace's continued fraction takes over, which never forms the difference; Im z < 0 by
    w(z) = 2 exp(-z^2) - w(-z), which overflows where the function does. docs/theory/medium.md, section 3.
    """
    # Here, so that what needs no specimen does not load it; every run has loaded it by then for scipy.fft.
    from scipy.special import wofz

    z = np.asarray(z, dtype=np.complex128)
    far = np.abs(z) >= _FAR
    out = np.empty_like(z)
    out[~far] = 1 + 1j * np.sqrt(np.pi) * z[~far] * wofz(z[~far])
    distant = z[far]
    rest = np.zeros_like(distant)
    # From the innermost term out; the fraction is even in z, so one sign serves both half planes.
    for term in range(_FAR_TERMS, 0, -1):
        rest = term / 2 / (distant - rest)
    out[far] = -rest / (distant - rest)
    below = far & (z.imag < 0)
    out[below] += 2j * np.sqrt(np.pi) * z[below] * np.exp(-(z[below] ** 2))
    return out


@lru_cache
def legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return ``count`` nodes and weights of Gauss's quadrature, which no caller can change: all get the same."""
    node, weight = np.polynomial.legendre.leggauss(count)
    node.flags.writeable = weight.flags.writeable = False
    return node, weight


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Displacement at the focus, m per N/m^3, at a time after a unit force is switched on for good."""

    memory_s: float
    """Time after which the displacement is the static one; where there is none, the end of the table."""
    panels: Panels

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the displacement at ``time_s``, any shape, exactly 0 up to the onset."""
        return self.panels.at(time_s)[..., 0]


@lru_cache(maxsize=8)
def tabulate_step_response(specimen: Specimen, width_m: Triple) -> StepResponse:
    """Return the specimen's step response, good to 1e-10 of itself at any time from 1 ps to 10^4 s, a sphere's to 1e-6.

    Kept: a plan's checks and the measurement of a scene ask for the same one.
    """
    course = (AXIS_CONTOUR,) if specimen.sphere is None else (SPHERE_CONTOUR, SPHERE_DEGREES)
    panels = panels_of(lambda s: transfer(specimen, width_m, s)[:, None], *course)
    return StepResponse(memory_s(specimen, panels), panels)


def memory_s(specimen: Specimen, panels: Panels, forgotten: float = _FORGOTTEN) -> float:
    """Return the time after which no response of ``panels`` changes; their end for a medium that creeps for ever.

    By more than ``forgotten``, relative to the largest of them at rest.
    """
    if creeps_for_ever(specimen):
        return panels.end_s
    value = panels.at(np.append(panels.begins_s, panels.end_s))
    moving = np.abs(value - value[-1]).max(axis=1) > forgotten * np.abs(value[-1]).max()
    return float(panels.begins_s[min(int(np.flatnonzero(moving)[-1]) + 1, len(moving) - 2)])


def transient_displacement(response: StepResponse, force: ForcePulses, time_ps: Int64Array) -> FloatArray:
    """Return the displacement at the focus at ``time_ps`` (time,) under all ``force`` pulses, m; 0 before any."""
    return transients(response, force, time_ps)[:, 0]


def transients(response: StepResponse, force: ForcePulses, time_ps: Int64Array) -> FloatArray:
    """Return every tabulated response at ``time_ps`` (time,) under all ``force`` pulses: (time, response).

    Each pulse is a step up and a step down; once both are older than the medium's memory they cancel, so a pulse
    costs only the times that feel it.
    """
    order = np.argsort(time_ps, kind="stable")
    ascending_ps = time_ps[order]
    memory_ps = math.ceil(response.memory_s * PS_PER_S)
    moved = np.zeros((len(time_ps), response.panels.coefficient.shape[2]))
    first = np.searchsorted(ascending_ps, force.onset_ps)
    last = np.searchsorted(ascending_ps, force.end_ps + memory_ps, side="right")
    # Each pulse is added to the slice of times that lie between its onset and the end of its memory. The responses to
    # several pulses, one after another, are looked up together.
    felt = np.flatnonzero(first < last)
    total = np.cumsum(last[felt] - first[felt])
    for some in np.split(felt, np.flatnonzero(np.diff(total // _TIMES_AT_ONCE)) + 1) if felt.size else ():
        parts, count = [slice(first[index], last[index]) for index in some], last[some] - first[some]
        edges_ps = np.repeat([force.onset_ps[some], force.end_ps[some]], count, axis=1)
        age_s = (np.concatenate([ascending_ps[part] for part in parts]) - edges_ps) / PS_PER_S
        up, down = response.panels.at(age_s)
        added = np.repeat(force.force_density_n_per_m3[some], count)[:, None] * (up - down)
        for part, own in zip(parts, np.split(added, np.cumsum(count)[:-1]), strict=True):
            moved[part] += own
    unsorted = np.empty_like(moved)
    unsorted[order] = moved
    return unsorted


def force_volume(width_m: Triple) -> float:
    """Return (2 pi)^(-1/2) sx sy sz, the Gaussian's volume over (2 pi)^2."""
    return math.prod(width_m) / math.sqrt(2 * math.pi)


def _directions(width_m: Triple) -> tuple[FloatArray, FloatArray]:
    """Return ``a``, half the squared width of the force along each direction, and its share, (direction,)."""
    wide, narrow = max(width_m[:2]), min(width_m[:2])
    # The mean over azimuth converges like ((r - 1)/(r + 1))^2n, r the ratio of the lateral widths.
    count = 1 if wide == narrow else 8 * math.ceil(wide / narrow) + 8
    azimuth = (np.arange(count) + 0.5) * np.pi / (2 * count)
    lateral = width_m[0] * width_m[0] * np.cos(azimuth) ** 2 + width_m[1] * width_m[1] * np.sin(azimuth) ** 2
    parts = [polar_nodes(float(square), width_m[2] ** 2) for square in lateral]
    return np.concatenate([a for _, a, _ in parts]), np.concatenate([share for _, _, share in parts]) / count


def polar_nodes(lateral: float, axial: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return cosine m, half the squared width ``a`` and share of the directions of one azimuth, (direction,) each.

    ``lateral`` and ``axial`` are the squared widths. The share is that of the
    divergence-free force, 1 - m^2, with the quadrature's weight. Gauss-Legendre nodes in the variable that makes the
    width a smooth function: asinh for a force longer than wide, asin for a disc (docs/theory/medium.md, section 2).
    """
    node, weight = legendre(_DIRECTION_NODES)
    node, weight = (node + 1) / 2, weight / 2
    if axial > lateral:
        unit = math.sqrt(lateral / (axial - lateral))
        top = math.asinh(1 / unit)
        m, slope = unit * np.sinh(top * node), unit * top * np.cosh(top * node)
    elif axial < lateral:
        unit = 1 / math.sqrt(1 - axial / lateral)
        top = math.asin(1 / unit)
        m, slope = unit * np.sin(top * node), unit * top * np.cos(top * node)
    else:
        m, slope = node, np.ones_like(node)
    return m, (lateral * (1 - m**2) + axial * m**2) / 2, 2 * (1 - m**2) * slope * weight
