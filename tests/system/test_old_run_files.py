"""Run files of earlier versions are still read, estimated, resumed and reported; see tests/fixtures/README.md."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hpe_rig.measurement import prepare, prepare_resumption, record_run, resume
from hpe_rig.report import write_report
from hpe_rig.runs import open_run, process
from hpe_rig.scene import SettingsError, parse_scene
from hpe_rig.store import list_runs, read_covariance, read_run, read_snapshots

FIXTURES = Path(__file__).parents[1] / "fixtures" / "run_files"
NAMES = ("specimen", "aborted", "compressed")
SHAPES = {"specimen": (2, 119, 192), "aborted": (4, 41, 192), "compressed": (2, 41, 192)}
CHAIN = "cross_spectrum"
"""The estimator of the paper: the others have become better since, it stays as published."""
SINGLE = 1e-5
"""Relative difference from numbers of versions whose spectra were of single precision: at most 4e-6, of a residual.

With the samples in double precision those versions differ from this one by 1e-8.
"""
TRACKED_NAMES = (
    "amplitude_m",
    "amplitude_uncertainty_m",
    "phase_rad",
    "phase_uncertainty_rad",
    "amplitude_error",
    "phase_error_rad",
)
PRESENT_NAMES = {name: f"tracked_{name}" for name in TRACKED_NAMES}
ENGINE = SINGLE
"""The same where the twin computes the echoes anew, to the tolerance of its echo engine, and rounds them to codes."""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """Return a folder with copies of the run files, which a test may write beside."""
    shutil.copytree(FIXTURES, tmp_path / "runs")
    return tmp_path / "runs"


def shots_of(name: str) -> list[dict[str, Any]]:
    """Return the shots of a result as the earlier version printed them, with the numbers and names of this version.

    The scenes have no beams: the corrected values are null.
    """
    shots: list[dict[str, Any]] = json.loads((FIXTURES / f"{name}.json").read_text(encoding="utf-8"))["shots"]
    for shot in shots:
        shot["shot"] += 1
        shot["repeat"] += 1
        shot["estimates"] = [
            {PRESENT_NAMES.get(key, key): value for key, value in estimate.items() if "corrected" not in key}
            for estimate in shot["estimates"]
        ]
    return shots


def assert_alike(found: Any, expected: Any, relative: float, where: str = "") -> None:
    """Compare nested tables key by key; ``found`` may say more, and words may have changed."""
    match expected:
        case dict():
            for key, value in expected.items():
                assert key in found, f"{where}.{key} is gone"
                if key == "warnings" and found.get("complete") is False:
                    # Of a shot in which the run stopped it was once said that its triggers were lost.
                    continue
                assert_alike(found[key], value, relative, f"{where}.{key}")
        case list():
            assert len(found) == len(expected), where
            for index, (one, other) in enumerate(zip(found, expected, strict=True)):
                assert_alike(one, other, relative, f"{where}[{index}]")
        case float():
            # Errors against the truth are differences of nearly equal numbers: rounding counts against 1 there.
            # The truth of a prescribed motion was once fitted at whole picoseconds: 1e-12 s at some 100 Hz.
            # So it does for phases: one near zero is known no better than another.
            phase = where.endswith("phase_rad")
            rounding = 1e-9 if where.endswith("true_phase_rad") else relative if "error" in where or phase else 1e-15
            assert found == pytest.approx(expected, rel=relative, abs=rounding), where
        case str():
            assert isinstance(found, str), where
        case _:
            assert found == expected, where


@pytest.mark.parametrize("name", NAMES)
def test_an_old_run_file_is_read_record_by_record(name: str) -> None:
    path = FIXTURES / f"{name}.h5"
    run = read_run(path)
    assert run.records.shape == SHAPES[name]
    assert run.simulated
    assert run.scene_toml == (FIXTURES / f"{name}.toml").read_text(encoding="utf-8")
    shots = [0, 1] if name == "aborted" else range(SHAPES[name][0])
    assert len(read_snapshots(path)) == len(shots)
    if name == "compressed":
        pytest.importorskip("hdf5plugin")
    with h5py.File(path) as file:
        for shot in shots:
            recorded = file["records/recorded"][shot] == 1
            assert recorded.sum() == (25 if (name, shot) == ("aborted", 1) else SHAPES[name][1])
            np.testing.assert_array_equal(run.records[shot].codes[recorded], file["records/echo"][shot][recorded])


def test_the_monitor_channel_of_an_old_run_file_is_read() -> None:
    monitor = read_run(FIXTURES / "compressed.h5").records.monitor(1)
    assert monitor is not None
    assert monitor.codes.shape == SHAPES["compressed"][1:]
    assert read_run(FIXTURES / "specimen.h5").records.monitor(0) is None


@pytest.mark.parametrize("name", NAMES)
def test_an_old_run_file_gives_the_numbers_that_its_version_gave(copied: Path, name: str) -> None:
    """Fits once left out a sine without its cosine, so that numbers of ``specimen`` depended on time zero, by 0.1 u.

    Those in its table are of the fit that does not.
    """
    result = process(copied / f"{name}.h5", CHAIN).as_dict()
    expected = json.loads((FIXTURES / f"{name}.json").read_text(encoding="utf-8"))
    for key in ("title", "status", "simulated", "estimator"):
        assert result[key] == expected[key]
    assert_alike(result["shots"], shots_of(name), SINGLE)


def test_the_comparison_notices_a_number_that_differs(copied: Path) -> None:
    shots = process(copied / "specimen.h5", CHAIN).as_dict()["shots"]
    shots[1]["estimates"][0]["tracked_phase_rad"] += 1e-4
    with pytest.raises(AssertionError, match=r"\[1\].estimates\[0\].tracked_phase_rad"):
        assert_alike(shots, shots_of("specimen"), SINGLE)


def test_an_old_run_is_resumed_and_equals_one_that_was_not_interrupted(copied: Path) -> None:
    rest = prepare_resumption(copied / "aborted.h5")
    assert rest.complete == 1
    done = resume(rest)
    resumed = read_run(done)
    assert (resumed.status, resumed.predecessor) == ("complete", "aborted.h5")
    assert resumed.shot_complete.all()
    assert_alike(process(done, CHAIN).as_dict()["shots"], shots_of("aborted-resumed"), ENGINE)
    whole = read_run(record_run(prepare(str(copied / "aborted.toml")), copied / "whole.h5"))
    for shot in range(1, 4):
        # The first shot is the old version's; the others this version has measured in both files.
        np.testing.assert_array_equal(resumed.records[shot].codes, whole.records[shot].codes)
    np.testing.assert_array_equal(resumed.records[0].codes, read_run(copied / "aborted.h5").records[0].codes)


@pytest.mark.parametrize(
    "setting",
    [
        "process_noise = 1e-3",
        'harmonic = "medium_prior"',
        'harmonic = "medium_prior"\nestimator = "cross_spectrum"',
        "[beams]\nexcitation_width_m = [1.7e-4, 1.7e-4, 1.8e-3]\ntracking_width_m = [7.8e-5, 7.8e-5, 8.3e-4]\n"
        "pulse_length_m = 1e-5\nfocus_depth_m = 50e-3",
    ],
)
def test_a_run_opens_whose_settings_a_younger_rule_would_refuse(copied: Path, setting: str) -> None:
    path = copied / "aborted.h5"
    with h5py.File(path, "r+") as file:
        text = bytes(file["scene"][()]).decode()
        younger = (
            f"{text}{setting}\n" if "[beams]" in setting else text.replace("[processing]", f"[processing]\n{setting}")
        )
        del file["scene"]
        file["scene"] = np.bytes_(younger.encode())
    with pytest.raises(SettingsError):
        parse_scene("of today", younger)
    run = open_run(path)
    assert run.stored.scene_toml == younger
    assert len(run.estimate(CHAIN).shots) == 2


def test_a_run_that_names_the_removed_estimator_joint_is_read_as_coherent(copied: Path) -> None:
    path = copied / "aborted.h5"
    with h5py.File(path, "r+") as file:
        text = bytes(file["scene"][()]).decode().replace("[processing]", '[processing]\nestimator = "joint"')
        del file["scene"]
        file["scene"] = np.bytes_(text.encode())
    with pytest.raises(SettingsError, match=r"joint.* was removed, use coherent"):
        parse_scene("new", text)
    run = open_run(path)
    assert run.estimate().as_dict()["estimator"] == "coherent"
    assert len(run.estimate("kasai").shots) == 2
    assert np.isfinite(run.displacement_m(0)).any()


def test_a_run_is_resumed_whose_settings_a_younger_rule_would_refuse(copied: Path) -> None:
    path = copied / "aborted.h5"
    with h5py.File(path, "r+") as file:
        younger = bytes(file["scene"][()]).decode().replace("[processing]", "[processing]\nprocess_noise = 1e-3")
        del file["scene"]
        file["scene"] = np.bytes_(younger.encode())
    assert read_run(resume(prepare_resumption(path))).shot_complete.all()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "aborted" else pytest.mark.slow) for name in NAMES]
)
def test_a_report_is_written_of_an_old_run_file(copied: Path, name: str, request: pytest.FixtureRequest) -> None:
    if name == "aborted":
        # The default file; pictures take most of the time.
        request.getfixturevalue("page_without_pictures")
    title = json.loads((FIXTURES / f"{name}.json").read_text(encoding="utf-8"))["title"]
    page = write_report(copied / f"{name}.h5", None, None, None)
    text = Path(page).read_text(encoding="utf-8")
    assert title in text
    assert "<svg" in text


def test_an_old_result_file_states_its_corrected_amplitude_and_counts_shots_from_1(copied: Path) -> None:
    result = copied / "specimen.kasai.h5"
    shutil.move(copied / "result-version-1.h5", result)
    assert read_covariance(result).shot.tolist() == [2]
    # The result leaves out shot 1, which version 1 called 0.
    open_run(copied / "specimen.h5").mark(0, bad="air bubble")
    lead = {entry.path.name: entry.lead for entry in list_runs(copied)[0]}["specimen.h5"]
    assert lead is not None
    assert (lead.amplitude_m, lead.amplitude_uncertainty_m) == pytest.approx((3.13738e-6, 7.04309e-8), rel=1e-5)
