"""Error against run time of the variants of a scene, measured by the functions of a run."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.processing import ESTIMATORS
from hpe_rig.scene import Scene, load_scene
from hpe_rig.study import one_shot
from hpe_rig.validation.accuracy import own_scene
from hpe_rig.validation.accuracy.own_scene import (
    UNCHANGED,
    SceneRow,
    Variant,
    _beats,
    _error_norms_m,
    _is_significantly_less,
    _Trial,
    scene_rows,
    scene_text,
    variants,
)


@pytest.fixture(scope="module")
def tiny() -> Scene:
    return load_scene("table-1").with_({"tracking.pulse_count": 21, "acquisition.repeats": 3})


@pytest.fixture(scope="module")
def rows(tiny: Scene) -> list[SceneRow]:
    messages: list[str] = []
    variants_of_scene = [
        Variant(UNCHANGED, "coherent", {}),
        Variant("estimator", "cross_spectrum", {"processing.estimator": "cross_spectrum"}),
        Variant("estimator", "none such", {"processing.frequencies_hz": [200.0, 201.0]}),
    ]
    scene_table = scene_rows(one_shot(tiny), None, variants_of_scene, 2, report_progress=messages.append)
    assert len(messages) == 2 * len(variants_of_scene)
    return scene_table


def test_the_errors_of_a_variant_are_those_of_its_runs(rows: list[SceneRow], tiny: Scene, tmp_path: Path) -> None:
    from hpe_rig.runs import measure

    errors = []
    for seed in (1, 2):
        run = measure(one_shot(tiny).with_({"simulation.seed": seed}), path=tmp_path / f"{seed}.h5")
        (estimate,) = run.estimate("cross_spectrum").shots[0].estimates
        assert estimate.corrected
        errors.append(estimate.amplitude_m / 1000e-9 - 1)
    row = rows[1]
    assert row.bias == pytest.approx(abs(sum(errors)) / 2, rel=1e-9)
    assert row.error == pytest.approx(math.sqrt(sum(e**2 for e in errors) / 2), rel=1e-9)


def test_every_variant_changes_the_error_and_a_failing_fit_is_reported(rows: list[SceneRow]) -> None:
    assert len({row.error for row in rows[:2]}) == 2
    assert math.isnan(rows[2].error)
    assert not rows[2].on_front
    assert "no estimate" in scene_text(rows)
    assert [row.own for row in rows] == [True, False, False]
    assert all(row.time_s > row.estimation_s > 0 for row in rows[:2])


def test_the_text_states_the_benefit_of_a_setting_that_is_beaten(rows: list[SceneRow]) -> None:
    unchanged = replace(rows[0], on_front=False, error=0.02, time_s=1.0)
    faster = replace(
        rows[1],
        varied="gate",
        setting="half",
        on_front=True,
        beats_own=True,
        is_more_exact=True,
        error=0.005,
        time_s=0.5,
    )
    text = scene_text([unchanged, faster])
    assert "gate half beats the scene's settings: rms error 0.5 instead of 2 %, 0.5 instead of 1 s" in text
    # An error within that of the seeds is no gain.
    text = scene_text([unchanged, replace(faster, is_more_exact=False, error=0.0202)])
    assert "beats the scene's settings: 0.5 instead of 1 s, its error is as good within that of the seeds;" in text
    assert "resolution in depth" in text
    # Any estimate is a gain over none.
    text = scene_text([replace(unchanged, error=math.nan), replace(faster, time_s=2.0)])
    assert "beats the scene's settings: rms error 0.5 instead of no estimate;" in text
    assert "lie on the Pareto front" in scene_text(
        [replace(unchanged, on_front=True), replace(faster, beats_own=False)]
    )


def trials(errors_m: list[float], times_s: list[float]) -> list[_Trial]:
    return [
        _Trial(np.array([error_m]), np.ones(1), time_s, time_s)
        for error_m, time_s in zip(errors_m, times_s, strict=True)
    ]


def test_a_variant_beats_another_only_by_a_significant_difference() -> None:
    unchanged = trials([1.0, -2.0, 3.0, -1.5], [1.0, 1.01, 0.99, 1.0])
    halves = trials([0.5, -1.0, 1.5, -0.75], [1.0, 1.0, 1.0, 1.0])
    assert _beats(halves, unchanged)
    assert not _beats(unchanged, halves)
    # Equal errors in less time; then smaller errors in more time: neither beats the other.
    assert _beats(trials([1.0, -2.0, 3.0, -1.5], [0.5] * 4), unchanged)
    slower = trials([0.5, -1.0, 1.5, -0.75], [2.0] * 4)
    assert not _beats(slower, unchanged)
    assert not _beats(unchanged, slower)
    # An insignificantly smaller mean error, and a gain of 1 % in time, do not count.
    assert not _beats(trials([0.5, -2.2, 2.5, -1.8], [1.0] * 4), unchanged)
    assert not _beats(trials([1.0, -2.0, 3.0, -1.5], [0.99, 1.0, 0.98, 0.99]), unchanged)
    assert not _beats(unchanged, unchanged)
    # A variant without an estimate is beaten by all others.
    failed = trials([math.nan] * 4, [0.1] * 4)
    assert _beats(unchanged, failed)
    assert _is_significantly_less(_error_norms_m(unchanged), _error_norms_m(failed))
    assert not _beats(failed, unchanged)


def test_variants_that_are_invalid_for_the_scene_are_not_tried() -> None:
    tried = variants(one_shot(load_scene("cardiac-background")))
    assert {variant.setting for variant in tried if variant.varied == "estimator"} == {*ESTIMATORS} - {"coherent"}


def test_every_free_setting_of_a_scene_is_varied() -> None:
    tried = variants(one_shot(load_scene("muscle-force")))
    assert {variant.varied for variant in tried} == {
        UNCHANGED,
        "estimator",
        "harmonic",
        "gate",
        "echo tolerance",
        "field",
    }
    assert {variant.setting for variant in tried if variant.varied == "estimator"} == {*ESTIMATORS} - {"coherent"}
    assert "field" not in {variant.varied for variant in variants(one_shot(load_scene("table-1")))}


def test_one_shot_of_a_long_scene_is_measured() -> None:
    scene = one_shot(load_scene("muscle-pulse-rate"))
    assert not scene.sweep.pulse_rate_hz
    assert scene.acquisition.repeats == 1
    assert len(one_shot(load_scene("muscle-force")).excitation.force_fraction) == 1  # type: ignore[union-attr]


@pytest.mark.slow
def test_the_command_writes_the_table_and_reports_its_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def two_kinds(scene: Scene) -> list[Variant]:
        return [variant for variant in variants(scene) if variant.varied in (UNCHANGED, "gate")]

    monkeypatch.setattr(own_scene, "variants", two_kinds)
    table, scene = tmp_path / "mine.csv", tmp_path / "mine.toml"
    from hpe_rig.scene import scene_text as text_of

    scene.write_text(text_of("table-1")[1].replace("pulse_count = 101", "pulse_count = 21"), encoding="utf-8")
    words = ["accuracy", "--scene", str(scene), "--seeds", "2", "--output", str(table)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "seed 2 of 2: gate" in result.output
    with table.open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert {"varied", "setting", "bias", "sd", "error", "time_s", "own", "on_front"} <= read[0].keys()
    assert sum(row["own"] == "True" for row in read) == 1
    assert any(row["on_front"] == "True" for row in read)


def test_invalid_file_names_are_refused_before_the_first_measurement() -> None:
    words = ["accuracy", "--scene", "table-1", "--output", "mine.foo", "--figure", "nowhere/mine.svg"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "mine.foo: unknown format" in result.output
    assert "the folder nowhere does not exist" in result.output
    assert "seed 1" not in result.output


def test_a_part_on_a_scene_is_refused() -> None:
    result = CliRunner().invoke(app, ["accuracy", "motion", "--scene", "table-1"])
    assert result.exit_code == 2
    assert "PART" in result.output
