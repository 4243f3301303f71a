"""A run that is exported for other programs keeps its echoes, times and truth, and is imported again unchanged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

import hpe_rig as hpe
from hpe_rig.result import Estimate
from hpe_rig.runs import Run
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError

SCENE = """title = "Two shots"
[excitation]
burst_rate_hz = 100.0
burst_length_s = 100e-6
burst_count = 3
[tracking]
pulse_rate_hz = 2000.0
delay_s = 131e-6
pulse_count = 40
[acquisition]
gate_depth_m = 70.0e-3
gate_length_m = 1.0e-3
record_samples = 384
repeats = 2
[beams]
excitation_width_m = [0.34e-3, 0.34e-3, 3.60e-3]
tracking_width_m = [0.078e-3, 0.078e-3, 0.83e-3]
[processing]
frequencies_hz = [100.0, 200.0]
harmonic = "least_squares"
frequency_accuracy = 0.0
[simulation]
seed = 1
[simulation.specimen]
preset = "bovine_muscle"
force_density_n_per_m3 = 2.2e6
[simulation.receiver]
snr_db = 40.0
"""
FORMATS = {"zea": "hdf5", "uff": "uff", "mat": "mat"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export")
    (path / "scene.toml").write_text(SCENE)
    hpe.measure(path / "scene.toml", path=path / "run.h5")
    return path


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    return hpe.open_run(folder / "run.h5")


@pytest.fixture(scope="module")
def estimates(run: Run) -> tuple[Estimate, ...]:
    """Return the estimates of the run's first shot."""
    return run.estimate().shots[0].estimates


@pytest.mark.parametrize("file_format", FORMATS)
def test_an_exported_run_is_imported_with_the_same_codes_and_motion(
    file_format: str, run: Run, estimates: tuple[Estimate, ...], folder: Path, tmp_path: Path
) -> None:
    exported = tmp_path / f"a.{FORMATS[file_format]}"
    assert hpe.export_run(run, exported) == (f"{exported}: hpe-rig import {exported} --scene SCENE reads it again",)
    again = hpe.import_records(exported, folder / "scene.toml", tmp_path / "again.h5")
    for shot, records in enumerate(run.records):
        other = again.records[shot]
        np.testing.assert_array_equal(other.codes, records.codes)
        assert (other.volts_per_code, other.volts_offset) == pytest.approx(
            (records.volts_per_code, records.volts_offset), rel=1e-12
        )
        # The times of the import count from the first toneburst.
        timeline, other_timeline = run.plan.shots[shot].timeline, again.plan.shots[shot].timeline
        zero_s, other_zero_s = timeline.burst_onset_s[0], other_timeline.burst_onset_s[0]
        np.testing.assert_allclose(
            other_timeline.pulse_onset_s - other_zero_s, timeline.pulse_onset_s - zero_s, atol=1e-13
        )
        assert other_timeline.record_offset_s == pytest.approx(timeline.record_offset_s, rel=1e-12)
    for estimate, other_estimate in zip(estimates, again.estimate().shots[0].estimates, strict=True):
        assert other_estimate.amplitude_m == pytest.approx(estimate.amplitude_m, rel=1e-9)
        assert other_estimate.phase_rad == pytest.approx(estimate.phase_rad, abs=1e-9)
        assert other_estimate.amplitude_uncertainty_m == pytest.approx(estimate.amplitude_uncertainty_m, rel=1e-6)


def test_a_simulated_run_is_exported_with_its_truth(run: Run, estimates: tuple[Estimate, ...], tmp_path: Path) -> None:
    hpe.export_run(run, tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5") as file:
        labels = {name: dataset[()] for name, dataset in file["custom"].items()}
        assert file["custom/true_displacement_m"].attrs["unit"] == "m"
        assert file.attrs["us_machine"] == "hpe_rig, simulated"
    assert run.stored.true_displacement_m is not None
    assert labels["simulated"] == 1
    np.testing.assert_array_equal(labels["true_displacement_m"][1], run.stored.true_displacement_m[1])
    amplitude_m, phase_rad = labels["true_amplitude_m"][0], labels["true_phase_rad"][0]
    for index, estimate in enumerate(estimates):
        assert (amplitude_m[index], phase_rad[index]) == pytest.approx(
            (estimate.true_amplitude_m, estimate.true_phase_rad), rel=1e-12
        )


def test_matlab_gets_variables_with_units_and_a_description(run: Run, tmp_path: Path) -> None:
    hpe.export_run(run, tmp_path / "a.mat")
    variables = loadmat(tmp_path / "a.mat", squeeze_me=True)
    np.testing.assert_array_equal(variables["echo_codes"][:, :, 1], run.records[1].codes.T)
    assert variables["pulse_time_s"].shape == (40, 2)
    assert variables["sample_rate_hz"] == run.scene.acquisition.sample_rate_hz
    described = {line.split(" ")[0] for line in variables["readme"].tolist()}
    assert described == {name for name in variables if not name.startswith("__")} - {"readme"}


def test_a_real_recording_is_exported_as_measured_and_without_truth(folder: Path, tmp_path: Path, run: Run) -> None:
    hpe.export_run(run, tmp_path / "a.uff", shots=[1])
    hpe.import_records(tmp_path / "a.uff", folder / "scene.toml", tmp_path / "again.h5")
    hpe.export_run(tmp_path / "again.h5", tmp_path / "b.hdf5")
    with h5py.File(tmp_path / "b.hdf5") as file:
        assert file.attrs["us_machine"] == "hpe_rig, measured"
        assert "true_displacement_m" not in file["custom"]
        assert file["tracks/track_0/data/raw_data"].shape == (1, 40, 384, 1, 1)
        assert b"a.uff" in file["custom/origin"][()]


@pytest.mark.parametrize("file_format", ["zea", pytest.param("mat", marks=pytest.mark.slow)])
def test_a_missing_record_stays_missing(file_format: str, folder: Path, tmp_path: Path) -> None:
    hpe.export_run(folder / "run.h5", tmp_path / "all.hdf5")
    with h5py.File(tmp_path / "all.hdf5", "r+") as file:
        file["tracks/track_0/data/raw_data"][0, 7] = np.nan
    lossy: dict[str, Any] = {"not_finite": "missing"}
    once = hpe.import_records(tmp_path / "all.hdf5", folder / "scene.toml", tmp_path / "once.h5", **lossy)
    exported = tmp_path / f"a.{FORMATS[file_format]}"
    missing, again = hpe.export_run(once, exported)
    assert missing == "shot 1: 1 missing record"
    # Without the option the import refuses the missing record.
    assert "--set not_finite=missing reads it again" in again
    twice = hpe.import_records(exported, folder / "scene.toml", tmp_path / "twice.h5", **lossy)
    assert np.flatnonzero(~twice.records[0].valid).tolist() == [7]
    volts, other = (
        records.codes * records.volts_per_code + records.volts_offset for records in (once.records[1], twice.records[1])
    )
    # Volts are rounded to codes again, with zero volts between two codes.
    np.testing.assert_allclose(other, volts, rtol=0, atol=1.01 * twice.records[1].volts_per_code)


@pytest.mark.parametrize("gain", [1e3, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_echoes_that_were_changed_after_the_export_are_imported_as_volts(
    gain: float, run: Run, folder: Path, tmp_path: Path
) -> None:
    hpe.export_run(run, tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "r+") as file:
        volts = gain * file["tracks/track_0/data/raw_data"][()]
        file["tracks/track_0/data/raw_data"][...] = volts
    records = hpe.import_records(tmp_path / "a.hdf5", folder / "scene.toml", tmp_path / "again.h5").records[1]
    imported = records.codes * records.volts_per_code + records.volts_offset
    # Half a code of rounding, and zero volts between two codes: the largest value has the code 2^15 - 2.
    np.testing.assert_allclose(imported, volts[1, :, :, 0, 0], rtol=0, atol=1.01 * 2**-15 * np.abs(volts).max())


def test_bad_shots_are_left_out_unless_they_are_named(run: Run, tmp_path: Path) -> None:
    marked = run.mark(0, "cable touched")
    try:
        sentence, _ = hpe.export_run(marked, tmp_path / "a.mat")
        assert sentence == "shot 1 is left out: marked bad: cable touched"
        assert loadmat(tmp_path / "a.mat")["shot_number"].item() == 2
        assert len(hpe.export_run(marked, tmp_path / "b.mat", shots=[0])) == 1
    finally:
        marked.mark(0, None)


def test_shots_of_several_offsets_or_rates_are_exported_together_only_where_a_format_holds_them(
    folder: Path, tmp_path: Path
) -> None:
    scene = hpe.load_scene(folder / "scene.toml").with_({"acquisition.repeats": 1})
    rates = hpe.measure(scene.with_({"sweep.axes": {"tracking.pulse_rate_hz": [2000.0, 2500.0]}}), path=tmp_path / "r")
    with pytest.raises(SettingsError, match=r"UFF holds one pulse rate, the intervals are 0\.0004 to 0\.0005 s"):
        hpe.export_run(rates, tmp_path / "a.uff")
    (sentence,) = hpe.export_run(rates, tmp_path / "a.hdf5")
    assert "its shots differ in pulse_time_s, and hpe-rig import needs one value of it" in sentence
    with pytest.raises(SettingsError, match="time_to_next_transmit differs between frames"):
        hpe.import_records(tmp_path / "a.hdf5", folder / "scene.toml", tmp_path / "again.h5")
    hpe.export_run(rates, tmp_path / "b.uff", shots=[1])
    again = hpe.import_records(tmp_path / "b.uff", scene, tmp_path / "again.h5")
    assert again.scene.tracking.pulse_rate_hz == pytest.approx(2500.0)
    carriers = scene.with_({"sweep.axes": {"tracking.carrier_hz": [9e6, 9.1e6]}})
    with pytest.raises(SettingsError, match=r"several values: tracking\.carrier_hz, 9000000\.0, 9100000\.0"):
        hpe.export_run(hpe.measure(carriers, path=tmp_path / "c"), tmp_path / "c.mat")


@pytest.mark.slow
def test_an_export_promises_no_import_of_several_offsets(folder: Path, tmp_path: Path) -> None:
    scene = hpe.load_scene(folder / "scene.toml").with_(
        {"acquisition.repeats": 1, "sweep.lateral_offset_m": [0.0, 1e-3]}
    )
    run = hpe.measure(scene, path=tmp_path / "wide.h5")
    for ending in FORMATS.values():
        (sentence,) = hpe.export_run(run, tmp_path / f"wide.{ending}")
        assert "its shots differ in lateral_offset_m" in sentence
        assert "reads it again" not in sentence
        with pytest.raises(SettingsError, match="its shots differ in lateral_offset_m"):
            hpe.import_records(tmp_path / f"wide.{ending}", folder / "scene.toml", tmp_path / "again.h5")


def test_a_wrong_request_ends_with_a_message_and_no_file(run: Run, tmp_path: Path, monkeypatch: Any) -> None:
    for name, options, said in (
        ("a.dat", {}, r"the ending of a\.dat implies no format\. Try: one of zea, uff, mat"),
        ("a.mat", {"file_format": "dicom"}, "'dicom' is unknown"),
        ("a.mat", {"file_format": "zea"}, r"a\.mat is no name of a zea file.* Try: a\.hdf5 or a\.h5"),
        ("a.mat", {"shots": [2]}, r"shot 3 does not exist\. Try: 1 to 2"),
    ):
        with pytest.raises(SettingsError, match=said):
            hpe.export_run(run, tmp_path / name, **options)
    monkeypatch.setattr("hpe_rig.runs.exporting.MAX_BYTES", 50_000)
    with pytest.raises(SettingsError, match=r"the echoes take 0\.0 GB"):
        hpe.export_run(run, tmp_path / "a.mat")
    with pytest.raises(StoreError, match=r"the folder .* does not exist"):
        hpe.export_run(run, tmp_path / "absent" / "a.mat")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(StoreError, match="already exists"):
        hpe.export_run(run, run.path, "zea", overwrite=True)
    monkeypatch.undo()
    (tmp_path / "a.mat").write_bytes(b"an older export")
    with pytest.raises(StoreError, match="already exists"):
        hpe.export_run(run, tmp_path / "a.mat")
    hpe.export_run(run, tmp_path / "a.mat", overwrite=True)
    assert "echo_codes" in loadmat(tmp_path / "a.mat")
