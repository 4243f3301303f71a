"""Profile over depth: the shots of a place as each of several gates in their records sees them."""

from __future__ import annotations

from dataclasses import replace

from hpe_rig.plan import Plan, depth_gates, shots_with_gate, with_gate
from hpe_rig.result import GateResult
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun


def depth_profile(scene: Scene, plan: Plan, stored: StoredRun, estimator: str) -> tuple[list[GateResult], list[str]]:
    """Return what every gate over depth says of the shots of a place, and in words what has no result.

    The averaging over the beam is that of the focal plane, at the gate's own depth. Raises ``ValueError`` where no
    averaging can be predicted.
    """
    from hpe_rig.prediction import beam_widths, predicted_averaging
    from hpe_rig.processing import burst_period_motion, estimate_run

    found, without = list[GateResult](), list[str]()
    if not plan.shots:
        return found, without
    # the truth that a twin stores is that of the focus
    untold = replace(stored, true_displacement_m=None)
    for gate in depth_gates(scene, plan.shots[0]):
        there = with_gate(scene, gate)
        shots = shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)
        averaging, beams = predicted_averaging(there, estimator), beam_widths(there, estimator)
        estimates = estimate_run(there, shots, untold, estimator, averaging, beams)
        motion = {shot.index: burst_period_motion(there, shot, stored) for shot in shots.shots}
        for shot in estimates.shots:
            time_s, moved_m = motion[shot.shot]
            trusted = replace(shot, motion=None, untrusted=stored.untrusted.get(shot.shot, ""))
            found.append(
                GateResult(gate.depth_m, gate.length_m, trusted, tuple(time_s.tolist()), tuple(moved_m.tolist()))
            )
        where = f"gate at {gate.depth_m * 1e3:.4g} mm, shot"
        without += [f"{where} {shot + 1} left out: {why}" for shot, why in estimates.without.items()]
    return found, without
