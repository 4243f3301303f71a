"""Snapshot of a capture: one arming of the digitizer with everything that determines its records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import Int64Array
from sim_backend.digitizer.board import AcceptedTriggers, Arming
from sim_backend.wiring import BURST_FIELDS, Bursts, Capture

FAR_PS = 1 << 60


@dataclass(frozen=True, slots=True)
class CaptureSnapshot:
    """One arming with everything that determines its records."""

    arming: Arming
    triggers: AcceptedTriggers
    tonebursts: Bursts
    pulses: Bursts
    origin_ps: int

    @property
    def capture(self) -> Capture:
        """The times of all records, as the simulation of echoes needs them."""
        settings, index = self.arming.settings, self.arming.index
        first_ps = self.triggers.first_sample_ps
        return Capture(
            index=index,
            origin_ps=self.origin_ps,
            first_sample_ps=first_ps,
            sample_period_ps=settings.sample_period_ps,
            samples=settings.record_samples,
            clock_error=self.arming.clock_error,
        )


def pulse_onsets_ps(captured: CaptureSnapshot) -> Int64Array:
    """Return the onset of the tracking pulse of each record, int64 (record,); -1 if none was fired for it."""
    tick_ps, onset_ps = captured.triggers.tick_ps, captured.pulses.onset_ps
    first = np.searchsorted(onset_ps, tick_ps)
    following_ps = np.append(tick_ps[1:], FAR_PS)
    padded_ps = np.append(onset_ps, FAR_PS)
    return np.where(padded_ps[first] < following_ps, padded_ps[first], -1)


def same_inputs(first: CaptureSnapshot, second: CaptureSnapshot) -> bool:
    """Return whether two snapshots of the bench lead to the same records: same triggers, bursts and time zero."""
    if first is second:
        return True
    same = first.origin_ps == second.origin_ps and first.arming.index == second.arming.index
    same = same and np.array_equal(first.triggers.first_sample_ps, second.triggers.first_sample_ps)
    return same and all(
        np.array_equal(getattr(getattr(first, bursts), name), getattr(getattr(second, bursts), name))
        for bursts in ("tonebursts", "pulses")
        for name in BURST_FIELDS
    )
