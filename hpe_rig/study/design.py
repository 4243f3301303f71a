"""The best scene within limits: differential evolution over some of its numbers, then a pattern search.

Every candidate is planned and checked as ``hpe-rig check`` does; what a bench or the physics refuse is no candidate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hpe_rig.bench import check_simulation
from hpe_rig.bench_file import BenchFile
from hpe_rig.finding import Finding
from hpe_rig.jitter_model import Expected, Setting
from hpe_rig.mistakes import Mistake, Path, SettingsError, mistakes_of
from hpe_rig.plan import Plan
from hpe_rig.run import Setup, planned
from hpe_rig.safety import AcousticOutput, highest_output
from hpe_rig.scene import Scene
from hpe_rig.study.design_model import Baseline, baseline, design_setting, predicted
from hpe_rig.study.design_space import Variable
from hpe_rig.study.scene_keys import Number, with_values

Goal = Literal["jitter", "phase-jitter", "bias", "time"]
GOALS: tuple[Goal, ...] = get_args(Goal)

SEARCH_DRAWS = 200
"""Scatterer draws of a candidate: all have the same, so that their differences are better known than each."""
FINAL_DRAWS = 2000
"""Draws, other ones, of the scene at the start and of the winner."""
FINAL_SEED = 1
SIDE_WEIGHT = 1e-6
"""Weight of the logarithm of what is not minimised: time for jitter or bias, jitter for time. It decides ties alone."""
NEEDLESS = 1e-4
"""Loss in the logarithm of what is minimised below which a number is left as it was."""
POPULATION, GENERATIONS = 10, 30
FINEST = 1e-4
OUTSIDE = 100.0
"""Cost beyond which a candidate keeps a limit not; logarithms of jitters and times stay far below."""

Values = Mapping[Path, Number]


@dataclass(frozen=True, slots=True)
class Limits:
    """What no candidate may exceed."""

    longest_s: float
    target_m: float | None = None


@dataclass(frozen=True)
class Candidate:
    """One scene with what its plan and the model say of it; ``conflicts`` is what refuses it."""

    values: Values
    conflicts: tuple[Finding, ...]
    scene: Scene | None = None
    plan: Plan | None = None
    setting: Setting | None = None

    @cached_property
    def expected(self) -> Expected:
        """Bias and jitter as the search sees them."""
        return self.predict(SEARCH_DRAWS, 0)

    def predict(self, draws: int, seed: int) -> Expected:
        """Return bias and jitter by the scene's own estimator."""
        assert self.scene is not None  # noqa: S101
        assert self.setting is not None  # noqa: S101
        return predicted(self.setting, self.scene.processing.estimator, draws, seed)

    def output(self, bench: BenchFile) -> AcousticOutput | None:
        """Return the estimated acoustic output; None where nothing is calibrated."""
        assert self.plan is not None  # noqa: S101
        return None if bench.calibration is None else highest_output(bench, self.plan.shots)


class Problem:
    """Candidates of one starting scene and how good they are; each is made and judged once."""

    def __init__(
        self, setup: Setup, tables: Mapping[str, Any], space: Sequence[Variable], goal: Goal, limits: Limits
    ) -> None:
        self.bench, self.space, self.goal, self.limits = setup.bench.bench, tuple(space), goal, limits
        self._tables = tables
        self.baseline: Baseline = baseline(setup.scene.scene)
        self._accepted = {found.check for found in setup.findings if found.level == "warning"}
        self._twin = any(variable.key.path[0] == "simulation" for variable in space)
        self._seen: dict[tuple[tuple[Path, Number], ...], Candidate] = {}
        self.start = self.candidate({})

    @property
    def tried(self) -> int:
        """How many different scenes have been judged."""
        return len(self._seen)

    def at(self, place: NDArray[np.float64]) -> Candidate:
        """Return the candidate at ``place`` (variable,) of the space."""
        return self.candidate(
            {variable.key.path: variable.value(x) for variable, x in zip(self.space, place, strict=True)}
        )

    def candidate(self, values: Values) -> Candidate:
        """Return the starting scene with ``values``."""
        key = tuple(values.items())
        if key not in self._seen:
            self._seen[key] = self._candidate(dict(values))
        return self._seen[key]

    def cost(self, candidate: Candidate) -> float:
        """Return what is minimised: below `OUTSIDE` within all limits, beyond by how far a candidate is outside."""
        if candidate.conflicts:
            return OUTSIDE**2 * len(candidate.conflicts)
        excess = sum(math.log(ratio) for ratio in self.excess(candidate).values())
        return OUTSIDE + excess if excess > 0 else self.measure(candidate)

    def excess(self, candidate: Candidate) -> dict[str, float]:
        """Return by which factor a candidate is beyond each limit that it does not keep."""
        assert candidate.plan is not None  # noqa: S101
        found = {"time": candidate.plan.duration_s / self.limits.longest_s}
        if self.limits.target_m is not None and self.goal != "jitter":
            found["target"] = candidate.expected.jitter_m / self.limits.target_m
        return {name: ratio for name, ratio in found.items() if ratio > 1 + 1e-9}

    def measure(self, candidate: Candidate) -> float:
        """Return the logarithm of what the goal minimises; jitter and bias relative to the amplitude."""
        assert candidate.plan is not None  # noqa: S101
        assert candidate.setting is not None  # noqa: S101
        found, amplitude_m = candidate.expected, candidate.setting.amplitude_m
        time, jitter = math.log(candidate.plan.duration_s), math.log(found.jitter_m / amplitude_m)
        if self.goal == "time":
            return time + SIDE_WEIGHT * jitter
        main = {
            "jitter": jitter,
            "phase-jitter": math.log(found.phase_jitter_rad),
            "bias": math.log(max(abs(found.bias_m) / amplitude_m, 1e-9)),
        }
        return main[self.goal] + SIDE_WEIGHT * time

    def _candidate(self, values: Values) -> Candidate:
        tables = with_values(self._tables, values)
        mistakes = mistakes_of(Scene, tables)
        if self._twin:
            mistakes += check_simulation(tables.get("simulation", {}))
        if mistakes:
            return Candidate(values, tuple(_conflict(mistake) for mistake in mistakes))
        scene = Scene.model_validate(tables)
        try:
            plan, found = planned(scene, self.bench)
        except SettingsError as error:
            return Candidate(values, tuple(_conflict(mistake) for mistake in error.mistakes), scene)
        conflicts = tuple(
            finding
            for finding in found
            if finding.level == "refused" or (finding.level == "warning" and finding.check not in self._accepted)
        )
        refused = Candidate(values, conflicts, scene, plan)
        return refused if conflicts else self.judged(refused)

    def judged(self, candidate: Candidate) -> Candidate:
        """Return ``candidate`` as the model sees it, whatever refuses it; with one more conflict where it cannot."""
        if candidate.setting is not None or candidate.scene is None or candidate.plan is None:
            return candidate
        try:
            return replace(candidate, setting=design_setting(candidate.scene, candidate.plan, self.baseline))
        except ValueError as error:
            conflict = Finding("resolution", "refused", str(error), "a longer processing window, or fewer frequencies")
            return replace(candidate, conflicts=(*candidate.conflicts, conflict))


@dataclass(frozen=True)
class Design:
    """The scene at the start and the best one, what holds the latter back, and how many were tried."""

    problem: Problem
    start: Candidate
    best: Candidate
    held: tuple[str, ...]


def design(problem: Problem, seed: int = 0, generations: int = GENERATIONS) -> Design:
    """Return the best scene of ``problem`` after at most so many generations; the same seed gives the same.

    Raises ``SettingsError`` where no candidate keeps all limits, with what refuses the one that comes closest.
    """
    best = _without_the_needless(problem, _pattern_search(problem, _evolution(problem, seed, generations)))
    if problem.cost(best) >= OUTSIDE:
        raise SettingsError("design", list(_why_none(problem, best)))
    return Design(problem, problem.start, best, tuple(_held(problem, best)))


def _conflict(mistake: Mistake) -> Finding:
    return Finding(mistake.path, "refused", mistake.what, mistake.remedy)


def _place(problem: Problem, candidate: Candidate) -> NDArray[np.float64]:
    """Return where ``candidate`` is in the space, or is nearest to it; in the middle for what has no value."""
    places = []
    for variable in problem.space:
        value = candidate.values.get(variable.key.path, variable.key.value)
        if value is None and variable.key.path == ("tracking", "pulse_count") and candidate.plan is not None:
            value = candidate.plan.shots[0].capture.record_count
        places.append(variable.last / 2 if value is None else variable.place(value))
    return np.array(places)


def _evolution(problem: Problem, seed: int, generations: int) -> NDArray[np.float64]:
    from scipy.optimize import Bounds, differential_evolution

    def cost(place: NDArray[np.float64]) -> float:
        return problem.cost(problem.at(place))

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


def _pattern_search(problem: Problem, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the best place by steps along single variables, halved whenever none is better."""
    last = np.array([variable.last for variable in problem.space])
    discrete = np.array([variable.discrete for variable in problem.space])
    cost, share = problem.cost(problem.at(place)), 0.1
    while share >= FINEST:
        better = False
        for index in range(len(place)):
            step = max(1.0, round(share * last[index])) if discrete[index] else share
            for sign in (1, -1):
                moved = place.copy()
                moved[index] = min(max(place[index] + sign * step, 0.0), last[index])
                trial = problem.cost(problem.at(moved))
                if trial < cost:
                    place, cost, better = moved, trial, True
        share = share if better else share / 2
    return place


def _without_the_needless(problem: Problem, place: NDArray[np.float64]) -> Candidate:
    """Return the candidate with every number that does not matter left as the starting scene has it."""
    best = problem.at(place)
    for variable in problem.space:
        own = variable.key.value
        if own is not None and not variable.low <= own <= variable.high:
            continue
        values = {path: value for path, value in best.values.items() if path != variable.key.path}
        less = problem.candidate(values)
        if problem.cost(less) <= problem.cost(best) + NEEDLESS:
            best = less
    return best


def _held(problem: Problem, best: Candidate) -> Iterator[str]:
    """Yield what keeps each number of the best scene from going further to where it would be better."""
    place = _place(problem, best)
    for index, variable in enumerate(problem.space):
        if variable.key.path not in best.values:
            continue
        for sign, word in ((1, "more"), (-1, "less")):
            moved = place.copy()
            moved[index] = np.clip(place[index] + sign * (1.0 if variable.discrete else 0.01), 0.0, variable.last)
            if moved[index] == place[index]:
                yield f"{variable.key} = {best.values[variable.key.path]:.6g}: its bound"
                continue
            trial = problem.judged(problem.at(moved))
            inside = problem.cost(trial) < OUTSIDE
            if trial.setting is None or inside or problem.measure(trial) >= problem.measure(best):
                continue
            reasons = [finding.check for finding in trial.conflicts] or list(problem.excess(trial))
            yield f"{word} {variable.key}: {', '.join(reasons)}"


def _why_none(problem: Problem, closest: Candidate) -> Iterator[Mistake]:
    for finding in closest.conflicts:
        yield Mistake(finding.check, f"no candidate passes, the closest has: {finding.text}", finding.remedy)
    if closest.conflicts:
        return
    assert closest.plan is not None  # noqa: S101
    excess, found = problem.excess(closest), closest.expected
    if "time" in excess:
        what = f"the closest scene takes {closest.plan.duration_s:.4g} s, {problem.limits.longest_s:.4g} s are allowed"
        yield Mistake("--longest-s", what, "more time, or a key in --over that shortens the scene")
    if "target" in excess and problem.limits.target_m is not None:
        what = (
            f"the jitter comes down to {found.jitter_m * 1e9:.3g} nm (noise {found.noise_jitter_m * 1e9:.3g}, speckle "
            f"{found.speckle_jitter_m * 1e9:.3g}), {problem.limits.target_m * 1e9:.3g} nm are wanted"
        )
        yield Mistake("--target", what, "a larger target, more keys in --over, or more time with --longest-s")
