"""Checks of gates over depth: inside the record, long enough, clear of tonebursts, and where the twin echoes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.plan.checks.check_result import CheckResult, Level, judged
from hpe_rig.plan.gate_profile import DepthGate, depth_gates, shots_with_gate
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene

MOST_GATES = 1000
LEAST_SAMPLES = 8
MOST_NAMED = 5


def gates_over_depth(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the gates over depth can be used; nothing where the scene has none."""
    processing, shot = scene.processing, plan.shots[0]
    # one shot of each burst length: the others have the same gates and instants
    plan = replace(plan, shots=tuple({each.timeline.burst_length_s: each for each in plan.shots}.values()))
    if not processing.gates and processing.gate_profile_step_m is None:
        return
    gates, name = depth_gates(scene, shot), "gates over depth"
    if len(gates) > MOST_GATES or (len(gates) < 2 and not processing.gates):
        room_m = shot.capture.record_samples / shot.capture.sample_rate_hz * scene.acquisition.sound_speed_m_per_s / 2
        text = f"processing.gate_profile_step_m = {processing.gate_profile_step_m:g} m makes {len(gates)} of them in a "
        text += f"record of {room_m * 1e3:.3g} mm with a gate of {scene.acquisition.gate_length_m * 1e3:g} mm"
        yield CheckResult(
            name, "refused", text, f"2 to {MOST_GATES} gates: another step, or longer acquisition.record_samples"
        )
        return
    own = [(gate, shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)) for gate in gates]
    outside = [
        gate for gate, at in own if at.shots[0].gate.start < 0 or at.shots[0].gate.stop > shot.capture.record_samples
    ]
    start_m, end_m = (edge * scene.acquisition.sound_speed_m_per_s / 2 for edge in shot.timeline.record_offset_s)
    key = "gates" if processing.gates else "gate_profile_step_m"
    text = f"the record goes from {start_m * 1e3:.4g} to {end_m * 1e3:.4g} mm, processing.{key} has "
    yield judged(
        name,
        not outside,
        text + (f"one at {_named(outside)}" if outside else f"{len(gates)} of them inside it"),
        "acquisition.record_samples larger, or gates nearer to acquisition.gate_depth_m",
    )
    if short := [gate for gate, at in own if at.shots[0].gate.stop - at.shots[0].gate.start < LEAST_SAMPLES]:
        text = f"the gate at {_named(short)} holds fewer than {LEAST_SAMPLES} samples"
        yield CheckResult(name, "refused", text, "a longer length_m of the gate")
    yield from _clear(scene, plan, own)
    yield from _echoing(scene, bench, gates)


def _clear(scene: Scene, plan: Plan, own: list[tuple[DepthGate, Plan]]) -> Iterator[CheckResult]:
    """Yield where tonebursts or their echoes meet more pulses in a gate over depth than the scene's own gate tells."""
    if scene.excitation is None or scene.tracking.disturbed == "skip":
        return
    met = [
        gate
        for gate, at in own
        if any(
            disturbed_pulses(there).sum() > disturbed_pulses(here).sum()
            for there, here in zip(at.shots, plan.shots, strict=True)
        )
    ]
    if met:
        text = f"tonebursts or their echoes disturb pulses in the gate at {_named(met)}"
        level: Level = "warning" if scene.tracking.disturbed == "keep" else "refused"
        remedy = 'tracking.disturbed = "skip", another tracking.delay_s, or gates nearer to acquisition.gate_depth_m'
        yield CheckResult("gates over depth", level, text, remedy)


def _echoing(scene: Scene, bench: BenchFile, gates: tuple[DepthGate, ...]) -> Iterator[CheckResult]:
    """Yield which gates of a simulated bench hold nothing but noise."""
    twin = twin_of(scene) if bench.simulated else None
    if twin is None:
        return
    scale = twin.sound_speed_m_per_s / scene.acquisition.sound_speed_m_per_s
    dark = [
        gate for gate in gates if abs(gate.depth_m * scale - twin.focus_depth_m) - gate.length_m / 2 > twin.echo_reach_m
    ]
    if dark:
        text = f"nothing echoes in the gate at {_named(dark)}: the twin's scatterers reach {twin.echo_reach_m * 1e3:g} "
        text += "mm from the focus"
        yield CheckResult(
            "gates over depth", "refused", text, "a longer third simulation.scatterers.volume_m, or nearer gates"
        )


def _named(gates: list[DepthGate]) -> str:
    depths = ", ".join(f"{gate.depth_m * 1e3:.4g}" for gate in gates[:MOST_NAMED])
    return f"{depths}{' ...' if len(gates) > MOST_NAMED else ''} mm"
