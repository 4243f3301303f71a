"""What of a twin contradicts its scene is named, with both numbers and the remedy."""

import pytest

from hpe_rig.acquire.run import prepare, prepare_text
from hpe_rig.scene.scene import shipped_scenes

TABLE_1 = shipped_scenes()["table-1"]


def found(text, check):
    setup = prepare_text("a", text, refuse=False)
    return [each for each in setup.findings if each.check == check]


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_agree_with_their_twins(name):
    said = {each.check for each in prepare(name, refuse=False).findings}
    assert not said & {"gate in focus", "sound speed", "motion aliased"}


def test_a_gate_in_which_nothing_echoes_is_refused():
    (finding,) = found(TABLE_1.replace("gate_depth_m = 70.0e-3", "gate_depth_m = 60.0e-3"), "gate in focus")
    assert finding.level == "refused"
    for word in ("60 mm", "0.07 m", "2.5 mm from the focus", "equal depths"):
        assert word in str(finding)


@pytest.mark.parametrize(("depth_m", "level"), [(70.4e-3, None), (70.6e-3, "warning"), (73e-3, "warning")])
def test_a_gate_beside_the_focus_is_named(depth_m, level):
    each = found(TABLE_1.replace("gate_depth_m = 70.0e-3", f"gate_depth_m = {depth_m}"), "gate in focus")
    assert [finding.level for finding in each] == ([] if level is None else [level])


def test_another_sound_speed_moves_the_gate_as_well():
    text = TABLE_1.replace("[simulation]\n", "[simulation]\nsound_speed_m_per_s = 1580.0\n")
    assert [each.level for each in found(text, "sound speed")] == ["warning"]
    (finding,) = found(text, "gate in focus")
    assert "71.82 mm" in finding.text  # 70 mm x 1580 / 1540


@pytest.mark.parametrize(("moving_hz", "seen"), [(3800.0, "at 200 Hz"), (4200.0, "at 200 Hz"), (215.0, "at 215 Hz")])
def test_motion_that_the_pulses_show_at_a_wanted_frequency_is_named(moving_hz, seen):
    extra = f"\n[[simulation.motion]]\nfrequency_hz = {moving_hz}\namplitude_m = 1e-6\n"
    (finding,) = found(TABLE_1 + extra, "motion aliased")
    assert finding.level == "warning"
    assert seen in finding.text


@pytest.mark.parametrize("moving_hz", [1.2, 400.0, 3000.0])
def test_motion_that_the_pulses_tell_apart_is_not(moving_hz):
    extra = f"\n[[simulation.motion]]\nfrequency_hz = {moving_hz}\namplitude_m = 1e-6\n"
    assert not found(TABLE_1 + extra, "motion aliased")
