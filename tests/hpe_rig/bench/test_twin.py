"""What a scene declares of its twin, with defaults, presets and the scene's own sections filled in."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.bench.twin import check_declared, twin_of
from hpe_rig.scene.scene import Scene, parse_scene, shipped_scenes

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
