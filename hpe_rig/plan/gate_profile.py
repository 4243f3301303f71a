"""Gates over depth: where they lie in the records of a shot, and the scene and shot as if each were the only one.

Centre z_k = z_0 + k d of gates of the scene's own length, or as [[processing.gates]] says. Everything that hangs on a
gate's depth follows from there: its samples, which pulses a toneburst disturbs in it, when they sense its motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene


@dataclass(frozen=True, slots=True, order=True)
class DepthGate:
    """A gate by its middle's distance from the transducer and its length, m."""

    depth_m: float
    length_m: float

    def overlaps(self, other: DepthGate) -> bool:
        """Return whether echoes are in both."""
        return abs(self.depth_m - other.depth_m) < (self.length_m + other.length_m) / 2 * (1 - 1e-9)


def depth_gates(scene: Scene, shot: Shot) -> tuple[DepthGate, ...]:
    """Return the gates over depth that ``scene`` asks for, from near to far; none where it asks for none.

    Of a profile those alone that lie in the record of ``shot``, a place's; listed ones wherever they lie.
    """
    processing, length_m = scene.processing, scene.acquisition.gate_length_m
    listed = (DepthGate(each.depth_m, each.length_m or length_m) for each in processing.gates)
    if processing.gate_profile_step_m is None:
        return tuple(sorted(set(listed)))
    step_m, gate = processing.gate_profile_step_m, shot.gate
    per_metre = 2 / scene.acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    before = math.floor(gate.start / per_metre / step_m + 1e-9)
    after = math.floor((shot.capture.record_samples - gate.stop) / per_metre / step_m + 1e-9)
    return tuple(DepthGate(scene.gate_depth_m + k * step_m, length_m) for k in range(-before, after + 1))


def with_gate(scene: Scene, gate: DepthGate) -> Scene:
    """Return ``scene`` as if ``gate`` were its only one, and the axis at its depth what is asked for, not the focus."""
    at_gate = {"gate_depth_m": gate.depth_m, "gate_length_m": gate.length_m}
    parts = {
        "acquisition": scene.acquisition.model_copy(update=at_gate),
        "tracking": scene.tracking.model_copy(update={"axial_offset_m": 0.0}),
        "processing": scene.processing.model_copy(update={"gates": (), "gate_profile_step_m": None}),
    }
    if scene.beams is not None:
        foci: dict[str, float | None] = {"focus_depth_m": None}
        if scene.beams.push_focus_depth_m is not None:
            # Of two transducers that push and track the one stays as much farther away as it is.
            foci = {"focus_depth_m": gate.depth_m, "push_focus_depth_m": gate.depth_m + scene.beams.push_farther_m}
        parts["beams"] = scene.beams.model_copy(update=foci)
    return scene.model_copy(update=parts)


def shots_with_gate(plan: Plan, gate: DepthGate, sound_speed_m_per_s: float) -> Plan:
    """Return ``plan`` with the gate of every shot at ``gate``, the records as they are."""
    middle_s, half_s = 2 * gate.depth_m / sound_speed_m_per_s, gate.length_m / sound_speed_m_per_s
    offset_s = middle_s - half_s, middle_s + half_s
    shots = (replace(shot, timeline=replace(shot.timeline, gate_offset_s=offset_s)) for shot in plan.shots)
    return replace(plan, shots=tuple(shots))


def apart(gates: Sequence[DepthGate], depth_m: float) -> tuple[DepthGate, ...]:
    """Return those of ``gates``, nearest to ``depth_m`` first, that share no echo with one before them; by depth."""
    kept: list[DepthGate] = []
    for gate in sorted(gates, key=lambda each: abs(each.depth_m - depth_m)):
        if not any(gate.overlaps(other) for other in kept):
            kept.append(gate)
    return tuple(sorted(kept))
