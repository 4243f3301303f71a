"""Interference of tonebursts and their echoes with tracking pulses and gates, and the delays t_d without any."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from hpe_rig.arrays import BoolArray
from hpe_rig.plan.shots import Shot

SETTLING_S = 4.5e-6
"""How long the receiver is not quiet after a toneburst's echo from the gate: 3.2 us of echoes from the focus up to
2.5 mm behind it, and the filters' ringing down to a thousandth (twin, `hpe_rig.validation.paper.twin`)."""


def forbidden_window_s(shot: Shot) -> tuple[float, float]:
    """Return the start and end, relative to a toneburst's onset, between which no tracking pulse may be fired.

    A pulse is disturbed when it is fired into the toneburst, or when its gate or reference gate meets the toneburst or
    an echo of it from any depth down to the far end of both, or what follows it within ``SETTLING_S``.
    """
    gate_start_s, gate_end_s = shot.timeline.heard_offset_s
    quiet_s = shot.timeline.burst_length_s + gate_end_s + shot.timeline.push_later_s - gate_start_s + SETTLING_S
    return -(gate_end_s + shot.timeline.pulse_length_s), quiet_s


def disturbed_pulses(shot: Shot) -> BoolArray:
    """Return which tracking pulses a toneburst or its echo disturbs, shape (pulse,)."""
    pulses, bursts = shot.timeline.pulse_onset_s, shot.timeline.burst_onset_s
    if not bursts.size:
        return np.zeros(pulses.shape, np.bool_)
    start_s, end_s = forbidden_window_s(shot)
    latest = np.searchsorted(bursts, pulses - start_s, side="left") - 1
    return (latest >= 0) & (pulses < bursts[np.maximum(latest, 0)] + end_s)


def admissible_delays_s(shot: Shot) -> list[tuple[float, float]]:
    """Return the intervals of t_d, modulo the pulse period, in which no tracking pulse is disturbed."""
    period_s = 1 / shot.tracking_train.rate_hz
    start_s, end_s = forbidden_window_s(shot)
    if end_s - start_s >= period_s:
        return []
    offset_s = shot.timeline.pulse_onset_s[0] - shot.tracking_train.delay_s
    starts = np.sort(np.round((shot.timeline.burst_onset_s - offset_s + start_s) % period_s, 12))
    free, end = [], starts[0] + end_s - start_s
    for start in (*starts[1:], starts[0] + period_s):
        if start > end + 1e-9:
            free.append((float(end), float(start)))
        end = max(end, start + end_s - start_s)
    return [(low % period_s, low % period_s + high - low) for low, high in free]


def effective_rate_hz(pulse_rate_hz: float, burst_rate_hz: float, bursts: int) -> float:
    """Return the rate at which ``bursts`` burst periods together sample one period.

    It is the pulse rate where every period is sampled at the same instants, and more where the pulses shift from burst
    to burst: then harmonics up to half of it can be resolved.
    """
    shifts = Fraction(pulse_rate_hz / burst_rate_hz).limit_denominator(max(1, bursts))
    return float(shifts.numerator) * burst_rate_hz
