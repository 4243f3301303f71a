"""Search for the best scene within limits: differential evolution over its variables, then a pattern search."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.design.problem import INFEASIBLE_COST, Candidate, Problem
from hpe_rig.scene import Mistake, SettingsError

IRRELEVANT_COST = 1e-4
"""Loss in the logarithm of the goal below which a number keeps its starting value."""
POPULATION, GENERATIONS = 10, 30
MIN_STEP = 1e-4
"""Last step of the pattern search relative to the range."""
NEIGHBOUR_STEP = 0.01
"""Step relative to the range for the test of the limits of the best scene."""
OTHER_SPACE = "other bounds with --bound, or more keys in --over"


@dataclass(frozen=True)
class DesignResult:
    """The starting scene, the best one, and the limits that prevent a further improvement, in words."""

    problem: Problem
    start: Candidate
    best: Candidate
    limits: tuple[str, ...]


def find_design(problem: Problem, seed: int = 0, generations: int = GENERATIONS) -> DesignResult:
    """Return the best scene of ``problem`` after at most ``generations``; repeatable from ``seed``.

    Raises ``SettingsError`` if no candidate satisfies all limits, with the conflicts of the closest one.
    """
    position = _pattern_search(problem, _evolution(problem, seed, generations))
    best = _without_irrelevant_changes(problem, position)
    if problem.cost(best.values) >= INFEASIBLE_COST:
        raise SettingsError("design", list(_infeasibility(problem, best)))
    return DesignResult(problem, problem.start, best, tuple(_limits(problem, best)))


def _position(problem: Problem, candidate: Candidate) -> FloatArray:
    """Return the position in the space nearest to ``candidate``; the middle for a number without a value."""
    positions = []
    for variable in problem.space:
        value = candidate.values.get(variable.key.path, variable.key.value)
        if value is None and variable.key.path == ("tracking", "pulse_count") and candidate.plan is not None:
            value = candidate.plan.shots[0].capture.record_count
        positions.append(variable.last / 2 if value is None else variable.position(value))
    return np.array(positions)


def _last_positions(problem: Problem) -> FloatArray:
    return np.array([variable.last for variable in problem.space])


def _evolution(problem: Problem, seed: int, generations: int) -> FloatArray:
    from scipy.optimize import Bounds, differential_evolution

    def cost(position: FloatArray) -> float:
        return problem.cost(problem.values_at(position))

    optimum = differential_evolution(
        cost,
        Bounds(np.zeros(len(problem.space)), _last_positions(problem)),
        integrality=[variable.discrete for variable in problem.space],
        x0=_position(problem, problem.start),
        popsize=POPULATION,
        maxiter=generations,
        tol=1e-4,
        polish=False,
        seed=seed,
    )
    return np.asarray(optimum.x, dtype=np.float64)


def _pattern_search(problem: Problem, position: FloatArray) -> FloatArray:
    """Return the best position by steps along variables and pairs of them; the step halves without improvement.

    Pairs are needed where two variables share a limit, such as pulse rate and number of pulses in a given time.
    """
    last = _last_positions(problem)
    discrete = np.array([variable.discrete for variable in problem.space])
    # Steps are relative to the range, and at least one step of a discrete number.
    cost, relative_step = problem.cost(problem.values_at(position)), 0.1
    while relative_step >= MIN_STEP:
        improved = False
        step = np.where(discrete, np.maximum(1.0, np.round(relative_step * last)), relative_step)
        for direction in _directions(len(position)):
            trial = np.clip(position + direction * step, 0.0, last)
            trial_cost = problem.cost(problem.values_at(trial))
            if trial_cost < cost:
                position, cost, improved = trial, trial_cost, True
        relative_step = relative_step if improved else relative_step / 2
    return position


def _directions(variables: int) -> list[FloatArray]:
    """Return the directions along every variable, and of equal or opposite change of every pair."""
    axes = np.eye(variables)
    pairs = [first + sign * second for first, second in itertools.combinations(axes, 2) for sign in (1, -1)]
    return [sign * axis for axis in (*axes, *pairs) for sign in (1, -1)]


def _without_irrelevant_changes(problem: Problem, position: FloatArray) -> Candidate:
    """Return the candidate at ``position``; numbers without influence on the goal keep their starting value."""
    best = problem.values_at(position)
    for variable in problem.space:
        initial = variable.key.value
        # A starting value outside the bounds is not allowed.
        if initial is not None and not variable.low <= initial <= variable.high:
            continue
        reduced = {path: value for path, value in best.items() if path != variable.key.path}
        if problem.cost(reduced) <= problem.cost(best) + IRRELEVANT_COST:
            best = reduced
    return problem.candidate(best)


def _limits(problem: Problem, best: Candidate) -> Iterator[str]:
    """Yield the limit that prevents each number of the best scene from a further improvement."""
    position = _position(problem, best)
    for index, variable in enumerate(problem.space):
        if variable.key.path not in best.values:
            continue
        for sign, word in ((1, "more"), (-1, "less")):
            if position[index] == (variable.last if sign > 0 else 0.0):
                yield f"{variable.key} = {best.values[variable.key.path]:.6g}: its bound"
                continue
            conflicts = (_conflicts(problem, best, trial) for trial in _neighbours(problem, position, index, sign))
            if names := next(filter(None, conflicts), ()):
                yield f"{word} {variable.key}: {', '.join(names)}"


def _neighbours(problem: Problem, position: FloatArray, index: int, sign: int) -> Iterator[FloatArray]:
    """Yield positions one step along variable ``index``: alone, then together with an increase of each other one."""
    variable = problem.space[index]
    step = 1.0 if variable.discrete else NEIGHBOUR_STEP
    single = position.copy()
    single[index] = min(max(position[index] + sign * step, 0.0), variable.last)
    yield single
    for second, companion in enumerate(problem.space):
        # A discrete companion moves by at least one step.
        step = max(1.0, round(NEIGHBOUR_STEP * companion.last)) if companion.discrete else NEIGHBOUR_STEP
        if second != index and position[second] + step <= companion.last:
            pair = single.copy()
            pair[second] += step
            yield pair


def _conflicts(problem: Problem, best: Candidate, position: FloatArray) -> list[str]:
    """Return the checks and limits that refuse the scene at ``position``; empty if none does or it is no better."""
    values = {path: value for path, value in problem.values_at(position).items() if path in best.values}
    trial = problem.judged(problem.candidate(values))
    feasible = problem.cost(values) < INFEASIBLE_COST
    if trial.setting is None or feasible or problem.measure(trial) >= problem.measure(best):
        return []
    return [conflict.check for conflict in trial.conflicts] or list(problem.excess(trial))


def _infeasibility(problem: Problem, closest: Candidate) -> Iterator[Mistake]:
    """Yield the reasons why even the closest candidate violates a limit."""
    for conflict in closest.conflicts:
        what = f"no candidate passes, the closest has: {conflict.text}"
        yield Mistake(conflict.check, what, conflict.remedy or OTHER_SPACE)
    if closest.conflicts:
        return
    _, plan, _ = closest.inputs()
    excess, prediction = problem.excess(closest), closest.expected
    if "time" in excess:
        what = f"the closest scene takes {plan.duration_s:.4g} s, {problem.longest_s:.4g} s are allowed"
        yield Mistake("--longest-s", what, "more time, or a key in --over that shortens the scene")
    if "target" in excess and problem.target_m is not None:
        what = (
            f"the smallest jitter is {prediction.jitter_m * 1e9:.3g} nm (noise {prediction.noise_jitter_m * 1e9:.3g}, "
            f"speckle {prediction.speckle_jitter_m * 1e9:.3g}), above the {problem.target_m * 1e9:.3g} nm"
        )
        yield Mistake("--target", what, "a larger target, more keys in --over, or more time with --longest-s")
