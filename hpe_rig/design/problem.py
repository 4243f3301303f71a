"""Optimisation problem of a design: candidate scenes, their plans, checks as by ``hpe-rig check``, and costs.

A candidate is infeasible if bench or physics refuse it, or if it has a warning that the starting scene does not have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import check_simulation, with_transducers
from hpe_rig.design.model import Baseline, baseline, clock_phase_u, design_setting, predicted
from hpe_rig.design.variables import Variable
from hpe_rig.measurement import Setup, plan_and_check
from hpe_rig.moduli import ModuliForecast, moduli_forecast
from hpe_rig.plan import CheckResult, Plan
from hpe_rig.prediction import Conditions, EstimatorErrors
from hpe_rig.scene import (
    KeyPath,
    Mistake,
    Number,
    Scene,
    SettingsError,
    scene_mistakes,
    with_default_specimen,
    with_values,
)

Goal = Literal["jitter", "phase-jitter", "bias", "time", "modulus-uncertainty"]
GOALS: tuple[Goal, ...] = get_args(Goal)

SEARCH_DRAWS = 200
"""Scatterer draws for each candidate; common to all, so that differences have smaller errors than values."""
FINAL_DRAWS = 2000
"""Independent draws for the starting scene and the best one."""
FINAL_SEED = 1
SIDE_WEIGHT = 1e-6
"""Weight of the logarithm of the second goal: time for jitter or bias, jitter for time. It only breaks ties."""
INFEASIBLE_COST = 100.0
"""Minimum cost of a candidate that violates a limit; logarithms of jitters and times stay far below."""

Values = Mapping[KeyPath, Number]


@dataclass(frozen=True)
class Candidate:
    """One scene with its plan and the inputs of the model; ``conflicts`` are the checks that refuse it.

    ``clock_phase_u``: u that the clocks add to the phase of the first frequency, rad.
    """

    values: Values
    conflicts: tuple[CheckResult, ...]
    scene: Scene | None = None
    plan: Plan | None = None
    setting: Conditions | None = None
    clock_phase_u: float = 0.0

    @cached_property
    def expected(self) -> EstimatorErrors:
        """Bias and jitter from the draws of the search."""
        return self.predict(SEARCH_DRAWS, 0)

    @cached_property
    def moduli(self) -> ModuliForecast:
        """Forecast of the moduli with the model's SNR and amplitude; raises as ``moduli_forecast``."""
        scene, plan, setting = self.inputs()
        expected = {"expected_snr_db": 10 * math.log10(setting.snr), "expected_amplitude_m": setting.amplitude_m}
        processing = scene.processing.model_copy(update=expected)
        return moduli_forecast(scene.model_copy(update={"processing": processing}), plan)

    def inputs(self) -> tuple[Scene, Plan, Conditions]:
        """Return scene, plan and the inputs of the model, which every candidate without conflicts has."""
        if self.scene is None or self.plan is None or self.setting is None:
            raise ValueError("the scene has no plan, or the model does not apply to it")
        return self.scene, self.plan, self.setting

    def predict(self, draws: int, seed: int) -> EstimatorErrors:
        """Return bias and jitter of the scene's estimator."""
        scene, _, setting = self.inputs()
        return predicted(setting, scene.processing.estimator, draws, seed)


class Problem:
    """Candidates of one starting scene and their costs, each computed once.

    ``longest_s`` limits the time, ``target_m`` the jitter.
    """

    def __init__(
        self,
        setup: Setup,
        tables: Mapping[str, Any],
        space: Sequence[Variable],
        goal: Goal,
        *,
        longest_s: float,
        target_m: float | None = None,
    ) -> None:
        self.bench, self.space, self.goal = setup.bench.bench, tuple(space), goal
        self.longest_s, self.target_m = longest_s, target_m
        self._tables = tables
        self.baseline: Baseline = baseline(setup.scene.scene)
        self._accepted_warnings = {result.check for result in setup.findings if result.level == "warning"}
        self._varies_simulation = any(variable.key.path[0] == "simulation" for variable in space)
        self._cost: dict[tuple[tuple[KeyPath, Number], ...], float] = {}
        self.start = self.candidate({})

    @property
    def evaluations(self) -> int:
        """Number of different scenes with a cost."""
        return len(self._cost)

    def values_at(self, position: FloatArray) -> Values:
        """Return the values at ``position`` (variable,) of the space."""
        return {variable.key.path: variable.value(x) for variable, x in zip(self.space, position, strict=True)}

    def cost(self, values: Values) -> float:
        """Return the cost: the goal within all limits, else `INFEASIBLE_COST` plus the excess over the limits."""
        key = tuple(values.items())
        if key not in self._cost:
            self._cost[key] = self._cost_of(self.candidate(values))
        return self._cost[key]

    def _cost_of(self, candidate: Candidate) -> float:
        if candidate.conflicts:
            return INFEASIBLE_COST**2 * len(candidate.conflicts)
        # The excess leads the search back to the limits.
        excess = sum(math.log(ratio) for ratio in self.excess(candidate).values())
        return INFEASIBLE_COST + excess if excess > 0 else self.measure(candidate)

    def excess(self, candidate: Candidate) -> dict[str, float]:
        """Return the value over the limit for each limit that a candidate violates."""
        _, plan, _ = candidate.inputs()
        ratios = {"time": plan.duration_s / self.longest_s}
        if self.target_m is not None and self.goal != "jitter":
            ratios["target"] = candidate.expected.jitter_m / self.target_m
        return {name: ratio for name, ratio in ratios.items() if ratio > 1 + 1e-9}

    def measure(self, candidate: Candidate) -> float:
        """Return the logarithm of the goal; jitter and bias relative to the amplitude."""
        _, plan, setting = candidate.inputs()
        prediction, amplitude_m = candidate.expected, setting.amplitude_m
        if self.goal == "modulus-uncertainty":
            forecast = candidate.moduli
            relative = forecast.uncertainty[0] / forecast.values[0]
            return math.log(relative) + SIDE_WEIGHT * math.log(plan.duration_s)
        time, jitter = math.log(plan.duration_s), math.log(prediction.jitter_m / amplitude_m)
        if self.goal == "time":
            return time + SIDE_WEIGHT * jitter
        # The logarithms of different goals differ by constants, which do not matter.
        main = {
            "jitter": jitter,
            "phase-jitter": math.log(math.hypot(prediction.phase_jitter_rad, candidate.clock_phase_u)),
            "bias": math.log(max(abs(prediction.bias_m) / amplitude_m, 1e-9)),
        }
        return main[self.goal] + SIDE_WEIGHT * time

    def candidate(self, values: Values) -> Candidate:
        """Return the starting scene with ``values``."""
        tables = with_values(self._tables, values)
        mistakes = scene_mistakes(tables)
        if self._varies_simulation:
            mistakes += check_simulation(tables)
        if mistakes:
            return Candidate(values, tuple(_conflict(mistake) for mistake in mistakes))
        scene = with_transducers(Scene.model_validate(tables), self.bench)
        if self.bench.simulated:
            scene = with_default_specimen(scene)
        try:
            plan, check_results = plan_and_check(scene, self.bench)
        except SettingsError as error:
            return Candidate(values, tuple(_conflict(mistake) for mistake in error.mistakes), scene)
        conflicts = tuple(
            result
            for result in check_results
            if result.level == "refused" or (result.level == "warning" and result.check not in self._accepted_warnings)
        )
        candidate = Candidate(values, conflicts, scene, plan)
        return candidate if conflicts else self.judged(candidate)

    def judged(self, candidate: Candidate) -> Candidate:
        """Return ``candidate`` with the model's inputs, even if a check refuses it; a failure is one more conflict."""
        if candidate.setting is not None or candidate.scene is None or candidate.plan is None:
            return candidate
        try:
            setting = design_setting(candidate.scene, candidate.plan, self.baseline)
            phase_u = clock_phase_u(candidate.scene, candidate.plan, setting, self.bench)
            judged = replace(candidate, setting=setting, clock_phase_u=phase_u)
            if self.goal == "modulus-uncertainty":
                _ = judged.moduli
            return judged
        except ValueError as error:
            conflict = CheckResult("estimate", "refused", str(error))
            return replace(candidate, conflicts=(*candidate.conflicts, conflict))


def _conflict(mistake: Mistake) -> CheckResult:
    return CheckResult(mistake.path, "refused", mistake.what, mistake.remedy)
