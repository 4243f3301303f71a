"""Estimates of every stored shot: records -> displacement -> fit -> amplitude and phase with budget and warnings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.medium import BeamWidths
from hpe_rig.plan import (
    PhaseReference,
    Plan,
    Selection,
    Shot,
    follow_tonebursts,
    phase_reference_of,
    precede_tonebursts,
    select,
)
from hpe_rig.processing.budget import ErrorSources, error_sources_of, estimates_of, with_first_pulse
from hpe_rig.processing.control import ControlMotion
from hpe_rig.processing.echo.conditioning import gate_statistics
from hpe_rig.processing.error_influences import error_influences
from hpe_rig.processing.estimators import EstimatorSpec, Options, spec_of
from hpe_rig.processing.first_pulse import PulseAssignment
from hpe_rig.processing.harmonics.aliasing_error import with_aliasing_error
from hpe_rig.processing.harmonics.drift import Drift, with_drift_uncertainty
from hpe_rig.processing.harmonics.fit_checks import Line, residual_line
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.quantisation import quantisation_m
from hpe_rig.processing.motion_model import stored_motion
from hpe_rig.processing.shot_controls import Controls, estimate_controls
from hpe_rig.processing.shot_fitting import (
    HarmonicFitter,
    available_prior,
    carrier_error,
    options_of,
    shot_averaging,
    shot_drift,
    shot_prior,
)
from hpe_rig.processing.shot_tracking import (
    ALL_CLIPPED,
    NO_RECORDS,
    ShotRecords,
    WindowMotion,
    clipped_count,
    read_shot,
)
from hpe_rig.processing.shot_warnings import (
    clock_warnings,
    drift_warnings,
    first_pulse_warnings,
    fit_warnings,
    line_warnings,
    medium_warnings,
    missing_record_warnings,
    record_warnings,
    setting_warnings,
    toneburst_warnings,
)
from hpe_rig.processing.time_base import TimeBase, clocks_of, phasor_influence_m, timed_motion
from hpe_rig.result import MAX_INFLUENCE_BYTES, MOST_PULSES, Averaging, ShotResult
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from hpe_rig.store import GatedRecords, StoredRun

FALSE_ALARM_PROBABILITY = 0.01
"""Probability, over all shots of a run, of a false warning from a statistical test."""


@dataclass(frozen=True, slots=True)
class Estimates:
    """Results of the shots of a run, and for each shot without a result (index from 0) the reason."""

    shots: tuple[ShotResult, ...]
    failures: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class _RunSettings:
    """Settings that the shots of a run share.

    ``averaging`` (frequency,): predicted beam averaging. ``false_alarm``: probability of a false warning per window.
    ``clocks`` (3, 3): covariance of the rate errors of motion, pulses and digitizer; None if nothing is known of them.
    """

    spec: EstimatorSpec
    averaging: tuple[Averaging | None, ...]
    beams: BeamWidths | None
    sources: ErrorSources
    false_alarm: float
    clocks: FloatArray | None


def estimate_run(
    scene: Scene,
    plan: Plan,
    stored: StoredRun,
    estimator: str,
    averaging: tuple[Averaging | None, ...],
    beams: BeamWidths | None = None,
) -> Estimates:
    """Return the estimates of every shot that has records and was not marked as bad.

    ``averaging`` (frequency,): predicted beam averaging. With ``beams`` the fit uses the medium prior
    (``hpe_rig.medium.ensemble``), if scene and estimator allow it. If the scene declares no medium, that fit also
    yields a posterior over media, and its beam averaging replaces the predicted one. The motion in the control of a
    shot, a recording with tonebursts off, is subtracted. A shot that cannot be estimated is listed in ``failures`` and
    does not affect the others.
    """
    # Every window of every shot is tested: division by their number keeps the probability of a false warning in the
    # whole run at FALSE_ALARM_PROBABILITY (Bonferroni).
    settings = _RunSettings(
        spec=spec_of(estimator),
        averaging=averaging,
        beams=beams,
        sources=error_sources_of(scene, stored.simulated),
        false_alarm=FALSE_ALARM_PROBABILITY / max(len(plan.shots), 1) / len(scene.windows),
        clocks=clocks_of(scene, stored),
    )
    controls = estimate_controls(scene, plan, stored, estimator)
    results, failures = list[ShotResult](), dict[int, str]()
    shots, pulses, _ = stored.records.shape
    # Results of very long runs do not hold the displacement of every pulse.
    with_motion, influence_bytes = shots * pulses * len(scene.windows) <= MOST_PULSES, 0
    for shot in plan.shots:
        if shot.is_control:
            continue
        if shot.index in stored.marks:
            failures[shot.index] = stored.marks[shot.index]
            continue
        try:
            shot_results = _estimate_shot(scene, shot, stored, settings, controls)
        except ValueError as error:
            failures[shot.index] = str(error)
            continue
        results += shot_results if with_motion else [replace(result, motion=None) for result in shot_results]
        influence_bytes += sum(item.influence_m.nbytes for result in shot_results for item in result.influences)
        if influence_bytes > MAX_INFLUENCE_BYTES:
            results = [replace(result, influences=()) for result in results]
    return Estimates(tuple(results), failures)


def estimate_records(scene: Scene, shot: Shot, records: GatedRecords, estimator: str, shot_count: int) -> ShotResult:
    """Return the result of one shot from its ``records`` in memory, in the gate, without beams.

    Estimate, budget and warnings are those of the same records in a run file with ``shot_count`` shots. Raises
    ``ValueError`` if the shot cannot be estimated.
    """
    from hpe_rig.store import Placement

    valid = records.valid
    if not valid.any():
        raise ValueError(NO_RECORDS)
    settings = _RunSettings(
        spec=spec_of(estimator),
        averaging=(None,) * len(scene.wanted_frequencies_hz),
        beams=None,
        sources=error_sources_of(scene, simulated=False),
        false_alarm=FALSE_ALARM_PROBABILITY / shot_count,
        clocks=None,
    )
    placement = Placement(np.where(valid, np.arange(valid.size), -1), valid, np.zeros(valid.size, bool))
    shot_records = ShotRecords(records, gate_statistics(records), None, PulseAssignment(placement))
    result = _estimate_window(scene, shot, shot_records, settings, None, True)
    return result if shot_count * valid.size <= MOST_PULSES else replace(result, motion=None)


def _estimate_shot(
    scene: Scene, shot: Shot, stored: StoredRun, settings: _RunSettings, controls: Controls
) -> list[ShotResult]:
    """Return the result of one shot in each processing window; raise ``ValueError`` if one cannot be estimated.

    A scene with several windows of slow time (``scene.windows``) is estimated once in each, from the same records.
    A control is a recording of the same shot with tonebursts off; its motion is subtracted. ``controls``: the motions
    in the controls of all shots, or why a shot has none to subtract.
    """
    records = read_shot(scene, shot, stored)
    # True amplitudes and phases are stored as means over the window. With the drift removed, an estimate is that at the
    # first pulse, which cannot be compared with a mean.
    true_m = None
    if stored.true_displacement_m is not None and scene.processing.drift == "none":
        true_m = stored.true_displacement_m.harmonics_m(shot.index, len(scene.wanted_frequencies_hz))
    complete = bool(stored.shot_complete[shot.index])
    window_controls = controls.motions.get(shot.index) or (None,) * len(scene.windows)
    results = [
        _estimate_window(window, shot, records, settings, true_m, complete, control)
        for window, control in zip(scene.windows, window_controls, strict=True)
    ]
    if why := stored.untrusted.get(shot.index):
        results = [replace(result, untrusted=why) for result in results]
    if (reason := controls.failures.get(shot.index)) is None:
        return results
    warning = f"no control is subtracted ({reason}): motion without tonebursts, such as a hum, is in the values"
    return [replace(result, warnings=(*result.warnings, warning)) for result in results]


def _estimate_window(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    settings: _RunSettings,
    true_m: FloatArray | None,
    complete: bool,
    control: ControlMotion | None = None,
) -> ShotResult:
    """Return amplitude and phase of every wanted frequency, with uncertainty budget and warnings, in one window.

    The window of slow time is that of ``scene``. ``true_m`` (frequency, 2): true A cos(phase) and A sin(phase), m,
    None if unknown. ``complete``: the shot was recorded to its end. ``control``: motion without tonebursts, subtracted.
    """
    spec, selection = settings.spec, select(scene, shot)
    options = options_of(scene.processing, shot_prior(scene, shot, spec.name, settings.beams))
    motion, time_base = timed_motion(scene, shot, records, spec.motion, settings.clocks, settings.beams, control)
    drift = _drift(scene, shot, motion, selection, options, settings)
    removed_drift = drift if scene.processing.drift == "linear" else None
    if removed_drift is not None:
        motion = motion.without(removed_drift.change_m(motion.tracked.time_s))
    fit_of = partial(_fit_with_aliasing, scene, shot, selection=selection, options=options, settings=settings)
    fit = fit_of(motion) if removed_drift is None else with_drift_uncertainty(fit_of(motion), removed_drift)
    delay_s = phase_reference_of(scene, shot).delay_s
    reference, true_reference = _phase_references(scene, shot, time_base)
    time_base_m = phasor_influence_m(HarmonicFitter.of(selection, spec.name, options), motion, time_base, delay_s)
    sources = replace(_error_sources(records, motion, fit, settings, time_base, time_base_m), control=control)
    averaging = shot_averaging(scene, fit, settings.averaging)
    estimates = estimates_of(fit, sources, averaging, true_m, reference, true_reference)
    if max(records.assignment.shifts):
        alternatives = [
            estimates_of(late_fit, sources, shot_averaging(scene, late_fit, settings.averaging), None, reference)
            for late_fit in map(fit_of, map(motion.delayed, records.assignment.alternatives_s(shot)))
        ]
        estimates = with_first_pulse(estimates, alternatives, records.assignment.late_part_s(shot))
    residual_m, order = float(fit.quality.residual_rms_m), options.background_order
    line, clipped = _line(motion, selection, options), clipped_count(records, selection, motion)
    return ShotResult(
        **(_settings_of(scene, shot) | _rates_of(time_base)),
        pulses_used=int(motion.echoes.valid.sum()),
        pulses_missing=int((~records.gate.valid[selection.window]).sum()),
        residual_m=residual_m,
        estimates=estimates,
        control=() if control is None else estimates_of(control.fit, reference=reference),
        warnings=(
            *records.assignment.remarks,
            *_record_warnings(shot, records, selection, motion, clipped, complete),
            *fit_warnings(fit, float(motion.measured.largest_step)),
            *medium_warnings(fit, settings.false_alarm, uses_prior=options.prior is not None),
            *setting_warnings(scene, motion.echoes.pulse_time_s, motion.reference),
            *drift_warnings(drift, estimates, settings.false_alarm, is_removed=removed_drift is not None),
            *line_warnings(line, shot.tracking_train.rate_hz, settings.false_alarm, sources.rounding_m),
            *toneburst_warnings(records.tonebursts, time_base),
            *clock_warnings(time_base, estimates, motion.echoes.pulse_time_s - delay_s, scene.excitation is not None),
        ),
        complete=complete,
        untrusted=ALL_CLIPPED if clipped == motion.echoes.valid.sum() else "",
        influences=error_influences(fit, estimates, averaging, averaging is not settings.averaging, sources),
        motion=stored_motion(motion.tracked, estimates, reference, residual_m, selection, order, spec.name),
    )


def _phase_references(scene: Scene, shot: Shot, time_base: TimeBase) -> tuple[PhaseReference, PhaseReference]:
    """Return the references of measured and of true phases, with delays by the clock of the motion's frequencies."""
    nominal, twin = phase_reference_of(scene, shot), twin_of(scene)
    true_error = 0.0 if twin is None else twin.rate_error
    return nominal.by_motion_clock(time_base.by_pulses.value), nominal.by_motion_clock(true_error)


def _settings_of(scene: Scene, shot: Shot) -> dict[str, Any]:
    """Return the fields of a shot's result that state its settings."""
    return {
        "index": shot.index,
        "repeat": shot.repeat,
        "burst_length_s": shot.timeline.burst_length_s or None,
        "force_fraction": shot.force_fraction,
        "pulse_rate_hz": shot.tracking_train.rate_hz,
        "window_length_s": scene.processing.window_length_s,
        "lateral_offset_m": shot.lateral_offset_m,
        "axial_offset_m": shot.axial_offset_m,
    }


def _rates_of(time_base: TimeBase) -> dict[str, Any]:
    """Return the fields of a shot's result that state the measured rates of its pulses and of the motion."""
    rate, error = time_base.tracking_rate, time_base.by_pulses if time_base.is_uncertain else None
    return {
        "pulse_rate_error": rate.error if rate else None,
        "pulse_rate_uncertainty": rate.uncertainty if rate else None,
        "frequency_error": error.value if error else None,
        "frequency_error_uncertainty": error.uncertainty if error else None,
        "frequency_error_from_tonebursts": time_base.by_tonebursts is not None,
    }


def _error_sources(
    records: ShotRecords,
    motion: WindowMotion,
    fit: HarmonicFit,
    settings: _RunSettings,
    time_base: TimeBase,
    time_base_m: ComplexArray | None,
) -> ErrorSources:
    """Return the sources of uncertainty of the scene with those that depend on the shot.

    ``time_base_m`` (frequency,): influence of the rate error.
    """
    spec = settings.spec
    return replace(
        settings.sources,
        subtracts_jitter=motion.reference is not None,
        gate_edge=motion.echoes.edge_uncertainty(spec.gate_window),
        quantisation_m=()
        if motion.coherent is None
        else quantisation_m(motion.echoes, records.gate.volts_per_code, motion.coherent, fit),
        carrier_relative=carrier_error(motion.measured, motion.measured_coherent) if spec.by_carrier else 0.0,
        time_base_m=time_base_m,
        time_base_freedom=time_base.by_pulses.degrees_of_freedom,
        time_base_clock_fraction=time_base.by_pulses.clock_fraction,
    )


def _fit_with_aliasing(
    scene: Scene,
    shot: Shot,
    motion: WindowMotion,
    selection: Selection,
    options: Options,
    settings: _RunSettings,
) -> HarmonicFit:
    """Return the harmonics of the tracked displacement, with an uncertainty for aliasing if a prior is available.

    Tonebursts drive harmonics above half the pulse rate, which alias onto the wanted ones. How strong these are is
    estimated with a prior of the motions that media can have, from the coherent displacement, which has least noise.
    """
    fitter = HarmonicFitter.of(selection, settings.spec.name, options)
    fit, prior = fitter(motion.tracked), available_prior(scene, shot, settings.beams)
    # A fit with a medium has used the prior itself, for all harmonics: nothing aliases.
    if fit.medium is None and prior is not None and motion.coherent is not None:
        # ``with_aliasing_error`` raises ValueError if the pulses are too few for the prior: the fit stays without it.
        with suppress(ValueError):
            return with_aliasing_error(fit, motion.coherent, prior, fitter, options.background_order)
    return fit


def _record_warnings(
    shot: Shot, records: ShotRecords, selection: Selection, motion: WindowMotion, clipped: int, complete: bool
) -> Iterator[str]:
    """Yield warnings of records in the window that are missing, damaged, clipped, or unlike the others in energy.

    ``clipped``: number of used pulses at full scale.
    """
    gate, window = records.gate, selection.window
    recorded = gate.valid[window]
    damaged = np.zeros_like(recorded) if gate.damaged is None else gate.damaged[window]
    # In an incomplete shot the records after the stop never came.
    if complete:
        yield from missing_record_warnings(recorded, damaged)
        yield from first_pulse_warnings(records.assignment)
    used = recorded & selection.used
    deviating = np.zeros_like(window)
    deviating[window] = used & ~motion.echoes.valid
    position = ""
    if follow_tonebursts(shot, deviating):
        position = "after toneburst"
    elif precede_tonebursts(shot, deviating):
        position = "before toneburst"
    yield from record_warnings(damaged, int(deviating.sum()), clipped, position)


def _drift(
    scene: Scene,
    shot: Shot,
    motion: WindowMotion,
    selection: Selection,
    options: Options,
    settings: _RunSettings,
) -> Drift | None:
    """Return the change of the motion over the window, for its removal or for a test of whether there is one.

    One iteration is enough to test for a change. It is iterated to convergence if ``scene`` removes it or if it is
    significant: a steady motion shows one as large with a probability below ``settings.false_alarm``. None if a test is
    not possible: noisy echoes or few pulses. Raises ``ValueError`` if ``scene`` asks for the removal of a drift that
    cannot be estimated.
    """
    # Unfitted harmonics that alias near a fitted one beat with it, as a drift does: the prior contains them.
    options = replace(options, prior=available_prior(scene, shot, settings.beams))
    if scene.processing.drift == "linear":
        return shot_drift(motion, selection, options)
    drift = None
    if motion.coherent is not None:
        with suppress(ValueError):
            drift = shot_drift(motion, selection, options, max_iterations=1)
            # A significant drift is reported with its size, as its removal would estimate it. One iteration gives the
            # size only roughly, and stays if the iterations diverge.
            if drift.probability < settings.false_alarm:
                removal = replace(options, background_order=max(options.background_order, 1))
                drift = replace(shot_drift(motion, selection, removal), probability=drift.probability)
    return drift


def _line(motion: WindowMotion, selection: Selection, options: Options) -> Line | None:
    """Return the strongest spectral line in the residual of the coherent displacement; None if it cannot be fitted."""
    if motion.coherent is None:
        return None
    with suppress(ValueError):
        return residual_line(
            motion.coherent,
            selection.wanted_hz,
            also_hz=selection.driven_hz,
            background_order=options.background_order,
            prior=options.prior,
        )
    return None
