"""Problem of a design: candidate scenes that differ in some numbers, planned, checked as by ``hpe-rig check``, judged.

What a bench or the physics refuse is no candidate, nor what brings a warning that the starting scene does not have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import BenchFile, check_simulation, with_transducers
from hpe_rig.design.model import Baseline, baseline, design_setting, predicted
from hpe_rig.design.variables import Variable
from hpe_rig.measurement import Setup, planned
from hpe_rig.moduli import ModuliForecast, moduli_forecast
from hpe_rig.plan import AcousticOutput, CheckResult, Plan, highest_output
from hpe_rig.prediction import Conditions, Expected
from hpe_rig.scene import (
    KeyPath,
    Mistake,
    Number,
    Scene,
    SettingsError,
    mistakes_of,
    with_default_specimen,
    with_values,
)

Goal = Literal["jitter", "phase-jitter", "bias", "time", "modulus-uncertainty"]
GOALS: tuple[Goal, ...] = get_args(Goal)

SEARCH_DRAWS = 200
"""Scatterer draws of a candidate: all have the same, so that their differences are better known than each."""
FINAL_DRAWS = 2000
"""Draws, other ones, of the scene at the start and of the winner."""
FINAL_SEED = 1
SIDE_WEIGHT = 1e-6
"""Weight of the logarithm of what is not minimised: time for jitter or bias, jitter for time. It decides ties alone."""
OUTSIDE = 100.0
"""Cost beyond which a candidate keeps a limit not; logarithms of jitters and times stay far below."""

Values = Mapping[KeyPath, Number]


@dataclass(frozen=True, slots=True)
class Constraints:
    """What no candidate may exceed."""

    longest_s: float
    target_m: float | None = None


@dataclass(frozen=True)
class Candidate:
    """One scene with what its plan and the model say of it; ``conflicts`` is what refuses it."""

    values: Values
    conflicts: tuple[CheckResult, ...]
    scene: Scene | None = None
    plan: Plan | None = None
    setting: Conditions | None = None

    @cached_property
    def expected(self) -> Expected:
        """Bias and jitter as the search sees them."""
        return self.predict(SEARCH_DRAWS, 0)

    @cached_property
    def moduli(self) -> ModuliForecast:
        """How well the places tell the medium, with SNR and amplitude of the model; raises as ``moduli_forecast``."""
        assert self.scene is not None  # noqa: S101
        assert self.plan is not None  # noqa: S101
        assert self.setting is not None  # noqa: S101
        expected = {
            "expected_snr_db": 10 * math.log10(self.setting.snr),
            "expected_amplitude_m": self.setting.amplitude_m,
        }
        processing = self.scene.processing.model_copy(update=expected)
        return moduli_forecast(self.scene.model_copy(update={"processing": processing}), self.plan)

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
    """Candidates of one starting scene and how good they are; a cost is computed once."""

    def __init__(
        self, setup: Setup, tables: Mapping[str, Any], space: Sequence[Variable], goal: Goal, constraints: Constraints
    ) -> None:
        self.bench, self.space, self.goal, self.constraints = setup.bench.bench, tuple(space), goal, constraints
        self._tables = tables
        self.baseline: Baseline = baseline(setup.scene.scene)
        self._accepted = {found.check for found in setup.findings if found.level == "warning"}
        self._twin = any(variable.key.path[0] == "simulation" for variable in space)
        self._cost: dict[tuple[tuple[KeyPath, Number], ...], float] = {}
        self.start = self.candidate({})

    @property
    def tried(self) -> int:
        """How many different scenes have been judged."""
        return len(self._cost)

    def values_at(self, place: FloatArray) -> Values:
        """Return the values at ``place`` (variable,) of the space."""
        return {variable.key.path: variable.value(x) for variable, x in zip(self.space, place, strict=True)}

    def cost(self, values: Values) -> float:
        """Return what is minimised: below `OUTSIDE` within all limits, beyond by how far a candidate is outside."""
        key = tuple(values.items())
        if key not in self._cost:
            self._cost[key] = self._cost_of(self.candidate(values))
        return self._cost[key]

    def _cost_of(self, candidate: Candidate) -> float:
        if candidate.conflicts:
            return OUTSIDE**2 * len(candidate.conflicts)
        excess = sum(math.log(ratio) for ratio in self.excess(candidate).values())
        return OUTSIDE + excess if excess > 0 else self.measure(candidate)

    def excess(self, candidate: Candidate) -> dict[str, float]:
        """Return by which factor a candidate is beyond each limit that it does not keep."""
        assert candidate.plan is not None  # noqa: S101
        found = {"time": candidate.plan.duration_s / self.constraints.longest_s}
        if self.constraints.target_m is not None and self.goal != "jitter":
            found["target"] = candidate.expected.jitter_m / self.constraints.target_m
        return {name: ratio for name, ratio in found.items() if ratio > 1 + 1e-9}

    def measure(self, candidate: Candidate) -> float:
        """Return the logarithm of what the goal minimises; jitter and bias relative to the amplitude."""
        assert candidate.plan is not None  # noqa: S101
        assert candidate.setting is not None  # noqa: S101
        found, amplitude_m = candidate.expected, candidate.setting.amplitude_m
        if self.goal == "modulus-uncertainty":
            forecast = candidate.moduli
            relative = forecast.uncertainty[0] / forecast.values[0]
            return math.log(relative) + SIDE_WEIGHT * math.log(candidate.plan.duration_s)
        time, jitter = math.log(candidate.plan.duration_s), math.log(found.jitter_m / amplitude_m)
        if self.goal == "time":
            return time + SIDE_WEIGHT * jitter
        main = {
            "jitter": jitter,
            "phase-jitter": math.log(found.phase_jitter_rad),
            "bias": math.log(max(abs(found.bias_m) / amplitude_m, 1e-9)),
        }
        return main[self.goal] + SIDE_WEIGHT * time

    def candidate(self, values: Values) -> Candidate:
        """Return the starting scene with ``values``."""
        tables = with_values(self._tables, values)
        mistakes = mistakes_of(Scene, tables)
        if self._twin:
            mistakes += check_simulation(tables)
        if mistakes:
            return Candidate(values, tuple(_conflict(mistake) for mistake in mistakes))
        scene = with_transducers(Scene.model_validate(tables), self.bench)
        if self.bench.simulated:
            scene = with_default_specimen(scene)
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
            found = replace(candidate, setting=design_setting(candidate.scene, candidate.plan, self.baseline))
            if self.goal == "modulus-uncertainty":
                _ = found.moduli
            return found
        except ValueError as error:
            conflict = CheckResult("estimate", "refused", str(error))
            return replace(candidate, conflicts=(*candidate.conflicts, conflict))


def _conflict(mistake: Mistake) -> CheckResult:
    return CheckResult(mistake.path, "refused", mistake.what, mistake.remedy)
