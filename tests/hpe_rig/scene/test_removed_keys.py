"""Keys of earlier versions: a new scene that has them is refused with what to do, a stored one is read without them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import hpe_rig as hpe
from hpe_rig.bench import check_simulation, twin_of
from hpe_rig.measurement import prepare
from hpe_rig.scene import SettingsError, named_text, parse_scene, shipped_scenes
from sim_backend.settings import SimulationSettings

OLD = """
[simulation.transmitter]
saturation_v = 30.0

[simulation.instruments]
sample_clock_offset = 1e-6
trigger_jitter_s = 1e-9
"""


def text_of_earlier_version() -> str:
    return named_text("table-1", shipped_scenes(), "scene")[1] + OLD


def test_a_removed_key_is_a_mistake_that_says_what_to_do() -> None:
    with pytest.raises(SettingsError) as caught:
        parse_scene("old", text_of_earlier_version(), check_simulation)
    remedies = {mistake.path: mistake.remedy for mistake in caught.value.mistakes}
    assert set(remedies) == {"simulation.transmitter", "simulation.instruments.sample_clock_offset"}
    assert "linear" in remedies["simulation.transmitter"]
    assert "clock_error.digitizer" in remedies["simulation.instruments.sample_clock_offset"]


@pytest.mark.parametrize("table", ["", "simulation.", "simulation.scatterers."])
def test_a_removed_key_is_recognised_in_any_table(table: str) -> None:
    with pytest.raises(SettingsError) as caught:
        prepare("table-1", changes={f"{table}measured_pulse_rate_hz": 1e8})
    (mistake,) = caught.value.mistakes
    assert mistake.remedy == "remove it together with measured_pulse"


def test_the_twin_of_a_run_file_is_read_without_removed_keys_and_keeps_the_clock_error_that_one_of_them_set() -> None:
    twin = twin_of(parse_scene("old", text_of_earlier_version(), stored=True).scene)
    assert twin is not None
    assert isinstance(twin.settings, SimulationSettings)
    assert twin.settings.instruments.trigger_jitter_s == 1e-9
    # A period too long is a rate too low.
    assert twin.settings.instruments.clock_error.digitizer == pytest.approx(-1e-6, rel=2e-6)
    assert twin.has_clock_errors


def test_a_run_of_the_removed_power_stage_says_that_its_predictions_are_without(tmp_path: Path) -> None:
    run = hpe.measure("table-1", path=tmp_path / "run.h5")
    old = replace(run, scene=parse_scene("old", text_of_earlier_version(), stored=True).scene)
    (warning,) = set(old.estimate().warnings) - set(run.estimate().warnings)
    assert "with simulation.transmitter" in warning


def test_a_sweep_of_a_removed_key_is_read_from_a_run_file() -> None:
    axis = '\n[sweep.axes]\n"simulation.transmitter.saturation_v" = [30.0, 40.0]\n'
    scene = parse_scene("old", text_of_earlier_version() + axis, stored=True).scene
    values = [point.values["simulation.transmitter.saturation_v"] for point in scene.points]
    assert values == [30.0, 40.0]
    assert None not in [twin_of(point.scene) for point in scene.points]
