"""Displacement pulse by pulse: against the truth, in the file, through xarray; JSON as its schema says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.result import Result
from hpe_rig.runs import json_schema
from hpe_rig.store import verify, write_result


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    scene = hpe.load_scene("table-1").with_({"acquisition.repeats": 2, "notes.operator": "A. B."})
    return hpe.measure(scene, path=tmp_path_factory.mktemp("motion") / "run.h5")


@pytest.fixture(scope="module")
def result(run: hpe.Run) -> Result:
    result = run.estimate()
    run.save(result)
    return result


def test_the_displacement_lies_within_its_uncertainty_of_the_truth(run: hpe.Run, result: Result) -> None:
    """The true motion, its scale and offset free, leaves a chi-square of one a pulse: 0.07 by chance with 2 x 99."""
    squares = []
    for shot in result.shots:
        assert shot.motion is not None
        true_m = run.stored.true_displacement_m[shot.index][shot.motion.pulse]  # type: ignore[index]
        columns = np.stack([true_m, np.ones_like(true_m)], axis=1)
        state = np.linalg.lstsq(columns, shot.motion.displacement_m, rcond=None)[0]
        squares.append(((shot.motion.displacement_m - columns @ state) / shot.motion.uncertainty_m) ** 2)
        assert np.allclose(shot.motion.displacement_m, run.displacement_m(shot.index), atol=1e-15)
    assert np.mean(squares) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 198))


def test_the_model_is_made_of_the_result_s_harmonics(result: Result) -> None:
    (estimate,), motion = result.shots[0].estimates, result.shots[0].motion
    assert motion is not None
    wave_m = estimate.tracked_amplitude_m * np.sin(
        2 * np.pi * estimate.frequency_hz * motion.time_s + estimate.tracked_phase_rad
    )
    offset_m = motion.model_m - wave_m
    assert np.ptp(offset_m) < 1e-15
    assert np.mean(motion.residual_m) == pytest.approx(0.0, abs=1e-15)
    assert motion.tracked_by == "coherent"


def test_xarray_reads_the_file_with_axes_and_units(run: hpe.Run, result: Result) -> None:
    beside = run.path.with_name("run.coherent.h5")
    assert verify(beside).as_dict()["sound"]
    with xarray.open_dataset(beside, group="motion", engine="h5netcdf") as stored:
        assert dict(stored.sizes) == {"shot": 2, "pulse": 101}
        assert {name: stored[name].attrs["units"] for name in stored} == {
            "time_s": "s",
            **dict.fromkeys(("displacement_m", "displacement_uncertainty_m", "model_m", "residual_m"), "m"),
        }
        dataset = result.to_xarray()
        np.testing.assert_array_equal(stored.displacement_m, dataset.displacement_m)
        np.testing.assert_array_equal(stored.residual_m, dataset.displacement_m - dataset.model_m)
    assert dataset.amplitude_m.sel(shot=2, frequency=200.0).item() == result.shots[1].estimates[0].amplitude_m
    assert dataset.time_s.dims == ("shot", "pulse")
    assert dataset.repeat.values.tolist() == [1, 2]
    assert [shot["repeat"] for shot in result.as_dict()["shots"]] == [1, 2]
    assert dataset.attrs["note_operator"] == "A. B."


def test_motion_is_by_the_estimator_of_the_result(run: hpe.Run) -> None:
    motion = run.estimate("cross_spectrum").shots[0].motion
    assert motion is not None
    assert motion.tracked_by == "cross_spectrum"
    assert np.isfinite(motion.displacement_m).all()


def test_json_is_as_its_schema_says(result: Result) -> None:
    schema = json_schema("result")
    validator = jsonschema.Draft202012Validator(schema)
    jsonschema.Draft202012Validator.check_schema(schema)
    printed = json.loads(json.dumps(result.as_dict()))
    validator.validate(printed)
    # Without beams, truth and repeats much is unknown.
    echoes = np.sin(np.arange(200) / 3.0) + 1e-3 * np.random.default_rng(1).normal(size=(60, 200))
    settings = {"sample_rate_hz": 100e6, "pulse_rate_hz": 4e3, "carrier_hz": 5e6, "frequencies_hz": [200.0]}
    validator.validate(json.loads(json.dumps(hpe.estimate(echoes, **settings).as_dict())))  # type: ignore[arg-type]
    del printed["shots"][0]["residual_m"]
    printed["shots"][1]["estimates"][0]["phase_rad"] = "none"
    printed["another"] = 1
    assert len(list(validator.iter_errors(printed))) == 3
    done = CliRunner().invoke(app, ["schema", "result"])
    assert json.loads(done.stdout) == schema


def test_shots_of_different_frequencies_share_a_file(result: Result, tmp_path: Path) -> None:
    (estimate,) = result.shots[0].estimates
    pair = (replace(estimate, frequency_hz=100.0), replace(estimate, frequency_hz=300.0))
    mixed = replace(result, shots=(result.shots[0], replace(result.shots[1], estimates=pair)))
    write_result(tmp_path / "mixed.h5", mixed)
    with xarray.open_dataset(tmp_path / "mixed.h5", group="results", engine="h5netcdf") as stored:
        assert stored.frequency_hz.values.tolist()[1] == [100.0, 300.0]
        assert np.isnan(stored.frequency_hz.values[0, 1])
        np.testing.assert_array_equal(stored.frequency_hz, mixed.to_xarray().frequency_hz)
