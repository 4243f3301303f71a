"""Recordings that other people published are read as their own programs read them.

The files are no part of this repository. Folder HPE_RIG_PUBLIC_FILES holds clones of eight repositories of GitHub:

* scottprahl/RigolWFM at 159e647c, tests/files: 97 files of oscilloscopes of seven vendors, from many owners; 86 were
  read. Refused with the reason: a LeCroy file without samples (lecroy_1.trc), a capture of several acquisitions of
  Rohde & Schwarz, three malformed or purely digital files of an MSO5074, and the five payloads .Wfm.bin, which lack
  their description. DS1102D-A.csv has times without unit, 10 us apart, and is asked for it.
* Lars27/ultrasound-measurements at fab0a202: echoes of a PicoScope and calibrations of hydrophones. The MATLAB file
  (30000, 2) states step and start; the axes of its two channels are asked for. The .wfm files of its program in LabVIEW
  are raw values behind a header. The calibrations are tables of frequencies, which are asked for their unit of time.
* kelu124/un0rick at c7f7c9f: pulse echoes of a board with one element. The times in its NPZ files have no unit: the
  message states the rates that they would be. Its text files are bytes, and are asked for the length of a record.
* Guokr1991/Ultrasound_Elastography at 4e7e313, AM2D: radio-frequency frames of a Siemens scanner with the sampling rate
  in the saved header; two files are two pulses.
* AbdelrahmanZayed/PCA-GLUE_Ultrasound_Elastography at 3dfcd5e: beamformed frames of an Alpinion scanner without rates.
  Two simulated frames of different lengths are refused as such.
* buenlb/verasonics at 424f8df, MonkeyTx/lib/sampleData.mat: a workspace of Verasonics without SeqControl, 4 MB. Its
  buffer of 1.07 GB is nearly empty and refused by its size; with the used rows alone it is read.
* SAFEERHYDER/Ultrasound_Elastography at 8e5261e (in folder SAFEERHYDER): positions of scatterers, and
  swklemmer/ElastographySim at f008a1c: maps of displacement. Neither is an echo; both are asked for axes and rates.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from hpe_rig.recordings import Recording, RecordingSettings, Source, read_recording
from hpe_rig.recordings.importers import read_contents
from hpe_rig.scene import SettingsError

# RigolWFM leaves files to the garbage collector.
pytestmark = [pytest.mark.external, pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")]
VENDORS = "RigolWFM/tests/files"
# Path; shape of the samples; sampling rate and time of the first sample that the file states.
FILES: dict[str, tuple[tuple[int, ...], float, float]] = {
    f"{VENDORS}/wfm/DS1052E.csv": ((8192, 2), 500e6, 0.0),
    f"{VENDORS}/wfm/DS1102E-B.csv": ((600,), 50e6, -6e-6),
    f"{VENDORS}/wfm/DS1204B-A-original.csv": ((8192, 4), 125e3, -32.768e-3),
    f"{VENDORS}/wfm/DS2072A-5.csv": ((1400, 2), 100e6, -2.52e-6),
    f"{VENDORS}/wfm/DS4024-A.csv": ((1356, 2), 500e3, -1.356e-3),
    f"{VENDORS}/rs/rs_rtp_04.Wfm.csv": ((4000,), 40e9, -52.4e-9),
    f"{VENDORS}/rs/rs_rtp_05.bin": ((2, 4000), 40e9, -52.4e-9),
    f"{VENDORS}/trc/lecroy_2.trc": ((1, 100002), 10e6, -1.0000682e-3),
    f"{VENDORS}/trc/lecroy_3.trc": ((1, 20, 502), 1e9, -0.36457937e-6),
    f"{VENDORS}/bin/agilent_3.bin": ((2, 4000), 2e9, -1e-6),
    f"{VENDORS}/bin/DHO824-ch1.bin": ((1, 10000), 2.5e6, -2e-3),
    f"{VENDORS}/wfm/DS1054Z-A.wfm": ((4, 278), 250e6, -0.556e-6),
    "ultrasound-measurements/acquire_ultrasound/matlab/US_2023_09_29_0042.mat": ((30000, 2), 125e6, -24e-6),
}


def public(name: str) -> Path:
    return Path(os.environ["HPE_RIG_PUBLIC_FILES"]) / name


@pytest.mark.parametrize("name", FILES)
def test_a_public_file_is_read_with_its_rate_and_start(name: str) -> None:
    shape, rate_hz, first_s = FILES[name]
    _, contents = read_contents(public(name), RecordingSettings())
    (array,) = contents.arrays.values()
    assert array.shape == shape
    assert np.isfinite(array).all()
    assert contents.stated["sample_rate_hz"][0] == pytest.approx(rate_hz, rel=1e-6)
    assert contents.stated["first_sample_s"][0] == pytest.approx(first_s, rel=1e-6, abs=1e-12)


def test_text_and_binary_of_one_capture_agree() -> None:
    settings = RecordingSettings()
    _, text = read_contents(public(f"{VENDORS}/rs/rs_rtp_05.Wfm.csv"), settings)
    _, binary = read_contents(public(f"{VENDORS}/rs/rs_rtp_05.bin"), settings)
    (volts,), (other,) = text.arrays.values(), binary.arrays.values()
    np.testing.assert_allclose(volts.T, other, rtol=1e-4, atol=1e-6)


def test_two_channels_of_echoes_are_asked_for_their_axes() -> None:
    path = public("ultrasound-measurements/acquire_ultrasound/matlab/US_2023_09_29_0042.mat")
    stated: dict[str, Any] = {"carrier_hz": 5e6, "pulse_rate_hz": 1e3}
    with pytest.raises(SettingsError, match='axes = "sample,line" and record_samples'):
        read_recording(path, RecordingSettings.model_validate(stated))


def test_a_raw_file_of_another_program_is_read_behind_its_header() -> None:
    path = public("ultrasound-measurements/analyse_ultrasound_results/measure_speed_of-sound/python")
    raw = {"dtype": "float32", "byte_order": "big", "header_bytes": 52, "shape": (5000, 2)}
    _, contents = read_contents(path / "US_2023_10_20_0051.wfm", RecordingSettings.model_validate(raw))
    (volts,) = contents.arrays.values()
    assert 1e-3 < np.abs(volts).max() < 20.0


def read(source: Source, **stated: Any) -> Recording:
    return read_recording(source, RecordingSettings.model_validate(stated))


@pytest.mark.parametrize("name", ["20210117173109", "20240208182809_ndt"])
def test_times_without_unit_are_no_rate_but_a_suggestion(name: str) -> None:
    path = public(f"un0rick/usb/{name}.npz")
    stated: dict[str, Any] = {"axes": "pulse,sample", "carrier_hz": 5e6, "pulse_rate_hz": 1e3}
    with pytest.raises(SettingsError, match=r"'t' ascends by 0\.015625: 64 if in s, 6\.4e\+07 if in us"):
        read(path, **stated)
    recording = read(path, **stated, sample_rate_hz=64e6)
    with np.load(path) as file:
        np.testing.assert_array_equal(recording.values[0, 0], file["signal"])


def test_bytes_in_a_text_file_are_asked_for_the_length_of_a_record() -> None:
    path = public("un0rick/images/20180403/p_A-130us-1-VGA@0x22-spimode1-64msps.csv")
    with pytest.raises(SettingsError, match="a signal of 16640 samples has no axis pulse"):
        read(path, sample_rate_hz=64e6, carrier_hz=5e6, pulse_rate_hz=1e3)


@pytest.mark.parametrize(
    ("names", "variable"), [(("rf01", "rf03"), "RfDataDouble"), (("rf052", "rf054"), "RfDataFilt")]
)
def test_frames_of_a_siemens_scanner_state_their_sampling_rate(names: tuple[str, str], variable: str) -> None:
    paths = tuple(public(f"Ultrasound_Elastography/AM2D/{name}.mat") for name in names)
    recording = read(paths, axes="pulse,sample,line", carrier_hz=6.67e6, pulse_rate_hz=30.0, lines="100")
    assert recording.sample_rate_hz == 40e6
    for path, pulse in zip(paths, recording.values[0, 0], strict=True):
        np.testing.assert_array_equal(pulse, loadmat(path)[variable][:, 99])


def test_frames_of_an_alpinion_scanner_are_asked_for_their_rates() -> None:
    folder = public("PCA-GLUE_Ultrasound_Elastography")
    paths = tuple(folder / f"{index}_layer0_idx{index}_BDATA_BF.mat" for index in (248, 253))
    with pytest.raises(SettingsError, match="sample_rate_hz: neither options") as refused:
        read(paths)
    assert str(refused.value).count("\n") == 4
    rates = {"sample_rate_hz": 40e6, "carrier_hz": 10e6, "pulse_rate_hz": 30.0}
    recording = read(paths, axes="pulse,sample,line", lines="100", **rates)
    np.testing.assert_array_equal(recording.values[0, 0, 1], loadmat(paths[1])["BfData"][:, 99])
    simulated = tuple(folder / f"Im{index}_with_tstart_level_1.mat" for index in (0, 1))
    with pytest.raises(SettingsError, match=r"holds samples of \(2285, 250\), Im0_with_tstart_level_1\.mat of"):
        read(simulated, **rates)


def test_the_used_rows_of_a_verasonics_workspace_are_256_acquisitions(tmp_path: Path) -> None:
    path = public("verasonics/MonkeyTx/lib/sampleData.mat")
    with pytest.raises(SettingsError, match="than the 256 MB that this file may expand to"):
        read(path)
    variables = {name: value for name, value in loadmat(path).items() if not name.startswith("__")}
    rows = variables["RcvData"][0, 0][:65536]
    variables["RcvData"][0, 0] = rows
    savemat(tmp_path / "used.mat", variables)
    recording = read(tmp_path / "used.mat", pulse_rate_hz=100.0, lines="1")
    np.testing.assert_array_equal(recording.values[0, 0], rows[:, 0].reshape(256, 256))
    stated = (recording.sample_rate_hz, recording.carrier_hz, recording.sound_speed_m_per_s, recording.first_sample_s)
    assert stated == pytest.approx((62.5e6 / 24, 62.5e6 / 96, 1490.0, 0.0))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("SAFEERHYDER/cyst_phantom_test/pht_data.mat", "(1000, 3)"),
        ("ElastographySim/out_experiments/random_experiment_d23.9_win_1.50.mat", "(20, 200, 200)"),
    ],
)
def test_numbers_that_are_no_echoes_are_asked_for_axes_and_rates(name: str, shape: str) -> None:
    with pytest.raises(SettingsError, match="the order of axes of") as refused:
        read(public(name))
    for said in (shape, "sample_rate_hz", "carrier_hz", "pulse_rate_hz"):
        assert said in str(refused.value)
