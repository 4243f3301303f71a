"""Phase reference: time zero and sign of the stated phases.

    D(t) = A sin(2 pi f t + phase)        D positive away from the transducer

Two time zeros are distinguished. The *physical* one, ``Timeline.time_zero_s``, is the arrival of the first toneburst at
the gate (without tonebursts the master trigger's edge): pulse times, prior of media, ground truth and warnings use it.
The *stated* one is that of the phases in a result, ``delay_s`` later:

    stated phase = physical phase + 2 pi f delay_s

Only this module chooses the stated one: ``time_zero_event`` in words, ``phase_reference_of`` in seconds. Both are equal
at present.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from hpe_rig.plan.shots import Shot
from hpe_rig.scene import Scene

SAME_TIME_ZERO: Final = "runs that both have an [excitation], or both none"
"""Remedy where the phases of two runs count from different events."""


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """Time zero of stated phases: ``delay_s`` after the physical time zero, by the same clock as the phases."""

    delay_s: float = 0.0

    def by_motion_clock(self, rate_error: float) -> PhaseReference:
        """Return this reference with a delay by the clock of the motion's frequencies, if it was by the pulses' clock.

        ``rate_error``: relative error of these frequencies by the clock of the pulses.
        """
        return PhaseReference(self.delay_s * (1 + rate_error))

    def stated_rad(self, physical_rad: float, frequency_hz: float) -> float:
        """Return the stated phase of a physical one, in [-pi, pi]; the same number if both time zeros are equal."""
        return _shifted_rad(physical_rad, 2 * math.pi * frequency_hz * self.delay_s)

    def physical_rad(self, stated_rad: float, frequency_hz: float) -> float:
        """Return the physical phase of a stated one, in [-pi, pi]; the same number if both time zeros are equal."""
        return _shifted_rad(stated_rad, -2 * math.pi * frequency_hz * self.delay_s)


def phase_reference_of(scene: Scene, shot: Shot) -> PhaseReference:
    """Return the stated phase reference of ``shot``, with its delay by the clock of the tracking pulses."""
    return PhaseReference()


def time_zero_event(scene: Scene, imported: bool = False) -> str:
    """Return the event at the stated time zero in words.

    ``imported``: the records are those of another program, which states no master trigger.
    """
    if scene.excitation:
        return "the first toneburst's arrival at the gate"
    return "time zero of the recording's pulses" if imported else "the master trigger's edge"


def phase_definition(scene: Scene, imported: bool = False) -> str:
    """Return the definition of phase in words, as a result states it. ``imported``: as for ``time_zero_event``."""
    return f"of sin(2 pi f t + phase), the motion at the gate, with t from {time_zero_event(scene, imported)}"


def _shifted_rad(phase_rad: float, shift_rad: float) -> float:
    # No shift leaves the phase bit for bit: the remainder could turn pi into -pi.
    return math.remainder(phase_rad + shift_rad, 2 * math.pi) if shift_rad else phase_rad
