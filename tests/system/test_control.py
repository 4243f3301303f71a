"""Shots with controls on the twin: a hum at a wanted frequency is subtracted, in every output."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.processing import estimate_controls, shot_fit
from hpe_rig.report.page import _settings_texts
from hpe_rig.runs import json_schema
from hpe_rig.scene import SettingsError, scene_text

HUM_M = 60e-9
SCENE = hpe.load_scene("bovine-muscle").with_(
    {
        "acquisition.repeats": 2,
        "excitation.burst_count": 12,
        "simulation.background": [{"frequency_hz": 100.0, "amplitude_m": HUM_M, "phase_rad": 1.0}],
    }
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    """Return a run with controls, measured by the command."""
    folder = tmp_path_factory.mktemp("control")
    (folder / "scene.toml").write_text(scene_text(SCENE)[1], encoding="utf-8")
    done = CliRunner().invoke(app, ["run", str(folder / "scene.toml"), "--control", "--output", str(folder / "run.h5")])
    assert done.exit_code == 0, done.output
    assert "motion in 2 controls with tonebursts off, subtracted: at most 6" in done.output
    assert "at 100 Hz" in done.output
    return hpe.open_run(folder / "run.h5")


@pytest.mark.slow
def test_a_hum_is_within_u_with_controls_and_far_outside_without(run: hpe.Run, tmp_path: Path) -> None:
    means = [run.estimate().means, hpe.measure(SCENE, path=tmp_path / "without.h5").estimate().means]
    (with_controls, *_), (without, *_) = means
    errors_m = [mean.amplitude_m - (mean.true_amplitude_m or 0.0) for mean in (with_controls, without)]
    assert abs(errors_m[0]) < 2 * with_controls.amplitude_uncertainty_m
    assert abs(errors_m[1]) > 4 * without.amplitude_uncertainty_m
    # The controls add their own noise, and that of the shots they are subtracted from has the same size.
    assert with_controls.amplitude_uncertainty_m == pytest.approx(without.amplitude_uncertainty_m, rel=0.1)


def test_the_motion_in_the_control_is_the_hum_and_is_in_every_output(run: hpe.Run) -> None:
    result = run.estimate()
    assert [shot.index for shot in result.shots] == [0, 2]
    for shot in result.shots:
        assert "motion in the control with tonebursts off" in _settings_texts(shot)[-1]
        control = shot.control[0]
        assert control.tracked_amplitude_m == pytest.approx(HUM_M, abs=4 * control.tracked_amplitude_uncertainty_m)
        budget = {item.source: item for item in shot.estimates[0].budget}
        assert budget["control"].amplitude_m == pytest.approx(control.tracked_amplitude_uncertainty_m, rel=0.1)
        # The hum of the twin keeps its phase: the controls do not differ beyond their noise.
        assert budget["control scatter"].amplitude_m < 3 * budget["control"].amplitude_m
    printed = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    jsonschema.Draft202012Validator(json_schema("result")).validate(printed)
    assert printed["shots"][0]["control"][0]["tracked_amplitude_m"] == result.shots[0].control[0].tracked_amplitude_m
    assert "u_control_m" in result.to_frame().columns
    assert "control" in result.covariance().sources


def test_a_shot_without_its_control_says_so(run: hpe.Run) -> None:
    run.mark(1, bad="door slammed")
    try:
        first, *others = hpe.open_run(run.path).estimate().shots
    finally:
        run.mark(1, bad=None)
    assert first.control == ()
    (warning,) = [text for text in first.warnings if "no control is subtracted" in text]
    assert "shot 2" in warning
    assert "door slammed" in warning
    assert all(shot.control for shot in others)


def test_moduli_fit_the_motion_less_the_hum(run: hpe.Run) -> None:
    stored, plan = run.stored, run.plan
    controls = estimate_controls(run.scene, plan, stored, "coherent")
    raw, corrected = (
        shot_fit(run.scene, plan.shots[0], stored, "coherent", None, item) for item in (None, controls.motions[0][0])
    )
    removed = np.hypot(*(raw.state - corrected.state)[:2])
    assert removed == pytest.approx(HUM_M, rel=0.1)
    assert np.all(np.diag(corrected.state_covariance)[:20] > np.diag(raw.state_covariance)[:20])
    assert np.all(corrected.covariance[:, 0, 0] > raw.covariance[:, 0, 0])


def test_a_control_needs_tonebursts() -> None:
    with pytest.raises(SettingsError, match="control repeats shots with tonebursts off"):
        hpe.load_scene("table-1").with_({"acquisition.control": True})
