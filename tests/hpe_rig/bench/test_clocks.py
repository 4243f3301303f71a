"""Covariance of the clocks of motion, pulses and digitizer from a bench file."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

import hpe_rig as hpe
from hpe_rig.bench import clock_covariance, parse_bench, read_bench
from hpe_rig.measurement import prepare

SHIPPED = resources.files("hpe_rig.bench") / "shipped"
FREE, SYNCHRONISED = hpe.load_scene("free-running-clocks"), hpe.load_scene("bovine-muscle")


def ppm(covariance: np.ndarray) -> list[float]:
    return list(np.round(np.sqrt(np.diag(covariance)) * 1e6, 3))


def test_a_simulated_bench_has_one_clock_unless_the_scene_sets_clock_errors() -> None:
    bench = read_bench().bench
    assert not clock_covariance(SYNCHRONISED, bench).any()
    # Data sheets: 2 ppm for a 33250A, 25 ppm for an ATS460.
    assert ppm(clock_covariance(FREE, bench)) == [2.0, 2.0, 25.0]


def test_accuracies_of_the_bench_file_replace_those_of_the_models_and_locked_clocks_are_one() -> None:
    text = (SHIPPED / "simulated.toml").read_text()
    for role in ("burst_train", "tracking_train"):
        text = text.replace(f"[generators.{role}]", f"[generators.{role}]\ncommon_reference = true")
    text = text.replace("[digitizer]", "[digitizer]\nclock_accuracy = 6e-6")
    covariance = clock_covariance(FREE, parse_bench("bench", text).bench)
    assert ppm(covariance) == [2.0, 2.0, 6.0]
    difference = np.array([1.0, -1.0, 0.0])
    assert difference @ covariance @ difference == 0
    assert covariance[0, 2] == 0


def test_check_prints_accuracies_and_the_shift_that_they_allow() -> None:
    """2 and 2 ppm are 2.8 ppm: 360 deg x 1000 Hz x 2.83e-6 x 1 s = 1.02 deg."""
    texts = {str(result) for result in prepare("free-running-clocks").findings if result.check == "clocks"}
    (text,) = texts
    assert "motion 2 ppm, pulses 2 ppm, digitizer 25 ppm (clock_accuracy)" in text
    assert "shift 1000 Hz by 1 deg" in text
    assert not [result for result in prepare("bovine-muscle").findings if result.check == "clocks"]


def test_a_source_of_motion_that_is_not_on_the_bench_has_an_unknown_clock() -> None:
    vibrator = hpe.load_scene("free-running-clocks").model_copy(update={"excitation": None})
    assert ppm(clock_covariance(vibrator, read_bench().bench)) == [50.0, 2.0, 25.0]


def test_the_clocks_of_an_imported_recording_are_unknown(tmp_path: Path) -> None:
    echoes = np.random.default_rng(1).normal(0, 1e3, (40, 200)).astype(np.int16)
    scene = tmp_path / "scene.toml"
    scene.write_text("""
title = "Echoes of another program"
[tracking]
[acquisition]
gate_depth_m = 1.8e-3
gate_length_m = 1.0e-3
[processing]
frequencies_hz = [200.0]
""")
    rates: dict[str, Any] = {"sample_rate_hz": 50e6, "pulse_rate_hz": 4000.0, "carrier_hz": 5e6, "axes": "pulse,sample"}
    run = hpe.import_records(echoes, scene, tmp_path / "run.h5", **rates)
    assert ppm(clock_covariance(run.scene, run.bench)) == [50.0, 0.0, 0.0]
