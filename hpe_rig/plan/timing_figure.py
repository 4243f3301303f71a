"""Timing diagram of a shot: the activity of each instrument over a burst period and up to the first record."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hpe_rig.arrays import FloatArray
from hpe_rig.plan.shots import Shot

if TYPE_CHECKING:
    from hpe_rig.result import Picture

ECHO_COLOUR = "#C4804A"
MIN_WIDTH = 1 / 400
"""Smallest width of a bar relative to the time axis, about a pixel."""


def timing_pictures(shot: Shot) -> tuple[Picture, ...]:
    """Return the timing diagrams of one burst period, and of one tracking pulse from its onset to its record."""
    line = shot.timeline
    period_s = 1 / shot.tracking_train.rate_hz
    span_s = 1 / shot.burst_train.rate_hz if shot.burst_train else min(8, line.pulse_onset_s.size) * period_s
    start_s = float(line.burst_onset_s[0]) if line.burst_onset_s.size else float(line.pulse_onset_s[0])
    title = f"{span_s * 1e3:g} ms of tracking"
    if line.burst_onset_s.size:
        title = f"One burst period of {span_s * 1e3:g} ms"
    period_picture = _timing_picture(shot, start_s, span_s, "timing", title)
    later_s = line.pulse_onset_s[line.pulse_onset_s >= start_s]
    first_s = float(later_s[0]) if later_s.size else float(line.pulse_onset_s[0])
    close_s = first_s - start_s + 1.1 * line.record_offset_s[1]
    return period_picture, _timing_picture(
        shot, start_s, close_s, "timing-close", "Closer: to the first record and its gate"
    )


def _timing_picture(shot: Shot, start_s: float, span_s: float, key: str, title: str) -> Picture:
    """Draw the intervals of each instrument from ``start_s`` on, one row an instrument."""
    # Imported here, because most plans are made without figures.
    from hpe_rig.result import Colour, panel, picture

    line = shot.timeline
    bursts, pulses = line.burst_onset_s, line.pulse_onset_s
    rows: list[tuple[str, FloatArray, tuple[float, float], str]] = [
        ("gate", pulses, line.gate_offset_s, Colour.BLUE),
        ("record", pulses, line.record_offset_s, Colour.SKY),
        ("tracking pulse", pulses, (0.0, line.pulse_length_s), Colour.GREEN),
    ]
    if bursts.size:
        rows += [
            ("its echoes", bursts, (0.0, line.burst_length_s + line.gate_offset_s[1]), ECHO_COLOUR),
            ("toneburst", bursts, (0.0, line.burst_length_s), Colour.ORANGE),
        ]
    unit, factor = ("ms", 1e3) if span_s > 2e-3 else ("us", 1e6)
    figure, axes = panel(left=0.22)
    for row, (_, onset_s, (low_s, high_s), colour) in enumerate(rows):
        visible_s = onset_s[(onset_s + high_s >= start_s) & (onset_s + low_s <= start_s + span_s)]
        starts = (visible_s + low_s - start_s) * factor
        # A toneburst or pulse is often narrower than a pixel.
        width = max((high_s - low_s) * factor, span_s * factor * MIN_WIDTH)
        axes.broken_barh([(float(edge), width) for edge in starts], (row - 0.3, 0.6), color=colour, lw=0)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    zero = "the toneburst's onset" if bursts.size else "the first pulse"
    axes.set(xlim=(0, span_s * factor), xlabel=f"time after {zero} ({unit})", ylim=(-0.6, len(rows) - 0.4))
    axes.grid(axis="y", visible=False)
    first = pulses[pulses >= start_s]
    delay_us = (float(first[0]) - start_s) * 1e6 if first.size else math.nan
    gate_us = [edge * 1e6 for edge in line.gate_offset_s]
    alt = (
        f"Timing over {span_s * factor:.4g} {unit}: "
        + (f"a toneburst of {line.burst_length_s * 1e6:g} us; " if bursts.size else "no toneburst; ")
        + f"the first tracking pulse follows after {delay_us:.4g} us, the next ones every "
        f"{1e6 / shot.tracking_train.rate_hz:g} us; each gate is open {gate_us[0]:.2f} to {gate_us[1]:.2f} us after "
        f"its pulse, inside its record."
    )
    return picture(figure, key, title, alt)
