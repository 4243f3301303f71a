"""A stored run is estimated again with other settings of its processing; those of its acquisition are refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.scene import SettingsError


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    return hpe.measure("table-1", path=tmp_path_factory.mktemp("runs") / "run.h5")


def printed(*arguments: object) -> str:
    result = CliRunner().invoke(app, [*map(str, arguments)], env={"COLUMNS": "400"})
    return result.output


def test_another_fit_of_a_stored_run_gives_the_result_of_a_scene_with_it_and_says_so(
    run: hpe.Run, tmp_path: Path
) -> None:
    settings = {"processing.harmonic": "kalman", "processing.process_noise": 1e-3}
    scene = hpe.load_scene("table-1").with_(settings)
    expected = hpe.measure(scene, path=tmp_path / "kalman.h5").estimate("coherent")
    kalman, usual = run.with_(settings).estimate("coherent"), run.estimate("coherent")
    assert kalman.shots[0].estimates == expected.shots[0].estimates != usual.shots[0].estimates
    assert set(kalman.warnings) - set(expected.warnings) == {
        "estimated with other settings than the scene's: processing.harmonic = kalman, processing.process_noise = 0.001"
    }


def test_true_values_are_left_out_at_frequencies_and_depths_of_which_the_file_holds_none(run: hpe.Run) -> None:
    (usual,) = run.with_({"processing.frequencies_hz": [200.0]}).estimate().shots[0].estimates
    assert usual.true_amplitude_m == pytest.approx(1e-6)
    gate_depth_m = run.scene.acquisition.gate_depth_m
    for changed in ({"processing.frequencies_hz": [190.0]}, {"acquisition.gate_depth_m": gate_depth_m + 1e-3}):
        result = run.with_(changed).refreshed().estimate()
        other = result.shots[0].estimates[0]
        assert (other.true_amplitude_m, other.phase_error_rad) == (None, None)
        omitted = ("comparison with true values", "the run file holds those of other frequencies or another depth")
        assert omitted in result.omitted


def test_process_has_the_settings_of_run_and_names_the_fit_for_an_estimator_that_is_one(run: hpe.Run) -> None:
    refused = printed("process", run.path, "--estimator", "kalman")
    option = re.search(r"--set \S+kalman", refused)
    assert option is not None
    accepted = printed("process", run.path, "--estimator", "coherent", *option[0].split())
    assert "WARNING estimated with other settings than the scene's: processing.harmonic = kalman" in accepted


def test_the_earlier_names_for_a_linear_drift_work_with_a_warning(run: hpe.Run) -> None:
    settings = {"processing.drift": "linear"}
    with pytest.warns(FutureWarning, match=r"with_\(\{'processing\.drift'"):
        assert run.with_drift("linear").changes == settings
    text = printed("process", run.path, "--drift", "linear")
    assert "--drift linear is --set processing.drift=linear since version 1.0" in text
    assert "WARNING estimated with other settings than the scene's: processing.drift = linear" in text


def test_settings_of_the_acquisition_are_refused(run: hpe.Run) -> None:
    with pytest.raises(SettingsError, match=r"tracking\.pulse_rate_hz: cannot change after the measurement"):
        run.with_({"tracking.pulse_rate_hz": 3e3})
    with pytest.raises(SettingsError, match=r"tracking\.delay_s: cannot change after the measurement"):
        run.sweep({"tracking.delay_s": [0.0, 1e-4]})
    with pytest.raises(SettingsError, match=r"did you mean processing\.harmonic"):
        run.with_({"harmonic": "kalman"})


def test_the_list_of_runs_states_the_values_as_the_result_does(run: hpe.Run) -> None:
    amplitude, phase = re.findall(
        r"\S+ \+- \S+ (?:nm|um|deg)\b", printed("process", run.path).partition("simulated")[0]
    )
    assert f"{amplitude}, {phase} at 200 Hz" in printed("list", run.path.parent)
