"""Setup of a measurement: which parts of a scene apply on a simulated bench, and which on a real one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from hpe_rig.bench import read_bench
from hpe_rig.measurement import plan_and_check, prepare, prepare_text, record_run, setup_of_run
from hpe_rig.measurement.setup import with_scan_in_folder
from hpe_rig.plan import PlanError
from hpe_rig.scene import SettingsError, parse_scene, shipped_scenes
from hpe_rig.store import read_run

TABLE_1 = shipped_scenes()["table-1"]
MUSCLE = shipped_scenes()["bovine-muscle"]
WITHOUT_SIMULATION = MUSCLE.partition("[simulation]")[0]


def test_mistakes_of_the_simulation_are_those_of_a_simulated_bench_only(real_bench: Callable[..., Path]) -> None:
    wrong = TABLE_1.replace("seed = 1", "seed = -1")
    with pytest.raises(SettingsError, match=r"simulation\.seed"):
        prepare_text("wrong", wrong)
    assert prepare_text("wrong", wrong, real_bench(), refuse=False).scene.scene.simulation is not None


def test_a_scan_of_the_push_that_is_absent_is_a_mistake_of_a_simulated_measurement() -> None:
    with pytest.raises(SettingsError, match=r"beams\.excitation_scan"):
        prepare_text("scan", TABLE_1.replace("[beams]\n", "[beams]\nexcitation_scan = 'absent.h5'\n"))


def test_a_mistake_at_one_point_of_a_sweep_is_reported_once() -> None:
    text = TABLE_1 + '\n[sweep]\n"simulation.receiver.snr_db" = [40.0, 1e9, 1e9]\n'
    with pytest.raises(SettingsError, match=r"simulation\.receiver\.snr_db") as refused:
        prepare_text("sweep", text)
    assert [mistake.path for mistake in refused.value.mistakes] == ["simulation.receiver.snr_db"]


def test_only_a_simulated_bench_gets_a_default_specimen(real_bench: Callable[..., Path]) -> None:
    simulated = prepare_text("muscle", WITHOUT_SIMULATION).scene.scene
    assert "specimen" in (simulated.simulation or {})
    assert prepare_text("muscle", WITHOUT_SIMULATION, real_bench(), refuse=False).scene.scene.simulation is None


def test_a_bench_is_the_path_of_a_file_or_nothing(real_bench: Callable[..., Path]) -> None:
    with pytest.raises(TypeError, match="the path of a bench file or None, not int"):
        prepare("table-1", 3)  # type: ignore[arg-type]
    assert prepare("table-1").bench.bench.simulated
    assert not prepare("table-1", str(real_bench()), refuse=False).bench.bench.simulated


def test_a_conflict_is_refused_unless_the_caller_wants_the_findings(tmp_path: Path) -> None:
    conflict = TABLE_1.replace("pulse_rate_hz = 4000.0", "pulse_rate_hz = 20000.0")
    with pytest.raises(PlanError):
        prepare_text("conflict", conflict)
    (path := tmp_path / "conflict.toml").write_text(conflict, "utf-8")
    with pytest.raises(PlanError):
        prepare(path)
    findings = prepare_text("conflict", conflict, refuse=False).findings
    assert "refused" in {finding.level for finding in findings}


def test_rules_on_settings_that_go_together_apply_to_a_scene_but_not_to_that_of_a_run_file(tmp_path: Path) -> None:
    # A removed estimator: run files name it, scenes may not.
    text = TABLE_1.replace("[processing]\n", '[processing]\nestimator = "joint"\n')
    with pytest.raises(SettingsError, match=r"processing\.estimator"):
        prepare_text("scene", text)
    assert prepare_text("scene", text, stored=tmp_path / "run.h5").scene.scene.processing.estimator == "coherent"


def test_the_scene_of_a_run_file_is_planned_again_by_the_rules_for_stored_scenes(tmp_path: Path) -> None:
    path = record_run(
        prepare_text("short", TABLE_1.replace("pulse_count = 101", "pulse_count = 41"), refuse=False),
        tmp_path / "run.h5",
    )
    assert prepare(path, refuse=False).scene.scene.tracking.pulse_count == 41
    stored = read_run(path)
    removed = replace(
        stored, scene_toml=stored.scene_toml.replace("[processing]\n", '[processing]\nestimator = "joint"\n')
    )
    assert setup_of_run(removed).scene.scene.processing.estimator == "coherent"


def test_a_scan_is_found_beside_the_run_file_if_its_path_is_of_another_computer(tmp_path: Path) -> None:
    scene = parse_scene(
        "table-1", TABLE_1.replace("[beams]\n", "[beams]\nexcitation_scan = 'C:\\lab\\push.h5'\n")
    ).scene
    assert scene.beams is not None
    assert with_scan_in_folder(scene, tmp_path) is scene
    (beside := tmp_path / "push.h5").write_bytes(b"")
    moved = with_scan_in_folder(scene, tmp_path)
    assert moved.beams is not None
    assert moved.beams.excitation_scan == str(beside)
    # A path that exists is not replaced by a file of that name in the folder of the run file.
    (other := tmp_path / "other").mkdir()
    (other / "push.h5").write_bytes(b"")
    assert with_scan_in_folder(moved, other) is moved


def test_the_calibration_has_to_be_valid_on_a_stated_day_only() -> None:
    bench = read_bench().bench
    assert bench.calibration is not None
    expired = bench.model_copy(
        update={"calibration": bench.calibration.model_copy(update={"valid_until": date(2026, 3, 5)})}
    )
    scene = parse_scene("table-1", TABLE_1).scene

    def expiries(day: date | None) -> list[str]:
        return [finding.level for finding in plan_and_check(scene, expired, day)[1] if "valid_until" in finding.text]

    assert (expiries(date(2026, 3, 5)), expiries(date(2026, 3, 6)), expiries(None)) == (["passed"], ["warning"], [])


def test_changes_of_settings_are_part_of_the_text_that_is_stored_and_mistakes_are_those_of_the_text_as_written() -> (
    None
):
    setup = prepare("table-1", changes={"tracking.pulse_rate_hz": 5000.0, "acquisition.repeats": 3})
    assert (setup.scene.scene.tracking.pulse_rate_hz, len(setup.plan.shots)) == (5000.0, 3)
    assert parse_scene("again", setup.scene.text).scene == setup.scene.scene
    with pytest.raises(SettingsError, match=r"tracking\.pulse_rate_hz"):
        prepare("table-1", changes={"tracking.pulse_rate_hz": -1.0})


def test_numbers_that_lead_to_no_plan_are_a_mistake_of_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, bench = prepare("table-1").scene.scene, read_bench().bench
    for error, words in (
        (OverflowError("too large"), r"lead to no plan \(too large\)"),
        (MemoryError(), r"lead to no plan \(more memory than is available\)"),
    ):

        def fail(scene: object, bench: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr("hpe_rig.measurement.setup.make_plan", fail)
        with pytest.raises(SettingsError, match=words):
            plan_and_check(scene, bench)


def test_an_imported_recording_is_no_bench_to_measure_on(tmp_path: Path) -> None:
    recording = f'[recording]\nsource = "a"\nsha256 = "{"0" * 64}"\nformat = "npy"\nfirst_sample_s = 0.0\n'
    (path := tmp_path / "bench.toml").write_text(f"{read_bench().text}\n{recording}", "utf-8")
    with pytest.raises(SettingsError, match="describes an imported recording, without instruments"):
        prepare("table-1", path)
