"""Phase reference: time zero and sign of the stated phases.

    D(t) = A sin(2 pi f t + phase)        D positive away from the transducer

Two time zeros are distinguished. The *physical* one, ``Timeline.time_zero_s``, is the arrival of the first toneburst at
the gate (without tonebursts the master trigger's edge): pulse times, prior of media, ground truth and warnings use it.
The *stated* one is that of the phases in a result, ``delay_s`` later:

    stated phase = physical phase + 2 pi f delay_s

``phase_reference_of`` is the only place that chooses the stated one. Both are equal at present.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hpe_rig.plan.shots import Shot
from hpe_rig.scene import Scene


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """Time zero of stated phases: the ``event`` in words, ``delay_s`` after the physical time zero."""

    event: str
    delay_s: float = 0.0

    @property
    def words(self) -> str:
        """The definition of phase in words, as a result states it."""
        return f"of sin(2 pi f t + phase), the motion at the gate, with t from {self.event}"

    def stated_rad(self, physical_rad: float, frequency_hz: float) -> float:
        """Return the stated phase of a physical one, in [-pi, pi]; the same number if both time zeros are equal."""
        return _shifted_rad(physical_rad, 2 * math.pi * frequency_hz * self.delay_s)

    def physical_rad(self, stated_rad: float, frequency_hz: float) -> float:
        """Return the physical phase of a stated one, in [-pi, pi]; the same number if both time zeros are equal."""
        return _shifted_rad(stated_rad, -2 * math.pi * frequency_hz * self.delay_s)


FIRST_TONEBURST = PhaseReference("the first toneburst's arrival at the gate")
MASTER_TRIGGER = PhaseReference("the master trigger's edge")
RECORDED_TIMES = PhaseReference("time zero of the recording's pulses")


def phase_reference_of(scene: Scene, shot: Shot | None = None, imported: bool = False) -> PhaseReference:
    """Return the stated phase reference of ``shot``, or of the whole scene, then without ``delay_s``.

    ``imported``: the records are those of another program, which states no master trigger.
    """
    if scene.excitation:
        return FIRST_TONEBURST
    return RECORDED_TIMES if imported else MASTER_TRIGGER


def _shifted_rad(phase_rad: float, shift_rad: float) -> float:
    # No shift leaves the phase bit for bit: the remainder could turn pi into -pi.
    return math.remainder(phase_rad + shift_rad, 2 * math.pi) if shift_rad else phase_rad
