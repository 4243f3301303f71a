"""Page of a run: one self-contained HTML file with inline SVG, no script and no network.

Its numbers are estimated again from the stored records, never read from a table that could have been edited.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from hpe_rig.bench import twin_of
from hpe_rig.extensions import ESTIMATORS, IMPORTERS, MEDIA, named, origin
from hpe_rig.plan import scene_of, timing
from hpe_rig.prediction import detection_text, extrapolation_text
from hpe_rig.processing import margin_needed, samples_needed
from hpe_rig.report import figures, provenance as report_provenance
from hpe_rig.report.badges import badges
from hpe_rig.report.depth_profile import profile_pictures
from hpe_rig.report.foreseen import foreseen
from hpe_rig.report.moduli import moduli_part
from hpe_rig.report.residual_tests import ResidualTest, residual_tests
from hpe_rig.report.sweep import Sweep, make_sweep
from hpe_rig.report.views import MotionView, echo_view, gate_alone, motion_view
from hpe_rig.result import (
    Estimate,
    Picture,
    Result,
    ShotResult,
    Stages,
    amplitude_spectrum,
    headline_sentence,
    page_style,
    phase_spectrum,
    repeats_of,
    shot_warnings,
    shown_shot,
    symbols,
)
from hpe_rig.runs import Run, estimate_points, open_run, points_over
from hpe_rig.scene import Scene
from hpe_rig.store import StoreError, reason, refuse_unwritable

MOST_ROWS = 1000
"""Rows of the table of every shot; what is beyond stays in the result file."""
LONGEST_TEXT = 60_000
"""Characters of scene and bench file that are shown."""
LARGEST_SHOT_BYTES = 256_000_000
"""Records of a shot that are read whole; of more, the gate alone."""
CLOSE_PERIODS = 2
IN_THE_RESIDUAL = ("noise", "trigger jitter")
"""Sources of uncertainty that the stage 'harmonic' holds."""
PAGE_START = b"<!DOCTYPE html>"


@dataclass(frozen=True, slots=True)
class StoredAxes:
    """Axes of a sweep over what is made of stored records; ``together``: their values go in step."""

    values: Mapping[str, Sequence[float]]
    together: bool = False


@dataclass(frozen=True, slots=True)
class ErrorStage:
    """What one stage adds to the error of the strongest harmonic, in words."""

    stage: str
    size: str
    source: str


def write_report(
    path: Path,
    estimator: str | None = None,
    output: Path | None = None,
    shot: int | None = None,
    profile_step_m: float | None = None,
    axes: StoredAxes | None = None,
) -> Path:
    """Write the report of the run in ``path`` and return its own path, by default beside the run with ``.html``.

    ``shot`` counts from 1 and says which one is drawn; absent: of the complete ones that which moves most;
    ``profile_step_m``: also gates so far apart over depth; ``axes``: results and curves of the same records at every
    value of what is made of them, as ``Run.sweep``. Raises ``StoreError`` for a file that cannot be read or written, or
    would be lost, and ``SettingsError`` for what the file says or the caller asks.
    """
    if not path.name:
        raise StoreError(f"{path} is a folder. Try: the path of a run file.")
    target = output or path.with_suffix(".html")
    _refuse_other(target)
    refuse_unwritable(target)
    page = render(path, estimator, shot, profile_step_m, axes)
    try:
        target.write_text(page, encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{target} cannot be written ({reason(error)}). Try: another --output.") from None
    return target


def _refuse_other(target: Path) -> None:
    """Raise ``StoreError`` where ``target`` is there and no page: a run, maybe the one that is reported on."""
    if not target.is_file():
        return
    try:
        with target.open("rb") as file:
            start = file.read(len(PAGE_START))
    except OSError:
        # Writing it says why.
        return
    if start and start != PAGE_START:
        raise StoreError(f"{target} exists and is no HTML page: it is left alone. Try: another --output.")


def render(
    path: Path,
    estimator: str | None = None,
    shot: int | None = None,
    profile_step_m: float | None = None,
    axes: StoredAxes | None = None,
) -> str:
    """Return the report of the run in ``path`` as HTML text; raises as ``write_report``."""
    stages = Stages()
    with stages("read"):
        run = open_run(path).with_profile(profile_step_m)
    whole = run
    if axes is None:
        result = run.estimate(estimator, stages)
        with stages("write result"):
            run.save(result)
        shown = _shown(result, shot)
    else:
        points = points_over(run, axes.values, axes.together)
        result = estimate_points(points, estimator)
        shown = _shown(result, shot)
        # what is drawn of one shot is drawn with the settings of its point
        run = next(point.run for point in points if point.values.items() <= shown.swept.items())
    with stages("draw"):
        pictures, checks, motion = _look(run, shown, repeats_of(result, shown))
        sweep = make_sweep(result.shots)
        swept = figures.sweep_pictures(sweep) if sweep else ()
        fitted = moduli_part(whole, estimator)
        deep = profile_pictures([gate for gate in result.profile if _alike(gate.shot, shown)])
    return _page(
        result=result,
        shown=shown,
        scene=run.scene,
        stored=run.stored,
        pictures={picture.key: picture for picture in pictures},
        swept=swept,
        deep=deep,
        fitted=fitted,
        sweep=sweep,
        checks=checks,
        errors=error_stages(shown, motion),
        findings=run.findings,
        foreseen=foreseen(_scene_of(run, shown), run.plan.shots[shown.shot], shown, result.estimator),
        settings=report_provenance.settings(path, shown.shot),
        attributes=report_provenance.attributes(path, [f"version_{name}" for name in result.versions]),
        fingerprint=report_provenance.fingerprint(path),
        facts=[*_facts(run, result), *_dose(run, shown)],
        strongest=strongest(shown),
        headline=headline_sentence(result),
        asked=shot is not None,
        known=any(item.true_amplitude_m is not None for each in result.shots for item in each.estimates),
        most_rows=MOST_ROWS,
        longest_text=LONGEST_TEXT,
        stages=_bars(result),
    )


def _alike(shot: ShotResult, shown: ShotResult) -> bool:
    return (shot.shot, shot.window_length_s) == (shown.shot, shown.window_length_s)


def strongest(shot: ShotResult) -> Estimate:
    """Return the estimate of the largest amplitude."""
    return max(shot.estimates, key=lambda item: item.amplitude_m)


def error_stages(shot: ShotResult, motion: MotionView | None) -> list[ErrorStage]:
    """Return what every stage adds to the error of the strongest harmonic of ``shot``, first to last."""
    lead = strongest(shot)
    rows = []
    if motion is not None:
        echo_nm = math.sqrt(float(motion.noise_m2.mean())) * 1e9
        rows.append(ErrorStage("one echo", f"{echo_nm:.3g} nm", "scatter of the echoes about their mean shape"))
    rows.append(ErrorStage("one displacement", f"{shot.residual_m * 1e9:.3g} nm rms", "residual of the fit"))
    amplitude = f"{lead.amplitude_uncertainty_m * 1e9:.3g} nm, {math.degrees(lead.phase_uncertainty_rad):.2g} degrees"
    rows.append(
        ErrorStage("harmonic", amplitude, f"standard uncertainty from that residual, {shot.pulses_used} pulses")
    )
    if lead.averaging_factor is not None:
        bias = (
            f"{(lead.averaging_factor - 1) * 100:+z.1f} %, {math.degrees(lead.averaging_phase_rad or 0):+z.2f} degrees"
        )
        rows.append(ErrorStage("beam averaging", bias, "predicted, tracked against peak displacement; corrected"))
    if lead.averaging_factor is not None and (lead.aliasing_factor, lead.aliasing_phase_rad) != (1.0, 0.0):
        bias = f"{(lead.aliasing_factor - 1) * 100:+z.1f} %, {math.degrees(lead.aliasing_phase_rad):+z.2f} degrees"
        rows.append(ErrorStage("aliasing on the mean", bias, "told by the prior of media; corrected"))
    for each in lead.components:
        if each.source not in IN_THE_RESIDUAL and (each.amplitude_m or each.phase_rad):
            size = f"{each.amplitude_m * 1e9:.3g} nm, {math.degrees(each.phase_rad):.2g} degrees"
            rows.append(ErrorStage(each.source, size, "standard uncertainty that remains"))
    whole = lead.headline
    total = f"{whole.amplitude_uncertainty_m * 1e9:.3g} nm, {math.degrees(whole.phase_uncertainty_rad):.2g} degrees"
    rows.append(ErrorStage("combined", total, "standard uncertainty of the corrected values, all sources in squares"))
    within = f"{whole.interval_95_m * 1e9:.3g} nm, {math.degrees(whole.interval_95_rad):.2g} degrees"
    rows.append(ErrorStage("interval of 95 %", within, "to either side, by u and its effective degrees of freedom"))
    if lead.corrected_amplitude_error is not None and lead.corrected_phase_error_rad is not None:
        error_deg = math.degrees(lead.corrected_phase_error_rad)
        error = f"{lead.corrected_amplitude_error * 100:+z.1f} %, {error_deg:+z.2f} degrees"
        rows.append(ErrorStage("error found", error, "against the ground truth, which the twin knows"))
    return rows


def _shown(result: Result, shot: int | None) -> ShotResult:
    if shot is None:
        return shown_shot(result)
    for item in result.shots:
        if item.shot == shot - 1:
            return item
    numbers = ", ".join(str(item.shot + 1) for item in result.shots[:10])
    raise StoreError(f"shot {shot} has no result, of {len(result.shots)} that have one. Try: --shot {numbers}.")


def _look(
    run: Run, result: ShotResult, repeats: Sequence[Sequence[Estimate]]
) -> tuple[list[Picture], list[ResidualTest], MotionView | None]:
    """Return the pictures of one shot, the tests of its residual and its motion, None where there is none."""
    shot = run.plan.shots[result.shot]
    scene = scene_of(run.scene, shot)
    whole = 2 * shot.capture.record_count * shot.capture.record_samples <= LARGEST_SHOT_BYTES
    needed, margin, most = samples_needed(scene, shot), margin_needed(scene, shot), shot.capture.record_samples
    around = slice(max(0, needed.start - margin), min(most, needed.stop + margin))
    part = slice(0, most) if whole else around
    records = run.records.gated(result.shot, part)
    pictures = list(timing(shot))
    echoes = echo_view(scene, shot, records, first_sample=part.start)
    if echoes is not None:
        pictures += [figures.rf_line(echoes), figures.m_mode(echoes)]
    if result.estimates:
        pictures += [
            amplitude_spectrum(result.estimates, repeats),
            phase_spectrum(result.estimates, repeats),
        ]
    try:
        motion = motion_view(scene, shot, gate_alone(scene, shot, records, part.start), result.estimates)
    except ValueError as error:
        return pictures, [ResidualTest("displacement", "not possible", str(error), "")], None
    periods_s = CLOSE_PERIODS / min((item.frequency_hz for item in result.estimates), default=math.inf)
    close_s = periods_s if 0 < periods_s < motion.time_s[-1] - motion.time_s[0] else None
    pictures.append(figures.displacement(motion, None, "displacement", "Displacement in the processing window"))
    if close_s:
        title = f"Closer: {CLOSE_PERIODS} periods of the lowest frequency"
        pictures.append(figures.displacement(motion, close_s, "displacement-close", title))
    return pictures + list(figures.residual(motion)), residual_tests(motion), motion


def _facts(run: Run, result: Result) -> list[tuple[str, str]]:
    """Return what was measured and how, as names and values."""
    scene, shot = run.scene, run.plan.shots[0]
    gate, tracking = scene.acquisition, scene.tracking
    facts = [("bench", run.bench.title), ("run file", result.run_file), ("run", result.status)]
    if run.bench.recording is not None:
        facts = [
            ("imported", f"{run.bench.recording.source}, read as {named(IMPORTERS, run.bench.recording.format)}"),
            *facts[1:],
        ]
        facts.append(("SHA-256", run.bench.recording.sha256))
        facts += [("taken as", text) for text in run.bench.recording.inferred]
    if result.provenance.started:
        facts.append(("started", result.provenance.started.replace("T", " ")))
    twin = twin_of(scene) if run.stored.simulated else None
    if twin is not None and twin.foreign_medium is not None:
        facts.append(("simulated medium", origin(MEDIA, twin.foreign_medium)))
    if result.simulated_specimen:
        facts.append(("simulated specimen", result.simulated_specimen))
    if scene.excitation:
        lengths = " / ".join(f"{length * 1e6:g}" for length in scene.excitation.burst_length_s)
        forces = " / ".join(f"{force:g}" for force in scene.excitation.force_fraction)
        push = f"{scene.excitation.burst_count} tonebursts of {lengths} us at {scene.excitation.burst_rate_hz:g} Hz"
        facts.append(("push", f"{push}, F = {forces} F_0"))
    else:
        facts.append(("push", "none: the scene has no [excitation]"))
    return [
        *facts,
        ("track", f"{shot.capture.record_count} pulses of {tracking.cycles} cycles at {tracking.pulse_rate_hz:g} Hz"),
        ("gate", f"{gate.gate_length_m * 1e3:g} mm at {gate.gate_depth_m * 1e3:g} mm depth"),
        ("shots", _shot_count(run, result)),
        ("estimator", named(ESTIMATORS, result.estimator)),
        ("phase", result.phase_reference),
    ]


def _shot_count(run: Run, result: Result) -> str:
    complete = {shot.shot: shot.complete for shot in result.shots}
    words = f"{len(complete)} of {len(run.plan.shots)} planned"
    counts = {
        "incomplete": list(complete.values()).count(False),
        "untrusted": len({shot.shot for shot in result.shots if shot.untrusted}),
    }
    return ", ".join([words, *(f"{count} of them {what}" for what, count in counts.items() if count)])


def _scene_of(run: Run, shown: ShotResult) -> Scene:
    """Return the scene at the place and pulse rate, and with the slow-time window, of the shown shot."""
    wanted = shown.pulse_rate_hz, shown.lateral_offset_m, shown.axial_offset_m
    point = scene_of(run.scene, run.plan.shots[shown.shot])
    rates = [rate for place in point.places for rate in place.rates if _setting(rate) == wanted]
    windows = [window for rate in rates for window in rate.windows]
    own = [window for window in windows if window.processing.window_length_s == shown.window_length_s]
    return (own or [point])[0]


def _setting(scene: Scene) -> tuple[float, float, float]:
    tracking = scene.tracking
    return tracking.pulse_rate_hz, tracking.lateral_offset_m, tracking.axial_offset_m


def _dose(run: Run, shown: ShotResult) -> list[tuple[str, str]]:
    """Return the acoustic output by the bench file's calibration, the detection floor, and what the limits let move."""
    output = [("acoustic output", finding.text) for finding in run.findings if finding.check == "acoustic output"]
    scene, shot = _scene_of(run, shown), run.plan.shots[shown.shot]
    said = *extrapolation_text(scene, run.bench), *detection_text(scene, run.stored.simulated, shot)
    lines = [text.partition(": ") for text in said]
    return output + [(name, text) for name, _, text in lines]


def _bars(result: Result) -> list[tuple[str, float, float]]:
    """Return stage, seconds and share of the longest one."""
    longest = max(result.run_time_s.values(), default=0.0) or 1.0
    return [(name, seconds, seconds / longest) for name, seconds in result.run_time_s.items()]


@cache
def _template() -> jinja2.Template:
    """Return the page's template, compiled once a process: that takes a tenth of the time of a page."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters.update(nm=_nm, deg=_deg, percent=_percent, svg=_svg, symbols=symbols)
    template = (resources.files("hpe_rig.report") / "report.html").read_text(encoding="utf-8")
    return environment.from_string(template)


def _page(*, result: Result, sweep: Sweep | None, **context: Any) -> str:
    warnings = (*result.warnings, *shot_warnings(result.shots))
    shown = badges(result, warnings, context["findings"], context["checks"])
    style = Markup(page_style())  # noqa: S704, a file of this program
    return _template().render(
        style=style,
        result=result,
        sweep=sweep,
        warnings=warnings,
        badges=shown,
        **context,
    )


def _svg(picture: Picture) -> Markup:
    # Drawn here, from numbers, with every text escaped by the drawing itself.
    return Markup(picture.svg)  # noqa: S704


def _nm(length_m: float | None, digits: int = 4) -> str:
    if length_m is None or not math.isfinite(length_m):
        return "–"
    text = f"{length_m * 1e9:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text else text


def _deg(angle_rad: float | None, form: str = ".2f") -> str:
    return "–" if angle_rad is None or not math.isfinite(angle_rad) else format(math.degrees(angle_rad), form)


def _percent(ratio: float | None, form: str = "+z.1f") -> str:
    return "–" if ratio is None or not math.isfinite(ratio) else format(ratio * 100, form)
