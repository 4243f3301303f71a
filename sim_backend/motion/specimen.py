"""Displacement at the focus of an incompressible viscoelastic medium under a Gaussian body force.

Body force ``f0 exp(-x^2/2sx^2 - y^2/2sy^2 - z^2/2sz^2)`` along z in a medium of density rho and modulus mu(s), s = j w
(`sim_backend.motion.moduli`). Only the divergence-free part of the force moves such a medium: the share 1 - m^2 of a
plane wave whose direction has cosine m with z. The integral over wave numbers is a closed form at every complex
s, which leaves one smooth quadrature over directions (`transfer`). On s = j w that is the frequency response; summed along a
hyperbola in the left half plane it is the response to a step, at any time, without period, padding or time step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.motion.faddeeva import lag
from sim_backend.motion.force import ForcePulses
from sim_backend.motion.inverse_laplace import Panels, panels_of
from sim_backend.motion.moduli import creeps_for_ever, shear_modulus
from sim_backend.settings import Specimen
from sim_backend.wiring import PS_PER_S, Picoseconds

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Triple = tuple[float, float, float]

_DIRECTION_NODES = 64
_FORGOTTEN = 1e-11


def frequency_response(specimen: Specimen, width_m: Triple, frequency_hz: Floats) -> Complexes:
    """Return displacement at the focus over body force there, m per N/m^3, complex (frequency,), time factor exp(+jwt).

    ``width_m`` the sigmas of the force, ``frequency_hz`` (frequency,) >= 0. Model notes, section 3. Raises
    ``ValueError`` at 0 Hz for a medium that creeps for ever.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=np.float64)
    if creeps_for_ever(specimen) and not frequency_hz.all():
        raise ValueError(
            f"specimen: a {specimen.medium} medium has no displacement at 0 Hz, it creeps without end. "
            "Try: a frequency above 0, or another medium."
        )
    return transfer(specimen, width_m, np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128))


def transfer(specimen: Specimen, width_m: Triple, s_per_s: Complexes) -> Complexes:
    """Return the same at complex frequencies ``s_per_s`` (frequency,), continued into the left half plane.

    ``U = f0 (2 pi)^(-1/2) sx sy sz / mu(s) * mean over directions of (1 - m^2) sqrt(pi/a) (1 + j sqrt(pi) z w(z))``,
    z = q sqrt(a), q = j s sqrt(rho / mu(s)), a half the squared width of the force along the direction.
    """
    modulus = shear_modulus(specimen, s_per_s)
    a, share = _directions(width_m)
    q = 1j * s_per_s * np.sqrt(specimen.density_kg_per_m3 / modulus)
    moved = lag(q[:, None] * np.sqrt(a)) @ (np.sqrt(np.pi / a) / 2 * share)
    return np.asarray(force_volume(width_m) / modulus * moved)


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Displacement at the focus, m per N/m^3, at a time after a unit force is switched on for good."""

    memory_s: float
    """Time after which the displacement is the static one; where there is none, the end of the table."""
    panels: Panels

    def at(self, time_s: Floats) -> Floats:
        """Return the displacement at ``time_s``, any shape, exactly 0 up to the onset."""
        return self.panels.at(time_s)[..., 0]


def tabulate_step_response(specimen: Specimen, width_m: Triple) -> StepResponse:
    """Return the specimen's step response, good to 1e-10 of itself at any time from 1 ps to 10^4 s."""
    panels = panels_of(lambda s: transfer(specimen, width_m, s)[:, None])
    return StepResponse(memory_s(specimen, panels), panels)


def memory_s(specimen: Specimen, panels: Panels) -> float:
    """Return the time after which no response of ``panels`` changes; their end for a medium that creeps for ever."""
    if creeps_for_ever(specimen):
        return panels.end_s
    value = panels.at(np.append(panels.begins_s, panels.end_s))
    moving = np.abs(value - value[-1]).max(axis=1) > _FORGOTTEN * np.abs(value[-1]).max()
    return float(panels.begins_s[min(int(np.flatnonzero(moving)[-1]) + 1, len(moving) - 2)])


def step_response(specimen: Specimen, width_m: Triple, time_s: Floats) -> Floats:
    """Return the displacement at ``time_s`` (time,) > 0 after a unit force was switched on, m per N/m^3: no table."""
    from sim_backend.motion.inverse_laplace import step_of

    return np.array([step_of(lambda s: transfer(specimen, width_m, s), time) for time in time_s.tolist()])


def transient_displacement(response: StepResponse, force: ForcePulses, time_ps: Picoseconds) -> Floats:
    """Return the displacement at the focus at ``time_ps`` (time,) under all ``force`` pulses, m; 0 before any."""
    return transients(response, force, time_ps)[:, 0]


def transients(response: StepResponse, force: ForcePulses, time_ps: Picoseconds) -> Floats:
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
    for index, strength in enumerate(force.force_density_n_per_m3):
        felt = slice(first[index], last[index])
        up_s = (ascending_ps[felt] - force.onset_ps[index]) / PS_PER_S
        down_s = (ascending_ps[felt] - force.end_ps[index]) / PS_PER_S
        moved[felt] += strength * (response.panels.at(up_s) - response.panels.at(down_s))
    unsorted = np.empty_like(moved)
    unsorted[order] = moved
    return unsorted


def force_volume(width_m: Triple) -> float:
    """Return (2 pi)^(-1/2) sx sy sz, the Gaussian's volume over (2 pi)^2."""
    return math.prod(width_m) / math.sqrt(2 * math.pi)


def _directions(width_m: Triple) -> tuple[Floats, Floats]:
    """Return ``a``, half the squared width of the force along each direction, and its share, (direction,)."""
    wide, narrow = max(width_m[:2]), min(width_m[:2])
    # The mean over azimuth converges like ((r - 1)/(r + 1))^2n, r the ratio of the lateral widths.
    count = 1 if wide == narrow else 8 * math.ceil(wide / narrow) + 8
    azimuth = (np.arange(count) + 0.5) * np.pi / (2 * count)
    lateral = width_m[0] * width_m[0] * np.cos(azimuth) ** 2 + width_m[1] * width_m[1] * np.sin(azimuth) ** 2
    parts = [polar_nodes(float(square), width_m[2] ** 2) for square in lateral]
    return np.concatenate([a for _, a, _ in parts]), np.concatenate([share for _, _, share in parts]) / count


def polar_nodes(lateral: float, axial: float) -> tuple[Floats, Floats, Floats]:
    """Return cosine m, half the squared width ``a`` and share of the directions of one azimuth, (direction,) each.

    ``lateral`` and ``axial`` are the squared widths. Nodes in the variable that makes the width smooth.
    """
    node, weight = np.polynomial.legendre.leggauss(_DIRECTION_NODES)
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
