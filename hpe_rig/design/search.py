"""Search for the best scene within limits: differential evolution over some of its numbers, then a pattern search."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.design.problem import OUTSIDE, Candidate, Problem
from hpe_rig.design.variables import Variable
from hpe_rig.scene import Mistake, SettingsError

NEEDLESS = 1e-4
"""Loss in the logarithm of what is minimised below which a number is left as it was."""
POPULATION, GENERATIONS = 10, 30
FINEST = 1e-4
"""Last step of the pattern search, of the whole range."""
OTHERWISE = "other bounds with --bound, or more keys in --over"


@dataclass(frozen=True)
class DesignResult:
    """The scene at the start and the best one, what holds the latter back, and how many were tried."""

    problem: Problem
    start: Candidate
    best: Candidate
    held: tuple[str, ...]


def find_design(problem: Problem, seed: int = 0, generations: int = GENERATIONS) -> DesignResult:
    """Return the best scene of ``problem`` after at most so many generations; the same seed gives the same.

    Raises ``SettingsError`` where no candidate keeps all limits, with what refuses the one that comes closest.
    """
    best = _without_the_needless(problem, _pattern_search(problem, _evolution(problem, seed, generations)))
    if problem.cost(best.values) >= OUTSIDE:
        raise SettingsError("design", list(_why_none(problem, best)))
    return DesignResult(problem, problem.start, best, tuple(_held(problem, best)))


def _place(problem: Problem, candidate: Candidate) -> FloatArray:
    """Return where ``candidate`` is in the space, or is nearest to it; in the middle for what has no value."""
    places = []
    for variable in problem.space:
        value = candidate.values.get(variable.key.path, variable.key.value)
        if value is None and variable.key.path == ("tracking", "pulse_count") and candidate.plan is not None:
            value = candidate.plan.shots[0].capture.record_count
        places.append(variable.last / 2 if value is None else variable.place(value))
    return np.array(places)


def _evolution(problem: Problem, seed: int, generations: int) -> FloatArray:
    from scipy.optimize import Bounds, differential_evolution

    def cost(place: FloatArray) -> float:
        return problem.cost(problem.values_at(place))

    found = differential_evolution(
        cost,
        Bounds(np.zeros(len(problem.space)), np.array([variable.last for variable in problem.space])),
        integrality=[variable.discrete for variable in problem.space],
        x0=_place(problem, problem.start),
        popsize=POPULATION,
        maxiter=generations,
        tol=1e-4,
        polish=False,
        seed=seed,
    )
    return np.asarray(found.x, dtype=np.float64)


def _pattern_search(problem: Problem, place: FloatArray) -> FloatArray:
    """Return the best place by steps along single variables and pairs of them, halved whenever none is better.

    A limit that two variables share, such as pulse rate and number of pulses in a given time, lets neither move alone.
    """
    last = np.array([variable.last for variable in problem.space])
    discrete = np.array([variable.discrete for variable in problem.space])
    cost, share = problem.cost(problem.values_at(place)), 0.1
    while share >= FINEST:
        better = False
        step = np.where(discrete, np.maximum(1.0, np.round(share * last)), share)
        for direction in _directions(len(place)):
            moved = np.clip(place + direction * step, 0.0, last)
            trial = problem.cost(problem.values_at(moved))
            if trial < cost:
                place, cost, better = moved, trial, True
        share = share if better else share / 2
    return place


def _directions(variables: int) -> list[FloatArray]:
    """Return both ways along every variable, then those of every pair in which both grow, or shrink, or trade."""
    axes = np.eye(variables)
    pairs = [one + sign * other for one, other in itertools.combinations(axes, 2) for sign in (1, -1)]
    return [sign * axis for axis in (*axes, *pairs) for sign in (1, -1)]


def _without_the_needless(problem: Problem, place: FloatArray) -> Candidate:
    """Return the candidate with every number that does not matter left as the starting scene has it."""
    best = problem.values_at(place)
    for variable in problem.space:
        own = variable.key.value
        if own is not None and not variable.low <= own <= variable.high:
            continue
        less = {path: value for path, value in best.items() if path != variable.key.path}
        if problem.cost(less) <= problem.cost(best) + NEEDLESS:
            best = less
    return problem.candidate(best)


def _held(problem: Problem, best: Candidate) -> Iterator[str]:
    """Yield what keeps each number of the best scene from going further to where it would be better."""
    place = _place(problem, best)
    for index, variable in enumerate(problem.space):
        if variable.key.path not in best.values:
            continue
        for sign, word in ((1, "more"), (-1, "less")):
            if place[index] == (variable.last if sign > 0 else 0.0):
                yield f"{variable.key} = {best.values[variable.key.path]:.6g}: its bound"
                continue
            reasons = next(filter(None, (_refused(problem, best, m) for m in _moves(problem, place, index, sign))), ())
            if reasons:
                yield f"{word} {variable.key}: {', '.join(reasons)}"


def _moves(problem: Problem, place: FloatArray, index: int, sign: int) -> Iterator[FloatArray]:
    """Yield places a step further along one variable, alone, then with every other along: some gain only together."""
    alone = place.copy()
    alone[index] = min(max(place[index] + sign * _step(problem.space[index]), 0.0), problem.space[index].last)
    yield alone
    for other, variable in enumerate(problem.space):
        step = max(1.0, round(0.01 * variable.last)) if variable.discrete else 0.01
        if other != index and place[other] + step <= variable.last:
            along = alone.copy()
            along[other] += step
            yield along


def _refused(problem: Problem, best: Candidate, place: FloatArray) -> list[str]:
    """Return what refuses the scene at ``place``; empty where nothing does, or it would be no better."""
    values = {path: value for path, value in problem.values_at(place).items() if path in best.values}
    trial = problem.judged(problem.candidate(values))
    if trial.setting is None or problem.cost(values) < OUTSIDE or problem.measure(trial) >= problem.measure(best):
        return []
    return [finding.check for finding in trial.conflicts] or list(problem.excess(trial))


def _step(variable: Variable) -> float:
    return 1.0 if variable.discrete else 0.01


def _why_none(problem: Problem, closest: Candidate) -> Iterator[Mistake]:
    for finding in closest.conflicts:
        yield Mistake(
            finding.check, f"no candidate passes, the closest has: {finding.text}", finding.remedy or OTHERWISE
        )
    if closest.conflicts:
        return
    assert closest.plan is not None  # noqa: S101
    excess, found = problem.excess(closest), closest.expected
    if "time" in excess:
        allowed_s = problem.constraints.longest_s
        what = f"the closest scene takes {closest.plan.duration_s:.4g} s, {allowed_s:.4g} s are allowed"
        yield Mistake("--longest-s", what, "more time, or a key in --over that shortens the scene")
    if "target" in excess and problem.constraints.target_m is not None:
        what = (
            f"the jitter comes down to {found.jitter_m * 1e9:.3g} nm (noise {found.noise_jitter_m * 1e9:.3g}, speckle "
            f"{found.speckle_jitter_m * 1e9:.3g}), {problem.constraints.target_m * 1e9:.3g} nm are wanted"
        )
        yield Mistake("--target", what, "a larger target, more keys in --over, or more time with --longest-s")
