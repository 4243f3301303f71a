"""Gates over depth: their positions in the records of a shot, and scene and shots as if one of them were the only gate.

Centres are z_k = z_0 + k d for gates of the scene's length, or those of [[processing.gates]]. The samples of a gate,
the pulses that a toneburst disturbs in it, and the times of its motion follow from its depth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene


@dataclass(frozen=True, slots=True, order=True)
class DepthGate:
    """A gate: distance of its centre from the transducer, and its length, m."""

    depth_m: float
    length_m: float

    def overlaps(self, gate: DepthGate) -> bool:
        """Return whether some echoes are in both gates."""
        return abs(self.depth_m - gate.depth_m) < (self.length_m + gate.length_m) / 2 * (1 - 1e-9)


def depth_gates(scene: Scene, shot: Shot) -> tuple[DepthGate, ...]:
    """Return the gates over depth of ``scene``, from near to far.

    A profile has the gates that are in the record of ``shot``; listed gates may be anywhere.
    """
    processing, length_m = scene.processing, scene.acquisition.gate_length_m
    if processing.gate_profile_step_m is None:
        return tuple(sorted({DepthGate(gate.depth_m, gate.length_m or length_m) for gate in processing.gates}))
    step_m, gate = processing.gate_profile_step_m, shot.gate
    samples_per_m = 2 / scene.acquisition.sound_speed_m_per_s * shot.capture.sample_rate_hz
    # 1e-9 absorbs the rounding of a gate that ends with the record.
    count_before = math.floor(gate.start / samples_per_m / step_m + 1e-9)
    count_after = math.floor((shot.capture.record_samples - gate.stop) / samples_per_m / step_m + 1e-9)
    steps = range(-count_before, count_after + 1)
    return tuple(DepthGate(scene.gate_depth_m + step * step_m, length_m) for step in steps)


def with_gate(scene: Scene, gate: DepthGate) -> Scene:
    """Return ``scene`` with ``gate`` as its only one, and the focus at the gate's depth."""
    sections = {
        "acquisition": scene.acquisition.model_copy(
            update={"gate_depth_m": gate.depth_m, "gate_length_m": gate.length_m}
        ),
        "tracking": scene.tracking.model_copy(update={"axial_offset_m": 0.0}),
        "processing": scene.processing.model_copy(update={"gates": (), "gate_profile_step_m": None}),
    }
    if scene.beams is not None:
        foci: dict[str, float | None] = {"focus_depth_m": None}
        if scene.beams.push_focus_depth_m is not None:
            # The pushing transducer keeps its distance from the tracking one.
            foci = {"focus_depth_m": gate.depth_m, "push_focus_depth_m": gate.depth_m + scene.beams.push_farther_m}
        sections["beams"] = scene.beams.model_copy(update=foci)
    return scene.model_copy(update=sections)


def shots_with_gate(plan: Plan, gate: DepthGate, sound_speed_m_per_s: float) -> Plan:
    """Return ``plan`` with the gate of every shot at ``gate``, the records unchanged."""
    centre_s, half_s = 2 * gate.depth_m / sound_speed_m_per_s, gate.length_m / sound_speed_m_per_s
    offset_s = centre_s - half_s, centre_s + half_s
    shots = (replace(shot, timeline=replace(shot.timeline, gate_offset_s=offset_s)) for shot in plan.shots)
    return replace(plan, shots=tuple(shots))


def without_shared_echoes(gates: Sequence[DepthGate], depth_m: float) -> tuple[DepthGate, ...]:
    """Return a subset of ``gates`` without overlaps, those nearest to ``depth_m`` first chosen; sorted by depth."""
    separate: list[DepthGate] = []
    for gate in sorted(gates, key=lambda item: abs(item.depth_m - depth_m)):
        if not any(gate.overlaps(neighbour) for neighbour in separate):
            separate.append(gate)
    return tuple(sorted(separate))
