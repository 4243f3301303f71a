"""Fig. 18: the shipped scene names the delay t_d of every pulse rate that the page beside the paper takes."""

import re
import tomllib

from muscle import ADJUSTED_S

from hpe_rig.scene import Scene, shipped_scenes


def test_the_scene_of_fig_18_names_the_delays_of_the_page() -> None:
    text = shipped_scenes()["muscle-pulse-rate"]
    without = text.replace("\npulse_rate_hz = [2000.0", "\n# [2000.0")
    scene = Scene.model_validate(tomllib.loads(re.sub(r'^# (?="tracking|combine)', "", without, flags=re.MULTILINE)))
    tracked = [point.scene.tracking for point in scene.points]
    assert {each.pulse_rate_hz: each.delay_s for each in tracked} == ADJUSTED_S
