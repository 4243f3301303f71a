"""Checks of gates over depth: inside the record, long enough, undisturbed by tonebursts, with echoes on the twin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, Level, pass_or_refuse
from hpe_rig.plan.gate_profile import DepthGate, depth_gates, shots_with_gate
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene

NAME = "gates over depth"
MAX_GATES = 1000
MIN_SAMPLES = 8
MAX_NAMED = 5
"""Gates that a message lists by depth."""


def gates_over_depth(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the gates over depth can be used; nothing for a scene without."""
    processing, acquisition = scene.processing, scene.acquisition
    if not processing.gates and processing.gate_profile_step_m is None:
        return
    shot = plan.shots[0]
    # Shots with equal burst lengths have equal gates and times.
    plan = replace(plan, shots=tuple({item.timeline.burst_length_s: item for item in plan.shots}.values()))
    gates, samples = depth_gates(scene, shot), shot.capture.record_samples
    if len(gates) > MAX_GATES or (len(gates) < 2 and not processing.gates):
        record_mm = samples / shot.capture.sample_rate_hz * acquisition.sound_speed_m_per_s / 2 * 1e3
        text = f"processing.gate_profile_step_m = {processing.gate_profile_step_m:g} m makes {len(gates)} of them in a "
        text += f"record of {record_mm:.3g} mm with a gate of {acquisition.gate_length_m * 1e3:g} mm"
        remedy = f"2 to {MAX_GATES} gates: another step, or longer acquisition.record_samples"
        yield CheckResult(NAME, "refused", text, remedy)
        return
    gate_plans = [(gate, shots_with_gate(plan, gate, acquisition.sound_speed_m_per_s)) for gate in gates]
    gate_samples = [(gate, gate_plan.shots[0].gate) for gate, gate_plan in gate_plans]
    yield _gates_in_record(scene, shot, gate_samples)
    if short := [gate for gate, span in gate_samples if span.stop - span.start < MIN_SAMPLES]:
        text = f"the gate at {_depths(short)} holds fewer than {MIN_SAMPLES} samples"
        yield CheckResult(NAME, "refused", text, "a longer length_m of the gate")
    yield from _disturbed_gates(scene, plan, gate_plans)
    yield from _gates_without_echoes(scene, bench, gates)


def _gates_in_record(scene: Scene, shot: Shot, gate_samples: Sequence[tuple[DepthGate, slice]]) -> CheckResult:
    """Return whether all gates are inside the record."""
    half_speed_m_per_s = scene.acquisition.sound_speed_m_per_s / 2
    start_m, end_m = (edge_s * half_speed_m_per_s for edge_s in shot.timeline.record_offset_s)
    samples = shot.capture.record_samples
    outside = [gate for gate, span in gate_samples if span.start < 0 or span.stop > samples]
    text = f"the record goes from {start_m * 1e3:.4g} to {end_m * 1e3:.4g} mm, "
    text += f"processing.{'gates' if scene.processing.gates else 'gate_profile_step_m'} has "
    text += f"one at {_depths(outside)}" if outside else f"{len(gate_samples)} of them inside it"
    remedy = "acquisition.record_samples larger, or gates nearer to acquisition.gate_depth_m"
    return pass_or_refuse(NAME, not outside, text, remedy)


def _disturbed_gates(scene: Scene, plan: Plan, gate_plans: Sequence[tuple[DepthGate, Plan]]) -> Iterator[CheckResult]:
    """Yield the gates where tonebursts or their echoes disturb more pulses than in the scene's gate."""
    if scene.excitation is None or scene.tracking.disturbed == "skip":
        return
    counts = [disturbed_pulses(shot).sum() for shot in plan.shots]
    disturbed = [
        gate
        for gate, gate_plan in gate_plans
        if any(disturbed_pulses(shot).sum() > count for shot, count in zip(gate_plan.shots, counts, strict=True))
    ]
    if disturbed:
        text = f"tonebursts or their echoes disturb pulses in the gate at {_depths(disturbed)}"
        level: Level = "warning" if scene.tracking.disturbed == "keep" else "refused"
        remedy = 'tracking.disturbed = "skip", another tracking.delay_s, or gates nearer to acquisition.gate_depth_m'
        yield CheckResult(NAME, level, text, remedy)


def _gates_without_echoes(scene: Scene, bench: BenchFile, gates: Sequence[DepthGate]) -> Iterator[CheckResult]:
    """Yield the gates of a simulated bench that contain only noise."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    # Another sound speed moves the gate in the twin's medium.
    scale = twin.sound_speed_m_per_s / scene.acquisition.sound_speed_m_per_s
    silent = [
        gate for gate in gates if abs(gate.depth_m * scale - twin.focus_depth_m) - gate.length_m / 2 > twin.echo_reach_m
    ]
    if silent:
        text = f"nothing echoes in the gate at {_depths(silent)}: the twin's scatterers extend "
        text += f"{twin.echo_reach_m * 1e3:g} mm from the focus"
        remedy = "a longer third simulation.scatterers.volume_m, or nearer gates"
        yield CheckResult(NAME, "refused", text, remedy)


def _depths(gates: Sequence[DepthGate]) -> str:
    depths = ", ".join(f"{gate.depth_m * 1e3:.4g}" for gate in gates[:MAX_NAMED])
    return f"{depths}{' ...' if len(gates) > MAX_NAMED else ''} mm"
