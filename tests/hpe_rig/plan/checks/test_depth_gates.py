"""Gates over depth: where they lie, and what speaks against them, all of it at once."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.bench import read_bench
from hpe_rig.plan import (
    DepthGate,
    check_plan,
    depth_gates,
    make_plan,
    shots_with_gate,
    with_gate,
    without_shared_echoes,
)
from hpe_rig.plan.checks.depth_gates import MAX_GATES
from hpe_rig.plan.interference import admissible_delays_s
from hpe_rig.scene import Scene, SettingsError, load_scene

BENCH = read_bench(None).bench


def scene_with(**values: object) -> Scene:
    one_place = {"sweep.lateral_offset_m": [1e-3], "excitation.burst_count": 12, "processing.window_start_s": 50e-3}
    return load_scene("gelatin-moduli").with_(
        one_place | {name.replace("__", "."): each for name, each in values.items()}
    )


def refusals(scene: Scene) -> list[str]:
    return [str(each) for each in check_plan(scene, BENCH, make_plan(scene, BENCH)) if each.level == "refused"]


def test_a_profile_holds_the_scenes_own_gate_and_all_that_fit_into_the_record() -> None:
    scene = scene_with(processing__gate_profile_step_m=0.4e-3)
    plan = make_plan(scene, BENCH)
    gates = depth_gates(scene, plan.shots[0])
    np.testing.assert_allclose(np.diff([gate.depth_m for gate in gates]), 0.4e-3)
    assert DepthGate(scene.gate_depth_m, 1e-3) in gates
    samples = [shots_with_gate(plan, gate, 1540.0).shots[0].gate for gate in gates]
    assert all(each.start >= 0 and each.stop <= 512 for each in samples)
    # one more on either side would not fit
    step = 0.4e-3 * 2 / 1540 * 100e6
    assert samples[0].start < step
    assert 512 - samples[-1].stop < step + 1
    assert not refusals(scene)


def test_a_gate_senses_what_passes_its_own_depth_later_the_deeper_it_lies() -> None:
    scene = scene_with(processing__gates=[{"depth_m": 69e-3}, {"depth_m": 71e-3, "length_m": 0.5e-3}])
    plan = make_plan(scene, BENCH)
    near, far = (shots_with_gate(plan, gate, 1540.0).shots[0] for gate in depth_gates(scene, plan.shots[0]))
    np.testing.assert_allclose(far.timeline.sensing_s - near.timeline.sensing_s, 2e-3 / 1540, rtol=1e-9)
    assert (far.gate.stop - far.gate.start) * 2 == near.gate.stop - near.gate.start
    assert far.capture == near.capture == plan.shots[0].capture


def test_the_scene_of_a_gate_has_no_other_and_is_asked_about_its_own_depth() -> None:
    scene = load_scene("bovine-muscle").with_({"processing.gates": [{"depth_m": 71e-3}], "beams.focus_depth_m": 69e-3})
    there = with_gate(scene, DepthGate(71e-3, 0.5e-3))
    assert (there.gate_depth_m, there.acquisition.gate_length_m) == (71e-3, 0.5e-3)
    assert there.processing.gates == ()
    assert there.processing.gate_profile_step_m is None
    assert there.beams is not None
    assert there.beams.focus_depth_m is None


def test_a_gate_may_begin_with_its_record_and_end_with_it_but_not_a_sample_beyond() -> None:
    sample_m = 1540 / 2 / 100e6
    refused: dict[tuple[int, int], bool] = {}
    # A gate of 130 of the record's 512 samples, around 70 mm.
    for depth_m in (70e-3 + side * (191 + shift) * sample_m for side in (-1, 1) for shift in range(-2, 3)):
        scene = scene_with(processing__gates=[{"depth_m": float(depth_m)}])
        plan = make_plan(scene, BENCH)
        [gate] = depth_gates(scene, plan.shots[0])
        at = shots_with_gate(plan, gate, 1540.0).shots[0].gate
        refused[at.start, at.stop] = any("has one at" in each for each in refusals(scene))
    assert {start for start, _ in refused} >= {-1, 0}
    assert {stop for _, stop in refused} >= {512, 513}
    for (start, stop), told in refused.items():
        assert told == (start < 0 or stop > 512), (start, stop)


def test_gates_that_share_echoes_are_thinned_from_the_nearest_to_the_focus() -> None:
    gates = [DepthGate(70e-3 + k * 0.5e-3, 1e-3) for k in range(-3, 4)]
    assert [round(gate.depth_m * 1e3, 3) for gate in without_shared_echoes(gates, 70e-3)] == [69.0, 70.0, 71.0]


def test_what_speaks_against_gates_is_said_all_at_once() -> None:
    far = [{"depth_m": 60e-3}, {"depth_m": 70e-3, "length_m": 20e-6}, {"depth_m": 79e-3}]
    refused = "\n".join(refusals(scene_with(processing__gates=far)))
    assert "processing.gates has one at 60, 79 mm" in refused
    assert "the gate at 70 mm holds fewer than 8 samples" in refused
    assert "nothing echoes in the gate at 60, 79 mm" in refused
    assert refused.count("Try:") == 3


@pytest.mark.parametrize("step_m", [1e-6, 5e-3])
def test_a_step_that_makes_one_gate_or_thousands_is_refused(step_m: float) -> None:
    [refused] = refusals(scene_with(processing__gate_profile_step_m=step_m))
    assert "gate_profile_step_m" in refused


def test_a_deeper_gate_that_a_toneburst_reaches_is_named() -> None:
    clear = {"tracking__disturbed": "refuse", "tracking__pulse_rate_hz": 4000.0}
    wide = {"acquisition__record_samples": 1024, "simulation__scatterers__volume_m": [1e-3, 1e-3, 12e-3]}
    scene = scene_with(**clear, **wide)
    latest_s = max(high for _, high in admissible_delays_s(make_plan(scene, BENCH).shots[0]))
    # a pulse whose gate ends half a microsecond before the next toneburst: one a millimetre deeper ends 1.3 us later
    scene = scene.with_({"tracking.delay_s": latest_s - 0.5e-6})
    assert not refusals(scene)
    refused = "\n".join(refusals(scene.with_({"processing.gate_profile_step_m": 1e-3})))
    assert "disturb pulses in the gate at" in refused


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(SettingsError, match="remove one of them"):
        scene_with(processing__gates=[{"depth_m": 70e-3}], processing__gate_profile_step_m=1e-3)
    with pytest.raises(SettingsError, match="follow_gate"):
        scene_with(processing__follow_gate=True, processing__gate_profile_step_m=1e-3)


def test_the_longest_profile_has_a_thousand_gates() -> None:
    scene = scene_with(processing__gate_profile_step_m=10e-6, acquisition__record_samples=2048)
    count = len(depth_gates(scene, make_plan(scene, BENCH).shots[0]))
    assert count > MAX_GATES
    fits_m = 10e-6 * (count - 1) / (MAX_GATES - 1)
    for step_m, refused in ((fits_m * 1.003, False), (fits_m * 0.997, True)):
        scene = scene.with_({"processing.gate_profile_step_m": step_m})
        count = len(depth_gates(scene, make_plan(scene, BENCH).shots[0]))
        assert (count > MAX_GATES) == refused
        assert any("gate_profile_step_m" in each for each in refusals(scene)) == refused


def test_the_room_for_gates_is_told_as_the_length_of_the_record() -> None:
    [refused] = refusals(scene_with(processing__gate_profile_step_m=5e-3))
    # 512 samples of 100 MHz, there and back
    assert f"in a record of {512 / 100e6 * 1540 / 2 * 1e3:.3g} mm with a gate of 1 mm" in refused
