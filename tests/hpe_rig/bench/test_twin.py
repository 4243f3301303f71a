"""What a scene declares of its twin, with defaults, presets and the scene's own sections filled in."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.bench import check_declared, twin_of
from hpe_rig.scene import Scene, parse_scene, shipped_scenes
from sim_backend.settings import SimulationSettings

SCENES = shipped_scenes()


def scene(name: str, *edits: tuple[str, str]) -> Scene:
    text = SCENES[name]
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse_scene(name, text).scene


def test_a_prescribed_motion_is_declared_with_its_amplitudes() -> None:
    twin = twin_of(scene("table-1"))
    assert twin is not None
    assert (twin.prescribed, twin.has_specimen, twin.snr_db) == (((200.0, 1e-6),), False, 40.0)
    assert twin.medium(np.array([200.0])) is None


def test_a_voigt_specimen_is_declared_as_modulus_and_density() -> None:
    twin = twin_of(scene("bovine-muscle"))
    assert twin is not None
    assert not twin.prescribed
    modulus_pa, density = twin.medium(np.array([100.0, 200.0])) or (np.zeros(2), 0.0)
    np.testing.assert_allclose(modulus_pa, 12.0e3 + 2j * np.pi * np.array([100.0, 200.0]) * 5.7, rtol=1e-12)
    assert density == 1060.0


def test_a_preset_brings_the_chains_noise_along() -> None:
    with_preset, bare = (
        twin_of(scene("gelatin-8", *edits))
        for edits in ([], [('preset = "paper"', ""), ("noise_v_per_sqrt_hz", "# noise_v_per_sqrt_hz")])
    )
    assert with_preset is not None
    assert bare is not None
    assert (with_preset.has_receive_chain, with_preset.has_noise) == (True, True)
    assert (bare.has_receive_chain, bare.has_noise) == (True, False)


def test_where_the_twin_is_silent_the_scenes_own_sound_speed_holds() -> None:
    own = scene("table-1")
    faster = own.model_copy(update={"acquisition": own.acquisition.model_copy(update={"sound_speed_m_per_s": 1580.0})})
    simulation = {key: value for key, value in (own.simulation or {}).items() if key != "sound_speed_m_per_s"}
    twin = twin_of(faster.model_copy(update={"simulation": simulation}))
    assert twin is not None
    assert twin.sound_speed_m_per_s == 1580.0


def test_a_scene_without_simulation_declares_no_twin() -> None:
    bare = scene("table-1").model_copy(update={"simulation": None})
    assert twin_of(bare) is None
    assert check_declared(bare) == []


@pytest.mark.parametrize("wrong", [{"sede": 1}, {"seed": -1}])
def test_an_invalid_twin_is_told_by_the_check_and_declares_nothing(wrong: dict[str, int]) -> None:
    invalid = scene("table-1").model_copy(update={"simulation": wrong})
    assert twin_of(invalid) is None
    assert [mistake.path for mistake in check_declared(invalid)] == [f"simulation.{next(iter(wrong))}"]


@pytest.mark.parametrize(
    ("stated", "depth_m"),
    [
        ({}, 12.5e-3),
        ({"scatterers": {"attenuation_db_per_cm_mhz": 0.5}}, None),
        ({"scatterers": {"attenuation_db_per_cm_mhz": 0.0}}, 12.5e-3),
        ({"propagation": {"specimen_depth_m": 20e-3}}, 20e-3),
        ({"beams": {"focus_depth_m": 10e-3}}, 10e-3),
        ({"beams": {"focus_depth_m": 70e-3, "tracking_focus_depth_m": 11e-3}}, 11e-3),
    ],
)
def test_the_depth_of_a_preset_gives_way_to_what_a_scene_says(
    stated: dict[str, dict[str, float]], depth_m: float | None
) -> None:
    """Run files from before presets had a depth open as well."""
    found = SimulationSettings.model_validate({"specimen": {"preset": "gelatin_8"}, **stated}).specimen
    assert found is not None
    assert found.depth_m == depth_m


def test_a_depth_that_a_scene_itself_says_is_not_overruled() -> None:
    given = {"specimen": {"preset": "gelatin_8", "depth_m": 15e-3}, "propagation": {"specimen_depth_m": 20e-3}}
    with pytest.raises(ValueError, match="at one depth"):
        SimulationSettings.model_validate(given)


def test_the_echo_level_falls_as_the_twins_echo_does_where_diodes_take_their_threshold() -> None:
    threshold = ("[simulation]\n", "[simulation.transmitter]\ndiode_threshold_v = 4.0\n\n[simulation]\n")
    linear, diodes = twin_of(scene("table-1")), twin_of(scene("table-1", threshold))
    assert linear is not None
    assert diodes is not None
    reference_vpp = linear.settings.receiver.reference_pulse_vpp
    assert diodes.echo_v(reference_vpp, 3.0, 9e6) == pytest.approx(linear.echo_v(reference_vpp, 3.0, 9e6))
    # 37 dB behind a tenth of a volt peak to peak stand 3.5 V: nothing passes.
    assert diodes.echo_v(0.1, 3.0, 9e6) == 0.0
    assert linear.echo_v(0.1, 3.0, 9e6) > 0.0


def test_noise_without_a_receive_chain_follows_from_the_echo_and_its_ratio() -> None:
    noisy, silent = twin_of(scene("table-1")), twin_of(scene("table-1", ("snr_db", "# snr_db")))
    assert noisy is not None
    assert silent is not None
    assert (noisy.has_noise, silent.has_noise, silent.noise_v) == (True, False, 0.0)
    # 40 dB are a factor of 100 in volts.
    assert noisy.noise_v == pytest.approx(noisy.settings.receiver.echo_rms_v / 100)


def test_only_driven_tonebursts_displace_the_specimen() -> None:
    twin = twin_of(scene("bovine-muscle"))
    assert twin is not None
    time_s, onset_s = np.array([5e-3]), np.array([0.0])
    pushed_m, undriven_m = (twin.displacement_m(time_s, onset_s, 100e-6, drive)[0] for drive in ((3e6, 1.0), None))
    assert pushed_m != undriven_m
    assert undriven_m == 0.0
