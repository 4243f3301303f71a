"""Echoes and displacement of one stored shot: records -> echoes of the selected pulses -> displacement of each
pulse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Selection, Shot, reference_gate
from hpe_rig.processing.echo.conditioning import (
    CodedVolts,
    GateStatistics,
    code_statistics,
    concatenate_statistics,
    deviating_pulses,
    gate_statistics,
)
from hpe_rig.processing.echo.gate import EchoGate, margin_samples
from hpe_rig.processing.first_pulse import PulseAssignment, assign_pulses
from hpe_rig.processing.motion.displacement import Motion, relative_to
from hpe_rig.processing.motion.gate_tracking import add_gate_motion, track_gate
from hpe_rig.processing.motion.phase_shift import coherent
from hpe_rig.processing.toneburst_phases import ToneburstPhases, toneburst_phases
from hpe_rig.processing.tracking_rate import TrackingRate, measured_rate
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from hpe_rig.store import GatedRecords, StoredRun

MotionFunction = Callable[[EchoGate], Motion]
NO_RECORDS = "no record was acquired"
ALL_CLIPPED = "every record reaches the digitizer's full scale in the gate"
"""Reason why a shot is not to be trusted: clipped echoes change amplitude and phase by more than u."""
DAMAGED = "fail their checksums and count as missing: the file is damaged; hpe-rig verify lists them"


@dataclass(frozen=True, slots=True)
class ShotRecords:
    """Records of one shot: in the gate, with ``statistics`` of their codes, and in the reference gate, if any.

    ``tracking_rate``: the train's rate from the trigger times, None if it was not measured. ``tonebursts``: their
    phases at the second input, None if it was not recorded.
    """

    gate: GatedRecords
    statistics: GateStatistics
    reference: GatedRecords | None
    assignment: PulseAssignment
    tracking_rate: TrackingRate | None = None
    tonebursts: ToneburstPhases | None = None


@dataclass(frozen=True, slots=True)
class WindowMotion:
    """Displacement of the pulses in a processing window.

    ``measured``: by the estimator, before the reference is subtracted. ``reference``: apparent motion of the reference
    gate, None without one. ``measured_coherent``: by the estimator "coherent", None where single echoes are too noisy.
    ``tracked`` and ``coherent``: both minus the reference.
    """

    echoes: EchoGate
    measured: Motion
    reference: Motion | None
    measured_coherent: Motion | None
    tracked: Motion
    coherent: Motion | None

    def delayed(self, delay_s: float) -> WindowMotion:
        """Return the motion with ``tracked`` and ``coherent`` later by ``delay_s``."""
        tracked = replace(self.tracked, time_s=self.tracked.time_s + delay_s)
        # Both have the times of the same pulses.
        delayed_coherent = None if self.coherent is None else replace(self.coherent, time_s=tracked.time_s)
        return replace(self, tracked=tracked, coherent=delayed_coherent)

    def without(self, displacement_m: FloatArray) -> WindowMotion:
        """Return the motion with ``displacement_m`` (pulse,) subtracted from ``tracked`` and ``coherent``."""
        tracked = replace(self.tracked, displacement_m=self.tracked.displacement_m - displacement_m)
        if self.coherent is None:
            return replace(self, tracked=tracked)
        steady = replace(self.coherent, displacement_m=self.coherent.displacement_m - displacement_m)
        return replace(self, tracked=tracked, coherent=steady)


def read_shot(scene: Scene, shot: Shot, stored: StoredRun) -> ShotRecords:
    """Return the records of one shot, as codes in the gate; raise ``ValueError`` if none is valid.

    Of a long record only the gate and its margins are read, unless the gate follows the motion. The statistics of a
    long shot are computed while its checksums are verified, so that its file is read once.
    """
    margin, block_statistics = margin_needed(scene, shot), list[GateStatistics]()
    assignment = assign_pulses(shot, stored)
    placement = assignment.placement
    records = stored.records.gated_or_stored(
        shot.index,
        samples_needed(scene, shot),
        margin=margin,
        visit=lambda codes: block_statistics.append(code_statistics(codes)),
        placement=placement,
    )
    if not records.valid.any():
        damaged = records.damaged is not None and bool(records.damaged.any())
        raise ValueError(f"its records {DAMAGED}" if damaged else NO_RECORDS)
    gate = reference_gate(scene, shot)
    return ShotRecords(
        gate=records,
        statistics=concatenate_statistics(block_statistics) if block_statistics else gate_statistics(records),
        reference=None
        if gate is None
        else stored.records.gated_or_stored(shot.index, gate, margin=margin, placement=placement),
        assignment=assignment,
        tracking_rate=measured_rate(
            stored.records.arrival(shot.index).trigger_time_s,
            placement,
            shot.tracking_train.rate_hz,
            shot.capture.sample_rate_hz,
        ),
        tonebursts=None if max(assignment.shifts) else toneburst_phases(shot, stored, placement),
    )


def clipped_count(records: ShotRecords, selection: Selection, motion: WindowMotion) -> int:
    """Return the number of used pulses in the window at the digitizer's full scale."""
    at_full_scale = records.statistics.at_full_scale(records.gate.code_limits)[selection.window]
    # A disturbance that omits a pulse may also reach full scale, which a larger input range does not mend.
    return int((at_full_scale & motion.echoes.valid).sum())


def window_motion(
    scene: Scene, shot: Shot, records: ShotRecords, selection: Selection, motion: MotionFunction
) -> WindowMotion:
    """Return the displacement of the tissue at the selected pulses; ``motion`` computes it from their echoes.

    With a reference gate, its apparent motion (trigger jitter) is subtracted. The displacement by the estimator
    "coherent" is returned as well, for checks. Raises ``ValueError`` if the echoes yield no displacement.
    """
    echoes = shot_echoes(scene, shot, records.gate, selection, records.statistics)
    reference = None
    if records.reference is not None:
        reference = coherent(shot_echoes(scene, shot, records.reference, selection))
    measured = shot_motion(scene, shot, echoes, motion)
    measured_coherent = measured if motion is coherent else _coherent_or_none(scene, shot, echoes)
    tracked, tracked_coherent = measured, measured_coherent
    if reference is not None:
        tracked = relative_to(measured, reference)
        tracked_coherent = None if measured_coherent is None else relative_to(measured_coherent, reference)
    return WindowMotion(
        echoes=echoes,
        measured=measured,
        reference=reference,
        measured_coherent=measured_coherent,
        tracked=tracked,
        coherent=tracked_coherent,
    )


def _coherent_or_none(scene: Scene, shot: Shot, echoes: EchoGate) -> Motion | None:
    """Return the displacement by the estimator "coherent"; None if the echoes carry none."""
    try:
        return shot_motion(scene, shot, echoes, coherent)
    except ValueError:
        return None


def shot_echoes(
    scene: Scene,
    shot: Shot,
    records: GatedRecords,
    selection: Selection,
    statistics: GateStatistics | None = None,
) -> EchoGate:
    """Return the echoes of the selected pulses, as volts in the gate and its margins.

    ``records``: codes of the same samples, or of whole records if the gate follows the motion. ``statistics`` of the
    codes in the gate are computed if not given. Pulses with deviating energy are marked invalid if the scene asks for
    it.
    """
    # Imported here because a forecast uses this module's package without opening files.
    from hpe_rig.store import ShotRecords as RecordsInMemory

    statistics = statistics or gate_statistics(records)
    window = selection.window
    valid = records.valid[window] & selection.used
    unclipped = valid & ~statistics.at_full_scale(records.code_limits)[window]
    first = int(np.argmax(window))
    pulses = slice(first, first + valid.size)
    # Records of long shots stay in the file: their volts are computed block by block.
    coded = CodedVolts(records, pulses, unclipped, statistics)
    volts = coded[...] if isinstance(records, RecordsInMemory) else coded
    echoes = EchoGate(
        volts=volts,
        sample_rate_hz=shot.capture.sample_rate_hz,
        pulse_time_s=selection.time_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        valid=valid,
        margin=records.margin,
    )
    if not scene.processing.flag_pulses or scene.tracking.disturbed == "keep" or not valid.any():
        return echoes
    return echoes.without(deviating_pulses(echoes))


def samples_needed(scene: Scene, shot: Shot) -> slice:
    """Return the samples of each record that are processed: the gate, or all samples if the gate follows the motion."""
    return slice(0, shot.capture.record_samples) if scene.processing.follow_gate else shot.gate


def margin_needed(scene: Scene, shot: Shot) -> int:
    """Return the number of samples around ``samples_needed`` for the gate's edges; 0 if the gate follows the motion."""
    rate_hz, carrier_hz = shot.capture.sample_rate_hz, scene.tracking.carrier_hz
    return 0 if scene.processing.follow_gate else margin_samples(rate_hz, carrier_hz)


def shot_motion(scene: Scene, shot: Shot, echoes: EchoGate, motion: MotionFunction) -> Motion:
    """Return the displacement of ``echoes``, estimated by the function ``motion``.

    If the scene asks for it, the gate follows its tissue: the motion of the gate is then added to that within it.
    """
    if not scene.processing.follow_gate:
        return motion(echoes)
    tracked, gate_motion = track_gate(echoes, shot.gate)
    return add_gate_motion(motion(tracked), gate_motion)
