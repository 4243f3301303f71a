"""Amplitude and phase over depth from one acquisition, as a user gets them: table, file, report, moduli."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.cli.tables import print_result
from hpe_rig.medium import HarmonicMedium, PushForce, TrackedRegion, shear_motion
from hpe_rig.report import write_report
from hpe_rig.report.page import _depth_pictures
from hpe_rig.result import Result, result_csv

TRUTH = {"shear_modulus_pa": 7.25e3, "viscosity_pa_s": 1.0}
SHORT = {
    "sweep.lateral_offset_m": [1e-3, 3.5e-3],
    "excitation.burst_count": 15,
    "processing.window_start_s": 50e-3,
    "processing.frequencies_hz": [100.0, 200.0, 300.0, 500.0],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    scene = hpe.load_scene("gelatin-moduli").with_({**SHORT, "processing.gate_profile_step_m": 0.5e-3})
    return hpe.measure(scene, path=tmp_path_factory.mktemp("depth") / "run.h5")


@pytest.fixture(scope="module")
def result(run: hpe.Run) -> Result:
    return run.estimate()


def test_a_profile_is_the_field_of_the_medium_within_its_uncertainty(result: Result) -> None:
    assert [round(gate.depth_m * 1e3, 2) for gate in result.profile if gate.shot.index == 0] == [69, 69.5, 70, 70.5, 71]
    for gate in result.profile:
        for estimate in gate.shot.estimates:
            omega = 2 * math.pi * estimate.frequency_hz
            hz, force = np.array([estimate.frequency_hz]), PushForce((0.34e-3,), 3.6e-3)
            medium = HarmonicMedium(hz, np.array([7.25e3 + 1j * omega]))
            regions = (TrackedRegion(np.array([gate.shot.lateral_offset_m]), z) for z in (gate.depth_m - 70e-3, 0.0))
            here, focus = (shear_motion(medium, force, region).value[0, 0] for region in regions)
            [own] = [each for each in result.shots if each.index == gate.shot.index]
            [there] = [each for each in own.estimates if each.frequency_hz == estimate.frequency_hz]
            assert there.true_amplitude_m is not None
            assert there.true_phase_rad is not None
            # the twin's force acts at all depths at once: what is deeper is sensed that much later
            later_rad = omega * (gate.depth_m - 70e-3) / 1540
            found = abs(here / focus) * there.true_amplitude_m
            off_rad = math.remainder(
                estimate.phase_rad - there.true_phase_rad - np.angle(here / focus) - later_rad, math.tau
            )
            assert abs(estimate.amplitude_m - found) < 4 * estimate.amplitude_uncertainty_m
            assert abs(off_rad) < 4 * estimate.phase_uncertainty_rad


def test_rows_of_gates_follow_those_of_the_shots(result: Result) -> None:
    frame, rows = result.to_frame(), list(csv.DictReader(io.StringIO(result_csv(result))))
    own = sum(len(shot.estimates) for shot in result.shots)
    of_gates = [(gate, each) for gate in result.profile for each in gate.shot.estimates]
    assert len(frame) == len(rows) == own + len(of_gates) == 2 * 4 * 6
    assert frame["gate_depth_m"][:own].isna().all()
    for row, (gate, each) in zip(rows[own:], of_gates, strict=True):
        assert float(row["gate_depth_m"]) == gate.depth_m
        assert float(row["amplitude_m"]) == each.amplitude_m
        assert row["true_amplitude_m"] == ""


def test_the_scenes_own_gate_is_one_of_them_and_says_the_same(result: Result) -> None:
    own = [gate for gate in result.profile if gate.depth_m == 70e-3]
    for gate, shot in zip(own, result.shots, strict=True):
        for there, here in zip(gate.shot.estimates, shot.estimates, strict=True):
            assert (there.amplitude_m, there.phase_rad) == (here.amplitude_m, here.phase_rad)
            assert (there.interval_95_m, there.interval_95_rad) == (here.interval_95_m, here.interval_95_rad)
            assert there.true_amplitude_m is None


def test_the_motion_within_the_burst_period_is_that_of_the_harmonics(run: hpe.Run, result: Result) -> None:
    gate = next(gate for gate in result.profile if gate.depth_m == 70e-3)
    time_s, moved_m = np.array(gate.motion_time_s), np.array(gate.motion_m)
    assert time_s.size == 40
    turn = np.exp(-2j * np.pi * 100.0 * time_s)
    first = 2 * np.mean(moved_m * turn) * 1j
    estimate = gate.shot.estimates[0]
    expected = estimate.tracked_amplitude_m * np.exp(1j * estimate.tracked_phase_rad)
    # pulses stand anywhere in a part of the period: at most half of its 250 us from the middle
    assert abs(first - expected) < 2 * np.pi * 100.0 * 125e-6 * abs(expected)


def test_the_result_file_holds_profile_and_motion_over_depth(run: hpe.Run, result: Result) -> None:
    path = run.save(result)
    with xarray.open_dataset(path, group="profile", engine="h5netcdf") as profile:
        assert profile.amplitude_m.dims == ("shot", "depth", "frequency")
        np.testing.assert_allclose(profile.depth * 1e3, [69, 69.5, 70, 70.5, 71])
        assert profile.depth.units == "m"
        first = next(gate for gate in result.profile if gate.shot.shot == 2).shot.estimates[0]
        assert float(profile.tracked_amplitude_m.sel(shot=2, frequency=100.0)[0]) == first.tracked_amplitude_m
    with xarray.open_dataset(path, group="burst_period", engine="h5netcdf") as motion:
        assert motion.displacement_m.dims == ("shot", "depth", "time")
        assert np.isfinite(motion.displacement_m).all()


def test_a_stored_run_gives_the_profile_that_its_scene_did_not_ask_for(
    run: hpe.Run, result: Result, capsys: pytest.CaptureFixture[str]
) -> None:
    again = run.with_profile(1e-3).estimate()
    print_result(again)
    assert capsys.readouterr().out.count("OVER DEPTH at 100 Hz") == 2
    coarse = [gate for gate in result.profile if round(gate.depth_m * 1e6) % 1000 == 0]
    assert [gate.shot.estimates for gate in again.profile] == [gate.shot.estimates for gate in coarse]
    refused = CliRunner().invoke(app, ["process", str(run.path), "--gate-profile-step", "50mm"])
    assert refused.exit_code != 0
    assert "gate_profile_step_m" in refused.output


DEPTH_PICTURES = ("Amplitude over depth", "Phase over depth", "Motion over depth and burst period")


def test_the_pictures_of_a_shot_are_amplitude_phase_and_motion_over_depth(result: Result) -> None:
    titles = [picture.title.partition(",")[0] for picture in _depth_pictures(result, result.shots[0])]
    assert titles == list(DEPTH_PICTURES)


@pytest.mark.slow
def test_the_report_draws_amplitude_phase_and_motion_over_depth(run: hpe.Run, tmp_path: Path) -> None:
    page = write_report(run.path, output=tmp_path / "page.html").read_text(encoding="utf-8")
    assert all(title in page for title in DEPTH_PICTURES)


def test_moduli_of_all_depths_are_the_twins(run: hpe.Run) -> None:
    deep = hpe.fit_moduli(run, laws=["voigt"])
    assert not deep.best.excluded
    assert len(deep.vibrations) == 6
    assert sum("share echoes" in text for text in deep.omitted) == 2
    for name, true in TRUTH.items():
        assert abs(deep.best.values[name] - true) < 3 * deep.best.uncertainty[name]
