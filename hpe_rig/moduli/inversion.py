"""Inversion of vibrations for the moduli of the medium: fits of material laws to its shear field.

Least squares over the medium's parameters and all nuisances (``problem.py``), from several starts. The result has the
covariance, a second minimum if there is one, the evidence of the law, and the contribution of each part of the data.
Derivation: docs/explanation/moduli.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import chdtrc

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.medium import Law, MediumLaw, law_names, law_of
from hpe_rig.moduli.problem import COMMON, Nuisance, Problem
from hpe_rig.moduli.vibration_model import Push, Vibration

MAX_STARTS = 3
"""Starting points of the fit: the best of a grid that are at least ``START_DISTANCE`` apart."""
START_DISTANCE = 1.5
ROUGH, FINE = 1e-4, 1e-8
"""Relative changes of chi-square that end the search from a start and the search for a minimum."""
MINIMUM_DISTANCE = 0.05
"""Distance of coordinates above which two minima count as different."""
MAX_STEPS = 100
"""Steps of the solver from one start; a law that cannot explain the data would continue slowly."""
SECOND_MINIMUM = 12.0
"""Chi-square above the best up to which another minimum is reported: its relative likelihood is 1 in 400."""
REJECTED = 1e-3
"""Probability of so large a misfit below which the data exclude a law."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of one gate or frequency: the uncertainty of every parameter without it, over that with it."""

    label: str
    growth: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Moduli:
    """Parameters of one law with covariance and goodness of fit.

    ``values`` and ``uncertainty`` by parameter name, SI; ``covariance`` (parameter, parameter). ``chi_square`` of data
    and nuisances, ``freedom`` its degrees of freedom, ``significance`` the probability of a larger one by chance.
    ``log_evidence`` of the law by Laplace's approximation, with every parameter uniform over its range. ``modelled_m``:
    complex amplitudes (frequency,) of each vibration. ``adjusted``: nuisances by name, in units of their uncertainty.
    ``second``: values and chi-square above the best of another minimum that is nearly as good, or None. ``at_limit``:
    parameters at the end of their range.
    """

    law: MediumLaw
    values: dict[str, float]
    uncertainty: dict[str, float]
    covariance: FloatArray
    chi_square: float
    freedom: int
    significance: float
    log_evidence: float
    modelled_m: tuple[ComplexArray, ...]
    adjusted: dict[str, float]
    second: tuple[dict[str, float], float] | None
    at_limit: tuple[str, ...]
    by_place: tuple[Contribution, ...] = ()
    by_frequency: tuple[Contribution, ...] = ()

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the parameters (parameter, parameter)."""
        sigma = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(sigma, sigma))

    @property
    def excluded(self) -> bool:
        """Whether the data exclude the law."""
        return self.significance < REJECTED


@dataclass(frozen=True, slots=True, eq=False)
class _Minimum:
    unknown: FloatArray
    chi_square: float


def fit_medium(vibrations: Sequence[Vibration], push: Push, law: MediumLaw = "voigt") -> Moduli:
    """Return the parameters of ``law`` that explain ``vibrations`` best; no starting values are needed.

    Raises ``ValueError`` for fewer data than free parameters and for an offset beyond ``MAX_LATERAL_M``.
    """
    problem = Problem.of(vibrations, push, law_of(law))
    if problem.data_count <= problem.free_count:
        raise ValueError(
            f"{problem.data_count} numbers do not determine {problem.free_count} unknowns of a {law} medium and their "
            "uncertainty. Try: measure at more lateral offsets or frequencies"
        )
    best, *candidates = _minima(problem)
    return _moduli(problem, best, _second_minimum(problem, best, candidates))


def compare_media(
    vibrations: Sequence[Vibration], push: Push, laws: Sequence[MediumLaw] | None = None
) -> tuple[tuple[Moduli, ...], FloatArray]:
    """Return the fit of every material law, the most likely first, and the laws' probabilities (law,).

    Without data all laws are equally probable. Laws that the data exclude come last. A law with a parameter at the end
    of its range has become a simpler law, and comes after those without.
    """
    fits = [fit_medium(vibrations, push, law) for law in laws or law_names()]
    fits.sort(key=lambda fit: (fit.excluded, bool(fit.at_limit), -fit.log_evidence))
    highest = max(fit.log_evidence for fit in fits)
    # Relative to the highest evidence, so that the exponentials do not underflow together.
    weight = np.exp([fit.log_evidence - highest for fit in fits])
    return tuple(fits), np.asarray(weight / weight.sum())


def bound(vibrations: Sequence[Vibration], push: Push, law: MediumLaw, values: Sequence[float]) -> FloatArray:
    """Return the Cramer-Rao bound of the covariance (parameter, parameter) of a law's parameters at ``values``.

    The phasors of ``vibrations`` set the common amplitude only.
    """
    problem = Problem.of(vibrations, push, law_of(law))
    unknown, _ = problem.start(problem.law.coordinates(np.asarray(values, np.float64)))
    return problem.in_values(unknown, problem.coordinate_covariance(problem.jacobian(unknown)))


def _starts(problem: Problem) -> list[FloatArray]:
    """Return up to ``MAX_STARTS`` starting points of the fit from a coarse grid over the law's parameters.

    They are chosen in the order of their chi-square, each more than ``START_DISTANCE`` from those chosen before.
    """
    # Distances leave out the other unknowns, amplitude and nuisances.
    count = problem.coordinate_count
    points, costs = zip(*(problem.start(coordinates) for coordinates in problem.law.starts()), strict=True)
    starts: list[FloatArray] = []
    for index in np.argsort(costs):
        point = points[index]
        if all(np.abs(point[:count] - start[:count]).max() > START_DISTANCE for start in starts):
            starts.append(point)
        if len(starts) == MAX_STARTS:
            break
    return starts


def _minima(problem: Problem) -> list[_Minimum]:
    """Return the best minimum of chi-square, then other minima that may be nearly as good.

    The fit is run from every starting point with a quick, less exact field. Only candidates for a second minimum are
    then refined.
    """
    quick = problem.with_quick_field()
    rough = sorted((solve(quick, start, ROUGH) for start in _starts(quick)), key=lambda minimum: minimum.chi_square)
    # The quick field has found the basin; the full field gives the minimum.
    best = solve(problem, rough[0].unknown, FINE)
    candidates = (
        solve(problem, minimum.unknown, FINE)
        for minimum in rough[1:]
        if minimum.chi_square - best.chi_square < 10 * SECOND_MINIMUM and _differ(problem, minimum, best)
    )
    return sorted([best, *candidates], key=lambda minimum: minimum.chi_square)


def _differ(problem: Problem, first: _Minimum, second: _Minimum) -> bool:
    """Return whether two minima are at different parameters of the material law."""
    difference = (first.unknown - second.unknown)[: problem.coordinate_count]
    return bool(np.abs(difference).max() > MINIMUM_DISTANCE)


def solve(problem: Problem, start: FloatArray, change: float) -> _Minimum:
    """Return the minimum of chi-square next to the unknowns ``start``, within the limits of the law's parameters.

    The solver stops at a relative ``change`` of chi-square.
    """
    # Imported here: the forecast of ``hpe-rig check`` uses this module without a fit.
    from scipy.optimize import least_squares

    limits = problem.law.bounds()
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[: len(limits)], high[: len(limits)] = limits.T
    # The solver needs a start strictly inside the limits.
    inside = start.copy()
    inside[: len(limits)] = np.clip(inside[: len(limits)], limits[:, 0] + 1e-6, limits[:, 1] - 1e-6)
    solution = least_squares(
        problem.residual,
        inside,
        problem.jacobian,
        (low, high),
        x_scale="jac",
        xtol=change / 10,
        ftol=change,
        gtol=1e-10,
        max_nfev=MAX_STEPS,
    )
    return _Minimum(np.asarray(solution.x), 2 * float(solution.cost))


def _second_minimum(
    problem: Problem, best: _Minimum, candidates: Sequence[_Minimum]
) -> tuple[dict[str, float], float] | None:
    """Return parameters by name, and chi-square above the best, of another nearly as good minimum; else None."""
    for candidate in candidates:
        excess = candidate.chi_square - best.chi_square
        if excess < SECOND_MINIMUM and _differ(problem, candidate, best):
            return _by_name(problem.law, problem.law.values(candidate.unknown[: problem.coordinate_count])), excess
    return None


def _moduli(problem: Problem, best: _Minimum, second: tuple[dict[str, float], float] | None) -> Moduli:
    """Return parameters, covariance and goodness of fit at the ``best`` minimum.

    ``second``: another minimum that is nearly as good, as parameters and chi-square above the best, or None.
    """
    count, law, vibrations = problem.coordinate_count, problem.law, problem.vibrations
    coordinates, jacobian = best.unknown[:count], problem.jacobian(best.unknown)
    coordinate_covariance = problem.coordinate_covariance(jacobian)
    covariance = problem.in_values(best.unknown, coordinate_covariance)
    freedom = problem.data_count - problem.free_count
    # Each phasor belongs to one vibration and one frequency: their indices.
    vibration_of_phasor = np.repeat(
        np.arange(len(vibrations)), [vibration.frequency_hz.size for vibration in vibrations]
    )
    frequencies, frequency_of_phasor = np.unique(
        np.concatenate([vibration.frequency_hz for vibration in vibrations]), return_inverse=True
    )
    contributions = partial(
        _contributions, problem=problem, jacobian=jacobian, variances=np.diag(coordinate_covariance)
    )
    at_limit = np.any(np.abs(coordinates[:, None] - law.bounds()) < 1e-3, axis=1).tolist()
    return Moduli(
        law=law.name,
        values=_by_name(law, law.values(coordinates)),
        uncertainty=_by_name(law, np.sqrt(np.diag(covariance))),
        covariance=covariance,
        chi_square=best.chi_square,
        freedom=freedom,
        significance=float(chdtrc(freedom, best.chi_square)),
        log_evidence=_log_evidence(law, best.chi_square, coordinate_covariance),
        modelled_m=tuple(problem.modelled(best.unknown)),
        adjusted={
            _nuisance_name(nuisance, vibrations): float(best.unknown[problem.free_count + i])
            for i, nuisance in enumerate(problem.nuisances)
        },
        second=second,
        at_limit=tuple(parameter.name for parameter, at in zip(law.parameters, at_limit, strict=True) if at),
        by_place=contributions([vibration.label for vibration in vibrations], vibration_of_phasor),
        by_frequency=contributions([f"{hz:g} Hz" for hz in frequencies], frequency_of_phasor),
    )


def _log_evidence(law: Law, chi_square: float, covariance: FloatArray) -> float:
    """Return the logarithm of the law's evidence, which compares laws: likelihood times posterior over prior volume.

    This is Laplace's approximation. ``covariance`` (parameter, parameter) is that of the law's coordinates. The
    variance of a uniform distribution over the range limits the posterior volume.
    """
    span = np.ptp(law.bounds(), axis=1)
    # 12 / span^2 is the inverse variance of a uniform distribution.
    posterior = np.linalg.inv(np.linalg.inv(covariance) + np.diag(12 / span**2))
    return float(-chi_square / 2 + (np.linalg.slogdet(2 * np.pi * posterior)[1] / 2) - np.log(span).sum())


def _nuisance_name(nuisance: Nuisance, vibrations: Sequence[Vibration]) -> str:
    """Return the name of an unknown that is not wanted: its kind, and the gate or lateral offset it belongs to."""
    if nuisance.vibration == COMMON:
        return nuisance.kind
    vibration = vibrations[nuisance.vibration]
    # All gates at one lateral offset move with the stage, so its error belongs to the offset and not to one gate.
    location = f"{vibration.lateral_m * 1e3:g} mm" if nuisance.kind == "stage" else vibration.label
    return f"{nuisance.kind} at {location}"


def _contributions(
    labels: Sequence[str], label_of_phasor: IndexArray, problem: Problem, jacobian: FloatArray, variances: FloatArray
) -> tuple[Contribution, ...]:
    """Return, for each gate or frequency, the factor on the parameters' uncertainties if its data are left out.

    ``labels``: names of the gates, or of the frequencies. ``label_of_phasor``: index of the label of each measured
    phasor. ``variances`` (parameter,): of the fit to all data. Empty for fewer than two labels.
    """
    if len(labels) < 2:
        return ()
    contributions = []
    for index, label in enumerate(labels):
        # The Jacobian at the minimum gives the variances without another fit.
        remaining = problem.variances_without(label_of_phasor == index, jacobian)
        contributions.append(Contribution(label, tuple(np.sqrt(remaining / variances).tolist())))
    return tuple(contributions)


def _by_name(law: Law, values: FloatArray) -> dict[str, float]:
    return {parameter.name: float(value) for parameter, value in zip(law.parameters, values, strict=True)}
