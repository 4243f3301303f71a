"""Snapshot of a capture: one arming of the digitizer with everything that its records depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import Int64Array
from sim_backend.digitizer.board import Arming, Taken
from sim_backend.wiring import BURST_FIELDS, Bursts, Capture

FAR_PS = 1 << 60


@dataclass(frozen=True, slots=True)
class CaptureSnapshot:
    """One arming with everything that its records depend on."""

    arming: Arming
    taken: Taken
    tonebursts: Bursts
    pulses: Bursts
    origin_ps: int

    @property
    def capture(self) -> Capture:
        """The capture in the words of the physics."""
        settings, index = self.arming.settings, self.arming.index
        first_ps = self.taken.first_sample_ps
        return Capture(index, self.origin_ps, first_ps, settings.sample_period_ps, settings.record_samples)


def pulse_of_each_record(captured: CaptureSnapshot) -> Int64Array:
    """Return the onset of the pulse that each record's trigger fired, -1 where there is none: int64 (record,)."""
    tick_ps, onset_ps = captured.taken.tick_ps, captured.pulses.onset_ps
    first = np.searchsorted(onset_ps, tick_ps)
    following_ps = np.append(tick_ps[1:], FAR_PS)
    padded_ps = np.append(onset_ps, FAR_PS)
    return np.where(padded_ps[first] < following_ps, padded_ps[first], -1)


def same_inputs(one: CaptureSnapshot, other: CaptureSnapshot) -> bool:
    """Return whether the records of two evaluations are the same."""
    if one is other:
        return True
    same = one.origin_ps == other.origin_ps and one.arming.index == other.arming.index
    same = same and np.array_equal(one.taken.first_sample_ps, other.taken.first_sample_ps)
    return same and all(
        np.array_equal(getattr(getattr(one, bursts), name), getattr(getattr(other, bursts), name))
        for bursts in ("tonebursts", "pulses")
        for name in BURST_FIELDS
    )
