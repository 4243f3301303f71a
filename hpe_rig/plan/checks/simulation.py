"""Check that a simulated bench has something to measure, and at which sound speed."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def simulation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the twin has a specimen, and its sound speed is the one assumed."""
    if not bench.simulated:
        return
    if scene.simulation is None:
        yield CheckResult(
            "simulation",
            "refused",
            "a simulated bench without [simulation] has nothing to measure",
            "a [simulation] section",
        )
        return
    speed, assumed = scene.simulation.get("sound_speed_m_per_s"), scene.acquisition.sound_speed_m_per_s
    if isinstance(speed, int | float) and speed != assumed:
        text = f"simulation.sound_speed_m_per_s = {speed:g} m/s, "
        text += f"the gate assumes acquisition.sound_speed_m_per_s = {assumed:g} m/s"
        yield CheckResult("sound speed", "warning", text, "equal values, unless the mismatch is what is studied")
