"""Phase velocity and attenuation of shear waves: of a fitted material law, and fitted frequency by frequency.

    q = w / c - j alpha,    G = rho w^2 / q^2,    field ~ exp(-j q r) far from the push

c is the phase velocity, alpha the attenuation, q the complex wave number, G the complex modulus, rho the density. The
fit has c and alpha of every frequency as free parameters of the exact near field (``problem.py``): no law connects the
frequencies. Derivation: docs/how-to/dispersion.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import Law, Parameter, law_of
from hpe_rig.moduli.inversion import FINE, Moduli, fit_medium, solve
from hpe_rig.moduli.problem import COMMON, Nuisance, Problem
from hpe_rig.moduli.vibration_model import FREE_GAIN_UNCERTAINTY, Push, Vibration

SPEED_LIMITS_M_PER_S = (0.05, 100.0)
ATTENUATION_LIMITS_NP_PER_M = (0.0, 1e5)


@dataclass(frozen=True, slots=True, eq=False)
class DispersionCurve:
    """Phase velocity (m/s) and attenuation (Np/m) of shear waves with standard uncertainties, each (frequency,)."""

    frequency_hz: FloatArray
    phase_velocity_m_per_s: FloatArray
    phase_velocity_uncertainty_m_per_s: FloatArray
    attenuation_np_per_m: FloatArray
    attenuation_uncertainty_np_per_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WavenumberFit:
    """Dispersion ``curve`` fitted with the exact near field, and its misfit.

    ``chi_square`` of data and nuisances has ``freedom`` degrees of freedom; ``significance`` is the probability of a
    larger one by chance. ``nominal_m``: exact field (frequency,) of every vibration in a medium with this curve,
    without noise, with positions as stated, and with the fitted gains where they are unknown. ``error_m``: one-sigma
    errors of each vibration's phasors, of noise, positions and known gains, (frequency, error source); the sources are
    independent.
    """

    curve: DispersionCurve
    chi_square: float
    freedom: int
    significance: float
    nominal_m: tuple[ComplexArray, ...]
    error_m: tuple[ComplexArray, ...]


def curve_of_law(fit: Moduli, frequency_hz: FloatArray, density_kg_per_m3: float) -> DispersionCurve:
    """Return phase velocity and attenuation of the fitted law ``fit`` at ``frequency_hz`` (frequency,)."""
    omega, values = 2 * np.pi * frequency_hz, np.array(list(fit.values.values()))
    modulus_pa, by_values = law_of(fit.law).modulus(np.asarray(1j * omega, np.complex128), values)
    q = omega * np.sqrt(density_kg_per_m3 / modulus_pa)
    # dq/dG = -q / 2G; both quantities follow from q.
    q_by_values = -(q / (2 * modulus_pa))[:, None] * by_values
    speed_by_values = -(omega / q.real**2)[:, None] * q_by_values.real
    u_speed, u_attenuation = (
        np.sqrt(np.einsum("fi,ij,fj->f", slopes, fit.covariance, slopes))
        for slopes in (speed_by_values, q_by_values.imag)
    )
    return DispersionCurve(frequency_hz, omega / q.real, u_speed, -q.imag, u_attenuation)


def fit_wavenumbers(vibrations: Sequence[Vibration], push: Push, start: DispersionCurve | None = None) -> WavenumberFit:
    """Return the phase velocities and attenuations that explain ``vibrations`` best, one pair for each frequency.

    Frequencies share the strength of the force, its spectrum, and the uncertainties of widths and positions. The fit
    begins at ``start``, by default a fitted Voigt medium. Raises ``ValueError`` as ``fit_medium``.
    """
    frequency_hz = np.unique(np.concatenate([vibration.frequency_hz for vibration in vibrations]))
    law = _law_without_relation(frequency_hz, push.density_kg_per_m3)
    problem = Problem.of(vibrations, push, law)
    if start is None:
        start = curve_of_law(fit_medium(vibrations, push, "voigt"), frequency_hz, push.density_kg_per_m3)
    # Coordinates of the law are c and alpha themselves, frequency by frequency.
    coordinates = np.stack([start.phase_velocity_m_per_s, start.attenuation_np_per_m], axis=1).ravel()
    best = solve(problem, problem.start(coordinates)[0], FINE)
    jacobian = problem.jacobian(best.unknown)
    speed, attenuation = best.unknown[: problem.coordinate_count].reshape(-1, 2).T
    u_speed, u_attenuation = np.sqrt(np.diag(problem.coordinate_covariance(jacobian)).reshape(-1, 2)).T
    freedom = problem.data_count - problem.free_count
    # The nominal field has no errors of positions and widths: their nuisances are 0. A gain without a known value is no
    # error, so it has its fitted value and weights the offsets as in the measured field.
    is_fitted = [True] * problem.free_count + [_is_unknown_gain(nuisance) for nuisance in problem.nuisances]
    nominal = np.where(is_fitted, best.unknown, 0.0)
    return WavenumberFit(
        curve=DispersionCurve(frequency_hz, speed, u_speed, attenuation, u_attenuation),
        chi_square=best.chi_square,
        freedom=freedom,
        significance=float(chdtrc(freedom, best.chi_square)),
        nominal_m=tuple(problem.modelled(nominal)),
        error_m=_one_sigma_errors_m(problem, jacobian),
    )


def _law_without_relation(frequency_hz: FloatArray, density_kg_per_m3: float) -> Law:
    """Return a law with the parameters c (m/s) and alpha (Np/m) of each frequency in turn."""
    count = frequency_hz.size

    def modulus(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the modulus G = rho w^2 / q^2 (frequency,) at s = jw, and its derivatives (frequency, parameter).

        ``values``: phase velocity and attenuation of each frequency of the fit in turn.
        """
        omega = s.imag
        # A vibration may lack some of the frequencies.
        index = np.abs(omega[:, None] / (2 * np.pi) - frequency_hz).argmin(axis=1)
        speed, attenuation = values[2 * index], values[2 * index + 1]
        q = omega / speed - 1j * attenuation
        value = density_kg_per_m3 * omega**2 / q**2
        slopes, rows = np.zeros((s.size, 2 * count), np.complex128), np.arange(s.size)
        slopes[rows, 2 * index] = 2 * value / q * omega / speed**2
        slopes[rows, 2 * index + 1] = 2j * value / q
        return value, slopes

    parameters = [
        Parameter.linear(name, limits, ())
        for _ in range(count)
        for name, limits in (
            ("phase_velocity_m_per_s", SPEED_LIMITS_M_PER_S),
            ("attenuation_np_per_m", ATTENUATION_LIMITS_NP_PER_M),
        )
    ]
    return Law("dispersion", tuple(parameters), modulus)


def _is_unknown_gain(nuisance: Nuisance) -> bool:
    return nuisance.kind == "gain" and nuisance.uncertainty >= FREE_GAIN_UNCERTAINTY


def _one_sigma_errors_m(problem: Problem, jacobian: FloatArray) -> tuple[ComplexArray, ...]:
    """Return the errors of each vibration's phasors by one standard deviation of every source, (frequency, source), m.

    The independent sources are noise, as many as data, and the nuisances of the vibrations: positions and known gains.
    ``jacobian`` (datum, unknown): derivatives of the whitened residual.
    """
    # Errors of the push are left out: common to all offsets, they change the field and not how well it is measured.
    nuisance_columns = [
        problem.free_count + i
        for i, nuisance in enumerate(problem.nuisances)
        if nuisance.vibration != COMMON and not _is_unknown_gain(nuisance)
    ]
    # Whitened data have independent noise of standard deviation 1; nuisances are in units of their uncertainty.
    data = problem.data_count
    whitened_errors = np.hstack([np.eye(data), -jacobian[:data, nuisance_columns]])
    errors_m = block_diag(*(np.linalg.inv(whitening) for whitening in problem.whitening)) @ whitened_errors
    # Real and imaginary parts of a phasor are neighbouring rows.
    phasors_m = errors_m[0::2] + 1j * errors_m[1::2]
    sizes = [vibration.frequency_hz.size for vibration in problem.vibrations]
    return tuple(np.split(phasors_m, np.cumsum(sizes)[:-1]))
