"""Comparison of the starting scene and the best one: varied numbers, predicted and simulated errors, time and dose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hpe_rig.design.model import effective_pulses
from hpe_rig.design.problem import FINAL_DRAWS, FINAL_SEED, Candidate, Problem
from hpe_rig.design.search import DesignResult
from hpe_rig.design.simulation_check import simulate
from hpe_rig.plan import highest_output
from hpe_rig.prediction import EstimatorErrors, detection_floor, predict, predicted_averaging, with_beam_averaging
from hpe_rig.result import text_table
from hpe_rig.study import Errors

JITTER_TOLERANCE, BIAS_TOLERANCE, STANDARD_ERRORS = 0.15, 0.02, 3.0
"""Agreement required of the model: relative to the jitter, relative to the amplitude, plus standard errors."""
MAX_RELATIVE_ERROR = 0.25
"""Standard error relative to a jitter above which the simulation cannot test the model."""

GAIN_STANDARD_ERRORS = 2.0
"""A simulated gain below this number of its standard errors may be chance."""

Row = tuple[str, str, str]
"""Name, before, after."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """One outcome of a scene: its key in JSON, and name, scale, format and unit of its row in the table."""

    key: str
    name: str
    scale: float = 1.0
    form: str = ".3g"
    unit: str = ""
    absent: str = "-"
    standard_error: str = ""
    """Key of the standard error, if the value is simulated."""

    def text(self, values: Mapping[str, Any]) -> str:
        """Return the value among ``values`` with its standard error and unit, or why it is absent."""
        value = values.get(self.key)
        if isinstance(value, str):
            return value
        if value is None:
            return self.absent
        number = format(value * self.scale, self.form)
        if self.standard_error:
            number += f" +- {values[self.standard_error] * self.scale:.2g}"
        return f"{number} {self.unit}".rstrip()


DEGREES = math.degrees(1)
QUANTITIES = (
    _Quantity("amplitude_m", "amplitude", 1e9, ".4g", "nm"),
    _Quantity("effective_pulses", "effective number of pulses", form=".0f"),
    _Quantity("snr_db", "SNR in the gate", 1, ".1f", "dB"),
    _Quantity("predicted_bias_m", "bias, predicted", 1e9, ".4g", "nm"),
    _Quantity("simulated_bias_m", "bias, simulated", 1e9, unit="nm", standard_error="simulated_bias_se_m"),
    _Quantity("predicted_jitter_m", "jitter, predicted", 1e9, ".4g", "nm"),
    _Quantity("simulated_jitter_m", "jitter, simulated", 1e9, unit="nm", standard_error="simulated_jitter_se_m"),
    _Quantity("quadrature_noise_m", "noise of a quadrature", 1e9, unit="nm"),
    _Quantity("speckle_m", "speckle", 1e9, ".4g", "nm"),
    _Quantity("detection_floor_m", "detection floor", 1e9, unit="nm"),
    _Quantity("relative_jitter", "jitter over amplitude", 100, unit="%"),
    _Quantity("predicted_phase_jitter_rad", "phase jitter, predicted", DEGREES, unit="deg"),
    _Quantity("clock_phase_u_rad", "time base, phase", DEGREES, unit="deg"),
    _Quantity(
        key="simulated_phase_jitter_rad",
        name="phase jitter, simulated",
        scale=DEGREES,
        unit="deg",
        standard_error="simulated_phase_jitter_se_rad",
    ),
    _Quantity("model", "model"),
    _Quantity("no_moduli_because", "u of mu1"),
    _Quantity("mu1_relative_uncertainty", "u of mu1", 100, unit="%"),
    _Quantity("mu2_relative_uncertainty", "u of mu2", 100, unit="%"),
    _Quantity("duration_s", "time", 1, ".4g", "s"),
    _Quantity("mechanical_index", "derated MI", absent="not calibrated"),
    _Quantity("spta_w_per_m2", "I_spta", 0.1, unit="mW/cm2", absent="not calibrated"),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The scene before and after: the request in words, varied numbers, outcomes by key, and remarks.

    ``varied``: key, number before and after, None where the scene lacks it. ``before`` is empty if the starting scene
    cannot be planned.
    """

    request: str
    varied: Sequence[tuple[str, float | None, float | None]]
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    remarks: Sequence[str]

    def varied_rows(self) -> list[Row]:
        """Return the varied numbers as text."""
        return [(key, _number(before), _number(after)) for key, before, after in self.varied]

    def outcome_rows(self) -> list[Row]:
        """Return the outcomes as text."""
        return [
            (quantity.name, quantity.text(self.before) if self.before else "-", quantity.text(self.after))
            for quantity in QUANTITIES
            if quantity.key in self.after
        ]

    def lines(self) -> Iterator[str]:
        """Yield the request, the table and the remarks."""
        yield self.request
        yield text_table(("", "before", "after"), [*self.varied_rows(), *self.outcome_rows()])
        yield from self.remarks

    def as_dict(self) -> dict[str, Any]:
        """Return all values in the form of JSON."""
        varied = [{"key": key, "before": before, "after": after} for key, before, after in self.varied]
        outcome = {"before": self.before, "after": self.after, "remarks": self.remarks}
        return {"request": self.request, "varied": varied, **outcome}


def compare(design: DesignResult, draws: int = 0, seed: int = 0) -> Comparison:
    """Return the scene before and after; ``draws`` simulate both, 0 omits the simulation."""
    problem, best = design.problem, design.best
    start = problem.judged(design.start)
    varied = []
    for variable in problem.space:
        path, initial = variable.key.path, variable.key.value
        before_value, after_value = (candidate.values.get(path, initial) for candidate in (start, best))
        varied.append((str(variable.key), before_value, after_value))
    after = _outcome(problem, best, draws, seed)
    # Without a better scene both columns are equal: one simulation is enough.
    before = _outcome(problem, start, draws, seed) if best.values else after
    remarks = [*_remarks(design), *(_unconfirmed_gains(before, after) if best.values else ())]
    return Comparison(_request_text(design), varied, before.values, after.values, remarks)


def _request_text(design: DesignResult) -> str:
    problem = design.problem
    scene, plan, _ = design.best.inputs()
    shots = "" if len(plan.shots) == 1 else f" in shot 1 of {len(plan.shots)}"
    target = "" if problem.target_m is None else f", target {problem.target_m * 1e9:g} nm"
    return (
        f"{problem.goal}{shots} of {scene.wanted_frequencies_hz[0]:g} Hz with {scene.processing.estimator}, at most "
        f"{problem.longest_s:.4g} s{target}; {problem.evaluations} scenes evaluated"
    )


def _unconfirmed_gains(before: _Outcome, after: _Outcome) -> Iterator[str]:
    """Yield the jitters that the model predicts to fall, and whose simulation shows no fall beyond chance."""
    if before.prediction is None or after.prediction is None or before.simulated is None or after.simulated is None:
        return
    quantities = (("jitter", "jitter_m", 1e9, "nm"), ("phase jitter", "phase_jitter_rad", math.degrees(1), "deg"))
    pairs = zip(quantities, before.simulated, after.simulated, strict=True)
    for (name, attribute, scale, unit), simulated_before, simulated_after in pairs:
        predicted, predicted_after = (getattr(item.prediction, attribute) * scale for item in (before, after))
        fall = (simulated_before.jitter - simulated_after.jitter) * scale
        u = math.hypot(simulated_before.jitter_se, simulated_after.jitter_se) * scale
        if predicted_after < (1 - JITTER_TOLERANCE) * predicted and fall < GAIN_STANDARD_ERRORS * u:
            change = f"{'falls' if fall >= 0 else 'rises'} by {abs(fall):.2g} +- {u:.2g} {unit}"
            yield (
                f"the simulation does not confirm the gain in {name}: it {change}, by the model it falls from "
                f"{predicted:.3g} to {predicted_after:.3g} {unit}. Try: more --draws, or hpe-rig accuracy with both "
                "scenes"
            )


def _remarks(design: DesignResult) -> Iterator[str]:
    if not design.best.values:
        yield "no scene within the limits is better than the starting scene"
    yield from (f"limit: {reason}" for reason in design.limits)
    if design.start.conflicts:
        checks = ", ".join(dict.fromkeys(conflict.check for conflict in design.start.conflicts))
        yield f"hpe-rig check refuses the starting scene: {checks}"


def _number(value: float | None) -> str:
    return "absent" if value is None else f"{value:.6g}"


@dataclass(frozen=True, slots=True)
class _Outcome:
    """Outcomes by key, prediction, and simulated errors of amplitude and phase; empty without a plan."""

    values: dict[str, Any]
    prediction: EstimatorErrors | None = None
    simulated: tuple[Errors, Errors] | None = None


def _outcome(problem: Problem, candidate: Candidate, draws: int, seed: int) -> _Outcome:
    """Return predictions, simulation, time and dose of a candidate."""
    scene, plan, setting = candidate.scene, candidate.plan, candidate.setting
    if scene is None or plan is None or setting is None:
        return _Outcome({})
    # Bias and jitter have the beam averaging of ``hpe-rig check`` and of a result's budget.
    averaging = predicted_averaging(scene, scene.processing.estimator)[0]
    prediction = with_beam_averaging(candidate.predict(FINAL_DRAWS, FINAL_SEED), setting, averaging)
    # The noise is that of ``hpe-rig check``, from the same draws.
    quadrature_m = predict(setting, (scene.processing.estimator,)).expected[0].quadrature_m
    output = None if problem.bench.calibration is None else highest_output(problem.bench, plan.shots)
    simulated = None
    if draws and not candidate.conflicts:
        simulated = simulate(scene, plan, setting, problem.baseline, draws, seed)
    floor_m = detection_floor(scene, problem.bench.simulated, plan.shots[0]).detected_m
    values = {
        "amplitude_m": setting.amplitude_m,
        "effective_pulses": effective_pulses(scene, plan),
        "snr_db": 10 * math.log10(setting.snr),
        "predicted_bias_m": prediction.bias_m,
        "predicted_jitter_m": prediction.jitter_m,
        "quadrature_noise_m": quadrature_m,
        "speckle_m": prediction.speckle_jitter_m,
        "detection_floor_m": floor_m,
        "relative_jitter": prediction.jitter_m / setting.amplitude_m,
        "predicted_phase_jitter_rad": math.hypot(prediction.phase_jitter_rad, candidate.clock_phase_u),
        **({"clock_phase_u_rad": candidate.clock_phase_u} if candidate.clock_phase_u else {}),
        **(_simulated_values(prediction, setting.amplitude_m, simulated) if draws else {}),
        **_moduli(problem, candidate),
        "duration_s": plan.duration_s,
        "mechanical_index": output and output.mechanical_index,
        "spta_w_per_m2": output and output.spta_w_per_m2,
    }
    return _Outcome(values, prediction, simulated)


def _simulated_values(
    prediction: EstimatorErrors, amplitude_m: float, simulated: tuple[Errors, Errors] | None
) -> dict[str, Any]:
    """Return the simulated errors with their standard errors, None without a simulation, and the model's verdict."""
    amplitude, phase = simulated or (None, None)
    return {
        "simulated_bias_m": amplitude and amplitude.bias,
        "simulated_bias_se_m": amplitude and amplitude.bias_se,
        "simulated_jitter_m": amplitude and amplitude.jitter,
        "simulated_jitter_se_m": amplitude and amplitude.jitter_se,
        "simulated_phase_jitter_rad": phase and phase.jitter,
        "simulated_phase_jitter_se_rad": phase and phase.jitter_se,
        "model": _agreement(prediction, amplitude_m, simulated),
    }


def _moduli(problem: Problem, candidate: Candidate) -> dict[str, Any]:
    """Return the relative uncertainties of the moduli, or why there are none, if they are the goal."""
    if problem.goal != "modulus-uncertainty":
        return {}
    try:
        forecast = candidate.moduli
    except ValueError as error:
        return {"no_moduli_because": str(error)}
    names = ("mu1_relative_uncertainty", "mu2_relative_uncertainty")
    columns = zip(names, forecast.uncertainty, forecast.values, strict=True)
    return {name: u / value for name, u, value in columns}


def _agreement(prediction: EstimatorErrors, amplitude_m: float, simulated: tuple[Errors, Errors] | None) -> str:
    """Return whether the model agrees with the simulation, within its tolerance and the simulation's errors."""
    if simulated is None:
        return "not simulated"
    amplitude, phase = simulated
    jitters = (
        (prediction.jitter_m, amplitude.jitter, amplitude.jitter_se),
        (prediction.phase_jitter_rad, phase.jitter, phase.jitter_se),
    )
    # A simulation with large standard errors would agree with any model.
    if any(se > MAX_RELATIVE_ERROR * jitter for _, jitter, se in jitters):
        return "undecided: more draws needed"
    jitters_agree = all(
        abs(model - jitter) <= JITTER_TOLERANCE * jitter + STANDARD_ERRORS * se for model, jitter, se in jitters
    )
    allowed_m = BIAS_TOLERANCE * amplitude_m + STANDARD_ERRORS * amplitude.bias_se
    bias_agrees = abs(prediction.bias_m - amplitude.bias) <= allowed_m
    return "agrees" if jitters_agree and bias_agrees else "differs from the simulation"
