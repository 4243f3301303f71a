"""Checks of timing: pulses, records, depth and trains against the periods of pulses, bursts and shots; clocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, clock_covariance
from hpe_rig.plan.checks.check_result import CheckResult, in_hz, in_us, is_whole, pass_or_refuse
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene

MIN_PULSES = 4
"""Number of pulses that an estimate of amplitude, phase and constant background needs."""


def tracking_train(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield a conflict if the tracking pulses are too few or too long."""
    count = plan.shots[0].capture.record_count
    if scene.excitation is None and scene.tracking.pulse_count is None:
        remedy = "tracking.pulse_count (without [excitation] there is no burst train to fill)"
        yield CheckResult("pulse count", "refused", "the number of tracking pulses is not given", remedy)
    elif count < MIN_PULSES:
        text = f"{count} tracking pulses do not determine a vibration"
        yield CheckResult("pulse count", "refused", text, f"tracking.pulse_count of {MIN_PULSES} or more")
    pulse_s, period_s = plan.shots[0].timeline.pulse_length_s, 1 / scene.tracking.pulse_rate_hz
    if pulse_s >= period_s:
        text = f"a tracking pulse of {in_us(pulse_s)} does not fit the pulse period of {in_us(period_s)}"
        yield CheckResult("pulse length", "refused", text, "fewer tracking.cycles or a lower tracking.pulse_rate_hz")


def record_in_period(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether a record ends before the next pulse."""
    capture, period_s = plan.shots[0].capture, 1 / scene.tracking.pulse_rate_hz
    end_s = (capture.trigger_delay_samples + capture.record_samples) / capture.sample_rate_hz
    text = f"a record ends {in_us(end_s)} after its trigger, the pulse period is {in_us(period_s)}"
    remedy = f"acquisition.record_samples or tracking.pulse_rate_hz below {in_hz(1 / end_s)}"
    yield pass_or_refuse("record in period", end_s < period_s, text, remedy)


def depth(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the gate's echoes arrive before the next pulse, and the gate is in front of the transducer."""
    acquisition, rate_hz = scene.acquisition, scene.tracking.pulse_rate_hz
    far_m = scene.gate_depth_m + acquisition.gate_length_m / 2
    limit_hz = acquisition.sound_speed_m_per_s / (2 * far_m)
    text = f"tracking.pulse_rate_hz = {in_hz(rate_hz)}, c/2z at the gate's far end is {in_hz(limit_hz)}"
    yield pass_or_refuse("depth", rate_hz <= limit_hz, text, f"a pulse rate of at most {in_hz(limit_hz)}")
    near_m = scene.gate_depth_m - acquisition.gate_length_m / 2
    text = f"the gate starts {near_m * 1e3:.4g} mm from the transducer"
    remedy = "acquisition.gate_depth_m of more than half acquisition.gate_length_m"
    yield pass_or_refuse("gate depth", near_m > 0, text, remedy)


def periods(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether trains end before the next shot, and a synchronous scene's periods are commensurate."""
    train_s, period_s = max(shot.train_end_s for shot in plan.shots), scene.acquisition.shot_period_s
    if period_s is not None:
        text = f"trains end {train_s * 1e3:.4g} ms after the master trigger, "
        text += f"acquisition.shot_period_s = {period_s * 1e3:.4g} ms"
        remedy = f"a shot period above {train_s:.4g} s, or shorter trains"
        yield pass_or_refuse("master period", train_s < period_s, text, remedy)
    if scene.excitation is not None and scene.processing.synchronous:
        ratio = scene.tracking.pulse_rate_hz / scene.excitation.burst_rate_hz
        nearest_hz = max(1, round(ratio)) * scene.excitation.burst_rate_hz
        text = f"the burst period holds {ratio:g} pulse periods, processing.synchronous = true wants a whole number"
        remedy = f"tracking.pulse_rate_hz = {nearest_hz:g}, or synchronous = false"
        yield pass_or_refuse("synchronous", is_whole(ratio), text, remedy)


def clocks(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield the accuracies of the clocks of motion, pulses and digitizer, unless all share one or nothing is fitted."""
    covariance = clock_covariance(scene, bench)
    motion_by_pulses = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]))
    stated = scene.processing.frequency_accuracy
    accuracy = motion_by_pulses if stated is None else stated
    if not accuracy or not scene.wanted_frequencies_hz:
        return
    motion_ppm, pulses_ppm, digitizer_ppm = np.sqrt(np.diag(covariance)) * 1e6
    source = f"motion {motion_ppm:g} ppm, pulses {pulses_ppm:g} ppm, digitizer {digitizer_ppm:g} ppm (clock_accuracy)"
    if stated is not None:
        source = f"frequencies {stated * 1e6:g} ppm (processing.frequency_accuracy)"
    timeline, highest_hz = plan.shots[0].timeline, max(scene.wanted_frequencies_hz)
    length_s = scene.processing.window_length_s or float(timeline.pulse_onset_s[-1] - timeline.pulse_onset_s[0])
    shift_deg = 360 * highest_hz * accuracy * length_s
    text = (
        f"{source}: in {length_s:.3g} s they may shift {highest_hz:g} Hz by {shift_deg:.2g} deg, which the fit corrects"
    )
    yield CheckResult("clocks", "passed", text)
