"""What a bench must never put out, and the calibration that tells what it does: two sections of the bench file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hpe_rig.scene import Positive, Section


class Limits(Section):
    """What the bench must never exceed."""

    full_drive_vpp: Positive
    """Toneburst amplitude at the generator that gives the force F_0."""
    max_duty: Annotated[float, Field(gt=0, le=1, strict=True)]
    """Largest f_r T_b."""
    max_burst_length_s: Positive
    """Longest toneburst."""
    max_bursts: Annotated[int, Field(ge=1, strict=True)]
    """Most tonebursts in a train."""
    max_drive_vpp: Positive | None = None
    """Largest amplitude of a generator that drives the transducer; absent: the instrument's own limit."""
    max_mechanical_index: Positive = 1.9
    """Largest derated mechanical index (FDA, track 3)."""
    max_sppa_w_per_m2: Positive = 1.9e6
    """Largest derated pulse-average intensity; within it the mechanical index may be exceeded (FDA, track 3)."""
    max_spta_w_per_m2: Positive = 7.2e3
    """Largest derated time-average intensity (FDA, track 3)."""


class DriveCalibration(Section):
    """What a hydrophone in water measured at the focus for one kind of drive."""

    carrier_hz: Positive
    """Carrier that was driven."""
    amplitude_vpp: Positive
    """Generator amplitude that was set."""
    rarefaction_pa: Positive
    """Peak rarefactional pressure, not derated."""
    sppa_w_per_m2: Positive
    """Pulse-average intensity, not derated."""


class Calibration(Section):
    """Acoustic output of transducer, amplifier and generator together, from which every plan's output is estimated."""

    source: str
    """Who measured what when, or that it is assumed."""
    focus_depth_m: Positive
    """Distance between transducer and focus; the way over which the output is derated."""
    toneburst: DriveCalibration | None = None
    """The toneburst that pushes."""
    tracking_pulse: DriveCalibration | None = None
    """The pulse that tracks."""
