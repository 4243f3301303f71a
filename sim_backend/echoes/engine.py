"""Echoes of moving point scatterers, eq. (7) to (13): one equation, and the cheapest evaluation that meets a tolerance.

    r_k(t) = sum_n I_n p(t - tau_kn)

| evaluation   | for                                               | error                        | file          |
|--------------|---------------------------------------------------|------------------------------|---------------|
| running_sum  | any delays                                        | rounding                     | exact_sums.py |
| combined     | any delays of small motion and few freedoms       | held back echoes, else exact | combined.py   |
| interpolated | tau_kn = tau_n + b_k g_n, motion of many radians  | algebraic or geometric       | nodes.py      |
| series       | tau_kn = tau_n + sum_r b_kr g_rn, below 3 rad     | geometric, down to rounding  | series.py     |

``choice.py`` chooses; docs/theory/echoes.md says what each costs and where it is the cheapest.
Delays and sample times share one origin. Put it near the echo (the focus), not at the pulse's onset 90 us earlier:
then ``w t`` stays below some hundred radians and its rounding near 1e-14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.choice import (
    FINEST_TOLERANCE,
    LEFT_OUT_SHARE,
    Method,
    choices,
    in_reach,
    incoherent_rms,
    left_out_below,
)
from sim_backend.echoes.combined import combined
from sim_backend.echoes.delays import EchoDelays, refuse_aliasing, refuse_unusable
from sim_backend.echoes.exact_sums import blocks, local_origin_s, running_sum
from sim_backend.echoes.nodes import interpolated_within
from sim_backend.echoes.pulse import Pulse
from sim_backend.echoes.series import ScattererRows, series

DEFAULT_TOLERANCE = 1e-6
CANCELLED = 0.25
"""Share of what independent echoes add up to, below which scatterers cancel each other."""
_ECHOES_LOOKED_AT = 256
# Delays held at once: 64 MB.
_PAIRS_AT_ONCE = 1 << 23


@dataclass(frozen=True, slots=True)
class Synthesis:
    """Echoes and how they were made."""

    echo: FloatArray
    """(echo, sample)"""
    method: Method
    terms: int
    """Nodes, orders of the series, or exact echoes that the others combine; 0 where all are exact."""
    scatterers: int
    """How many were summed."""


def synthesise(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float = DEFAULT_TOLERANCE,
    method: Method | None = None,
) -> Synthesis:
    """Return the echoes, float64 (echo, sample), their rms error within ``tolerance`` of their rms.

    ``weight`` (scatterer,) any sign; ``sample_time_s`` (sample,) ascending, same origin as the delays. ``method``
    absent: the cheapest that meets the tolerance, at 0 an exact one. Raises ValueError for what is not finite or fits
    nothing else (by name), sample times that do not ascend or lie too wide apart for the pulse, and a method that
    cannot serve.
    """
    weight, sample_time_s = np.asarray(weight), np.asarray(sample_time_s, dtype=np.float64)
    refuse_unusable(delays, weight, sample_time_s, tolerance)
    refuse_aliasing(pulse, sample_time_s)
    if method is not None and method not in get_args(Method):
        raise ValueError(f"method {method!r} is unknown: take one of {', '.join(get_args(Method))}")
    return _synthesise(delays, weight, pulse, sample_time_s, tolerance, method)


def _synthesise(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> Synthesis:
    echoes_wanted = delays.echo_count
    if min(echoes_wanted, len(weight), len(sample_time_s)) == 0:
        return Synthesis(np.zeros((echoes_wanted, len(sample_time_s))), method or "running_sum", 0, 0)
    # First those that can be heard in the gate, then of these those that can matter to the tolerance.
    near = in_reach(delays, weight, pulse, sample_time_s)
    limit = left_out_below(weight[near], pulse, sample_time_s, tolerance)
    strong = near[np.abs(weight[near]) > limit]
    made = _evaluate(delays, weight, strong, pulse, sample_time_s, tolerance, method)
    made = _within_what_is_left(made, delays, weight, strong, pulse, sample_time_s, tolerance, method)
    if len(strong) < len(near):
        rms = _rms(made.echo)
        left_out = float(np.abs(weight[near]).sum() - np.abs(weight[strong]).sum()) * float(
            np.abs(pulse.amplitude).sum()
        )
        # The rms was estimated too high (scatterers that cancel each other): the bound does not hold, so take them all.
        if left_out > 2 * LEFT_OUT_SHARE * tolerance * rms:
            made = _evaluate(delays, weight, near, pulse, sample_time_s, tolerance, method)
            return _within_what_is_left(made, delays, weight, near, pulse, sample_time_s, tolerance, method)
    return made


def _within_what_is_left(
    made: Synthesis,
    delays: EchoDelays,
    weight: FloatArray,
    part: Int64Array,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> Synthesis:
    """Return the echoes to ``tolerance`` of their own rms also where scatterers nearly cancel each other.

    The series errs in proportion to what each scatterer adds; where their sum is far less, it is made anew so much
    finer, and exactly where it cannot be. Every other evaluation is exact or has been checked.
    """
    expected, share = incoherent_rms(weight[part], pulse, sample_time_s), 1.0
    some = slice(None, None, max(1, delays.echo_count // _ECHOES_LOOKED_AT))
    finer = tolerance
    # The first sum may be all error and so too large: until it no longer falls.
    while made.method == "series" and _rms(made.echo[some]) < CANCELLED * share * expected:
        share, before = _rms(made.echo[some]) / expected, finer
        finer = tolerance * share if method is None else max(tolerance * share, FINEST_TOLERANCE)
        if finer == before:
            break
        made = _evaluate(delays, weight, part, pulse, sample_time_s, finer, method)
    return made


def _rms(echo: FloatArray) -> float:
    return math.sqrt(float(np.vdot(echo, echo)) / echo.size)


def _evaluate(
    delays: EchoDelays,
    weight: FloatArray,
    part: Int64Array,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> Synthesis:
    if len(part) < len(weight):
        delays = delays.of(part)
        weight = weight[part]
    if len(weight) == 0:
        echoes_wanted = delays.echo_count
        return Synthesis(np.zeros((echoes_wanted, len(sample_time_s))), method or "running_sum", 0, 0)
    able = choices(delays, weight, pulse, sample_time_s, tolerance, method)
    choice = min(able, key=lambda one: one.cost_s)
    echo: FloatArray | None = None
    terms = choice.terms
    match choice.method:
        case "series":
            echo = _series_by_blocks(delays, weight, pulse, sample_time_s, tolerance)
        case "interpolated":
            echo = interpolated_within(delays, weight, pulse, sample_time_s, terms, tolerance)
        case "combined":
            made = combined(delays.delay_s(), weight, pulse, sample_time_s, tolerance, delays.colour)
            echo, terms = (None, 0) if made is None else made
    if echo is not None:
        return Synthesis(echo, choice.method, terms, len(weight))
    # Chosen, or what another evaluation falls back on that found its own error too large.
    parts = delays.parts(_PAIRS_AT_ONCE)
    exact = np.concatenate([running_sum(delay_s, weight, pulse, sample_time_s, delays.colour) for delay_s in parts])
    return Synthesis(exact, "running_sum", 0, len(weight))


def _series_by_blocks(
    delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, tolerance: float
) -> FloatArray:
    """Return the echoes, block by block of samples: each with the scatterers that can reach it, its origin near it."""
    delays = delays.about_middle()
    if (delays.rest_s[1:] < delays.rest_s[:-1]).any():
        order = np.argsort(delays.rest_s, kind="stable")
        delays, weight = delays.of(order), weight[order]
    reach_s = float(np.abs(delays.amplitude_s).max(axis=0) @ np.abs(delays.shape).max(axis=1))
    out: FloatArray = np.empty((1, delays.echo_count, len(sample_time_s)))
    for block in blocks(sample_time_s, pulse):
        origin_s = local_origin_s(sample_time_s[block], pulse)
        time_s = sample_time_s[block]
        begin, end = np.searchsorted(
            delays.rest_s, [time_s[0] - pulse.end_s - reach_s, time_s[-1] - pulse.start_s + reach_s]
        )
        # One beyond on each side: the sums above are rounded.
        near = slice(max(0, int(begin) - 1), int(end) + 1)
        row = np.zeros(len(delays.rest_s[near]), dtype=np.int64)
        colour = None if delays.colour is None else delays.colour[:, near]
        rest_s, amplitude_s = delays.rest_s[near] - origin_s, delays.amplitude_s[None]
        scene = ScattererRows(row, rest_s, weight[near], delays.shape[:, near], amplitude_s, colour)
        series(scene, pulse, time_s - origin_s, tolerance, out[:, :, block])
    echo: FloatArray = out[0]
    return echo


def echoes(
    depth_delay_s: FloatArray,
    weight: FloatArray,
    motion_weight: FloatArray,
    displacement_m: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    sound_speed_m_per_s: float,
    tolerance: float = DEFAULT_TOLERANCE,
    shift_s: FloatArray | None = None,
    colour: ComplexArray | None = None,
) -> FloatArray:
    """Return the echoes of proportionally moving scatterers, float64 (echo, sample), eq. (7) to (13).

    ``depth_delay_s``, ``weight``, ``motion_weight`` (scatterer,); ``displacement_m`` (echo,) at the focus;
    ``sample_time_s`` (sample,) ascending, same origin as the delays; ``shift_s`` (echo,) added to the sample times of
    each echo. A motion of several shapes has ``motion_weight`` (shape, scatterer) and ``displacement_m``
    (echo, shape). ``colour`` as in `EchoDelays`, ``tolerance`` as in `synthesise`. Inputs are trusted, also to alias:
    a digitizer may.
    """
    shape = np.atleast_2d(motion_weight)
    amplitude_s = displacement_m.reshape(len(displacement_m), len(shape)) * (2 / sound_speed_m_per_s)
    # A pulse that comes late sees everything earlier: one more shape, of ones.
    if shift_s is not None and shift_s.any():
        shape = np.concatenate([shape, np.ones((1, shape.shape[1]))])
        amplitude_s = np.concatenate([amplitude_s, -shift_s[:, None]], axis=1)
    return _synthesise(
        EchoDelays(depth_delay_s, shape, amplitude_s, colour), weight, pulse, sample_time_s, tolerance, None
    ).echo
