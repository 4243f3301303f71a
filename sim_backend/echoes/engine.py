"""Echoes of moving point scatterers, eq. (7) to (13) of the paper, by the faster evaluation that meets a tolerance.

    r_k(t) = sum_n I_n p(t - tau_kn)        tau_kn = tau_n + sum_r b_kr g_rn

    r_k(t)    echo k at sample time t
    I_n       weight of scatterer n
    p(t)      echo of one scatterer of weight 1 (pulse.py)
    tau_kn    delay, s (delays.py)

| evaluation   | for                              | error                          | module        |
|--------------|----------------------------------|--------------------------------|---------------|
| running_sum  | any delays                       | rounding                       | exact_sums.py |
| series       | few shapes, phases below 3 rad   | geometric, down to rounding    | series.py     |

``choice.py`` estimates both run times; docs/explanation/echoes.md gives measured ones.
Delays and sample times have one origin. Put it near the echo (the focus), not at the pulse's onset 90 us earlier:
then ``w t`` stays below some hundred radians and its rounding near 1e-14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.echoes.choice import (
    FINEST_TOLERANCE,
    OMITTED_FRACTION,
    Method,
    incoherent_rms,
    method_times_s,
    negligible_weight,
    reachable_scatterers,
)
from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.exact_sums import blocks, local_origin_s, running_sum
from sim_backend.echoes.pulse import Pulse
from sim_backend.echoes.series import ScattererRows, series, series_terms, shape_angles_rad

DEFAULT_TOLERANCE = 1e-6
CANCELLATION = 0.25
"""Fraction of the incoherent rms below which scatterers count as cancelling each other."""

# The rms is estimated from so many echoes.
_ECHOES_FOR_RMS = 256
# Delays in memory at once, 64 MB.
_PAIRS_PER_CHUNK = 1 << 23


@dataclass(frozen=True, slots=True)
class Synthesis:
    """Echoes and the evaluation that made them."""

    echo: FloatArray
    """(echo, sample)"""
    method: Method
    terms: int
    """Terms of the series; 0 of an exact sum."""
    scatterers: int
    """Number of scatterers in the sum."""


def synthesise(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float = DEFAULT_TOLERANCE,
    method: Method | None = None,
) -> Synthesis:
    """Return the echoes, float64 (echo, sample), and their evaluation; an echo is a sum over all scatterers.

    Each scatterer adds a delayed and weighted pulse. The rms error is at most ``tolerance`` times the rms of the
    echoes. ``weight`` (scatterer,), any sign. ``sample_time_s`` (sample,), ascending, counted from the same instant as
    the delays; samples may be too far apart for the pulse, since a digitizer may alias. Scatterers are left out if
    their echoes miss the gate or are too weak together. Without ``method`` the faster evaluation is used, at tolerance
    0 the exact one. Raises ValueError for a method that cannot meet the tolerance.
    """
    if min(delays.echo_count, len(weight), len(sample_time_s)) == 0:
        return Synthesis(np.zeros((delays.echo_count, len(sample_time_s))), method or "running_sum", 0, 0)
    # Leave out scatterers that cannot reach the gate, then those too weak to matter to the tolerance.
    reachable = reachable_scatterers(delays, weight, pulse, sample_time_s)
    limit = negligible_weight(weight[reachable], pulse, sample_time_s, tolerance)
    strong = reachable[np.abs(weight[reachable]) > limit]
    synthesis = _to_tolerance(delays.selected(strong), weight[strong], pulse, sample_time_s, tolerance, method)
    if len(strong) < len(reachable):
        weight_sum = float(np.abs(weight[reachable]).sum() - np.abs(weight[strong]).sum())
        omitted = weight_sum * float(np.abs(pulse.amplitude).sum())
        # If scatterers cancel each other, the estimated rms was too high and the bound fails: include all.
        if omitted > 2 * OMITTED_FRACTION * tolerance * _rms(synthesis.echo):
            return _to_tolerance(delays.selected(reachable), weight[reachable], pulse, sample_time_s, tolerance, method)
    return synthesis


def _to_tolerance(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> Synthesis:
    """Return the echoes to ``tolerance`` of their rms, also where scatterers nearly cancel each other.

    The error of the power series is relative to the rms of a sum with random phases. If the actual rms is far smaller,
    the series is evaluated again with a tolerance that is finer by the ratio of the two. Without ``method``,
    `_evaluate` takes the exact sums where that tolerance is below rounding.
    """
    synthesis = _evaluate(delays, weight, pulse, sample_time_s, tolerance, method)
    if synthesis.method != "series":
        return synthesis
    random_phase_rms = incoherent_rms(weight, pulse, sample_time_s)
    rms_ratio, series_tolerance = 1.0, tolerance
    step = max(1, delays.echo_count // _ECHOES_FOR_RMS)
    # The first sum may be all error and thus too large: repeat until the rms stops falling.
    while synthesis.method == "series" and _rms(synthesis.echo[::step]) < CANCELLATION * rms_ratio * random_phase_rms:
        rms_ratio = _rms(synthesis.echo[::step]) / random_phase_rms
        previous_tolerance, series_tolerance = series_tolerance, tolerance * rms_ratio
        if method is not None:
            series_tolerance = max(series_tolerance, FINEST_TOLERANCE)
        if series_tolerance == previous_tolerance:
            break
        synthesis = _evaluate(delays, weight, pulse, sample_time_s, series_tolerance, method)
    return synthesis


def _rms(echo: FloatArray) -> float:
    return math.sqrt(float(np.vdot(echo, echo)) / echo.size)


def _evaluate(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> Synthesis:
    """Return the echoes by ``method``: by the power series, or exactly by running sums.

    Without a method the faster one that meets the tolerance is used.
    """
    if len(weight) == 0:
        no_echo = np.zeros((delays.echo_count, len(sample_time_s)))
        return Synthesis(no_echo, method or "running_sum", terms=0, scatterers=0)
    if method != "running_sum" and _usable_method(delays, pulse, sample_time_s, tolerance, method) == "series":
        centred = delays.centred()
        terms = series_terms(shape_angles_rad(pulse, delays.shape, centred.amplitude_s), tolerance) or ()
        echo = _series_by_blocks(centred, weight, pulse, sample_time_s, tolerance)
        return Synthesis(echo, "series", terms=len(terms), scatterers=len(weight))
    # The delays of some echoes at a time, so that they fit into memory.
    chunks = delays.chunks(_PAIRS_PER_CHUNK)
    exact = [running_sum(delay_s, weight, pulse, sample_time_s, delays.response) for delay_s in chunks]
    return Synthesis(np.concatenate(exact), "running_sum", terms=0, scatterers=len(weight))


def _usable_method(
    delays: EchoDelays, pulse: Pulse, sample_time_s: FloatArray, tolerance: float, method: Method | None
) -> Method:
    """Return ``method``, or the faster method that meets the tolerance if it is None.

    Raises ValueError if ``method`` cannot meet the tolerance.
    """
    times_s = method_times_s(delays, pulse, sample_time_s, tolerance)
    if method is None:
        return min(times_s, key=times_s.__getitem__)
    if method not in times_s:
        raise ValueError(
            f"method {method!r} cannot serve because the motion has too many shapes or is too large for the tolerance: "
            "leave the method out or take running_sum"
        )
    return method


def _series_by_blocks(
    delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, tolerance: float
) -> FloatArray:
    """Return the echoes (echo, sample) by a power series in the displacements, one block of samples after another.

    A block is at most as long as the pulse, the longest time that `series` accepts. ``delays`` and ``weight`` are those
    of all scatterers; each block sums only the scatterers with an echo that can overlap it.
    """
    # `series` needs ascending delays.
    if (delays.rest_s[1:] < delays.rest_s[:-1]).any():
        order = np.argsort(delays.rest_s, kind="stable")
        delays, weight = delays.selected(order), weight[order]
    max_change_s = delays.max_change_s()
    # `series` can compute several independent sets of scatterers, "rows"; here all are in row 0.
    out: FloatArray = np.empty((1, delays.echo_count, len(sample_time_s)))
    for block in blocks(sample_time_s, pulse):
        time_s = sample_time_s[block]
        # Far from the origin of time the phases of the exponentials lose digits, so each block has an origin near it.
        origin_s = local_origin_s(time_s, pulse)
        # Delays at rest of scatterers with echoes in the block; one more on either side because the limits are rounded.
        min_s, max_s = time_s[0] - pulse.end_s - max_change_s, time_s[-1] - pulse.start_s + max_change_s
        first, end = np.searchsorted(delays.rest_s, [min_s, max_s])
        reaching = slice(max(0, int(first) - 1), int(end) + 1)
        near = delays.selected(reaching)
        scatterer_rows = ScattererRows(
            row=np.zeros(len(near.rest_s), dtype=np.int64),
            rest_s=near.rest_s - origin_s,
            weight=weight[reaching],
            shape=near.shape,
            # Change of delay, s, where a spatial shape of the motion is 1: (row, echo, shape).
            amplitude_s=near.amplitude_s[None],
            response=near.response,
        )
        series(scatterer_rows, pulse, time_s - origin_s, tolerance, out[:, :, block])
    return np.asarray(out[0])
