"""Comparison of the starting scene and the best one: varied numbers, predicted and simulated errors, time and dose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hpe_rig.design.model import effective_pulses
from hpe_rig.design.problem import FINAL_DRAWS, FINAL_SEED, Candidate, Problem
from hpe_rig.design.search import DesignResult
from hpe_rig.design.simulation_check import simulate
from hpe_rig.plan import highest_output
from hpe_rig.prediction import EstimatorErrors, detection_text, predict, predicted_averaging, with_beam_averaging
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
class Comparison:
    """The scene before and after: the request in words, rows of varied numbers and of outcomes, and remarks."""

    request: str
    varied: Sequence[Row]
    outcome: Sequence[Row]
    remarks: Sequence[str]

    def lines(self) -> Iterator[str]:
        """Yield the request, the table and the remarks."""
        yield self.request
        yield text_table(("", "before", "after"), [*self.varied, *self.outcome])
        yield from self.remarks


def compare(design: DesignResult, draws: int = 0, seed: int = 0) -> Comparison:
    """Return the scene before and after; ``draws`` simulate both, 0 omits the simulation."""
    problem, best = design.problem, design.best
    start = problem.judged(design.start)
    varied = []
    for variable in problem.space:
        path, initial = variable.key.path, variable.key.value
        before_value, after_value = (_number(candidate.values.get(path, initial)) for candidate in (start, best))
        varied.append((str(variable.key), before_value, after_value))
    after = _outcome(problem, best, draws, seed)
    # Without a better scene both columns are equal: one simulation is enough.
    before = _outcome(problem, start, draws, seed) if best.values else after
    outcome = [(name, before.rows.get(name, "-"), text) for name, text in after.rows.items()]
    remarks = [*_remarks(design), *(_unconfirmed_gains(before, after) if best.values else ())]
    return Comparison(_request_text(design), varied, outcome, remarks)


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
    """Rows of the table by name, prediction, and simulated errors of amplitude and phase; empty without a plan."""

    rows: dict[str, str]
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
    amplitude, phase = simulated or (None, None)
    detection = next(iter(detection_text(scene, problem.bench.simulated, plan.shots[0])))
    rows = {
        "amplitude": _nm(setting.amplitude_m),
        "effective number of pulses": f"{effective_pulses(scene, plan)}",
        "SNR in the gate": f"{10 * math.log10(setting.snr):.1f} dB",
        "bias, predicted": _nm(prediction.bias_m),
        "bias, simulated": _simulated_text(amplitude, "bias", 1e9, "nm"),
        "jitter, predicted": _nm(prediction.jitter_m),
        "jitter, simulated": _simulated_text(amplitude, "jitter", 1e9, "nm"),
        "noise of a quadrature": f"{quadrature_m * 1e9:.3g} nm",
        "speckle": _nm(prediction.speckle_jitter_m),
        "detection floor": detection.split()[2] + " nm",
        "jitter over amplitude": f"{100 * prediction.jitter_m / setting.amplitude_m:.3g} %",
        "phase jitter, predicted": f"{math.degrees(prediction.phase_jitter_rad):.3g} deg",
        "phase jitter, simulated": _simulated_text(phase, "jitter", math.degrees(1), "deg"),
        "model": _agreement(prediction, setting.amplitude_m, simulated),
        **_moduli(problem, candidate),
        "time": f"{plan.duration_s:.4g} s",
        "derated MI": "not calibrated" if output is None else f"{output.mechanical_index:.3g}",
        "I_spta": "not calibrated" if output is None else f"{output.spta_w_per_m2 / 10:.3g} mW/cm2",
    }
    if not draws:
        rows = {name: text for name, text in rows.items() if "simulated" not in name and name != "model"}
    return _Outcome(rows, prediction, simulated)


def _moduli(problem: Problem, candidate: Candidate) -> dict[str, str]:
    """Return the uncertainties of the moduli if they are the goal."""
    if problem.goal != "modulus-uncertainty":
        return {}
    try:
        forecast = candidate.moduli
    except ValueError as error:
        return {"u of mu1": str(error)}
    columns = zip(("u of mu1", "u of mu2"), forecast.uncertainty, forecast.values, strict=True)
    return {name: f"{100 * u / value:.3g} %" for name, u, value in columns}


def _nm(value_m: float) -> str:
    return f"{value_m * 1e9:.4g} nm"


def _simulated_text(errors: Errors | None, name: str, scale: float, unit: str) -> str:
    """Return a simulated error with its standard error; a dash without a simulation."""
    if errors is None:
        return "-"
    return f"{getattr(errors, name) * scale:.3g} +- {getattr(errors, f'{name}_se') * scale:.2g} {unit}"


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
