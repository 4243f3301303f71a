"""Result files: what other programs read in them, and the covariance that comes back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from hpe_rig.measurement import prepare_text, record_run
from hpe_rig.result import MOTION_UNITS, UNITS, Result
from hpe_rig.result.values import GateResult
from hpe_rig.runs import process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, read_covariance, verify, write_result


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("result") / "run.h5"
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    text = text.replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256")
    return process(record_run(prepare_text("small", text), path))


def test_estimates_and_motion_are_arrays_over_shot_and_frequency_with_units(result: Result, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_result(path, result)
    with h5py.File(path) as file:
        facts = {name: file.attrs[name] for name in ("format", "version", "title", "estimator", "phase_reference")}
        assert facts == {
            "format": "hpe_rig result",
            "version": 2,
            "title": result.title,
            "estimator": result.estimator,
            "phase_reference": result.phase_reference,
        }
        assert file.attrs["simulated"]
        assert json.loads(file["json"][()]) == result.as_dict()
        group = file["results"]
        assert (group["shot"][()].tolist(), group["frequency"][()].tolist()) == ([1, 2], [200.0])
        assert group["frequency"].attrs["units"] == "Hz"
        for name, unit in UNITS.items():
            stated = [[getattr(estimate, name) for estimate in shot.estimates] for shot in result.shots]
            expected = [[np.nan if value is None else value for value in row] for row in stated]
            np.testing.assert_array_equal(group[name][()], expected)
            assert group[name].attrs["units"] == unit
            assert [axis[0].name for axis in group[name].dims] == ["/results/shot", "/results/frequency"]
        motion = file["motion"]
        for shot, row in zip(result.shots, motion["displacement_m"][()], strict=True):
            assert shot.motion is not None
            np.testing.assert_array_equal(row, shot.motion.displacement_m)
        assert motion["pulse"][()].tolist() == list(range(48))
        assert {name: motion[name].attrs["units"] for name in MOTION_UNITS if name in motion} == {
            name: unit for name, unit in MOTION_UNITS.items() if name in motion
        }
        assert motion.attrs["tracked_by"] == result.shots[0].motion.tracked_by  # type: ignore[union-attr]
        assert motion["time_s"].attrs["long_name"].endswith(result.phase_reference)
        assert "profile" not in file
    assert verify(path).as_dict()["sound"]


def test_the_covariance_comes_back_bit_for_bit_and_files_without_one_are_named(result: Result, tmp_path: Path) -> None:
    path, expected = tmp_path / "a.h5", result.covariance()
    write_result(path, result)
    covariance = read_covariance(path)
    for name in ("shot", "frequency_hz", "phasor_m", "influence_m", "variable", "degrees_of_freedom"):
        np.testing.assert_array_equal(getattr(covariance, name), getattr(expected, name))
    assert (covariance.source, covariance.common_to) == (expected.source, expected.common_to)
    with h5py.File(path, "a") as file:
        group = file["covariance"]
        assert [axis[0].name.rpartition("/")[2] for axis in group["influence_m"].dims][:2] == ["shot", "frequency"]
        assert group["phasor_m"].attrs["units"] == "m"
        # Version 1 counted shots from 0.
        file.attrs["version"] = 1
    np.testing.assert_array_equal(read_covariance(path).shot, expected.shot + 1)
    with h5py.File(path, "a") as file:
        values = file["covariance/influence_m"][()]
        del file["covariance/influence_m"]
        file["covariance/influence_m"] = np.concatenate([values, values])
    with pytest.raises(StoreError, match="its values and their influences differ in shape"):
        read_covariance(path)
    with h5py.File(path, "a") as file:
        del file["covariance"]
    with pytest.raises(StoreError, match=r"a\.h5: no covariance can be read .*hpe-rig process with the run file"):
        read_covariance(path)


def test_gates_over_depth_are_rows_of_shots_and_columns_of_depths(result: Result, tmp_path: Path) -> None:
    first, second = result.shots
    times_s = (0.0, 1e-3)
    profile = (
        GateResult(71e-3, 1e-3, first, times_s, (1e-6, -1e-6)),
        GateResult(69e-3, 2e-3, first, times_s, (2e-6, -2e-6)),
        GateResult(69e-3, 2e-3, second),
    )
    path = tmp_path / "a.h5"
    write_result(path, replace(result, profile=profile))
    with h5py.File(path) as file:
        group = file["profile"]
        assert group["shot"][()].tolist() == [1, 2]
        assert group["depth"][()].tolist() == [69e-3, 71e-3]
        assert group["depth"].attrs["units"] == "m"
        assert group["frequency"].attrs["units"] == "Hz"
        np.testing.assert_array_equal(group["gate_length_m"][()], [[2e-3, 1e-3], [2e-3, np.nan]])
        amplitude_m = group["amplitude_m"][()]
        assert amplitude_m.shape == (2, 2, 1)
        assert amplitude_m[0, 0, 0] == amplitude_m[0, 1, 0] == first.estimates[0].amplitude_m
        assert amplitude_m[1, 0, 0] == second.estimates[0].amplitude_m
        assert np.isnan(amplitude_m[1, 1, 0])
        period = file["burst_period"]
        np.testing.assert_array_equal(
            period["displacement_m"][()],
            [[[2e-6, -2e-6], [1e-6, -1e-6]], [[np.nan, np.nan], [np.nan, np.nan]]],
        )
        assert period["time"][()].tolist() == list(times_s)
        assert (period["time"].attrs["units"], period["depth"].attrs["units"]) == ("s", "m")
    write_result(path, replace(result, profile=profile[2:]))
    with h5py.File(path) as file:
        assert "burst_period" not in file


def test_only_a_result_file_is_replaced(result: Result, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"thesis")
    with pytest.raises(StoreError, match=r"a\.h5 exists and is not a result file of hpe-rig"):
        write_result(path, result)
    assert path.read_bytes() == b"thesis"
    with pytest.raises(StoreError, match=r"cannot be written \(.*The run file is as it was"):
        write_result(tmp_path / "absent" / "a.h5", result)
