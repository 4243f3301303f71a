"""Command ``hpe-rig design``: from its options to the search, the table before and after, and the new scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from hpe_rig.design.model import baseline, effective_pulses
from hpe_rig.design.problem import FINAL_DRAWS, FINAL_SEED, GOALS, Candidate, Constraints, Problem
from hpe_rig.design.search import DesignResult, find_design
from hpe_rig.design.simulation_check import Simulated, simulate
from hpe_rig.design.variables import variables
from hpe_rig.measurement import prepare
from hpe_rig.moduli import push_of
from hpe_rig.prediction import Expected, as_averaged, detection_text, predict, predicted_averaging
from hpe_rig.result import text_table
from hpe_rig.scene import Mistake, SettingsError, edited_text, length_m, parse_toml
from hpe_rig.store import unwritable
from hpe_rig.study import Errors

MODEL_JITTER, MODEL_BIAS, ERRORS = 0.15, 0.02, 3.0
"""How well the model is to hold: share of a jitter, share of the amplitude for a bias, standard errors on top."""
UNSURE = 0.25
"""Share of a jitter beyond which its standard error tells nothing of the model."""
SLACK = 1.01
"""Share of the starting scene's time that is allowed where nothing else is said."""

MOST_DRAWS = 1_000_000

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a design, in the command line's words."""

    scene: str
    over: str
    minimise: str = "jitter"
    bench: Path | None = None
    bounds: tuple[str, ...] = ()
    longest_s: float | None = None
    target: str | None = None
    draws: int = 200
    seed: int = 0
    output: Path | None = None
    report: bool = False


def write_design(request: Request, tell: Callable[[str], None], announce: Callable[[str], None]) -> None:
    """Search, tell the table, write the new scene; raise ``SettingsError`` with all mistakes before the search."""
    problem, text = _problem(request)
    announce(f"searching {', '.join(str(variable.key) for variable in problem.space)}")
    found = find_design(problem, request.seed)
    if request.draws > 0:
        announce(f"simulating {request.draws} draws of scatterers and noise")
    comparison = compared(found, request.draws, request.seed)
    tell("\n".join(design_lines(comparison)))
    words = f"hpe-rig design {request.scene} --minimise {request.minimise} --over {request.over}"
    if request.report:
        from hpe_rig.design.page import write_page

        announce("drawing the goal over each number")
        tell(f"{write_page(found, comparison, request.scene, words)}: open it in any browser")
    if request.output is None:
        return
    new = edited_text(text, found.best.values)
    try:
        with request.output.open("x", encoding="utf-8") as file:
            file.write(f"# {words}\n{new}")
    except OSError as error:
        mistake = Mistake("--output", f"{request.output} cannot be written ({error.strerror})", "another place")
        raise SettingsError("command line", [mistake]) from None
    tell(f"{request.output}: hpe-rig check {request.output}")


def _problem(request: Request) -> tuple[Problem, str]:
    """Return the problem and the scene's text; raise ``SettingsError`` with every mistake of request and scene."""
    setup = prepare(request.scene, request.bench, refuse=False)
    text, scene = setup.scene.text, setup.scene.scene
    tables, mistakes = parse_toml(text, request.scene), list(_wrong_words(request))

    def tried(action: Callable[[], T]) -> T | None:
        try:
            return action()
        except SettingsError as error:
            mistakes.extend(error.mistakes)
            return None

    longest_s = SLACK * setup.plan.duration_s if request.longest_s is None else request.longest_s
    target_m = None if request.target is None else tried(lambda: length_m(request.target or "", "--target"))
    names = [name.strip() for name in request.over.split(",") if name.strip()]
    space = tried(lambda: variables(tables, scene, setup.bench.bench, longest_s, names, request.bounds))
    tried(lambda: baseline(scene))
    if request.minimise == "modulus-uncertainty":
        tried(lambda: push_of([scene]))
    if request.output is not None and space is not None:
        first = {variable.key.path: variable.value(0) for variable in space}
        tried(lambda: edited_text(text, first))
    if mistakes or space is None:
        raise SettingsError("design", mistakes)
    goal = next(goal for goal in GOALS if goal == request.minimise)
    return Problem(setup, tables, space, goal, Constraints(longest_s, target_m)), text


def _wrong_words(request: Request) -> Iterator[Mistake]:
    if request.minimise not in GOALS:
        yield Mistake("--minimise", f"{request.minimise!r} cannot be minimised", f"one of {', '.join(GOALS)}")
    if request.minimise == "time" and request.target is None:
        yield Mistake("--target", "the shortest scene needs a jitter to keep", "--target 20nm")
    if request.longest_s is not None and not 0 < request.longest_s < math.inf:
        yield Mistake("--longest-s", f"{request.longest_s:g} s is no time", "seconds, such as 0.5")
    if request.draws < 0 or request.draws in (1, 2):
        yield Mistake("--draws", f"{request.draws} draws tell no jitter", "100 or more, or 0 for none")
    if request.draws > MOST_DRAWS:
        yield Mistake("--draws", f"{request.draws} draws never end", f"{MOST_DRAWS} or fewer")
    if not 0 <= request.seed < 2**32:
        yield Mistake("--seed", "no seed of the search", "0 or more, below 2^32")
    if request.output is not None:
        if request.output.exists():
            yield Mistake("--output", f"{request.output} exists and is never overwritten", "another name")
        elif why := unwritable(request.output):
            yield Mistake("--output", f"{request.output} cannot be written ({why})", "another place")


@dataclass(frozen=True, slots=True)
class Comparison:
    """The scene before and after: what was asked, rows (name, before, after), and what is to be said besides."""

    asked: str
    varied: Sequence[tuple[str, str, str]]
    outcome: Sequence[tuple[str, str, str]]
    remarks: Sequence[str]


def compared(found: DesignResult, draws: int = 0, seed: int = 0) -> Comparison:
    """Return what changed, what is predicted, what ``draws`` draws simulate, time and dose, before and after."""
    problem, pair = found.problem, (found.problem.judged(found.start), found.best)
    constraints, scene, plan = problem.constraints, found.best.scene, found.best.plan
    assert scene is not None  # noqa: S101
    assert plan is not None  # noqa: S101
    shots = "" if len(plan.shots) == 1 else f" in shot 1 of {len(plan.shots)}"
    target = "" if constraints.target_m is None else f", target {constraints.target_m * 1e9:g} nm"
    asked = (
        f"{problem.goal}{shots} of {scene.wanted_frequencies_hz[0]:g} Hz with {scene.processing.estimator}, at most "
        f"{constraints.longest_s:.4g} s{target}; {problem.tried} scenes tried"
    )
    varied = []
    for variable in problem.space:
        before, now = (candidate.values.get(variable.key.path, variable.key.value) for candidate in pair)
        varied.append((str(variable.key), _number(before), _number(now)))
    after = _column(problem, found.best, draws, seed)
    before_too = _column(problem, pair[0], draws, seed) if found.best.values else after
    outcome = [(name, before_too.get(name, "-"), text) for name, text in after.items()]
    remarks = [] if found.best.values else ["no scene within the limits is better than the one at hand"]
    remarks += [f"held back: {reason}" for reason in found.held]
    if found.start.conflicts:
        refused = ", ".join(dict.fromkeys(item.check for item in found.start.conflicts))
        remarks.append(f"before, check refuses it: {refused}")
    return Comparison(asked, varied, outcome, remarks)


def _number(value: float | None) -> str:
    return "absent" if value is None else f"{value:.6g}"


def design_lines(found: Comparison) -> Iterator[str]:
    """Yield what was asked, the table of before and after, and the remarks."""
    yield found.asked
    yield text_table(("", "before", "after"), [*found.varied, *found.outcome])
    yield from found.remarks


def _column(problem: Problem, candidate: Candidate, draws: int, seed: int) -> dict[str, str]:
    scene, plan, setting = candidate.scene, candidate.plan, candidate.setting
    if scene is None or plan is None or setting is None:
        return {}
    expected = _expected(candidate)
    output = candidate.output(problem.bench)
    simulated: Simulated | None = None
    if draws and not candidate.conflicts:
        simulated = simulate(scene, plan, setting, problem.baseline, draws, seed)
    amplitude, phase = (simulated.amplitude_m, simulated.phase_rad) if simulated else (None, None)
    rows = {
        "amplitude": _nm(setting.amplitude_m),
        "effective number of pulses": f"{effective_pulses(scene, plan)}",
        "SNR in the gate": f"{10 * math.log10(setting.snr):.1f} dB",
        "bias, predicted": _nm(expected.bias_m),
        "bias, simulated": _simulated(amplitude, "bias", 1e9, "nm"),
        "jitter, predicted": _nm(expected.jitter_m),
        "jitter, simulated": _simulated(amplitude, "jitter", 1e9, "nm"),
        "noise of a quadrature": _quadrature(candidate),
        "speckle": _nm(expected.speckle_jitter_m),
        "detection floor": next(iter(detection_text(scene, problem.bench.simulated, plan.shots[0]))).split()[2] + " nm",
        "jitter over amplitude": f"{100 * expected.jitter_m / setting.amplitude_m:.3g} %",
        "phase jitter, predicted": f"{math.degrees(expected.phase_jitter_rad):.3g} deg",
        "phase jitter, simulated": _simulated(phase, "jitter", math.degrees(1), "deg"),
        "model": _agreement(candidate, simulated),
        **_moduli(problem, candidate),
        "time": f"{plan.duration_s:.4g} s",
        "derated MI": "not calibrated" if output is None else f"{output.mechanical_index:.3g}",
        "I_spta": "not calibrated" if output is None else f"{output.spta_w_per_m2 / 10:.3g} mW/cm2",
    }
    return rows if draws else {name: text for name, text in rows.items() if "simulated" not in name and name != "model"}


def _moduli(problem: Problem, candidate: Candidate) -> dict[str, str]:
    """Return the uncertainties of the moduli where they are what is minimised."""
    if problem.goal != "modulus-uncertainty":
        return {}
    try:
        found = candidate.moduli
    except ValueError as error:
        return {"u of mu1": str(error)}
    pairs = zip(("u of mu1", "u of mu2"), found.uncertainty, found.values, strict=True)
    return {name: f"{100 * u / value:.3g} %" for name, u, value in pairs}


def _expected(candidate: Candidate) -> Expected:
    """Return bias and jitter with the averaging that ``hpe-rig check`` and a result's budget have."""
    assert candidate.scene is not None  # noqa: S101
    assert candidate.setting is not None  # noqa: S101
    averaging = predicted_averaging(candidate.scene, candidate.scene.processing.estimator)[0]
    return as_averaged(candidate.predict(FINAL_DRAWS, FINAL_SEED), candidate.setting, averaging)


def _quadrature(candidate: Candidate) -> str:
    """Return the noise as ``hpe-rig check`` prints it: from the same draws."""
    assert candidate.scene is not None  # noqa: S101
    assert candidate.setting is not None  # noqa: S101
    found = predict(candidate.setting, (candidate.scene.processing.estimator,)).expected[0]
    return f"{found.quadrature_m * 1e9:.3g} nm"


def _nm(value_m: float) -> str:
    return f"{value_m * 1e9:.4g} nm"


def _simulated(found: Errors | None, name: str, scale: float, unit: str) -> str:
    """Return ``name`` of what was simulated with its standard error in words; a dash where nothing was."""
    if found is None:
        return "-"
    return f"{getattr(found, name) * scale:.3g} +- {getattr(found, f'{name}_se') * scale:.2g} {unit}"


def _agreement(candidate: Candidate, simulated: Simulated | None) -> str:
    """Return whether the model holds within what it is known to hold and the simulation's own errors."""
    if simulated is None or candidate.setting is None:
        return "not simulated"
    expected = _expected(candidate)
    amplitude, phase = simulated.amplitude_m, simulated.phase_rad
    jitters = (
        (expected.jitter_m, amplitude.jitter, amplitude.jitter_se),
        (expected.phase_jitter_rad, phase.jitter, phase.jitter_se),
    )
    if any(se > UNSURE * jitter for _, jitter, se in jitters):
        return "unsure: more draws"
    good = all(abs(model - jitter) <= MODEL_JITTER * jitter + ERRORS * se for model, jitter, se in jitters)
    allowed_m = MODEL_BIAS * candidate.setting.amplitude_m + ERRORS * amplitude.bias_se
    return "holds" if good and abs(expected.bias_m - amplitude.bias) <= allowed_m else "is off: simulated"
