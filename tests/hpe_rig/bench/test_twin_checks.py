"""Settings of the twin that differ from those of the scene, and mistakes of its [simulation]."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from hpe_rig.bench import check_declared, check_simulation, contradictions, twin_checks
from hpe_rig.scene import Scene, load_scene

MUSCLE = load_scene("bovine-muscle")
LINEAR = {"specimen": None, "motion": [{"frequency_hz": 100.0, "amplitude_m": 1e-6}]}


def simulated(scene: Scene, **tables: object) -> Scene:
    """Return ``scene`` with tables of its [simulation] replaced; None removes one."""
    simulation = {**(scene.simulation or {}), **tables}
    return scene.model_copy(
        update={"simulation": {key: value for key, value in simulation.items() if value is not None}}
    )


def test_a_shipped_scene_agrees_with_its_twin_and_a_scene_without_simulation_has_none() -> None:
    assert list(contradictions(MUSCLE)) == []
    assert list(contradictions(MUSCLE.model_copy(update={"simulation": None}))) == []
    assert check_declared(MUSCLE) == []


def test_beams_of_the_scene_and_of_the_twin_are_compared_key_by_key() -> None:
    beams = {
        "excitation_width_m": (0.2e-3, 0.2e-3, 2e-3),
        "tracking_width_m": (0.1e-3, 0.1e-3, 1e-3),
        "focus_depth_m": 71e-3,
    }
    found = list(contradictions(simulated(MUSCLE, beams=beams)))
    assert [(key, twin) for key, _, twin in found] == [
        ("beams.excitation_width_m", "[0.0002, 0.0002, 0.002]"),
        ("beams.tracking_width_m", "[0.0001, 0.0001, 0.001]"),
        *[("beams.focus_depth_m", "0.071")] * (MUSCLE.beams is not None and MUSCLE.beams.focus_depth_m is not None),
    ]
    assert found[0][1].startswith("[0.0003")
    with_aperture = MUSCLE.with_({"beams.transducer_diameter_m": 0.05})
    assert list(contradictions(with_aperture)) == [("beams.transducer_diameter_m", "0.05", "0")]
    without = MUSCLE.model_copy(update={"beams": None})
    assert list(contradictions(simulated(without, beams=beams))) == []


def test_medium_and_sphere_are_compared_where_both_have_them() -> None:
    medium = {"shear_modulus_pa": 5e3, "shear_viscosity_pa_s": 1.0, "density_kg_per_m3": 1050.0}
    declared = MUSCLE.with_({f"medium.{key}": value for key, value in medium.items()})
    voigt = simulated(declared, specimen={"medium": "voigt", "force_density_n_per_m3": 2.2e6, **medium})
    assert list(contradictions(voigt)) == []
    stiffer = simulated(
        declared, specimen={"medium": "voigt", "force_density_n_per_m3": 2.2e6, **medium, "shear_modulus_pa": 6e3}
    )
    assert list(contradictions(stiffer)) == [("medium.shear_modulus_pa", "5000", "6000")]
    assert list(contradictions(simulated(declared, **LINEAR))) == []


def test_a_sphere_of_the_scene_or_of_the_twin_alone_and_other_radii_and_densities_are_differences() -> None:
    scene = load_scene("steel-sphere")
    assert list(contradictions(scene)) == []
    other = scene.with_({"sphere.radius_m": 1e-3, "sphere.density_kg_per_m3": 8000.0})
    assert list(contradictions(other)) == [
        ("sphere.radius_m", "0.001", "0.000795"),
        ("sphere.density_kg_per_m3", "8000", "7650"),
    ]
    assert list(contradictions(scene.with_({"sphere": None}))) == [("sphere.radius_m", "0", "0.000795")]
    still = simulated(scene, **LINEAR)
    assert list(contradictions(still)) == [("sphere.radius_m", "0.000795", "0")]


def test_mistakes_of_a_simulation_are_named_and_one_that_is_no_table_is_the_scenes_mistake() -> None:
    assert check_simulation({}) == []
    assert check_simulation({"simulation": 3}) == []
    wrong = {"simulation": {"seed": -1, "receiver": {"snr_db": "loud"}}}
    assert [mistake.path for mistake in check_simulation(wrong)] == ["simulation.seed", "simulation.receiver.snr_db"]


def test_absent_scans_of_measured_beams_are_named_by_their_keys(tmp_path: Path) -> None:
    scans = {key: str(tmp_path / f"{key}.csv") for key in ("excitation_scan", "tracking_scan")}
    measured = simulated(MUSCLE, beams={"field": "measured", **scans})
    assert [mistake.path for mistake in check_declared(measured)] == [
        "simulation.beams.excitation_scan",
        "simulation.beams.tracking_scan",
    ]
    assert all("run file" in mistake.remedy for mistake in check_declared(measured))


def test_only_a_push_of_many_harmonics_is_announced_as_slow_and_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    twin_checks._warn_slow.cache_clear()
    monkeypatch.setattr("sim_backend.transducer.push_of", lambda settings, carrier_hz: None)
    caplog.set_level(logging.WARNING, "hpe_rig")
    lengths = list[int]()
    for harmonics in (24, 55, 56, 56, 60):
        assert check_declared(simulated(MUSCLE, propagation={"harmonics": harmonics})) == []
        lengths.append(len(caplog.records))
    assert lengths == [0, 0, 1, 1, 2]
    assert "with 56 harmonics takes minutes" in caplog.records[0].getMessage()
    # Without a specimen there is no force to compute.
    check_declared(simulated(MUSCLE, propagation={"harmonics": 64}, **LINEAR))
    assert len(caplog.records) == 2


def test_a_force_that_propagation_cannot_give_is_a_mistake_of_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    class Saturated:
        def surface_for(self, force_density_n_per_m3: float) -> float:
            raise ValueError("the force saturates")

    scene = simulated(MUSCLE, propagation={"harmonics": 24})
    monkeypatch.setattr("sim_backend.transducer.push_of", lambda settings, carrier_hz: Saturated())
    assert [item.path for item in check_declared(scene)] == ["simulation.specimen.force_density_n_per_m3"]

    def fail(settings: object, carrier_hz: float) -> None:
        raise ValueError("it diverges")

    monkeypatch.setattr("sim_backend.transducer.push_of", fail)
    assert [(item.path, item.what) for item in check_declared(scene)] == [("simulation.propagation", "it diverges")]
