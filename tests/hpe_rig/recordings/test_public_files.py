"""Recordings that other people published are read as their own programs read them.

The files are no part of this repository. Folder HPE_RIG_PUBLIC_FILES holds clones of two repositories of GitHub:

* scottprahl/RigolWFM at 159e647c, tests/files: 97 files of oscilloscopes of seven vendors, from many owners; 86 were
  read. Refused with the reason: a LeCroy file without samples (lecroy_1.trc), a capture of several acquisitions of
  Rohde & Schwarz, three malformed or purely digital files of an MSO5074, and the five payloads .Wfm.bin, which lack
  their description. DS1102D-A.csv has times without unit, 10 us apart, and is asked for it.
* Lars27/ultrasound-measurements at fab0a202: echoes of a PicoScope and calibrations of hydrophones. The MATLAB file
  (30000, 2) states step and start; the axes of its two channels are asked for. The .wfm files of its program in LabVIEW
  are raw values behind a header. The calibrations are tables of frequencies, which are asked for their unit of time.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.recordings import RecordingSettings, read_recording
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
