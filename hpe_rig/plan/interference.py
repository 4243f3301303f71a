"""Interference of tonebursts and their echoes with tracking pulses and gates, and the delays t_d without any."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from hpe_rig.arrays import BoolArray, Int64Array
from hpe_rig.plan.shots import Shot

SETTLING_S = 4.5e-6
"""Time after a toneburst's echo from the gate until the receiver is quiet: 3.2 us of echoes from the focus up to
2.5 mm behind it, and the filters' ringing down to a thousandth (twin, scripts/validation/paper/twin.py)."""
MIN_FREE_S = 1e-9
"""Shortest interval of admissible delays that is reported."""
CLEAN, NEAR, INSIDE = 0, 1, 2
"""Kinds of pulses: undisturbed, within the reach of a toneburst's echoes, and with a toneburst during the record."""
MIN_OVERLAP = 0.2
"""Fraction of a record, or of a shorter toneburst, above which the toneburst certainly disturbs the record."""


def forbidden_window_s(shot: Shot) -> tuple[float, float]:
    """Return start and end, relative to a toneburst's onset, of the window without tracking pulses.

    A pulse is disturbed if it is fired during the toneburst, or if its gate or reference gate receives the toneburst
    or an echo of it: from any depth down to the far end of both, and during ``SETTLING_S`` after that.
    """
    gate_start_s, gate_end_s = shot.timeline.listening_offset_s
    quiet_s = shot.timeline.burst_length_s + gate_end_s + shot.timeline.push_delay_s - gate_start_s + SETTLING_S
    return -(gate_end_s + shot.timeline.pulse_length_s), quiet_s


def disturbed_pulses(shot: Shot) -> BoolArray:
    """Return which tracking pulses (pulse,) a toneburst or its echo disturbs."""
    pulses_s, bursts_s = shot.timeline.pulse_onset_s, shot.timeline.burst_onset_s
    if not bursts_s.size:
        return np.zeros(pulses_s.shape, np.bool_)
    start_s, end_s = forbidden_window_s(shot)
    # The last burst before each pulse decides, because all windows are equally long.
    latest = np.searchsorted(bursts_s, pulses_s - start_s, side="left") - 1
    return (latest >= 0) & (pulses_s < bursts_s[np.maximum(latest, 0)] + end_s)


def follow_tonebursts(shot: Shot, pulses: BoolArray) -> bool:
    """Return whether ``pulses`` (pulse,), two or more, all come directly after the echoes of a toneburst.

    Directly means within one burst length: echoes of a toneburst that is longer than planned reach these pulses first.
    """
    line = shot.timeline
    if pulses.sum() < 2 or not line.burst_onset_s.size:
        return False
    onset_s = line.pulse_onset_s[pulses]
    latest = np.searchsorted(line.burst_onset_s, onset_s, side="right") - 1
    after_s = onset_s - line.burst_onset_s[latest.clip(min=0)] - forbidden_window_s(shot)[1]
    return bool(np.all((latest >= 0) & (after_s >= -MIN_FREE_S) & (after_s < line.burst_length_s)))


def precede_tonebursts(shot: Shot, pulses: BoolArray) -> bool:
    """Return whether ``pulses`` (pulse,), two or more, all come directly before a toneburst.

    Directly means within one burst length: a toneburst that is earlier than planned reaches their records first.
    """
    line = shot.timeline
    if pulses.sum() < 2 or not line.burst_onset_s.size:
        return False
    onset_s = line.pulse_onset_s[pulses]
    following = np.searchsorted(line.burst_onset_s, onset_s, side="right")
    next_onset_s = np.append(line.burst_onset_s, np.inf)[following]
    before_s = next_onset_s - onset_s + forbidden_window_s(shot)[0]
    return bool(np.all((before_s >= -MIN_FREE_S) & (before_s < line.burst_length_s)))


def pulse_kinds(shot: Shot) -> Int64Array:
    """Return how tonebursts disturb the record of each pulse, int64 (pulse,): ``CLEAN``, ``NEAR`` or ``INSIDE``.

    NEAR: the record starts before the echoes of the last toneburst have ended. INSIDE: it overlaps with the toneburst
    itself.
    """
    line, kinds = shot.timeline, np.full(shot.timeline.pulse_onset_s.size, CLEAN)
    if not line.burst_onset_s.size:
        return kinds
    # Start and end of each pulse's record, and the onset of the latest toneburst before its end, infinite without one.
    start_s, end_s = (line.pulse_onset_s + offset_s for offset_s in line.record_offset_s)
    latest = np.searchsorted(line.burst_onset_s, end_s + line.pulse_length_s) - 1
    onset_s = np.where(latest >= 0, line.burst_onset_s[np.maximum(latest, 0)], np.inf)
    reach_s = line.burst_length_s + line.record_offset_s[1] + line.push_delay_s + SETTLING_S
    kinds[start_s < onset_s + reach_s] = NEAR
    overlap_s = np.minimum(end_s, onset_s + line.burst_length_s) - np.maximum(start_s, onset_s)
    record_s = line.record_offset_s[1] - line.record_offset_s[0]
    kinds[overlap_s > MIN_OVERLAP * min(record_s, line.burst_length_s)] = INSIDE
    return kinds


def admissible_delays_s(shot: Shot) -> list[tuple[float, float]]:
    """Return the intervals of t_d, modulo the pulse period, without disturbed tracking pulses."""
    period_s = 1 / shot.tracking_train.rate_hz
    start_s, end_s = forbidden_window_s(shot)
    if end_s - start_s >= period_s:
        return []
    # Starts of the forbidden windows on the circle of one pulse period, as values of t_d.
    offset_s = shot.timeline.pulse_onset_s[0] - shot.tracking_train.delay_s
    starts = np.sort(np.round((shot.timeline.burst_onset_s - offset_s + start_s) % period_s, 12))
    free, end = [], starts[0] + end_s - start_s
    # Gaps between the union of the windows and the next start; the first window closes the circle.
    for start in (*starts[1:], starts[0] + period_s):
        if start > end + MIN_FREE_S:
            free.append((float(end), float(start)))
        end = max(end, start + end_s - start_s)
    return [(low % period_s, low % period_s + high - low) for low, high in free]


def effective_rate_hz(pulse_rate_hz: float, burst_rate_hz: float, bursts: int) -> float:
    """Return the sampling rate of one burst period by the pulses of ``bursts`` periods together.

    It equals the pulse rate if every period is sampled at the same times. If the pulses shift from burst to burst, it
    is higher, and harmonics up to half of it can be resolved.
    """
    # In lowest terms m / n: over n burst periods the m pulses sample m different phases of the period.
    ratio = Fraction(pulse_rate_hz / burst_rate_hz).limit_denominator(max(1, bursts))
    return float(ratio.numerator) * burst_rate_hz
