"""Fig. 18: the shipped scene has the delays t_d of the comparison with the paper."""

import re
import tomllib

from muscle import ADJUSTED_S

from hpe_rig.scene import Scene, shipped_scenes


def test_the_scene_of_fig_18_has_the_delays_of_the_comparison() -> None:
    text = shipped_scenes()["muscle-pulse-rate"]
    without = text.replace("\npulse_rate_hz = [2000.0", "\n# [2000.0")
    scene = Scene.model_validate(tomllib.loads(re.sub(r'^# (?="tracking|combine)', "", without, flags=re.MULTILINE)))
    tracked = [point.scene.tracking for point in scene.points]
    assert {settings.pulse_rate_hz: settings.delay_s for settings in tracked} == ADJUSTED_S
