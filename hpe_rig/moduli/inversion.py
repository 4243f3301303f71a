"""Inversion of vibrations at several places for the moduli of the medium, by its own shear field.

Least squares over the medium's parameters and all that is known of push and places within an uncertainty, so that the
covariance holds what is not known of them; second minima, evidence, and what each datum brings. docs/theory/moduli.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.medium import Law, MediumLaw, law_names, law_of
from hpe_rig.moduli.vibration_model import Problem, Push, Vibration

STARTS_FOLLOWED = 3
"""Starting points from which the fit is run, the best of a grid; each in a neighbourhood of its own."""
ROUGH, FINE = 1e-4, 1e-8
"""Relative change of chi-square at which a start has been followed far enough, and at which a minimum is found."""
APART = 0.05
"""Of coordinates, from where on two minima are two."""
MOST_STEPS = 100
"""Of the solver from one start; a law that cannot explain the data would crawl on."""
SECOND_MINIMUM = 12.0
"""Chi-square above the best up to which another minimum is told of: it is as likely as one in 400."""
REJECTED = 1e-3
"""Probability of so large a misfit below which a law is said to be excluded."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one place or one frequency brings: the uncertainty of every parameter without it, over that with it."""

    label: str
    growth: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Moduli:
    """Parameters of one law with covariance and goodness of fit.

    ``values`` and ``uncertainty`` by the law's parameter names, SI; ``covariance`` (parameter, parameter);
    ``chi_square`` of data and of what was known beforehand, over ``freedom``; ``significance``: the probability of a
    larger one by chance; ``log_evidence`` of the law by Laplace's approximation, every parameter equally likely over
    its range; ``modelled_m``: per place, complex amplitudes (frequency,); ``adjusted``: what the fit made of what was
    known within an uncertainty, each in units of it; ``second``: values and chi-square above the best of another
    minimum that is nearly as good, None where there is none; ``at_limit``: parameters at the end of their range.
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


def fit_medium(vibrations: Sequence[Vibration], push: Push, law: MediumLaw = "voigt") -> Moduli:
    """Return the parameters of ``law`` that explain ``vibrations`` best; no starting values are needed.

    Raises ``ValueError`` for fewer data than free parameters and for a place farther than ``FARTHEST_M``.
    """
    problem = Problem.of(vibrations, push, law_of(law))
    if problem.data_count <= problem.free:
        raise ValueError(
            f"{problem.data_count} numbers cannot give {problem.free} unknowns of a {law} medium and their "
            "uncertainty: measure at more places or frequencies"
        )
    (best, cost), *others = _minima(problem)
    return _described(problem, best, cost, _second(problem, best, cost, others))


def compare_media(
    vibrations: Sequence[Vibration], push: Push, laws: Sequence[MediumLaw] | None = None
) -> tuple[tuple[Moduli, ...], FloatArray]:
    """Return the fit of every law, the likeliest first, and the laws' probabilities (law,), equal beforehand.

    A law with a parameter at the end of its range comes after those that the data leave inside: it is a simpler one.
    """
    fits = [fit_medium(vibrations, push, law) for law in laws or law_names()]
    fits.sort(key=lambda each: (each.excluded, bool(each.at_limit), -each.log_evidence))
    highest = max(each.log_evidence for each in fits)
    weight = np.exp([each.log_evidence - highest for each in fits])
    return tuple(fits), np.asarray(weight / weight.sum())


def bound(vibrations: Sequence[Vibration], push: Push, law: MediumLaw, values: Sequence[float]) -> FloatArray:
    """Return the Cramer-Rao bound of the covariance of a law's parameters, (parameter, parameter), at ``values``.

    The phasors of ``vibrations`` count only for the overall amplitude.
    """
    problem = Problem.of(vibrations, push, law_of(law))
    coordinates = np.array(
        [one.to_coordinate(value) for one, value in zip(problem.law.parameters, values, strict=True)]
    )
    return problem.covariance(problem.start(coordinates)[0])


def _starts(problem: Problem) -> list[FloatArray]:
    """Return the unknowns at the best points of a coarse grid, no two next to each other."""
    tried, cost = zip(*(problem.start(each) for each in problem.law.starts()), strict=True)
    kept: list[FloatArray] = []
    for index in np.argsort(cost):
        count = problem.free - 1
        if all(np.abs(tried[index][:count] - each[:count]).max() > 1.5 for each in kept):
            kept.append(tried[index])
        if len(kept) == STARTS_FOLLOWED:
            break
    return kept


def _minima(problem: Problem) -> list[tuple[FloatArray, float]]:
    """Return unknowns and chi-square of the best minimum, then of others that may be nearly as good.

    Every start is followed roughly; what is no second minimum then needs no digits.
    """
    count, quick = problem.free - 1, problem.quickened()
    rough = sorted((_solved(quick, start, ROUGH) for start in _starts(quick)), key=lambda each: each[1])
    best, cost = _solved(problem, rough[0][0], FINE)
    others = (
        unknown
        for unknown, its_cost in rough[1:]
        if its_cost - cost < 10 * SECOND_MINIMUM and np.abs(unknown[:count] - best[:count]).max() > APART
    )
    found = [(best, cost), *(_solved(problem, unknown, FINE) for unknown in others)]
    return sorted(found, key=lambda each: each[1])


def _solved(problem: Problem, start: FloatArray, change: float) -> tuple[FloatArray, float]:
    """Return the unknowns of the minimum next to ``start``, and its chi-square, to this relative ``change`` of it."""
    limits = np.array([one.bounds for one in problem.law.parameters])
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[: len(limits)], high[: len(limits)] = limits.T
    inside = start.copy()
    inside[: len(limits)] = np.clip(inside[: len(limits)], limits[:, 0] + 1e-6, limits[:, 1] - 1e-6)
    found = least_squares(
        problem.residual,
        inside,
        problem.jacobian,
        (low, high),
        x_scale="jac",
        xtol=change / 10,
        ftol=change,
        gtol=1e-10,
        max_nfev=MOST_STEPS,
    )
    return np.asarray(found.x), 2 * float(found.cost)


def _second(
    problem: Problem, best: FloatArray, cost: float, others: Sequence[tuple[FloatArray, float]]
) -> tuple[dict[str, float], float] | None:
    """Return another minimum that is nearly as good as the best, None where there is none."""
    count = problem.free - 1
    for other, its_cost in others:
        if its_cost - cost < SECOND_MINIMUM and np.abs(other[:count] - best[:count]).max() > APART:
            return _named(problem.law, problem.law.values(other[:count])), its_cost - cost
    return None


def _described(
    problem: Problem, unknown: FloatArray, cost: float, second: tuple[dict[str, float], float] | None
) -> Moduli:
    count, law = problem.free - 1, problem.law
    jacobian = problem.jacobian(unknown)
    own = problem.coordinate_covariance(jacobian)
    covariance = problem.in_values(unknown, own)
    freedom = problem.data_count - problem.free
    span = np.array([one.bounds[1] - one.bounds[0] for one in law.parameters])
    # Laplace: the best likelihood, times the share of the range that the data leave; never more than all of it, whose
    # variance is that of an even distribution
    left = np.linalg.inv(np.linalg.inv(own) + np.diag(12 / span**2))
    log_evidence = -cost / 2 + (np.linalg.slogdet(2 * np.pi * left)[1] / 2) - np.log(span).sum()
    vibrations = problem.vibrations
    place = np.repeat(np.arange(len(vibrations)), [one.frequency_hz.size for one in vibrations])
    frequencies, frequency = np.unique(np.concatenate([one.frequency_hz for one in vibrations]), return_inverse=True)
    limits = np.array([one.bounds for one in law.parameters])
    near = np.abs(unknown[:count, None] - limits) < 1e-3
    return Moduli(
        law=law.name,
        values=_named(law, law.values(unknown[:count])),
        uncertainty=_named(law, np.sqrt(np.diag(covariance))),
        covariance=covariance,
        chi_square=cost,
        freedom=freedom,
        significance=float(chdtrc(freedom, cost)),
        log_evidence=float(log_evidence),
        modelled_m=tuple(problem.modelled(unknown)),
        adjusted={
            _nuisance(kind, None if where < 0 else vibrations[where]): float(unknown[problem.free + i])
            for i, (kind, where, _) in enumerate(problem.nuisances)
        },
        second=second,
        at_limit=tuple(one.name for one, at in zip(law.parameters, near, strict=True) if at.any()),
        by_place=_contributions([one.label for one in vibrations], place, problem, jacobian, own),
        by_frequency=_contributions([f"{hz:g} Hz" for hz in frequencies], frequency, problem, jacobian, own),
    )


def _nuisance(kind: str, one: Vibration | None) -> str:
    """Return the name of a nuisance, ``one`` the vibration that it is of."""
    if one is None:
        return kind
    return f"{kind} at {one.lateral_m * 1e3:g} mm" if kind == "stage" else f"{kind} at {one.label}"


def _contributions(
    labels: Sequence[str],
    number: IndexArray,
    problem: Problem,
    jacobian: FloatArray,
    own: FloatArray,
) -> tuple[Contribution, ...]:
    """Return what each part of the data brings, datum i (place and frequency,) belonging to part ``number[i]``."""
    if len(labels) < 2:
        return ()
    parts = (problem.variances_without(number == part, jacobian) for part in range(len(labels)))
    growth = [np.sqrt(without / np.diag(own)).tolist() for without in parts]
    return tuple(Contribution(label, tuple(each)) for label, each in zip(labels, growth, strict=True))


def _named(law: Law, values: FloatArray) -> dict[str, float]:
    return {one.name: float(value) for one, value in zip(law.parameters, values, strict=True)}
