"""A value whose unit's prefix was forgotten is named with what it may have meant; others are left alone."""

from __future__ import annotations

import pytest

from hpe_rig.runs import check
from hpe_rig.scene import Scene, SettingsError, forgotten_units, load_scene, shipped_scenes


def changed(path: str, value: float) -> Scene:
    return load_scene("bovine-muscle").with_({path: value})


@pytest.mark.parametrize(
    ("path", "value", "meant"),
    [
        ("excitation.burst_length_s", 100.0, "100e-6"),
        ("excitation.burst_length_s", 0.1, "0.1e-3"),
        ("tracking.delay_s", 130.0, "130e-6"),
        ("acquisition.gate_length_m", 1.0, "1e-3"),
        ("excitation.carrier_hz", 3.0, "3e6"),
        ("excitation.carrier_hz", 3000.0, "3000e3"),
        ("acquisition.sample_rate_hz", 0.1, "0.1e9"),
    ],
)
def test_a_forgotten_prefix_is_named_with_what_the_value_may_have_meant(path: str, value: float, meant: str) -> None:
    (found,) = forgotten_units(changed(path, value))
    assert (found.path, found.remedy) == (path, f"perhaps {meant}?")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("excitation.burst_length_s", 10e-3),  # too long, though no factor of 1000
        ("tracking.delay_s", 0.0),
        ("tracking.pulse_count", 1000),  # has no unit
        ("acquisition.gate_depth_m", 0.7),
    ],
)
def test_a_value_near_to_the_shipped_scenes_or_without_unit_is_left_alone(path: str, value: float) -> None:
    assert not forgotten_units(changed(path, value))


def test_no_shipped_scene_seems_to_lack_a_unit() -> None:
    assert not [name for name in shipped_scenes() if forgotten_units(load_scene(name))]


def test_an_entry_of_a_list_is_named_by_its_place() -> None:
    scene = load_scene("bovine-muscle").with_({"excitation.burst_length_s": [100e-6, 200.0]})
    assert [found.path for found in forgotten_units(scene)] == ["excitation.burst_length_s[1]"]


def test_a_value_out_of_bounds_is_refused_with_what_it_may_have_meant() -> None:
    with pytest.raises(SettingsError, match=r"gate_depth_m: 70\.0 is out of bounds.*perhaps 70e-3\?"):
        changed("acquisition.gate_depth_m", 70.0)


def test_the_forgotten_unit_comes_before_the_conflicts_that_it_causes_and_never_alone() -> None:
    for value, first in ((100.0, "forgotten unit"), (10e-3, "duty")):
        found = check(changed("excitation.burst_length_s", value)).findings
        refused = [one for one in found if one.level == "refused"]
        assert refused[0].check == first
        assert len(refused) > 1
    # Alone it is no mistake: a scene that can be measured is left as it is.
    scene = changed("processing.expected_snr_db", 0.1)
    assert forgotten_units(scene)
    assert all(one.check != "forgotten unit" for one in check(scene).findings)
