"""Error against run time on one's own scene: through the real run, one thing varied at a time, the front marked."""

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
from hpe_rig.scene.scene import Scene, load_scene
from hpe_rig.study import one_shot
from hpe_rig.validation.accuracy.own_scene import (
    OWN,
    SceneRow,
    Way,
    _beats,
    _Trial,
    scene_rows,
    scene_text,
    ways,
)


@pytest.fixture(scope="module")
def tiny() -> Scene:
    return load_scene("table-1").with_({"tracking.pulse_count": 21, "acquisition.repeats": 3})


@pytest.fixture(scope="module")
def rows(tiny: Scene) -> list[SceneRow]:
    told: list[str] = []
    chosen = [
        Way(OWN, "coherent", {}),
        Way("estimator", "cross_spectrum", {"processing.estimator": "cross_spectrum"}),
        Way("gate", "half", {"acquisition.gate_length_m": 0.5e-3}),
        Way("echo tolerance", "coarse", {"simulation.scatterers.echo_tolerance": 0.1}, True),
        Way("estimator", "none such", {"processing.frequencies_hz": [200.0, 201.0]}),
    ]
    found = scene_rows(one_shot(tiny), None, chosen, 3, tell=told.append)
    assert len(told) == 3 * len(chosen)
    return found


def test_a_way_is_as_wrong_as_its_runs_say(rows: list[SceneRow], tiny: Scene, tmp_path: Path) -> None:
    from hpe_rig.runs import measure

    errors = []
    for seed in (1, 2, 3):
        run = measure(one_shot(tiny).with_({"simulation.seed": seed}), path=tmp_path / f"{seed}.h5")
        (estimate,) = run.estimate("cross_spectrum").shots[0].estimates
        assert estimate.corrected_amplitude_m is not None
        errors.append(estimate.corrected_amplitude_m / 1000e-9 - 1)
    own = rows[1]
    assert own.bias == pytest.approx(abs(sum(errors)) / 3, rel=1e-9)
    assert own.error == pytest.approx(math.sqrt(sum(e**2 for e in errors) / 3), rel=1e-9)


def test_what_is_varied_changes_the_error_and_what_gives_up_says_so(rows: list[SceneRow]) -> None:
    assert len({row.error for row in rows[:4]}) == 4
    assert math.isnan(rows[4].error)
    assert not rows[4].on_front
    assert "gave up" in scene_text(rows)
    assert [row.own for row in rows] == [True, False, False, False, False]
    assert all(row.time_s > row.estimation_s > 0 for row in rows[:4])


def test_the_page_says_what_the_scene_buys_where_something_beats_it(rows: list[SceneRow]) -> None:
    own = replace(rows[0], on_front=False, error=0.02, time_s=1.0)
    faster = replace(rows[2], on_front=True, beats_own=True, error=0.005, time_s=0.5)
    text = scene_text([own, faster])
    assert "gate half beats the scene's own settings: rms error 0.5 instead of 2 %, 0.5 instead of 1 s" in text
    assert "resolution in depth" in text
    assert "lie on the Pareto front" in scene_text([replace(own, on_front=True), replace(faster, beats_own=False)])


def trials(errors_m: list[float], times_s: list[float]) -> list[_Trial]:
    return [
        _Trial(np.array([error_m]), np.ones(1), time_s, time_s)
        for error_m, time_s in zip(errors_m, times_s, strict=True)
    ]


def test_a_way_beats_another_by_more_than_chance_and_is_worse_in_nothing() -> None:
    own = trials([1.0, -2.0, 3.0, -1.5], [1.0, 1.01, 0.99, 1.0])
    halves = trials([0.5, -1.0, 1.5, -0.75], [1.0, 1.0, 1.0, 1.0])
    assert _beats(halves, own)
    assert not _beats(own, halves)
    # As true, but faster; then slower and truer: neither beats the other.
    assert _beats(trials([1.0, -2.0, 3.0, -1.5], [0.5] * 4), own)
    dear = trials([0.5, -1.0, 1.5, -0.75], [2.0] * 4)
    assert not _beats(dear, own)
    assert not _beats(own, dear)
    # A mean that chance makes smaller, and a gain of 1 %, are none.
    assert not _beats(trials([0.5, -2.2, 2.5, -1.8], [1.0] * 4), own)
    assert not _beats(trials([1.0, -2.0, 3.0, -1.5], [0.99, 1.0, 0.98, 0.99]), own)
    assert not _beats(own, own)
    # Giving up is worse than anything.
    gave_up = trials([math.nan] * 4, [0.1] * 4)
    assert _beats(own, gave_up)
    assert not _beats(gave_up, own)


def test_what_a_scene_cannot_have_is_not_tried() -> None:
    tried = ways(one_shot(load_scene("cardiac-background")))
    assert {way.setting for way in tried if way.varied == "estimator"} == {*ESTIMATORS} - {"coherent", "joint"}


def test_everything_that_a_scene_leaves_open_is_varied() -> None:
    tried = ways(one_shot(load_scene("muscle-force")))
    assert {way.varied for way in tried} == {OWN, "estimator", "harmonic", "gate", "echo tolerance", "field"}
    assert {way.setting for way in tried if way.varied == "estimator"} == {*ESTIMATORS} - {"coherent"}
    assert "field" not in {way.varied for way in ways(one_shot(load_scene("table-1")))}


def test_one_shot_of_a_long_scene_is_measured() -> None:
    scene = one_shot(load_scene("muscle-pulse-rate"))
    assert not scene.sweep.pulse_rate_hz
    assert scene.acquisition.repeats == 1
    assert len(one_shot(load_scene("muscle-force")).excitation.force_fraction) == 1  # type: ignore[union-attr]


def test_the_command_writes_the_table_and_tells_its_progress(tmp_path: Path) -> None:
    table, scene = tmp_path / "mine.csv", tmp_path / "mine.toml"
    from hpe_rig.scene.scene import scene_text as text_of

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


def test_names_of_files_that_cannot_be_are_refused_before_anything_is_measured() -> None:
    words = ["accuracy", "--scene", "table-1", "--output", "mine.foo", "--figure", "nowhere/mine.svg"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "mine.foo is no format it has" in result.output
    assert "there is no folder nowhere" in result.output
    assert "seed 1" not in result.output


def test_a_part_on_a_scene_is_refused() -> None:
    result = CliRunner().invoke(app, ["accuracy", "motion", "--scene", "table-1"])
    assert result.exit_code == 2
    assert "PART" in result.output
