"""Checks of sampling in slow time: aliasing of the wanted frequencies and of higher harmonics, window, resolution."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, is_whole, judged
from hpe_rig.plan.interference import effective_rate_hz
from hpe_rig.plan.selection import burst_bandwidth_hz, driven_frequencies_hz
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene

MOST_DRIVEN, MOST_VALUES = 5000, 100_000_000
"""Harmonics of a fit, and values of its matrix: 1 GB."""


def wanted_frequencies(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every wanted frequency lies below half the pulse rate, and something drives it."""
    frequencies_hz = scene.wanted_frequencies_hz
    if not frequencies_hz:
        remedy = "processing.frequencies_hz (without [excitation] there is no f_r to take multiples of)"
        yield CheckResult("frequencies", "refused", "no vibration frequency is wanted", remedy)
        return
    highest_hz, rate_hz = max(frequencies_hz), scene.tracking.pulse_rate_hz
    text = f"highest of processing.frequencies_hz is {highest_hz:g} Hz, tracking.pulse_rate_hz = {rate_hz:g} Hz"
    remedy = f"a pulse rate above {2 * highest_hz:g} Hz, or frequencies below {rate_hz / 2:g} Hz"
    yield judged("aliasing", rate_hz > 2 * highest_hz, text, remedy)
    if scene.excitation is not None:
        alias = [f for f in frequencies_hz if not is_whole(f / scene.excitation.burst_rate_hz)]
        text = f"processing.frequencies_hz against f_r = {scene.excitation.burst_rate_hz:g} Hz"
        if alias:
            text += f": {', '.join(f'{f:g}' for f in alias)} Hz is no multiple, nothing drives it"
            yield CheckResult("driven frequencies", "warning", text, "multiples of excitation.burst_rate_hz")


def driven_harmonics(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the harmonics that tonebursts drive, up to 1/T_b of the shortest, alias onto the wanted.

    Tonebursts are short, so that 1/T_b lies far above half the pulse rate. Pulses that shift from burst to burst sample
    the burst period at a higher effective rate.
    """
    if scene.excitation is None:
        return
    rate_hz, burst_rate_hz = scene.tracking.pulse_rate_hz, scene.excitation.burst_rate_hz
    bursts = int(plan.shots[0].capture.record_count / rate_hz * burst_rate_hz)
    effective_hz = effective_rate_hz(rate_hz, burst_rate_hz, bursts)
    driven_hz = burst_bandwidth_hz(scene.excitation)
    columns, pulses = driven_frequencies_hz(scene).size, plan.shots[0].capture.record_count
    if columns > MOST_DRIVEN or columns * pulses > MOST_VALUES:
        text = f"tonebursts drive {columns} harmonics of excitation.burst_rate_hz = {burst_rate_hz:g} Hz, each "
        text += f"fitted to {pulses} pulses: memory holds {MOST_DRIVEN} of them, and {MOST_VALUES:.0e} values"
        yield CheckResult("driven harmonics", "refused", text, "a higher burst rate, longer bursts or fewer pulses")
        return
    text = f"tonebursts drive every multiple of {burst_rate_hz:g} Hz up to 1/T_b = {driven_hz:g} Hz, the pulses sample "
    text += f"the burst period at {effective_hz:g} Hz in all"
    if effective_hz > 1.5 * driven_hz:
        yield CheckResult("aliasing harmonics", "passed", text)
        return
    remedy = f'tracking.pulse_rate_hz = {rate_hz - burst_rate_hz / 10:g} with disturbed = "skip", '
    remedy += "so that the pulses shift from burst to burst"
    text += ": higher harmonics alias onto the wanted ones; least squares take them for these, a prior of media tells "
    text += "them apart as well as media in general allow, and u covers the rest"
    yield CheckResult("aliasing harmonics", "warning", text, remedy)


def resolution(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the processing window is in the train, and long enough to tell the frequencies apart."""
    frequencies_hz = sorted(scene.wanted_frequencies_hz)
    if not frequencies_hz:
        return
    processing, rate_hz = scene.processing, scene.tracking.pulse_rate_hz
    train_s = plan.shots[0].capture.record_count / rate_hz
    window_s = min(processing.window_length_s or math.inf, train_s - processing.window_start_s)
    text = f"processing window of {window_s * 1e3:.4g} ms in a tracking train of {train_s * 1e3:.4g} ms"
    wanted_s = processing.window_start_s + (processing.window_length_s or 0)
    if wanted_s > train_s or window_s <= 0:
        remedy = f"window_start_s plus window_length_s within {train_s:g} s, or more tracking.pulse_count"
        yield CheckResult("window", "refused", text, remedy)
        return
    gaps_hz = np.diff([0.0, *frequencies_hz])
    needed_s = 1 / float(gaps_hz.min()) if gaps_hz.min() > 0 else math.inf
    remedy = f"a window of at least {needed_s * 1e3:.4g} ms (tracking.pulse_count), or frequencies further apart"
    good = window_s >= needed_s * (1 - 1e-9) and window_s * rate_hz >= 2 * len(frequencies_hz) + 2
    text += f", the closest frequencies stand {gaps_hz.min():g} Hz apart"
    yield judged("resolution", good, text, remedy)
