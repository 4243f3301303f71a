"""Checks of sampling in slow time: aliasing of the wanted frequencies and of higher harmonics, resolution and fit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, is_whole, pass_or_refuse
from hpe_rig.plan.interference import effective_rate_hz
from hpe_rig.plan.omitted import reason_without_prior
from hpe_rig.plan.selection import (
    MAX_CONDITION,
    Selection,
    burst_bandwidth_hz,
    driven_frequencies_hz,
    select,
    window_pulse_count,
)
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene, engineering

MAX_DRIVEN, MAX_VALUES = 5000, 50_000_000
"""Harmonics of a fit, and values of its matrix: 0.4 GB, and the fit needs about four copies."""
MAX_PULSES_FOR_CONDITION = 20_000
"""Pulses up to which the condition of a fit is computed; longer windows resolve all that a scene can ask for."""
ALIASING_MARGIN = 1.5
"""Ratio of effective sampling rate to toneburst bandwidth above which no strong harmonic aliases."""


def wanted_frequencies(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every wanted frequency is below half the pulse rate, and the tonebursts drive it."""
    frequencies_hz = scene.wanted_frequencies_hz
    if not frequencies_hz:
        remedy = "processing.frequencies_hz (without [excitation] there is no f_r to take multiples of)"
        yield CheckResult("frequencies", "refused", "no vibration frequency is wanted", remedy)
        return
    highest_hz, rate_hz = max(frequencies_hz), scene.tracking.pulse_rate_hz
    text = f"highest of processing.frequencies_hz is {highest_hz:g} Hz, tracking.pulse_rate_hz = {rate_hz:g} Hz"
    remedy = f"a pulse rate above {2 * highest_hz:g} Hz, or frequencies below {rate_hz / 2:g} Hz"
    yield pass_or_refuse("aliasing", rate_hz > 2 * highest_hz, text, remedy)
    if scene.excitation is None:
        return
    burst_rate_hz = scene.excitation.burst_rate_hz
    undriven = [f"{hz:g}" for hz in frequencies_hz if not is_whole(hz / burst_rate_hz)]
    if undriven:
        text = f"processing.frequencies_hz against f_r = {burst_rate_hz:g} Hz: "
        text += f"{', '.join(undriven)} Hz is no multiple, nothing drives it"
        yield CheckResult("driven frequencies", "warning", text, "multiples of excitation.burst_rate_hz")


def driven_harmonics(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the harmonics that tonebursts drive, up to 1/T_b of the shortest, alias onto the wanted ones.

    1/T_b is far above half the pulse rate. Pulses that shift from burst to burst sample the burst period at a higher
    effective rate.
    """
    if scene.excitation is None:
        return
    rate_hz, burst_rate_hz = scene.tracking.pulse_rate_hz, scene.excitation.burst_rate_hz
    bursts = int(plan.shots[0].capture.record_count / rate_hz * burst_rate_hz)
    effective_hz = effective_rate_hz(rate_hz, burst_rate_hz, bursts)
    driven_hz = burst_bandwidth_hz(scene.excitation)
    text = f"tonebursts drive every multiple of {burst_rate_hz:g} Hz up to 1/T_b = {driven_hz:g} Hz, the pulses sample "
    text += f"the burst period at {effective_hz:g} Hz in all"
    if effective_hz > ALIASING_MARGIN * driven_hz:
        yield CheckResult("aliasing harmonics", "passed", text)
        return
    text += ": higher harmonics alias onto the wanted ones"
    if scene.without_prior is None:
        text += (
            ". A prior of media separates them, and u holds on average over smooth media under a force as declared: "
        )
        text += f"a narrow resonance above {rate_hz / 2:g} Hz, an elastic medium or a force of half the width may "
        text += "cause larger errors without a warning"
    else:
        text += f", and u does not include their error ({scene.without_prior})"
    remedy = f'tracking.pulse_rate_hz = {rate_hz - burst_rate_hz / 10:g} with disturbed = "skip"'
    remedy += " and processing.synchronous = false" if scene.processing.synchronous else ""
    remedy += ", so that the pulses shift from burst to burst"
    yield CheckResult("aliasing harmonics", "warning", text, remedy)


def resolution(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the processing window is in the train, and long enough to resolve the frequencies."""
    frequencies_hz = sorted(scene.wanted_frequencies_hz)
    if not frequencies_hz:
        return
    processing, rate_hz = scene.processing, scene.tracking.pulse_rate_hz
    train_s = plan.shots[0].capture.record_count / rate_hz
    window_s = min(processing.window_length_s or math.inf, train_s - processing.window_start_s)
    text = f"processing window of {window_s * 1e3:.4g} ms in a tracking train of {train_s * 1e3:.4g} ms"
    if processing.window_start_s >= train_s:
        text = f"processing.window_start_s = {engineering(processing.window_start_s, 's')} lies after the end of the "
        text += f"tracking train ({engineering(train_s, 's')})"
        remedy = f"processing.window_start_s = 0, a start before {train_s:.4g} s, or more tracking.pulse_count"
        yield CheckResult("window", "refused", text, remedy)
        return
    window_end_s = processing.window_start_s + (processing.window_length_s or 0)
    if window_end_s > train_s:
        remedy = f"window_start_s plus window_length_s within {train_s:g} s, or more tracking.pulse_count"
        yield CheckResult("window", "refused", text, remedy)
        return
    # Frequencies are resolved by a window of one over the smallest distance, the distance to zero included.
    gaps_hz = np.diff([0.0, *frequencies_hz])
    needed_s = 1 / float(gaps_hz.min()) if gaps_hz.min() > 0 else math.inf
    good = window_s >= needed_s * (1 - 1e-9) and window_s * rate_hz >= 2 * len(frequencies_hz) + 2
    text += f", the closest frequencies are {gaps_hz.min():g} Hz apart"
    keys = _keys_of_window(scene, window_s, train_s, needed_s)
    remedy = f"a window of at least {needed_s * 1e3:.4g} ms ({keys}), or frequencies further apart"
    yield pass_or_refuse("resolution", good, text, remedy)


def _keys_of_window(scene: Scene, window_s: float, train_s: float, needed_s: float) -> str:
    """Return the keys that lengthen the processing window of ``window_s`` to ``needed_s``."""
    start_s = scene.processing.window_start_s
    if window_s < train_s - start_s:
        return "processing.window_length_s"
    bursts = scene.excitation is not None and scene.tracking.pulse_count is None
    train = "more excitation.burst_count" if bursts else "more tracking.pulse_count"
    if start_s > 0 and needed_s <= train_s:
        return f"processing.window_start_s of at most {(train_s - needed_s) * 1e3:.4g} ms, or {train}"
    return train


def fit_size(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield a conflict if the matrix of the fit (wanted and driven harmonics, background) exceeds the memory."""
    driven, pulses = driven_frequencies_hz(scene).size, window_pulse_count(scene)
    unknowns = min(2 * (len(scene.wanted_frequencies_hz) + driven) + scene.processing.background_order + 1, pulses)
    if driven > MAX_DRIVEN or unknowns * pulses > MAX_VALUES:
        text = f"tonebursts drive {driven} harmonics, and {unknowns} unknowns are fitted to {pulses} pulses: "
        text += f"memory holds {MAX_DRIVEN} harmonics, and {MAX_VALUES:.0e} values"
        remedy = "a shorter processing.window_length_s, fewer pulses, a higher burst rate or longer bursts"
        yield CheckResult("fit size", "refused", text, remedy)


def fit_condition(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield a conflict if the pulses in the window cannot separate the wanted frequencies and the background."""
    frequencies_hz, order = scene.wanted_frequencies_hz, scene.processing.background_order
    # With a prior of media the fit is determined by the prior too.
    if (
        not frequencies_hz
        or window_pulse_count(scene) > MAX_PULSES_FOR_CONDITION
        or reason_without_prior(scene) is None
    ):
        return
    selection = select(scene, plan.shots[0])
    used, unknowns = int(selection.used.sum()), 2 * len(frequencies_hz) + order + 1
    text = f"{len(frequencies_hz)} frequencies and processing.background_order = {order} are {unknowns} unknowns"
    remedy = "a lower background_order, a longer processing window, or fewer processing.frequencies_hz"
    if used <= unknowns:
        text += f", the processing window holds {used} usable pulses"
        yield CheckResult("fit", "refused", text, remedy)
    elif not (condition := _condition(selection, order)) <= MAX_CONDITION:
        text += f", which {used} pulses do not separate (condition {condition:.3g}, limit {MAX_CONDITION:g})"
        yield CheckResult("fit", "refused", text, remedy)


def _condition(selection: Selection, order: int) -> float:
    """Return the condition number of the fit's matrix with columns of unit length; inf if they are dependent."""
    time_s = selection.time_s
    # Columns: sine and cosine of each frequency, then Legendre polynomials up to the background's order.
    phase_rad = 2 * np.pi * np.outer(time_s - time_s[0], selection.wanted_hz)
    polynomials = np.ones((time_s.size, 1))
    if order:
        relative_time = (time_s - time_s[0]) * (2 / (time_s[-1] - time_s[0])) - 1
        polynomials = np.polynomial.legendre.legvander(relative_time, order)
    matrix = np.hstack([np.sin(phase_rad), np.cos(phase_rad), polynomials])[selection.used]
    singular = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0).clip(min=1e-300), compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf
