"""Background motion that the twin declares, against the gate, the record and the focus, by its own sine."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from hpe_rig.bench import read_bench
from hpe_rig.plan.checks.digitizer import background
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import Scene, load_scene

BENCH = read_bench().bench


def moving(amplitude_m: float, phase_rad: float = 0.0, **processing: object) -> Scene:
    window = {"window_start_s": 0.0, "window_length_s": 0.2}
    keys = {f"processing.{key}": value for key, value in (window | processing).items()}
    motion = {"frequency_hz": 5.0, "amplitude_m": amplitude_m, "phase_rad": phase_rad}
    return load_scene("bovine-muscle-synchronous").with_({"simulation.background": [motion], **keys})


def found(scene: Scene) -> dict[str, tuple[str, str]]:
    results = background(scene, BENCH, make_plan(scene, BENCH))
    return {result.check: (result.level, str(result)) for result in results}


def farthest_m(amplitude_m: float) -> float:
    """Return the plain form: the most that the sine moves from where it stands at the first pulse, in 200 ms."""
    scene = moving(amplitude_m)
    time_s = make_plan(scene, BENCH).shots[0].timeline.sensing_s
    moved_m = amplitude_m * np.sin(2 * math.pi * 5.0 * time_s)
    return float(np.abs(moved_m - moved_m[0]).max())


def test_nothing_is_said_where_nothing_moves_and_no_gate_follows() -> None:
    assert found(load_scene("bovine-muscle-synchronous")) == {}
    follows = load_scene("bovine-muscle-synchronous").with_({"processing.follow_gate": True})
    assert found(follows)["gate follows"][0] == "passed"


@pytest.mark.parametrize(("share", "level"), [(0.95, "passed"), (1.05, "warning")])
def test_a_gate_that_rests_bears_a_background_of_a_quarter_of_its_length(share: float, level: str) -> None:
    quarter_m = load_scene("bovine-muscle-synchronous").acquisition.gate_length_m / 4
    amplitude_m = share * quarter_m / (farthest_m(1e-3) / 1e-3)
    said, text = found(moving(amplitude_m))["background"]
    assert said == level
    (moved_mm,) = re.findall(r"moves by ([\d.]+) mm", text)
    assert float(moved_mm) == pytest.approx(share * quarter_m * 1e3, rel=6e-3)


@pytest.mark.parametrize(("share", "level"), [(0.98, "passed"), (1.02, "refused")])
def test_a_gate_that_follows_needs_room_in_its_record(share: float, level: str) -> None:
    scene = moving(1e-3, follow_gate=True)
    shot = make_plan(scene, BENCH).shots[0]
    room = min(shot.gate.start, shot.capture.record_samples - shot.gate.stop)
    room_m = room / 100e6 * 1540 / 2
    amplitude_m = share * room_m / (farthest_m(1e-3) / 1e-3)
    said, text = found(moving(amplitude_m, follow_gate=True))["gate follows"]
    assert said == level
    assert f"lets the gate follow by {room_m * 1e3:.3g} mm" in text
    if level == "refused":
        # What is suggested holds the gate, the motion to either side and 16 samples more, and is the board's next size.
        reach = math.ceil(farthest_m(amplitude_m) * 2 / 1540 * 100e6)
        least = shot.gate.stop - shot.gate.start + 2 * reach + 2 * 16
        assert f"record_samples = {16 * math.ceil(least / 16)}" in text


@pytest.mark.parametrize(("share", "level"), [(0.9, "passed"), (1.1, "refused"), (-1.1, "refused")])
def test_a_gate_that_follows_begins_at_the_focus(share: float, level: str) -> None:
    half_m = load_scene("bovine-muscle-synchronous").acquisition.gate_length_m / 2
    # At a quarter turn the sine stands at its amplitude; it hardly moves on before the first pulse.
    scene = moving(abs(share) * half_m, math.copysign(math.pi / 2, share), follow_gate=True)
    assert found(scene)["gate at focus"][0] == level
