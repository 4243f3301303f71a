"""Every conflict of a plan, found before anything is opened; each names keys, both numbers and the remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import Finding, Level, PlanError, judged, refuse_conflicts
from hpe_rig.plan.checks.digitizer import board, capture_mode, memory
from hpe_rig.plan.checks.output import acoustic_output, drive, generators
from hpe_rig.plan.interference import admissible_delays_s, disturbed_pulses, effective_rate_hz, forbidden_window_s
from hpe_rig.plan.shots import Plan, Shot, reference_gate
from hpe_rig.scene import DEFAULT_SPECIMEN, Scene, has_default_specimen

__all__ = ["Finding", "PlanError", "findings", "refuse_conflicts"]


def findings(scene: Scene, bench: BenchFile, plan: Plan) -> list[Finding]:
    """Return what every check found, passed ones included; of a sweep once each."""
    parts = [(window, _at(rate, plan)) for rate in scene.rates for window in rate.windows]
    return list(dict.fromkeys(found for check in _CHECKS for part in parts for found in check(part[0], bench, part[1])))


def _at(scene: Scene, plan: Plan) -> Plan:
    """Return the part of ``plan`` that has the scene's pulse rate."""
    rate_hz = scene.tracking.pulse_rate_hz
    return replace(plan, shots=tuple(shot for shot in plan.shots if shot.tracking_train.rate_hz == rate_hz))


def _us(time_s: float) -> str:
    return f"{time_s * 1e6:.4g} us"


def _interference(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    if scene.excitation is None or any(shot.toneburst is None for shot in plan.shots):
        return
    for shot in {shot.timeline.burst_length_s: shot for shot in plan.shots}.values():
        count, burst = int(disturbed_pulses(shot).sum()), _us(shot.timeline.burst_length_s)
        if not count:
            yield Finding("interference", "passed", f"no pulse or gate meets a {burst} toneburst or its echo")
            continue
        text = (
            f"tracking.delay_s = {_us(scene.tracking.delay_s)} lets tonebursts of excitation.burst_length_s = {burst} "
            f"or their echoes disturb {count} of {shot.capture.record_count} pulses or gates"
        )
        if scene.tracking.disturbed == "skip":
            yield Finding("interference", "passed", f"{text}; the estimate skips them")
            continue
        level: Level = "warning" if scene.tracking.disturbed == "keep" else "refused"
        yield Finding("interference", level, text, _delay_remedy(shot))


def _delay_remedy(shot: Shot) -> str:
    period_s, (start_s, end_s) = 1 / shot.tracking_train.rate_hz, forbidden_window_s(shot)
    intervals = admissible_delays_s(shot)
    if intervals:
        # Rounded inwards: every printed value is admissible.
        inner_us = [(math.ceil(low * 1e7) / 10, math.floor(high * 1e7) / 10) for low, high in intervals]
        words = " or ".join(f"{low:g} to {high:g} us" for low, high in inner_us)
        return f"tracking.delay_s within {words} (plus any multiple of the pulse period, {_us(period_s)})"
    needed_hz = 1 / (end_s - start_s)
    rate = f"a tracking.pulse_rate_hz that is a multiple of the burst rate and below {needed_hz:.4g} Hz"
    return f'{rate} (no t_d is free at {shot.tracking_train.rate_hz:g} Hz), or tracking.disturbed = "skip"'


def _record_in_period(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    capture, period_s = plan.shots[0].capture, 1 / scene.tracking.pulse_rate_hz
    busy_s = (capture.trigger_delay_samples + capture.record_samples) / capture.sample_rate_hz
    text = f"a record ends {_us(busy_s)} after its trigger, the pulse period is {_us(period_s)}"
    yield judged(
        "record in period",
        busy_s < period_s,
        text,
        f"acquisition.record_samples or tracking.pulse_rate_hz below {1 / busy_s:.4g} Hz",
    )


def _depth(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    acquisition = scene.acquisition
    far_m = acquisition.gate_depth_m + acquisition.gate_length_m / 2
    limit_hz = acquisition.sound_speed_m_per_s / (2 * far_m)
    text = (
        f"tracking.pulse_rate_hz = {scene.tracking.pulse_rate_hz:g} Hz, c/2z at the gate's far end is {limit_hz:.5g} Hz"
    )
    yield judged("depth", scene.tracking.pulse_rate_hz <= limit_hz, text, f"a pulse rate of at most {limit_hz:.5g} Hz")
    near_m = acquisition.gate_depth_m - acquisition.gate_length_m / 2
    text = f"the gate starts {near_m * 1e3:.4g} mm from the transducer"
    yield judged("gate depth", near_m > 0, text, "acquisition.gate_depth_m of more than half acquisition.gate_length_m")


def _aliasing(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    frequencies_hz = scene.wanted_frequencies_hz
    if not frequencies_hz:
        remedy = "processing.frequencies_hz (without [excitation] there is no f_r to take multiples of)"
        yield Finding("frequencies", "refused", "no vibration frequency is wanted", remedy)
        return
    highest_hz, rate_hz = max(frequencies_hz), scene.tracking.pulse_rate_hz
    text = f"highest of processing.frequencies_hz is {highest_hz:g} Hz, tracking.pulse_rate_hz = {rate_hz:g} Hz"
    yield judged(
        "aliasing",
        rate_hz > 2 * highest_hz,
        text,
        f"a pulse rate above {2 * highest_hz:g} Hz, or frequencies below {rate_hz / 2:g} Hz",
    )
    if scene.excitation is not None:
        alias = [f for f in frequencies_hz if not _whole(f / scene.excitation.burst_rate_hz)]
        text = f"processing.frequencies_hz against f_r = {scene.excitation.burst_rate_hz:g} Hz"
        if alias:
            text += f": {', '.join(f'{f:g}' for f in alias)} Hz is no multiple, nothing drives it"
            yield Finding("driven frequencies", "warning", text, "multiples of excitation.burst_rate_hz")


def _folding(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Tonebursts are short: they drive harmonics far above half the pulse rate, which fold onto the wanted ones."""
    if scene.excitation is None:
        return
    rate_hz, burst_rate_hz = scene.tracking.pulse_rate_hz, scene.excitation.burst_rate_hz
    bursts = int(plan.shots[0].capture.record_count / rate_hz * burst_rate_hz)
    effective_hz = effective_rate_hz(rate_hz, burst_rate_hz, bursts)
    driven_hz = 1 / max(scene.excitation.burst_length_s)
    text = f"tonebursts drive every multiple of {burst_rate_hz:g} Hz up to 1/T_b = {driven_hz:g} Hz, the pulses sample "
    text += f"the burst period at {effective_hz:g} Hz in all"
    if effective_hz > 1.5 * driven_hz:
        yield Finding("folding", "passed", text)
        return
    shifted_hz = rate_hz - burst_rate_hz / 10
    remedy = (
        f'tracking.pulse_rate_hz = {shifted_hz:g} with disturbed = "skip", so that the pulses shift from burst to burst'
    )
    text += ": higher harmonics fold onto the wanted ones and change amplitude and phase"
    yield Finding("folding", "warning", text, remedy)


def _resolution(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    frequencies_hz = sorted(scene.wanted_frequencies_hz)
    if not frequencies_hz:
        return
    processing, rate_hz = scene.processing, scene.tracking.pulse_rate_hz
    train_s = plan.shots[0].capture.record_count / rate_hz
    window_s = min(processing.window_length_s or math.inf, train_s - processing.window_start_s)
    text = f"processing window of {window_s * 1e3:.4g} ms in a tracking train of {train_s * 1e3:.4g} ms"
    wanted_s = processing.window_start_s + (processing.window_length_s or 0)
    if wanted_s > train_s or window_s <= 0:
        yield Finding(
            "window",
            "refused",
            text,
            f"window_start_s plus window_length_s within {train_s:g} s, or more tracking.pulse_count",
        )
        return
    gaps_hz = np.diff([0.0, *frequencies_hz])
    needed_s = 1 / float(gaps_hz.min()) if gaps_hz.min() > 0 else math.inf
    remedy = f"a window of at least {needed_s * 1e3:.4g} ms (tracking.pulse_count), or frequencies further apart"
    good = window_s >= needed_s * (1 - 1e-9) and window_s * rate_hz >= 2 * len(frequencies_hz) + 2
    text += f", the closest frequencies stand {gaps_hz.min():g} Hz apart"
    yield judged("resolution", good, text, remedy)


def _gate_in_record(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    shot = plan.shots[0]
    gate, samples = shot.gate, shot.capture.record_samples
    text = f"the gate takes samples {gate.start} to {gate.stop} of a record of {samples}"
    needed = gate.stop if gate.start >= 0 else gate.stop - gate.start + 2 * 16
    needed = 16 * math.ceil(needed / 16)
    remedy = f"acquisition.record_samples = {max(128, needed)} or more, or a shorter acquisition.gate_length_m"
    yield judged("gate in record", gate.start >= 0 and gate.stop <= samples, text, remedy)
    still = reference_gate(scene, shot)
    if still is not None:
        text = f"the reference gate takes samples {still.start} to {still.stop} of a record of {samples}"
        remedy = (
            "processing.reference_gate_depth_m closer to acquisition.gate_depth_m, or more acquisition.record_samples"
        )
        yield judged("reference gate in record", still.start >= 0 and still.stop <= samples, text, remedy)
    length = gate.stop - gate.start
    text = f"the gate holds {length} samples"
    yield judged("gate samples", length >= 8, text, "a longer acquisition.gate_length_m or a higher sample rate")


def _periods(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    longest_s = max(shot.train_end_s for shot in plan.shots)
    period_s = scene.acquisition.shot_period_s
    if period_s is not None:
        text = f"trains end {longest_s * 1e3:.4g} ms after the master trigger, "
        text += f"acquisition.shot_period_s = {period_s * 1e3:.4g} ms"
        yield judged(
            "master period", longest_s < period_s, text, f"a shot period above {longest_s:.4g} s, or shorter trains"
        )
    if scene.excitation is not None and scene.processing.synchronous:
        ratio = scene.tracking.pulse_rate_hz / scene.excitation.burst_rate_hz
        nearest = max(1, round(ratio)) * scene.excitation.burst_rate_hz
        text = f"the burst period holds {ratio:g} pulse periods, processing.synchronous = true wants a whole number"
        yield judged(
            "synchronous", _whole(ratio), text, f"tracking.pulse_rate_hz = {nearest:g}, or synchronous = false"
        )


def _excitation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    excitation, limits = scene.excitation, bench.limits
    if excitation is None:
        return
    if bench.generators.burst_train is None or bench.generators.toneburst is None:
        remedy = (
            "[generators.burst_train] and [generators.toneburst] in the bench file, or a scene without [excitation]"
        )
        yield Finding("excitation generators", "refused", "the bench has no generators for [excitation]", remedy)
    length_s, rate_hz = max(excitation.burst_length_s), excitation.burst_rate_hz
    duty = length_s * rate_hz
    text = f"duty f_r T_b = {duty:.3g}, limits.max_duty = {limits.max_duty:g}"
    yield judged(
        "duty", duty <= limits.max_duty, text, f"excitation.burst_length_s of at most {_us(limits.max_duty / rate_hz)}"
    )
    text = f"excitation.burst_length_s = {_us(length_s)}, limits.max_burst_length_s = {_us(limits.max_burst_length_s)}"
    yield judged(
        "burst length", length_s <= limits.max_burst_length_s, text, f"at most {_us(limits.max_burst_length_s)}"
    )
    text = f"excitation.burst_count = {excitation.burst_count}, limits.max_bursts = {limits.max_bursts}"
    yield judged("bursts", excitation.burst_count <= limits.max_bursts, text, f"at most {limits.max_bursts}")
    if excitation.burst_count == 1:
        yield Finding("harmonics", "warning", "one toneburst leaves a transient, no harmonics", "burst_count = 20")
    for burst_length_s in excitation.burst_length_s:
        cycles = burst_length_s * excitation.carrier_hz
        nearest_s = max(1, round(cycles)) / excitation.carrier_hz
        text = f"a toneburst of {_us(burst_length_s)} at {excitation.carrier_hz:g} Hz has {cycles:.6g} cycles"
        good = cycles >= 1 - 1e-9 and _whole(cycles)
        yield judged(
            "whole cycles", good, text, f"excitation.burst_length_s = {nearest_s:.9g}, a whole number of cycles"
        )


def _digitizer(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    yield from board(bench, plan, scene.tracking.carrier_hz)
    yield from capture_mode(bench, plan)
    yield from memory(bench, plan)


def _output(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    yield from generators(bench, plan)
    yield from drive(bench, plan)
    yield from acoustic_output(bench, plan)


def _tracking_train(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    count = plan.shots[0].capture.record_count
    if scene.excitation is None and scene.tracking.pulse_count is None:
        remedy = "tracking.pulse_count (without [excitation] there is no burst train to fill)"
        yield Finding("pulse count", "refused", "the number of tracking pulses is not given", remedy)
    elif count < 4:
        yield Finding(
            "pulse count",
            "refused",
            f"{count} tracking pulses cannot show a vibration",
            "tracking.pulse_count of 4 or more",
        )
    pulse_s, period_s = plan.shots[0].timeline.pulse_length_s, 1 / scene.tracking.pulse_rate_hz
    if pulse_s >= period_s:
        text = f"a tracking pulse of {_us(pulse_s)} does not fit the pulse period of {_us(period_s)}"
        yield Finding("pulse length", "refused", text, "fewer tracking.cycles or a lower tracking.pulse_rate_hz")


def _simulation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    if not bench.simulated:
        return
    if has_default_specimen(scene):
        text = f"{DEFAULT_SPECIMEN}, in focus at the gate: the scene has no [simulation]"
        yield Finding("simulated specimen", "passed", text)
    speed, assumed = (scene.simulation or {}).get("sound_speed_m_per_s"), scene.acquisition.sound_speed_m_per_s
    if isinstance(speed, int | float) and speed != assumed:
        text = f"simulation.sound_speed_m_per_s = {speed:g} m/s, "
        text += f"the gate assumes acquisition.sound_speed_m_per_s = {assumed:g} m/s"
        yield Finding("sound speed", "warning", text, "equal values, unless the mismatch is what is studied")


def _whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-6 * max(1.0, abs(number))


_CHECKS: tuple[Callable[[Scene, BenchFile, Plan], Iterator[Finding]], ...] = (
    _simulation,
    _excitation,
    _output,
    _interference,
    _tracking_train,
    _record_in_period,
    _depth,
    _aliasing,
    _folding,
    _resolution,
    _gate_in_record,
    _digitizer,
    _periods,
)
