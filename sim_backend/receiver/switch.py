"""The transmit/receive switch: shut while anything is transmitted, and slow to open again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.wiring import PS_PER_S, Bursts, Capture, to_ps

Floats = NDArray[np.float64]

_OPEN = 20.0
"""After this many recovery times the switch passes all but 2e-9."""


def switch_gain(sent: Bursts, capture: Capture, recovery_s: float) -> Floats | None:
    """Return what the switch passes, float64 (record, sample) from 0 to 1, or None where it passes everything.

    Shut from a burst's onset to its end, then ``1 - exp(-t / recovery)``. ``sent`` is by time and does not overlap
    itself: of bursts at once the one that began last counts.
    """
    open_ps = sent.end_ps + to_ps(_OPEN * recovery_s)
    length_ps = capture.samples * capture.sample_period_ps
    begin = np.searchsorted(sent.onset_ps, capture.first_sample_ps + length_ps, side="left") - 1
    met = begin >= 0
    met[met] &= open_ps[begin[met]] > capture.first_sample_ps[met]
    if not met.any():
        return None
    gain = np.ones((len(capture.first_sample_ps), capture.samples))
    offset_ps = np.arange(capture.samples) * capture.sample_period_ps
    for record in np.flatnonzero(met):
        gain[record] = _gain(sent, int(capture.first_sample_ps[record]) + offset_ps, recovery_s)
    return gain


def _gain(sent: Bursts, time_ps: NDArray[np.int64], recovery_s: float) -> Floats:
    last = np.searchsorted(sent.onset_ps, time_ps, side="right") - 1
    since_s = np.where(last >= 0, time_ps - sent.end_ps[np.maximum(last, 0)], 1 << 60) / PS_PER_S
    if recovery_s == 0:
        return np.where(since_s >= 0, 1.0, 0.0)
    return np.asarray(-np.expm1(-np.clip(since_s / recovery_s, 0.0, 700.0)))
