"""Displacement at the focus of a Voigt medium under a Gaussian body force.

Body force ``f0 exp(-x^2/2sx^2 - y^2/2sy^2 - z^2/2sz^2)`` along z in an incompressible medium of density rho and modulus
``mu = mu1 + j w mu2`` (time factor exp(+j w t)). Only the divergence-free part of the force moves such a medium: the
share 1 - m^2 of a plane wave whose direction has cosine m with z. What is left is a sum of independent damped
oscillators, one a wave number k, which gives two forms of the same thing: the integral over k in closed form at each
frequency (`frequency_response`), and each oscillator in closed form at each time (`step_response`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.edges import PS_PER_S, Picoseconds
from sim_backend.force import ForcePulses
from sim_backend.settings import Specimen

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

_ANGLE_NODES = 64
_FEWEST_TABLE_TIMES = 512
_TABLE_TIMES_PER_ONSET = 6
_OSCILLATOR_TIMES_AT_ONCE = 1 << 20
_NEGLIGIBLE_EXPONENT = 30.0  # exp(-30) = 1e-13
_MOST_WAVE_NUMBERS = 20_000


def frequency_response(specimen: Specimen, width_m: Triple, frequency_hz: Floats) -> NDArray[np.complex128]:
    """Return displacement at the focus over body force there, m per N/m^3, complex (frequency,), time factor exp(+jwt).

    ``width_m`` the sigmas of the force, ``frequency_hz`` (frequency,) >= 0. Model notes, section 3, with the azimuth
    averaged where the lateral widths differ. Loses digits where the focus is many shear wavelengths wide.
    """
    # Here because a run needs the transient only, and loading scipy.special takes longer than the run's physics.
    from scipy.special import wofz

    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=np.float64)[:, None]
    modulus = specimen.shear_modulus_pa + 1j * omega * specimen.shear_viscosity_pa_s
    k2 = specimen.density_kg_per_m3 * omega**2 / modulus
    a, share = _directions(width_m)
    # The integral over k converges on the root in the upper half plane; np.sqrt gives the one with Re >= 0.
    q = np.sqrt(k2)
    q = np.where(q.imag < 0, -q, q)
    static = np.sqrt(np.pi / a) / 2
    moving = np.where(omega > 0, 0.5j * np.pi * q * wofz(q * np.sqrt(a)), 0.0)
    return np.asarray(_strength(width_m) * ((static + moving) @ share) / modulus[:, 0])


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Displacement at the focus, m per N/m^3, at a time after a unit force is switched on for good."""

    memory_s: float
    """Time after which the displacement is the static one."""
    table_m: Floats
    """Displacement at equal steps of the square root of time, which resolve the onset; one step more on both sides."""

    def at(self, time_s: Floats) -> Floats:
        """Return the displacement at ``time_s``, any shape, exactly 0 up to the onset: cubic through four points."""
        steps = len(self.table_m) - 3
        place = np.sqrt(np.clip(time_s / self.memory_s, 0.0, 1.0)) * steps
        left = np.minimum(place.astype(np.int64), steps - 1)
        u = place - left
        before, start, end, after = (self.table_m[left + offset] for offset in range(4))
        outer = u * (u - 1) / 6 * ((u + 1) * after - (u - 2) * before)
        value = outer + (u + 1) * (u - 2) / 2 * ((u - 1) * start - u * end)
        return np.where(time_s > 0, value, 0.0)


def tabulate_step_response(specimen: Specimen, width_m: Triple) -> StepResponse:
    """Return the specimen's step response, good to 5e-6 of the peak response to a 100 us burst."""
    memory_s = _memory_s(specimen, width_m)
    onset_s = _onset_s(specimen, width_m)
    times = max(_FEWEST_TABLE_TIMES, math.ceil(_TABLE_TIMES_PER_ONSET * math.sqrt(memory_s / onset_s)))
    value = step_response(specimen, width_m, memory_s * np.linspace(0.0, 1.0, times) ** 2)
    value[0] = 0.0
    # Even in the square root of time on one side, static on the other.
    return StepResponse(memory_s, np.concatenate([value[1:2], value, value[-1:]]))


def step_response(specimen: Specimen, width_m: Triple, time_s: Floats) -> Floats:
    """Return the displacement at ``time_s`` (time,) >= 0 after a unit force was switched on, m per N/m^3.

    One quadrature over the wave number k of damped oscillators, each in closed form: causal, without period or padding.
    Beyond the medium's memory its accuracy is lost; there the displacement is static.
    """
    k, spacing = _wave_numbers(specimen, width_m)
    a, share = _directions(width_m)
    spectrum = (np.exp(-np.outer(k**2, a)) @ share) * spacing
    stiffness = specimen.shear_modulus_pa / specimen.density_kg_per_m3 * k**2
    damping = specimen.shear_viscosity_pa_s / (2 * specimen.density_kg_per_m3) * k**2
    rings = damping**2 < stiffness
    sagging = np.empty(time_s.shape)
    step = max(1, _OSCILLATOR_TIMES_AT_ONCE // len(k))
    for first in range(0, len(time_s), step):
        some = slice(first, first + step)
        sagging[some] = _ringing(damping[rings], stiffness[rings], time_s[some]) @ spectrum[rings]
        sagging[some] += _creeping(damping[~rings], stiffness[~rings], time_s[some]) @ spectrum[~rings]
    return np.asarray(_strength(width_m) / specimen.shear_modulus_pa * (spectrum.sum() - sagging))


def _ringing(damping: Floats, stiffness: Floats, time_s: Floats) -> Floats:
    """Return what the underdamped oscillators still lack of their static displacement, (time, oscillator)."""
    omega = np.sqrt(stiffness - damping**2)
    phase = np.outer(time_s, omega)
    return np.asarray(np.exp(-np.outer(time_s, damping)) * (np.cos(phase) + damping / omega * np.sin(phase)))


def _creeping(damping: Floats, stiffness: Floats, time_s: Floats) -> Floats:
    """Return the same for overdamped oscillators, without overflow and without cancellation of the slow root."""
    # Critical damping divides 0 by 0; a root apart by 1e-9 of the damping changes the result by its square.
    d = np.sqrt(np.maximum(damping**2 - stiffness, (1e-9 * damping) ** 2))
    gone = -np.expm1(np.outer(time_s, -2 * d))
    return np.asarray(np.exp(np.outer(time_s, -stiffness / (damping + d))) * (1 + gone * (damping / d - 1) / 2))


def transient_displacement(response: StepResponse, force: ForcePulses, time_ps: Picoseconds) -> Floats:
    """Return the displacement at the focus at ``time_ps`` (time,) under all ``force`` pulses, m; exactly 0 before any.

    Each pulse is a step up and a step down; once both are older than the medium's memory they cancel, so a pulse
    costs only the times that feel it.
    """
    order = np.argsort(time_ps, kind="stable")
    ascending_ps = time_ps[order]
    memory_ps = math.ceil(response.memory_s * PS_PER_S)
    displacement_m = np.zeros(len(time_ps))
    first = np.searchsorted(ascending_ps, force.onset_ps)
    last = np.searchsorted(ascending_ps, force.end_ps + memory_ps, side="right")
    for index, strength in enumerate(force.force_density_n_per_m3):
        felt = slice(first[index], last[index])
        up_s = (ascending_ps[felt] - force.onset_ps[index]) / PS_PER_S
        down_s = (ascending_ps[felt] - force.end_ps[index]) / PS_PER_S
        displacement_m[felt] += strength * (response.at(up_s) - response.at(down_s))
    unsorted_m = np.empty_like(displacement_m)
    unsorted_m[order] = displacement_m
    return unsorted_m


def _strength(width_m: Triple) -> float:
    """Return (2 pi)^(-1/2) sx sy sz, the Gaussian's volume over (2 pi)^2."""
    return math.prod(width_m) / math.sqrt(2 * math.pi)


def _directions(width_m: Triple) -> tuple[Floats, Floats]:
    """Return ``a``, half the squared width of the force along each direction, and its share, (direction,)."""
    node, node_weight = np.polynomial.legendre.leggauss(_ANGLE_NODES)
    node, node_weight = (node + 1) / 2, node_weight / 2
    x2, y2, z2 = (width**2 for width in width_m)
    azimuth = (np.arange(16) + 0.5) * np.pi / 32 if x2 != y2 else np.zeros(1)
    lateral = x2 * np.cos(azimuth) ** 2 + y2 * np.sin(azimuth) ** 2
    a = (lateral[:, None] * (1 - node**2) + z2 * node**2) / 2
    share = np.broadcast_to(2 * (1 - node**2) * node_weight / len(azimuth), a.shape)
    return a.ravel(), share.ravel()


def _onset_s(specimen: Specimen, width_m: Triple) -> float:
    """Return the shortest time in which the response bends: a shear wave, or viscosity, crosses the force's waist."""
    narrow_m = min(width_m)
    by_wave_s = narrow_m / math.sqrt(specimen.shear_modulus_pa / specimen.density_kg_per_m3)
    by_viscosity_per_s = specimen.shear_viscosity_pa_s / (specimen.density_kg_per_m3 * narrow_m**2)
    return 1 / (1 / by_wave_s + by_viscosity_per_s)


def _memory_s(specimen: Specimen, width_m: Triple) -> float:
    """Return when the last wave has left the focus: c^2 t^2 = 4 x 30 (a + s t), diffusivity s = mu2 / 2 rho."""
    c2 = specimen.shear_modulus_pa / specimen.density_kg_per_m3
    diffusivity = specimen.shear_viscosity_pa_s / (2 * specimen.density_kg_per_m3)
    b = 4 * _NEGLIGIBLE_EXPONENT * diffusivity
    return (b + math.sqrt(b**2 + 8 * _NEGLIGIBLE_EXPONENT * max(width_m) ** 2 * c2)) / (2 * c2)


def _wave_numbers(specimen: Specimen, width_m: Triple) -> tuple[Floats, float]:
    """Return the wave numbers that the force contains and their spacing, for the trapezoidal rule.

    The integrand is even and entire in k, so the rule errs only by its images, sources at multiples of 2 pi / spacing:
    with these 2 c t away, none arrives within the memory t.
    """
    highest = math.sqrt(2 * _NEGLIGIBLE_EXPONENT) / min(width_m)
    speed = math.sqrt(specimen.shear_modulus_pa / specimen.density_kg_per_m3)
    spacing = math.pi / (speed * _memory_s(specimen, width_m))
    count = math.ceil(highest / spacing)
    if count > _MOST_WAVE_NUMBERS:
        raise ValueError(
            f"specimen: its transient needs {count} wave numbers, at most {_MOST_WAVE_NUMBERS} are kept. "
            "The medium creeps too slowly for its size. Try: raise shear_modulus_pa or lower shear_viscosity_pa_s."
        )
    return spacing * np.arange(0.5, count), spacing
