"""Page of a run: results estimated again from the stored records, checks, residual tests and provenance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hpe_rig.bench import twin_of
from hpe_rig.extensions import ESTIMATORS, IMPORTERS, MEDIA, named, origin
from hpe_rig.plan import scene_of_shot, timing_pictures
from hpe_rig.prediction import detection_text, extrapolation_text
from hpe_rig.processing import assign_pulses, margin_needed, samples_needed
from hpe_rig.report import figures, page_tables, provenance as report_provenance
from hpe_rig.report.badges import badges
from hpe_rig.report.depth_profile import profile_pictures
from hpe_rig.report.moduli import moduli_summary
from hpe_rig.report.page_tables import text_table
from hpe_rig.report.page_writer import PageTable, render_template
from hpe_rig.report.residual_tests import ResidualTest, residual_tests
from hpe_rig.report.sweep import Sweep, make_sweep
from hpe_rig.report.views import MotionView, echo_view, motion_view, tracked_motion
from hpe_rig.result import (
    Estimate,
    Picture,
    Result,
    ShotResult,
    Stages,
    control_text,
    frequency_error_text,
    headline_sentence,
    main_shot,
    means_of,
    setting_pictures,
    shot_warnings,
    spectrum_pictures,
)
from hpe_rig.runs import Run, estimate_points, open_run, points_over
from hpe_rig.scene import Axis, Scene, plural
from hpe_rig.store import StoreError, refuse_unwritable, write_file

MAX_TEXT = 60_000
"""Characters of scene and bench file on the page."""
MAX_SHOT_BYTES = 256_000_000
"""Size of a shot's records up to which they are read completely; beyond, only the gate."""
CLOSE_UP_PERIODS = 2
"""Periods of the lowest frequency in the close-up of the displacement."""
SOURCES_OF_RESIDUAL = ("noise", "trigger jitter")
"""Sources of uncertainty that the stage 'harmonic' contains."""
PAGE_START = b"<!DOCTYPE html>"


def write_report(
    path: Path,
    estimator: str | None = None,
    output: Path | None = None,
    shot: int | None = None,
    *,
    profile_step_m: float | None = None,
    axes: Sequence[Axis] = (),
    together: bool = False,
    settings: Mapping[str, Any] | None = None,
) -> Path:
    """Write the page of the run in ``path`` and return its path, by default that of the run with the suffix .html.

    ``shot``: number of the main shot from 1, by default the complete one with the largest amplitude.
    ``profile_step_m``: distance of additional gates over depth. ``axes``: values of processing settings, for which the
    page shows results and curves from the same records; ``together`` as for ``Run.sweep``. ``settings``: values instead
    of the scene's, as for ``Run.with_``. Raises ``StoreError`` for a file that cannot be read or written, or would be
    lost, and ``SettingsError`` for wrong settings.
    """
    if not path.name:
        raise StoreError(f"{path} is a folder. Try: the path of a run file.")
    target = output or path.with_suffix(".html")
    _refuse_other_file(target)
    refuse_unwritable(target)
    page = render(path, estimator, shot, profile_step_m=profile_step_m, axes=axes, together=together, settings=settings)
    write_file(target, page)
    return target


def _refuse_other_file(target: Path) -> None:
    """Raise ``StoreError`` if ``target`` exists and is no page: it may be the run itself."""
    if not target.is_file():
        return
    try:
        with target.open("rb") as file:
            start = file.read(len(PAGE_START))
    except OSError:
        # The attempt to write reports the reason.
        return
    if start and start != PAGE_START:
        raise StoreError(f"{target} exists and is no HTML page: it stays unchanged. Try: another --output.")


def render(
    path: Path,
    estimator: str | None = None,
    shot_number: int | None = None,
    *,
    profile_step_m: float | None = None,
    axes: Sequence[Axis] = (),
    together: bool = False,
    settings: Mapping[str, Any] | None = None,
) -> str:
    """Return the page of the run in ``path`` as HTML; raises as ``write_report``."""
    stages = Stages()
    with stages("read"):
        stored_run = open_run(path).with_(settings or {}).with_profile(profile_step_m)
    if axes:
        points = points_over(stored_run, axes, together)
        result = estimate_points(points, estimator)
    else:
        points = [({}, stored_run)]
        result = stored_run.estimate(estimator, stages)
        # The result file is for other programs; the page never reads one, since it could have been edited.
        with stages("write result"):
            stored_run.save(result)
    shot = _selected_shot(result, shot_number)
    # The pictures of the main shot use the settings of its point.
    run = next(run for values, run in points if values.items() <= shot.swept.items())
    with stages("draw"):
        pictures, tests, motion = _display(run, result, shot, alone=shot_number is not None)
        sweep = make_sweep(result.shots)
        sweep_pictures = figures.sweep_pictures(sweep) if sweep else ()
        moduli = moduli_summary(stored_run, estimator)
        depth_pictures = _depth_pictures(result, shot)
    warnings = (*result.warnings, *shot_warnings(result.shots))
    return render_template(
        "report.html",
        result=result,
        shot=shot,
        selected=shot_number is not None,
        by_setting=any(picture.key == "amplitude-settings" for picture in pictures),
        repeats=max((len(mean.shots) for mean in means_of(result.means, shot)), default=1),
        stored=run.stored,
        corrected=strongest(shot).corrected,
        known=_has_truth(result),
        headline=headline_sentence(result),
        badges=list(badges(result, warnings, run.findings, tests)),
        warnings=warnings,
        facts=[*_facts(run, result), *_dose(run, shot)],
        shot_settings=_settings_texts(shot),
        pictures={picture.key: picture for picture in pictures},
        sweep=sweep,
        sweep_pictures=sweep_pictures,
        depth_pictures=depth_pictures,
        moduli=moduli,
        tables=_tables(run, result, shot, sweep) | _error_tables(shot, tests, motion),
        check_results=run.findings,
        settings=report_provenance.settings(path, shot.index),
        fingerprint=report_provenance.fingerprint(path),
        max_text=MAX_TEXT,
        max_rows=page_tables.MAX_ROWS,
    )


def _depth_pictures(result: Result, shot: ShotResult) -> Sequence[Picture]:
    """Return the pictures of amplitude and phase over depth, for ``shot`` and its window."""
    same_window = [gate for gate in result.profile if gate.shot.window_length_s == shot.window_length_s]
    return profile_pictures([gate for gate in same_window if gate.shot.index == shot.index])


def _tables(run: Run, result: Result, shot: ShotResult, sweep: Sweep | None) -> dict[str, PageTable | None]:
    """Return the tables of the page by name; None for an empty one."""
    scene, has_truth = _scene_at(run, shot), _has_truth(result)
    attributes = report_provenance.attributes(run.path, [f"version_{name}" for name in result.versions])
    return {
        "means": page_tables.means_table(result.means) if result.means else None,
        "sweep": page_tables.sweep_table(sweep) if sweep else None,
        "estimates": page_tables.estimates_table(shot, has_truth),
        "budget": page_tables.budget_table(shot),
        "prediction": page_tables.prediction_table(scene, run.plan.shots[shot.index], shot, result.estimator),
        "run_times": page_tables.run_times_table(result),
        "shots": page_tables.shots_table(result, has_truth) if sweep else None,
        "conditions": page_tables.conditions_table(result),
        "versions": page_tables.versions_table(result, attributes),
    }


def _error_tables(
    shot: ShotResult, tests: Sequence[ResidualTest], motion: MotionView | None
) -> dict[str, PageTable | None]:
    """Return the residual tests, and the contributions to the error of the strongest harmonic."""
    test_rows = [{"test": t.name, "verdict": t.verdict, "value": t.value, "meaning": t.meaning} for t in tests]
    stages = [{"stage": s, "size": size, "source": text} for s, size, text in error_stages(shot, motion)]
    caption = f"Error of the strongest harmonic, {strongest(shot).frequency_hz:g} Hz."
    return {
        "residual_tests": text_table("tests", "Tests of residual and innovations; noticed below p = 0.001.", test_rows),
        "error_stages": text_table("errors", caption, stages),
    }


def _has_truth(result: Result) -> bool:
    return any(item.true_amplitude_m is not None for shot in result.shots for item in shot.estimates)


def _settings_texts(shot: ShotResult) -> list[str]:
    """Return the settings and the number of pulses of a shot in words."""
    texts = [] if shot.force_fraction is None else [f"F = {shot.force_fraction:.4g} F_0"]
    texts += [] if shot.burst_length_s is None else [f"T_b = {shot.burst_length_s * 1e6:g} us"]
    texts += [f"{name} = {value:g}" for name, value in shot.swept.items()]
    texts.append(f"{shot.pulses_used} pulses, {shot.pulses_missing} missing")
    if shot.pulse_rate_error is not None and shot.pulse_rate_uncertainty is not None:
        error, u = shot.pulse_rate_error * 1e6, shot.pulse_rate_uncertainty * 1e6
        texts.append(f"pulse rate {error:+z.2f} ppm from nominal by the digitizer's clock (u {u:.2g} ppm)")
    if text := control_text([shot]):
        texts.append(text)
    if clock_text := frequency_error_text(shot):
        texts.append(clock_text)
    return texts


def strongest(shot: ShotResult) -> Estimate:
    """Return the estimate with the largest amplitude."""
    return max(shot.estimates, key=lambda item: item.amplitude_m)


def error_stages(shot: ShotResult, motion: MotionView | None) -> Iterator[tuple[str, str, str]]:
    """Yield stage, error and source of every contribution to the error of the strongest harmonic, in order."""
    lead = strongest(shot)
    if motion is not None:
        echo_nm = math.sqrt(float(motion.noise_m2.mean())) * 1e9
        yield "one echo", f"{echo_nm:.3g} nm", "scatter of the echoes about their mean shape"
    yield "one displacement", f"{shot.residual_m * 1e9:.3g} nm rms", "residual of the fit"
    u = _nm_and_degrees(lead.tracked_amplitude_uncertainty_m, lead.tracked_phase_uncertainty_rad)
    yield "harmonic", u, f"standard uncertainty from that residual, {shot.pulses_used} pulses"
    # Systematic effects are corrected; the uncertainty of their correction remains (GUM, 3.2.3).
    if lead.averaging_factor is not None:
        bias = _relative_and_degrees(lead.averaging_factor - 1, lead.averaging_phase_rad or 0.0)
        yield "beam averaging", bias, "predicted, tracked relative to peak displacement; corrected"
        if (lead.aliasing_factor, lead.aliasing_phase_rad) != (1.0, 0.0):
            bias = _relative_and_degrees(lead.aliasing_factor - 1, lead.aliasing_phase_rad)
            yield "mean aliasing", bias, "predicted by the prior of media; corrected"
    for component in lead.components:
        if component.source not in SOURCES_OF_RESIDUAL and (component.amplitude_m or component.phase_rad):
            u = _nm_and_degrees(component.amplitude_m, component.phase_rad)
            yield component.source, u, "standard uncertainty after correction"
    u = _nm_and_degrees(lead.amplitude_uncertainty_m, lead.phase_uncertainty_rad)
    yield "combined", u, "standard uncertainty of the corrected values: root sum of squares"
    half_width = _nm_and_degrees(lead.interval_95_m, lead.interval_95_rad)
    yield "interval of 95 %", half_width, "half width, from u and its effective degrees of freedom"
    if lead.amplitude_error is not None and lead.phase_error_rad is not None:
        error = _relative_and_degrees(lead.amplitude_error, lead.phase_error_rad)
        yield "actual error", error, "relative to the ground truth of the twin"


def _nm_and_degrees(length_m: float, angle_rad: float) -> str:
    return f"{length_m * 1e9:.3g} nm, {math.degrees(angle_rad):.2g} degrees"


def _relative_and_degrees(ratio: float, angle_rad: float) -> str:
    return f"{ratio * 100:+z.1f} %, {math.degrees(angle_rad):+z.2f} degrees"


def _selected_shot(result: Result, number: int | None) -> ShotResult:
    if number is None:
        return main_shot(result)
    for shot in result.shots:
        if shot.shot == number:
            return shot
    numbers = ", ".join(str(shot.shot) for shot in result.shots[:10])
    why = dict(result.shots_without_result).get(number, f"{len(result.shots)} shots have one")
    raise StoreError(f"shot {number} has no result ({why}). Try: --shot {numbers}.")


def _display(
    run: Run, result: Result, shot_result: ShotResult, *, alone: bool
) -> tuple[list[Picture], list[ResidualTest], MotionView | None]:
    """Return the pictures of a shot, the tests of its residual, and its motion, None if it has no displacement.

    The spectra are those of the mean over its repeats, unless it is to be drawn ``alone``.
    """
    shot = run.plan.shots[shot_result.index]
    scene = scene_of_shot(run.scene, shot)
    # A large shot is read in the gate only, with the margins that the estimators need.
    needed, margin, last = samples_needed(scene, shot), margin_needed(scene, shot), shot.capture.record_samples
    samples = slice(0, last)
    if 2 * shot.capture.record_count * last > MAX_SHOT_BYTES:
        samples = slice(max(0, needed.start - margin), min(last, needed.stop + margin))
    records = run.records.gated(shot.index, samples, placement=assign_pulses(shot, run.stored).placement)
    pictures = list(timing_pictures(shot))
    echoes = echo_view(scene, shot, records, first_sample=samples.start)
    if echoes is not None:
        pictures += [figures.rf_line(echoes), figures.m_mode(echoes)]
    pictures += spectrum_pictures(result, shot_result, alone)
    pictures += () if alone else setting_pictures(result)
    try:
        tracked = tracked_motion(scene, shot, records, samples.start)
        motion = motion_view(scene, shot, tracked, shot_result.estimates)
    except ValueError as error:
        return pictures, [ResidualTest("displacement", "not possible", str(error), "")], None
    pictures.append(figures.displacement(motion, None, "displacement", "Displacement in the processing window"))
    span_s = CLOSE_UP_PERIODS / min((item.frequency_hz for item in shot_result.estimates), default=math.inf)
    if 0 < span_s < motion.time_s[-1] - motion.time_s[0]:
        title = f"Close-up: {CLOSE_UP_PERIODS} periods of the lowest frequency"
        pictures.append(figures.displacement(motion, span_s, "displacement-close", title))
    return [*pictures, *figures.residual_pictures(motion)], residual_tests(motion), motion


def _facts(run: Run, result: Result) -> Iterator[tuple[str, str]]:
    """Yield names and values that describe the measurement."""
    scene, shot, recording = run.scene, run.plan.shots[0], run.bench.recording
    if recording is None:
        yield "bench", run.bench.title
    else:
        yield "imported", f"{recording.source}, format {named(IMPORTERS, recording.format)}"
    yield "run file", result.run_file
    yield "run", result.status
    if recording is not None:
        yield "SHA-256", recording.sha256
        yield from (("inferred", text) for text in recording.inferred)
    if result.provenance.started:
        yield "started", result.provenance.started.replace("T", " ")
    if result.provenance.continues:
        yield "earlier shots", f"copied from {result.provenance.continues}"
    twin = twin_of(scene) if run.stored.simulated else None
    if twin is not None and twin.foreign_medium is not None:
        yield "simulated medium", origin(MEDIA, twin.foreign_medium)
    if result.simulated_specimen:
        yield "simulated specimen", result.simulated_specimen
    yield "push", _push_text(scene)
    tracking, acquisition = scene.tracking, scene.acquisition
    pulses = f"{shot.capture.record_count} pulses of {tracking.cycles} cycles"
    yield "track", f"{pulses} at {tracking.pulse_rate_hz:g} Hz"
    yield "gate", f"{acquisition.gate_length_m * 1e3:g} mm at {acquisition.gate_depth_m * 1e3:g} mm depth"
    yield "shots", _shot_count(run, result)
    yield "estimator", named(ESTIMATORS, result.estimator)
    yield "phase", result.phase_reference


def _push_text(scene: Scene) -> str:
    if not scene.excitation:
        return "none: the scene has no [excitation]"
    lengths = " / ".join(f"{length * 1e6:g}" for length in scene.excitation.burst_length_s)
    forces = " / ".join(f"{force:g}" for force in scene.excitation.force_fraction)
    bursts = (
        f"{plural(scene.excitation.burst_count, 'toneburst')} of {lengths} us at {scene.excitation.burst_rate_hz:g} Hz"
    )
    return f"{bursts}, F = {forces} F_0"


def _shot_count(run: Run, result: Result) -> str:
    complete = {shot.index: shot.complete for shot in result.shots}
    counts = {
        "incomplete": list(complete.values()).count(False),
        "untrusted": len({shot.index for shot in result.shots if shot.untrusted}),
    }
    controls = sum(shot.is_control for shot in run.plan.shots)
    planned = f"{len(complete)} of {len(run.plan.shots) - controls} planned"
    planned += ", each with a control" if controls else ""
    return ", ".join([planned, *(f"{count} of them {kind}" for kind, count in counts.items() if count)])


def _scene_at(run: Run, shot: ShotResult) -> Scene:
    """Return the scene at the offsets, pulse rate and slow-time window of ``shot``."""
    # The axes of a sweep multiply: offsets, then pulse rates, then windows.
    settings = shot.pulse_rate_hz, shot.lateral_offset_m, shot.axial_offset_m
    point = scene_of_shot(run.scene, run.plan.shots[shot.index])
    rates = [
        rate
        for offset_scene in point.places
        for rate in offset_scene.rates
        if settings == (rate.tracking.pulse_rate_hz, rate.tracking.lateral_offset_m, rate.tracking.axial_offset_m)
    ]
    windows = [window for rate in rates for window in rate.windows]
    return next((scene for scene in windows if scene.processing.window_length_s == shot.window_length_s), point)


def _dose(run: Run, shot: ShotResult) -> list[tuple[str, str]]:
    """Return the calibrated acoustic output, the motion at its limits, and the detection floor."""
    output = [("acoustic output", check.text) for check in run.findings if check.check == "acoustic output"]
    scene, planned = _scene_at(run, shot), run.plan.shots[shot.index]
    lines = *extrapolation_text(scene, run.bench), *detection_text(scene, run.stored.simulated, planned)
    return output + [(name, text) for name, _, text in (line.partition(": ") for line in lines)]
