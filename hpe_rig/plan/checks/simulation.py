"""Check that a simulated bench has something to measure, and at which sound speed."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import DEFAULT_SPECIMEN, Scene, has_default_specimen


def simulation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the twin has a specimen, and its sound speed is the one assumed."""
    if not bench.simulated:
        return
    if has_default_specimen(scene):
        text = f"{DEFAULT_SPECIMEN}, in focus at the gate: the scene has no [simulation]"
        yield CheckResult("simulated specimen", "passed", text)
    twin, assumed = twin_of(scene), scene.acquisition.sound_speed_m_per_s
    if twin is not None and twin.sound_speed_m_per_s != assumed:
        text = f"simulation.sound_speed_m_per_s = {twin.sound_speed_m_per_s:g} m/s, "
        text += f"the gate assumes acquisition.sound_speed_m_per_s = {assumed:g} m/s"
        yield CheckResult("sound speed", "warning", text, "equal values, unless the mismatch is what is studied")
