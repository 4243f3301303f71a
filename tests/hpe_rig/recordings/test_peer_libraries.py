"""Files of zea and pyuff_ustb, the packages of the authors of both formats, are read, and they read exported runs.

Needs the extra ``foreign``: zea 0.1.8 and pyuff_ustb 3.0.0. zea checks the whole file against its specification.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.recordings import Recording, as_source, read_recording, read_settings
from hpe_rig.runs import Run

# Both leave files to the garbage collector, and JAX warns of its own future.
pytestmark = [
    pytest.mark.external,
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
PULSES, LINES, SAMPLES, RATE_HZ, PULSE_RATE_HZ, CARRIER_HZ = 12, 3, 64, 40e6, 4e3, 5e6
TIME_S = np.arange(SAMPLES) / RATE_HZ
WEIGHTS = np.random.default_rng(4).normal(size=(PULSES, LINES, 1))
IQ = WEIGHTS * np.exp(-(((TIME_S - 0.8e-6) / 0.2e-6) ** 2)) * np.exp(0.3j)
RF = np.real(IQ * np.exp(2j * np.pi * CARRIER_HZ * TIME_S))


def read(source: Path, **options: Any) -> Recording:
    settings, origins = read_settings(None, None, {"lines": "2"} | options)
    return read_recording(as_source(source), settings, origins)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A simulated run of two shots of 40 pulses."""
    folder = tmp_path_factory.mktemp("export")
    scene = hpe.load_scene("bovine-muscle").with_(
        {
            "excitation.burst_count": 3,
            "tracking.pulse_count": 40,
            "acquisition.record_samples": 384,
            "acquisition.repeats": 2,
            "processing.window_start_s": 0.0,
            "processing.frequencies_hz": [100.0],
        }
    )
    return hpe.measure(scene, path=folder / "run.h5")


def test_zea_validates_and_reads_an_exported_run(run: Run, tmp_path: Path) -> None:
    import zea

    hpe.export_run(run, tmp_path / "a.hdf5")
    with zea.File(tmp_path / "a.hdf5") as file:
        assert file.validate() == {"status": "success"}
        assert (file.n_frames, file.n_tx, file.n_ax, file.n_el) == (2, 40, 384, 1)
        volts = file.data.raw_data[1, :, :, 0, 0]
        truth_m = file.custom["true_displacement_m"].data
        parameters = file.load_parameters()
        assert (parameters.sampling_frequency, parameters.center_frequency) == (100e6, 9e6)
        assert float(parameters.initial_times[0]) == pytest.approx(run.plan.shots[0].timeline.record_offset_s[0])
    records = run.records[1]
    np.testing.assert_allclose(volts, records.codes * records.volts_per_code + records.volts_offset, rtol=1e-6)
    assert run.stored.true_displacement_m is not None
    np.testing.assert_array_equal(truth_m[1], run.stored.true_displacement_m[1])


def test_pyuff_reads_an_exported_run(run: Run, tmp_path: Path) -> None:
    import pyuff_ustb as pyuff

    hpe.export_run(run, tmp_path / "a.uff")
    data = pyuff.Uff(str(tmp_path / "a.uff")).read("channel_data")
    assert (data.N_samples, data.N_elements, data.N_waves, data.N_frames) == (384, 1, 40, 2)
    assert (float(data.sampling_frequency), float(data.PRF)) == (100e6, pytest.approx(3990.0))
    assert float(data.pulse.center_frequency) == 9e6
    assert data.sequence[39].wavefront is pyuff.Wavefront.spherical
    assert float(data.sequence[39].source.distance) == pytest.approx(70e-3)
    records = run.records[1]
    volts = records.codes * records.volts_per_code + records.volts_offset
    np.testing.assert_allclose(data.data[:, 0, :, 1].T, volts, rtol=1e-6)


@pytest.mark.parametrize("is_iq", [False, True])
@pytest.mark.parametrize("waves_are_pulses", [False, True])
def test_channel_data_of_pyuff_are_read(is_iq: bool, waves_are_pulses: bool, tmp_path: Path) -> None:
    import pyuff_ustb as pyuff

    samples = (IQ[..., ::4] if is_iq else RF).transpose(2, 1, 0)
    point = pyuff.Point(distance=np.inf, azimuth=0.0, elevation=0.0)
    # In USTB the reference time of a wave is part of its samples' time.
    wave = pyuff.Wave(wavefront=pyuff.Wavefront.plane, source=point, origin=point, delay=0.5e-6, sound_speed=1540.0)
    data = pyuff.ChannelData(
        sampling_frequency=RATE_HZ / (4 if is_iq else 1),
        initial_time=1e-6,
        sound_speed=1540.0,
        modulation_frequency=CARRIER_HZ if is_iq else 0.0,
        pulse=pyuff.Pulse(center_frequency=CARRIER_HZ),
        PRF=PULSE_RATE_HZ,
        probe=pyuff.LinearArray(N=LINES, pitch=3e-4, element_width=2e-4, element_height=5e-3),
        sequence=[wave] * PULSES if waves_are_pulses else wave,
        data=samples[..., None] if waves_are_pulses else samples[:, :, None],
    )
    data.write(str(tmp_path / "a.uff"), "channel_data", ignore_missing_compulsory_fields=True)
    settings, origins = read_settings(None, None, {})
    recording = read_recording(tmp_path / "a.uff", settings, origins, for_map=True)
    np.testing.assert_allclose(recording.values[:, 0], samples.transpose(1, 2, 0), rtol=1e-6, atol=1e-7)
    stated = (recording.sample_rate_hz, recording.carrier_hz, recording.pulse_rate_hz, recording.first_sample_s)
    assert stated == pytest.approx((float(data.sampling_frequency), CARRIER_HZ, PULSE_RATE_HZ, 1.5e-6))
    assert recording.sound_speed_m_per_s == 1540.0
    assert recording.demodulation_hz == (CARRIER_HZ if is_iq else None)


def scan_of(transmits: int, rate_hz: float) -> dict[str, Any]:
    """Return the scan of plane waves that zea requires, without times."""
    return {
        "sampling_frequency": rate_hz,
        "center_frequency": CARRIER_HZ,
        "demodulation_frequency": CARRIER_HZ,
        "sound_speed": 1540.0,
        "initial_times": np.full(transmits, 1e-6, np.float32),
        "t0_delays": np.zeros((transmits, LINES), np.float32),
        "tx_apodizations": np.ones((transmits, LINES), np.float32),
        "focus_distances": np.full(transmits, np.inf, np.float32),
        "transmit_origins": np.zeros((transmits, 3), np.float32),
        "polar_angles": np.zeros(transmits, np.float32),
    }


PROBE = {"name": "test", "probe_geometry": np.zeros((LINES, 3), np.float32)}


@pytest.mark.parametrize("is_iq", [False, True])
@pytest.mark.parametrize("transmits_are_pulses", [False, True])
def test_a_file_of_zea_is_read(is_iq: bool, transmits_are_pulses: bool, tmp_path: Path) -> None:
    import zea

    samples = np.stack([IQ.real, IQ.imag], -1)[:, :, ::4] if is_iq else RF[..., None]
    raw = samples.transpose(0, 2, 1, 3).astype(np.float32)
    raw = raw[None] if transmits_are_pulses else raw[:, None]
    scan = scan_of(raw.shape[1], RATE_HZ / (4 if is_iq else 1))
    scan["time_to_next_transmit"] = np.full(raw.shape[:2], 1 / PULSE_RATE_HZ, np.float32)
    zea.File.create(tmp_path / "a.hdf5", {"raw_data": raw}, scan, probe=PROBE, ignore_warnings=True)
    settings, origins = read_settings(None, None, {})
    recording = read_recording(tmp_path / "a.hdf5", settings, origins, for_map=True)
    expected = IQ[..., ::4] if is_iq else RF
    np.testing.assert_allclose(recording.values[:, 0], expected.transpose(1, 0, 2), rtol=1e-6, atol=1e-6)
    stated = (recording.sample_rate_hz, recording.carrier_hz, recording.pulse_rate_hz, recording.first_sample_s)
    assert stated == pytest.approx((scan["sampling_frequency"], CARRIER_HZ, PULSE_RATE_HZ, 1e-6), rel=1e-6)
    assert recording.demodulation_hz == (CARRIER_HZ if is_iq else None)


def test_the_tracking_pulses_beside_a_push_in_a_file_of_zea_are_read(tmp_path: Path) -> None:
    import zea

    raw = RF.transpose(0, 2, 1)[None, ..., None].astype(np.float32)
    push = {"scan": scan_of(2, RATE_HZ), "label": "push", "transmit_only": True}
    track = {"data": {"raw_data": raw}, "scan": scan_of(PULSES, RATE_HZ), "label": "track"}
    zea.File.create(tmp_path / "a.hdf5", tracks=[push, track], probe=PROBE, ignore_warnings=True)
    with h5py.File(tmp_path / "a.hdf5") as file:
        assert set(file["tracks"]) == {"track_0", "track_1"}
    recording = read(tmp_path / "a.hdf5", pulse_rate_hz=PULSE_RATE_HZ)
    np.testing.assert_allclose(recording.values[0, 0], RF[:, 1], rtol=1e-6, atol=1e-6)
    assert recording.carrier_hz == CARRIER_HZ
