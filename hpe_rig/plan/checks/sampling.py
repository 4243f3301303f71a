"""Checks of sampling in slow time: aliasing of the wanted frequencies and of higher harmonics, resolution and fit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, is_whole, judged
from hpe_rig.plan.interference import effective_rate_hz
from hpe_rig.plan.selection import (
    LARGEST_CONDITION,
    Selection,
    burst_bandwidth_hz,
    driven_frequencies_hz,
    select,
    window_pulse_count,
)
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene, properties_of

MOST_DRIVEN, MOST_VALUES = 5000, 50_000_000
"""Harmonics of a fit, and values of its matrix: 0.4 GB, of which the fit holds about four copies."""
MOST_JUDGED = 20_000
"""Pulses up to which the condition of a fit is looked at: a longer window tells all that a scene may ask for apart."""


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


def fit_size(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield why the matrix of the fit, wanted and driven harmonics and background, is larger than memory."""
    driven, pulses = driven_frequencies_hz(scene).size, window_pulse_count(scene)
    unknowns = min(2 * (len(scene.wanted_frequencies_hz) + driven) + scene.processing.background_order + 1, pulses)
    if driven > MOST_DRIVEN or unknowns * pulses > MOST_VALUES:
        text = f"tonebursts drive {driven} harmonics, and {unknowns} unknowns are fitted to {pulses} pulses: "
        text += f"memory holds {MOST_DRIVEN} harmonics, and {MOST_VALUES:.0e} values"
        remedy = "a shorter processing.window_length_s, fewer pulses, a higher burst rate or longer bursts"
        yield CheckResult("fit size", "refused", text, remedy)


def fit_condition(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield why the pulses in the window do not tell the wanted frequencies and the background apart.

    A prior of media stands for what the pulses do not tell; least squares and velocities need them to.
    """
    frequencies_hz, order = scene.wanted_frequencies_hz, scene.processing.background_order
    pulses = window_pulse_count(scene)
    if not frequencies_hz or pulses > MOST_JUDGED or _has_prior(scene):
        return
    chosen = select(scene, plan.shots[0])
    used, unknowns = int(chosen.used.sum()), 2 * len(frequencies_hz) + order + 1
    text = f"{len(frequencies_hz)} frequencies and processing.background_order = {order} are {unknowns} unknowns"
    remedy = "a lower background_order, a longer processing window, or fewer processing.frequencies_hz"
    if used <= unknowns:
        text += f", the processing window holds {used} pulses of use"
        yield CheckResult("fit", "refused", text, remedy)
    elif not (condition := _condition(chosen, order)) <= LARGEST_CONDITION:
        text += f", which {used} pulses do not tell apart (condition {condition:.3g}, limit {LARGEST_CONDITION:g})"
        yield CheckResult("fit", "refused", text, remedy)


def _has_prior(scene: Scene) -> bool:
    """Return whether a prior of media stands for the harmonics in the fit of displacements."""
    processing = scene.processing
    return not (
        properties_of(processing.estimator).velocity_chain
        or processing.harmonic == "least_squares"
        or processing.process_noise
        or scene.without_prior is not None
    )


def _condition(chosen: Selection, order: int) -> float:
    """Return the condition number of the fit's matrix, its columns scaled to unit length; inf where they depend."""
    time_s = chosen.time_s
    angle = 2 * np.pi * np.outer(time_s - time_s[0], chosen.wanted_hz)
    background = np.ones((time_s.size, 1))
    if order:
        scaled = (time_s - time_s[0]) * (2 / (time_s[-1] - time_s[0])) - 1
        background = np.polynomial.legendre.legvander(scaled, order)
    matrix = np.hstack([np.sin(angle), np.cos(angle), background])[chosen.used]
    values = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0).clip(min=1e-300), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0 else math.inf
