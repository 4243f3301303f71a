"""Emission of a 33250A: programmed registers and trigger edges -> voltage steps or sine bursts.

Assumed, no source found:
- Trig In is a 10 kohm TTL input that switches at 2.0 V;
- triggers are ignored until the burst of the previous one has ended;
- a change of a setting that affects the output cuts a running or pending burst.
Not modelled: ramps, triangles, noise and gated bursts (no output), phases, jitter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from sim_backend.arrays import Int64Array
from sim_backend.generator.registers import Registers
from sim_backend.wiring import (
    PS_PER_S,
    Bursts,
    Emission,
    Steps,
    accepted,
    crossings,
    joined_bursts,
    joined_steps,
    to_ps,
)

TRIGGER_LEVEL_V = 2.0
TRIGGER_INPUT_OHM = 10e3
MAX_STEPS = 20_000_000
FAR_PS = 1 << 61
WITHOUT_EFFECT = frozenset(
    {"unit", "load_ohm", "sync", "trigger_output", "trigger_output_slope", "range_auto", "angle_unit"}
    | {"display", "display_text", "beeper", "phase_deg", "pulse_hold"}
)
"""Registers that do not affect the output; the declared load changes displayed values alone."""

History = Sequence[tuple[int, Registers]]


def changes_output(before: Registers, after: Registers) -> bool:
    """Return whether the output differs between two states."""
    names = (item.name for item in fields(Registers) if item.name not in WITHOUT_EFFECT)
    return (before.output or after.output) and any(getattr(before, name) != getattr(after, name) for name in names)


def with_clock_error(registers: Registers, clock_error: float) -> Registers:
    """Return ``registers`` with the true frequency and times for a clock with a relative rate error."""
    if not clock_error:
        return registers
    rate = 1 + clock_error
    return replace(
        registers,
        frequency_hz=registers.frequency_hz * rate,
        width_s=registers.width_s / rate,
        burst_period_s=registers.burst_period_s / rate,
        delay_s=registers.delay_s / rate,
    )


def is_endless(registers: Registers) -> bool:
    """Return whether the output continues without further triggers."""
    if not registers.output:
        return False
    return not registers.burst or registers.trigger_source == "IMM" or math.isinf(registers.cycles)


def respond(history: History, software_ps: Sequence[int], arriving: Steps, latency_ps: int, until_ps: int) -> Emission:
    """Return the whole output of a generator, in open-circuit volts, over the history of its settings.

    ``history`` holds (time, registers), sorted by time; ``software_ps`` are triggers by command, ``arriving`` is the
    voltage at Trig In. An endless output is computed up to ``until_ps``.
    """
    # Each state lasts until the next one.
    following = [*((start_ps, _idle_v(registers)) for start_ps, registers in history[1:]), (FAR_PS, 0.0)]
    steps, bursts, ignored, idle_v = [], [], 0, 0.0
    for (start_ps, registers), (stop_ps, next_idle_v) in zip(history, following, strict=True):
        onset_ps, ignored_here = _onsets(registers, start_ps, stop_ps, software_ps, arriving, latency_ps, until_ps)
        ignored += ignored_here
        if _idle_v(registers) != idle_v:
            steps.append(_steps(np.array([start_ps]), idle_v, _idle_v(registers)))
        idle_v = _idle_v(registers)
        # An endless output is computed up to the horizon only.
        limit_ps = min(stop_ps, until_ps) if is_endless(registers) else stop_ps
        if onset_ps.size and registers.function == "SIN":
            bursts.append(_sines(registers, onset_ps, limit_ps))
        elif onset_ps.size and registers.function in ("PULS", "SQU"):
            train, cut = _pulses(registers, onset_ps, limit_ps, next_idle_v)
            steps.append(train)
            idle_v = next_idle_v if cut else idle_v
    return Emission(joined_steps(steps), joined_bursts(bursts), ignored)


def _onsets(
    registers: Registers,
    start_ps: int,
    stop_ps: int,
    software_ps: Sequence[int],
    arriving: Steps,
    latency_ps: int,
    until_ps: int,
) -> tuple[Int64Array, int]:
    """Return the burst onsets while ``registers`` are set, and the number of triggers ignored during bursts.

    The settings hold from ``start_ps`` to ``stop_ps``. Triggers come by command (``software_ps``), at Trig In
    (``arriving``) or from the internal timer.
    """
    if not registers.output or (registers.burst and registers.burst_mode == "GAT"):
        return np.empty(0, np.int64), 0
    if not registers.burst:
        return np.array([start_ps]), 0
    triggers = [np.array([time for time in software_ps if start_ps <= time < stop_ps], np.int64)]
    if registers.trigger_source == "EXT":
        edges = crossings(arriving, TRIGGER_LEVEL_V, registers.trigger_slope == "POS", TRIGGER_INPUT_OHM)
        triggers.append(edges[(edges >= start_ps) & (edges < stop_ps)])
    elif registers.trigger_source == "IMM":
        last_ps, period_ps = min(stop_ps, until_ps), to_ps(registers.burst_period_s)
        triggers.append(np.arange(start_ps, last_ps, period_ps, dtype=np.int64))
    trigger_ps = np.sort(np.concatenate(triggers))
    # The instrument is busy from the trigger to the end of the burst.
    busy_ps = min(FAR_PS, round(min(registers.delay_s + registers.burst_s, 1e6) * PS_PER_S))
    indices = accepted(trigger_ps, busy_ps)
    onset_ps = trigger_ps[indices] + latency_ps + to_ps(registers.delay_s)
    return onset_ps[onset_ps < stop_ps], trigger_ps.size - indices.size


def _idle_v(registers: Registers) -> float:
    """Return the output voltage between bursts."""
    if registers.output and registers.function == "DC":
        return registers.offset_v
    if not registers.output or registers.function not in ("PULS", "SQU"):
        return 0.0
    return registers.low_v if registers.polarity == "NORM" else registers.high_v


def _cycles(registers: Registers) -> float:
    """Return the cycles of a burst; infinite for a continuous output."""
    return registers.cycles if registers.burst else math.inf


def _sines(registers: Registers, onset_ps: Int64Array, stop_ps: int) -> Bursts:
    """Return the sine bursts with these onsets, cut at ``stop_ps``."""
    # A burst that the end of the segment cuts has a fraction of its cycles.
    cycles = _cycles(registers)
    full_ps = onset_ps + round(min(cycles / registers.frequency_hz, 1e6) * PS_PER_S)
    end_ps = np.minimum(full_ps, stop_ps)
    is_complete = math.isfinite(cycles) & (end_ps == full_ps)
    emitted = np.where(is_complete, cycles, (end_ps - onset_ps) / PS_PER_S * registers.frequency_hz)
    ones = np.ones(onset_ps.size)
    return Bursts(
        onset_ps=onset_ps,
        end_ps=end_ps,
        carrier_hz=registers.frequency_hz * ones,
        cycles=emitted,
        amplitude_vpp=registers.amplitude_v * ones,
    )


def _pulses(registers: Registers, onset_ps: Int64Array, stop_ps: int, after_cut_v: float) -> tuple[Steps, bool]:
    """Return the voltage steps of all pulses in bursts with these onsets, (burst,).

    The second value is whether ``stop_ps`` cuts a pulse, which then ends at ``after_cut_v``.
    """
    period_ps = PS_PER_S / registers.frequency_hz
    square_s = registers.duty_percent / 100 / registers.frequency_hz
    high_s = registers.width_s if registers.function == "PULS" else square_s
    counts = np.minimum(_cycles(registers), np.ceil((stop_ps - onset_ps) / period_ps)).astype(np.int64)
    if counts.sum() > MAX_STEPS:
        raise ValueError(
            f"the programmed output has {counts.sum()} pulses, more than the twin simulates ({MAX_STEPS}); "
            "program a finite burst or a lower frequency"
        )
    # Pulse times are rounded relative to the burst's onset, so that rounding does not accumulate.
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    rise_ps = np.repeat(onset_ps, counts) + np.rint(number * period_ps).astype(np.int64)
    rise_ps = rise_ps[rise_ps < stop_ps]
    fall_ps = rise_ps + to_ps(high_s)
    is_cut = fall_ps > stop_ps
    idle_v, active_v = registers.low_v, registers.high_v
    if registers.polarity != "NORM":
        idle_v, active_v = active_v, idle_v
    falls = Steps(np.minimum(fall_ps, stop_ps), np.full(fall_ps.size, active_v), np.where(is_cut, after_cut_v, idle_v))
    return joined_steps([_steps(rise_ps, idle_v, active_v), falls]), bool(is_cut.any())


def _steps(time_ps: Int64Array, before_v: float, after_v: float) -> Steps:
    return Steps(time_ps, np.full(time_ps.size, before_v), np.full(time_ps.size, after_v))
