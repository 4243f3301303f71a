"""Choice of the evaluation that meets a tolerance at the least run time, and of the scatterers it may leave out.

The run times are models fitted to measurements, docs/theory/echoes.md, section 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.echoes.combined import FEWEST_ECHOES
from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.nodes import CHECKED, MOST_NODES, edge_share, node_count
from sim_backend.echoes.pulse import Pulse
from sim_backend.echoes.series import MOST_ANGLE_RAD, largest_angle, terms_needed

Method = Literal["running_sum", "combined", "interpolated", "series"]

# Below this the series and the nodes promise what rounding does not let them keep.
FINEST_TOLERANCE = 1e-14
LEFT_OUT_SHARE = 0.1
"""Of the tolerance, for scatterers left out."""

_FEWEST_TO_SORT_OUT = 64
# Monomials of the motion's shapes; tables of more grow past 10 MB a gate.
_MOST_COLUMNS = 1000
# Delays that combining echoes holds at once: 0.5 GB.
_MOST_PAIRS = 1 << 26


@dataclass(frozen=True, slots=True)
class Choice:
    """An evaluation that meets the tolerance."""

    method: Method
    cost_s: float
    """Run time as measured, roughly, on one core."""
    terms: int = 0
    """Nodes, or orders of the series; 0 where it is exact."""


def choices(
    delays: EchoDelays,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    tolerance: float,
    method: Method | None,
) -> list[Choice]:
    """Return the evaluations that meet the tolerance, with their run times as measured, roughly, on one core."""
    if method == "running_sum":
        return [Choice(method, 0.0)]
    if tolerance < FINEST_TOLERANCE:
        return [Choice("running_sum", 0.0)] if method is None else refuse(method, "of its tolerance")
    samples, scatterers, frequencies = len(sample_time_s), len(weight), len(pulse.frequency_hz)
    echoes_wanted = delays.echo_count
    stretches = max(1, math.ceil(float(sample_time_s[-1] - sample_time_s[0]) / (pulse.end_s - pulse.start_s)))
    # Figures of run time: measured on one x86-64 core, `hpe-rig accuracy echo` shows how often they choose well.
    # A scatterer reaches at most two stretches of the gate, or three where it moves far.
    exact_s = min(stretches, 2) * (20e-9 + 30e-9 * frequencies) * scatterers + 57e-9 * frequencies * samples
    combining_s = 4e-10 * echoes_wanted * samples
    found = []
    if method is None:
        found.append(Choice("running_sum", 3e-4 * stretches + echoes_wanted * exact_s))
    # One shape is left to the series and the nodes, whose error does not rest on a sample of the echoes.
    usual = len(delays.shape) > 1 and echoes_wanted * scatterers <= _MOST_PAIRS
    if method == "combined" or (method is None and usual and echoes_wanted >= FEWEST_ECHOES):
        found.append(Choice("combined", 0.4 * echoes_wanted * exact_s))
    if method == "combined":
        return found
    spread_s = np.ptp(delays.amplitude_s, axis=0) / 2
    if method in (None, "interpolated") and len(delays.shape) == 1:
        largest_s = float(spread_s[0] * np.abs(delays.shape).max())
        share = edge_share(delays.rest_s, weight, pulse, largest_s, sample_time_s)
        nodes = node_count(pulse, largest_s, share, tolerance, delays.colour)
        if nodes < MOST_NODES:
            found.append(
                Choice("interpolated", 4e-4 * stretches + (nodes + CHECKED) * exact_s + nodes * combining_s, nodes)
            )
    angle = largest_angle(pulse, delays.shape, delays.about_middle().amplitude_s[None])
    orders = terms_needed(angle, tolerance)
    columns = math.comb(orders - 1 + len(delays.shape), orders - 1)
    if method in (None, "series") and angle <= MOST_ANGLE_RAD and columns <= _MOST_COLUMNS:
        period_s = float(sample_time_s[-1] - sample_time_s[0]) / max(1, samples - 1) or 1.0
        reach_s = spread_s @ np.abs(delays.shape)
        crossings = 4 * float(reach_s.sum()) / period_s
        each_s = 160e-9 + 10e-9 * columns * frequencies
        cost_s = 5e-4 * stretches + scatterers * each_s + 7e-10 * orders * crossings * echoes_wanted
        found.append(Choice("series", cost_s + columns * combining_s, orders))
    return found or refuse(method, "the motion has too many shapes or is too large for the tolerance")


def refuse(method: Method | None, reason: str) -> list[Choice]:
    """Raise ValueError that says why ``method`` cannot serve."""
    raise ValueError(f"method {method!r} cannot serve here because {reason}: leave the method out or take running_sum")


def in_reach(delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> Int64Array:
    """Return the scatterers whose echo can touch a sample."""
    early_s, late_s = delays.range_s()
    touches = (early_s + pulse.start_s <= sample_time_s[-1]) & (late_s + pulse.end_s >= sample_time_s[0])
    touches &= weight != 0
    return np.flatnonzero(touches)


def left_out_below(weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, tolerance: float) -> float:
    """Return the weight below which scatterers are left out: all of them together stay below the tolerance's share.

    No echo exceeds its scatterer's weight times the pulse's amplitudes, so N of them below w add less than N w. The rms
    they are held against is that of an incoherent sum; the caller checks it afterwards.
    """
    if len(weight) < _FEWEST_TO_SORT_OUT or tolerance <= 0:
        return 0.0
    largest = float(np.abs(pulse.amplitude).sum())
    return LEFT_OUT_SHARE * tolerance * incoherent_rms(weight, pulse, sample_time_s) / (largest * len(weight))


def incoherent_rms(weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> float:
    """Return the rms in the gate of echoes whose phases are independent; what cancels stays far below it."""
    power = float(np.square(np.abs(pulse.amplitude)).sum()) / 2
    pulse_s, gate_s = pulse.end_s - pulse.start_s, float(sample_time_s[-1] - sample_time_s[0])
    return math.sqrt(float(weight @ weight) * power * min(1.0, pulse_s / (pulse_s + gate_s)))
