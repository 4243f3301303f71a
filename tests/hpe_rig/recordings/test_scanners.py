"""Files in the layouts of USTB, zea and Verasonics come in with what they state, and damaged ones with one message."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hpe_rig.recordings import Recording, as_source, read_recording, read_settings
from hpe_rig.scene import SettingsError

PULSES, LINES, SAMPLES, RATE_HZ, PULSE_RATE_HZ, CARRIER_HZ = 12, 3, 64, 40e6, 4e3, 5e6
TIME_S = np.arange(SAMPLES) / RATE_HZ
WEIGHTS = np.random.default_rng(4).normal(size=(PULSES, LINES, 3))
ENVELOPES = np.exp(-(((TIME_S - np.array([[0.5], [0.8], [1.1]]) * 1e-6) / 0.2e-6) ** 2))
"""Three echoes, (echo, sample); narrow enough in frequency for I and Q at the carrier's rate."""
RF = WEIGHTS @ (ENVELOPES * np.cos(2 * np.pi * CARRIER_HZ * TIME_S))


def read(source: Path, **options: Any) -> Recording:
    settings, origins = read_settings(None, None, {"lines": "2"} | options)
    return read_recording(as_source(source), settings, origins)


def write(path: Path, values: Mapping[str, Any]) -> Path:
    with h5py.File(path, "w") as file:
        for name, value in values.items():
            if value is not None:
                file[name] = value
    return path


def uff(array: Any, **changed: Any) -> dict[str, Any]:
    """Return channel data of USTB: (frame, wave, channel, sample), numbers as matrices of one value."""
    numbers = {
        "sampling_frequency": RATE_HZ,
        "initial_time": 1e-6,
        "modulation_frequency": 0.0,
        "sound_speed": 1540.0,
        "PRF": PULSE_RATE_HZ,
        "pulse/center_frequency": CARRIER_HZ,
    } | changed
    values = {name: None if value is None else np.full((1, 1), value, "f4") for name, value in numbers.items()}
    arrays = {"data/real": array.real.astype("f4"), "data/imag": array.imag.astype("f4")}
    return {f"channel_data/{name}": value for name, value in (values | arrays).items()}


def zea(array: Any, **changed: Any) -> dict[str, Any]:
    """Return a zea file: (frame, transmit, sample, element, component)."""
    scan = {
        "sampling_frequency": RATE_HZ,
        "center_frequency": CARRIER_HZ,
        "demodulation_frequency": 0.0,
        "sound_speed": 1540.0,
        "initial_times": np.full(array.shape[1], 1e-6),
        "time_to_next_transmit": np.full(array.shape[:2], 1 / PULSE_RATE_HZ),
    } | changed
    return {"data/raw_data": array.astype("f4")} | {f"scan/{name}": value for name, value in scan.items()}


def zea_frames(values: Any) -> Any:
    """Return samples (pulse, line, sample) as frames of one transmit."""
    return values.transpose(0, 2, 1)[:, None, :, :, None]


@pytest.mark.parametrize("transmits_are_pulses", [False, True])
@pytest.mark.parametrize("layout", ["uff", "zea"])
def test_real_samples_come_in_with_every_rate_that_the_file_states(
    layout: str, transmits_are_pulses: bool, tmp_path: Path
) -> None:
    array = RF[:, None] if layout == "uff" else zea_frames(RF)
    array = array.swapaxes(0, 1) if transmits_are_pulses else array
    path = write(tmp_path / f"a.{layout}", uff(array) if layout == "uff" else zea(array))
    recording = read(path, **({} if layout == "uff" else {"format": "hdf5"}))
    np.testing.assert_allclose(recording.values[0, 0], RF[:, 1], rtol=1e-6, atol=1e-6)
    stated = (recording.sample_rate_hz, recording.carrier_hz, recording.pulse_rate_hz, recording.first_sample_s)
    assert stated == pytest.approx((RATE_HZ, CARRIER_HZ, PULSE_RATE_HZ, 1e-6))
    assert recording.sound_speed_m_per_s == 1540.0
    assert "are the pulses" in recording.inferred[0]


def plain_uff(array: Any, *delays_s: float) -> dict[str, Any]:
    """Return real channel data as USTB and pyuff_ustb write them, one dataset, with a delay of every wave."""
    values = {name: value for name, value in uff(array).items() if not name.startswith("channel_data/data/")}
    delays = {f"channel_data/sequence/sequence_{n + 1:04d}/delay": [[value]] for n, value in enumerate(delays_s)}
    return values | {"channel_data/data": array} | delays


def test_the_time_of_real_samples_in_uff_includes_the_delay_of_their_wave(tmp_path: Path) -> None:
    recording = read(write(tmp_path / "a.uff", plain_uff(RF[None], *([0.5e-6] * PULSES))))
    np.testing.assert_allclose(recording.values[0, 0], RF[:, 1])
    assert recording.first_sample_s == pytest.approx(1.5e-6)
    assert recording.carrier_hz == CARRIER_HZ


def test_times_without_unit_are_suggested_as_rates(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", rf=RF[:, 1], t=np.arange(SAMPLES) / 40)
    with pytest.raises(SettingsError, match=r"'t' ascends by 0\.025: 40 if in s, 4e\+07 if in us"):
        read(tmp_path / "a.npz", axes="pulse,sample", lines="1", carrier_hz=CARRIER_HZ, pulse_rate_hz=PULSE_RATE_HZ)


def test_transmits_of_several_frames_are_pulses_of_several_shots(tmp_path: Path) -> None:
    frames = zea_frames(RF).swapaxes(0, 1)
    both = np.concatenate([frames, -frames])
    recording = read(write(tmp_path / "a.hdf5", zea(both)))
    np.testing.assert_allclose(recording.values[0], [RF[:, 1], -RF[:, 1]], rtol=1e-6, atol=1e-6)
    assert recording.inferred[0] == "zea: 12 transmits of each frame are the pulses, 2 frames are the shots"


def test_demodulated_samples_come_in_as_i_and_q(tmp_path: Path) -> None:
    iq = (WEIGHTS @ ENVELOPES)[..., ::4] * np.exp(0.3j)
    components = np.stack([iq.real, iq.imag], axis=-1).transpose(0, 2, 1, 3)[:, None]
    files = (
        write(
            tmp_path / "a.hdf5",
            zea(components, sampling_frequency=RATE_HZ / 4, demodulation_frequency=CARRIER_HZ),
        ),
        write(
            tmp_path / "a.uff",
            uff(
                iq[:, None],
                sampling_frequency=RATE_HZ / 4,
                modulation_frequency=CARRIER_HZ,
                **{"pulse/center_frequency": None},
            ),
        ),
    )
    for path in files:
        settings, origins = read_settings(None, None, {})
        recording = read_recording(path, settings, origins, for_map=True)
        np.testing.assert_allclose(recording.values[:, 0], iq.transpose(1, 0, 2), rtol=1e-5, atol=1e-5)
        assert (recording.demodulation_hz, recording.carrier_hz) == (CARRIER_HZ, CARRIER_HZ)


def test_pixels_of_a_linear_scan_are_lines_and_depths(tmp_path: Path) -> None:
    x_m, z_m = np.array([-1e-3, 0.0, 1e-3]), 1540.0 * (1e-6 + TIME_S) / 2
    pixels = uff(RF.reshape(PULSES, 1, 1, -1), sampling_frequency=None, initial_time=None)
    # The depths of pixels contain the delays of the waves, which may differ.
    delays = {f"channel_data/sequence/sequence_000{number}/delay": [[number * 1e-6]] for number in (1, 2)}
    scan = {"channel_data/scan/x_axis": x_m, "channel_data/scan/z_axis": z_m}
    path = write(tmp_path / "a.uff", pixels | scan | delays)
    recording = read(path, lines="all")
    np.testing.assert_allclose(recording.values[:, 0], RF.transpose(1, 0, 2), rtol=1e-6, atol=1e-6)
    assert (recording.sample_rate_hz, recording.first_sample_s) == pytest.approx((RATE_HZ, 1e-6))
    np.testing.assert_allclose(recording.line_position_m, x_m)


UFF, ZEA = uff(RF[:, None]), zea(zea_frames(RF))
TRAINS = zea(np.concatenate([zea_frames(RF).swapaxes(0, 1)] * 2))
DAMAGED: dict[str, tuple[dict[str, Any], str]] = {
    "zea of four axes": (ZEA | {"data/raw_data": RF[:, None]}, "(12, 3, 64) is not stated"),
    "zea of three components": (ZEA | {"data/raw_data": np.ones((12, 1, 64, 1, 3))}, "axis iq has a length of 3"),
    "zea without rate": (ZEA | {"scan/sampling_frequency": None}, "sample_rate_hz: neither options"),
    "zea with a wrong rate": (
        ZEA | {"scan/sampling_frequency": -1.0},
        "'scan/sampling_frequency' of the file states -1",
    ),
    "zea without carrier": (ZEA | {"scan/center_frequency": None}, "carrier_hz: neither options"),
    "zea without intervals": (ZEA | {"scan/time_to_next_transmit": None}, "pulse_rate_hz: neither options"),
    "zea with too few intervals": (ZEA | {"scan/time_to_next_transmit": np.ones((5, 1))}, "5 times"),
    "zea with intervals of zero": (ZEA | {"scan/time_to_next_transmit": np.zeros((12, 1))}, "do not ascend"),
    "zea with intervals that are not finite": (
        ZEA | {"scan/time_to_next_transmit": np.full((12, 1), np.nan)},
        "do not ascend",
    ),
    "zea with other intervals per frame": (
        TRAINS | {"scan/time_to_next_transmit": np.array([[1e-3], [2e-3]]) * np.ones(12)},
        "differs between frames",
    ),
    "zea of transmits with other starts": (
        TRAINS | {"scan/initial_times": np.arange(12) * 1e-6},
        "scan/initial_times differs between transmits (0 to 1.1e-05)",
    ),
    "zea of transmits with other frequencies": (
        TRAINS | {"scan/center_frequency": np.linspace(4e6, 6e6, 12)},
        "scan/center_frequency differs between transmits",
    ),
    "zea of one pulse": (zea(zea_frames(RF[:1])), "1 pulses"),
    "zea of two tracks": (
        {f"tracks/{track}/{name}": value for track in "ab" for name, value in ZEA.items()},
        'holds the samples tracks/a/data/raw_data, tracks/b/data/raw_data. Try: variable = "tracks/a/data/raw_data"',
    ),
    "UFF with half the imaginary part": (UFF | {"channel_data/data/imag": np.ones((6, 1, 3, 64))}, "real part of"),
    "UFF without rate": (UFF | {"channel_data/sampling_frequency": None}, "sample_rate_hz: neither options"),
    "UFF without pulse rate": (UFF | {"channel_data/PRF": None}, "pulse_rate_hz: neither options"),
    "UFF without carrier": (UFF | {"channel_data/pulse/center_frequency": None}, "carrier_hz: neither options"),
    "UFF with a pulse rate of zero": (UFF | {"channel_data/PRF": 0.0}, "'channel_data/PRF' of the file states 0"),
    "UFF with an impossible sound speed": (UFF | {"channel_data/sound_speed": 1.54}, "of the file states 1.54"),
    "UFF with a late first sample": (UFF | {"channel_data/initial_time": 1e9}, "of the file states 1e+09"),
    "UFF with values that are not finite": (uff(np.where(RF > 0, RF, np.nan)[:, None]), "not finite"),
    "UFF of waves with other delays": (plain_uff(RF[None], *TIME_S[:12]), "sequence/delay differs between waves (0 to"),
    "UFF of zeros": (uff(0 * RF[:, None]), "no selected record holds an echo"),
    "UFF of five axes": (uff(RF[:, None, None]), "several arrays may be the samples"),
    "UFF of pixels without sound speed": (
        UFF
        | {"channel_data/sound_speed": None}
        | {"channel_data/scan/x_axis": [0.0, 1.0], "channel_data/scan/z_axis": np.arange(32.0)},
        "states depths of pixels and no sound_speed",
    ),
    "UFF of two objects": (
        UFF | {name.replace("channel", "b"): value for name, value in UFF.items()},
        'Try: variable = "b_data/data"',
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_refused_with_what_is_wrong(name: str, tmp_path: Path) -> None:
    values, said = DAMAGED[name]
    with pytest.raises(SettingsError) as refused:
        read(write(tmp_path / "a.h5", values))
    assert said in str(refused.value)


def test_one_of_several_objects_is_selected_by_its_name(tmp_path: Path) -> None:
    path = write(tmp_path / "a.uff", UFF | {name.replace("channel", "b"): value for name, value in UFF.items()})
    recording = read(path, variable="/channel_data/data")
    np.testing.assert_allclose(recording.values[0, 0], RF[:, 1], rtol=1e-6, atol=1e-6)


RECEIVE = {
    "startSample": [float(SAMPLES * pulse + 1) for pulse in range(PULSES)],
    "endSample": [float(SAMPLES * (pulse + 1)) for pulse in range(PULSES)],
    "framenum": [1.0] * PULSES,
    "decimSampleRate": [40.0] * PULSES,
    "demodFrequency": [5.0] * PULSES,
    "startDepth": [2.5] * PULSES,
}
SEQUENCE = [("jump", 1.0), ("timeToNextAcq", 250.0), ("transferToHost", np.zeros((0, 0))), ("timeToNextAcq", 9000.0)]


def verasonics(rows: Any, sequence: Any = SEQUENCE, **receive: Any) -> dict[str, Any]:
    """Return the variables of a workspace of Verasonics: (row, channel, frame) in a cell."""
    fields = {name: column for name, column in (RECEIVE | receive).items() if column is not None}
    structures = np.empty((1, len(next(iter(fields.values())))), [(name, object) for name in fields])
    for name, column in fields.items():
        structures[name][0] = column
    commands = np.empty((1, len(sequence)), [("command", object), ("argument", object)])
    for index, command in enumerate(sequence):
        commands[0, index] = command
    cell = np.empty((1, 1), object)
    cell[0, 0] = rows
    return {
        "RcvData": cell,
        "Receive": structures,
        "SeqControl": commands,
        "Trans": {"frequency": 5.0, "ElementPos": np.zeros((128, 5))},
        "Resource": {"Parameters": {"speedOfSound": 1540.0}},
    }


def save_v73(path: Path, variables: Mapping[str, Any]) -> Path:
    """Write cells and arrays of structures as MATLAB's version 7.3 does: references, axes in reverse order."""
    with h5py.File(path, "w") as file:

        def referred(value: Any) -> Any:
            codes = np.frombuffer(value.encode("utf-16-le"), np.uint16)[:, None] if isinstance(value, str) else value
            return file.create_dataset(f"#refs#/{len(file['#refs#'])}", data=np.atleast_2d(codes).T).ref

        file.create_group("#refs#")
        for name in ("Receive", "SeqControl"):
            for field in variables[name].dtype.names:
                column = variables[name][field][0]
                references = file.create_dataset(f"{name}/{field}", (column.size, 1), h5py.ref_dtype)
                references[:, 0] = [referred(value) for value in column]
        file.create_dataset("RcvData", (1, 1), h5py.ref_dtype)[0, 0] = referred(variables["RcvData"][0, 0])
        for name, value in variables["Trans"].items():
            if not isinstance(value, str):
                file[f"Trans/{name}"] = np.atleast_2d(value).T
        file["Resource/Parameters/speedOfSound"] = [[1540.0]]
    return path


ROWS = np.rint(RF * 1000).astype("i2").transpose(0, 2, 1).reshape(-1, LINES)
"""All acquisitions of one frame, (row, channel)."""


@pytest.mark.parametrize("version", [pytest.param(5, marks=pytest.mark.slow), 7.3])
def test_rows_of_a_verasonics_buffer_are_divided_into_acquisitions(version: float, tmp_path: Path) -> None:
    # Rows behind the last acquisition are not used.
    variables, path = verasonics(np.concatenate([ROWS, np.ones((100, LINES), "i2")])), tmp_path / "a.mat"
    if version == 5:
        savemat(path, variables)
    else:
        save_v73(path, variables)
    recording = read(path)
    np.testing.assert_array_equal(recording.values[0, 0], ROWS[:, 1].reshape(PULSES, SAMPLES))
    stated = (recording.sample_rate_hz, recording.carrier_hz, recording.pulse_rate_hz, recording.sound_speed_m_per_s)
    assert stated == pytest.approx((RATE_HZ, CARRIER_HZ, PULSE_RATE_HZ, 1540.0))
    assert recording.first_sample_s == pytest.approx(2 * 2.5 / 5e6)
    assert recording.inferred[0] == (
        "Verasonics: 12 acquisitions are the pulses; the shortest timeToNextAcq of 250, 9000 us counts"
    )


@pytest.mark.parametrize("one_acquisition", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_frames_are_pulses_or_shots(one_acquisition: bool, tmp_path: Path) -> None:
    frames = ROWS.reshape(PULSES, SAMPLES, LINES).transpose(1, 2, 0) if one_acquisition else np.stack([ROWS, -ROWS], -1)
    one = {name: column[:1] for name, column in RECEIVE.items()}
    savemat(tmp_path / "a.mat", verasonics(frames, **(one if one_acquisition else {})))
    recording = read(tmp_path / "a.mat")
    samples = ROWS[:, 1].reshape(PULSES, SAMPLES)
    np.testing.assert_array_equal(recording.values[0], [samples] if one_acquisition else [samples, -samples])


@pytest.mark.parametrize("decimation", [2, *(pytest.param(count, marks=pytest.mark.slow) for count in (3, 4))])
def test_bandwidth_sampling_becomes_i_and_q_at_one_time(decimation: int, tmp_path: Path) -> None:
    # Echoes narrower than the rate of the pairs, 20 MHz / 8: their spectrum is below 1e-6 beyond it.
    time_s = np.arange(240) / 20e6
    motion_s = 1e-8 * np.sin(np.arange(PULSES))[:, None]
    envelope = np.exp(-(((time_s - motion_s - 6e-6) / 1e-6) ** 2))
    echoes = envelope * np.cos(2 * np.pi * CARRIER_HZ * (time_s - motion_s))
    pairs = echoes.reshape(PULSES, -1, 2 * decimation)[..., :2].reshape(PULSES, -1)
    length = pairs.shape[1]
    receive = {
        "startSample": [float(length * pulse + 1) for pulse in range(PULSES)],
        "endSample": [float(length * (pulse + 1)) for pulse in range(PULSES)],
        "decimSampleRate": [20.0] * PULSES,
        "quadDecim": [float(decimation)] * PULSES,
    }
    save_v73(tmp_path / "a.mat", verasonics(pairs.reshape(-1, 1), **receive))
    settings, origins = read_settings(None, None, {})
    recording = read_recording(tmp_path / "a.mat", settings, origins, for_map=True)
    expected = (envelope * np.exp(-2j * np.pi * CARRIER_HZ * motion_s))[:, :: 2 * decimation]
    np.testing.assert_allclose(recording.values[0, 0], expected, atol=1e-5)
    assert recording.sample_rate_hz == pytest.approx(20e6 / (2 * decimation))
    assert recording.demodulation_hz == CARRIER_HZ


DAMAGED_BUFFERS: dict[str, tuple[dict[str, Any], str]] = {
    "several buffers": (verasonics(ROWS, bufnum=[1.0] * 6 + [2.0] * 6), "RcvData holds several buffers"),
    "other lengths": (verasonics(ROWS, endSample=[*RECEIVE["endSample"][:-1], 760.0]), "acquisitions have 56, 64"),
    "too few rows": (verasonics(ROWS[:-9]), "Receive ends at sample 768, the frame has 759 rows"),
    "no pulse rate": (verasonics(ROWS, [("jump", 1.0)]), "pulse_rate_hz: neither options"),
    "no sampling rate": (verasonics(ROWS, decimSampleRate=None), "sample_rate_hz: neither options"),
    "two sampling rates": (verasonics(ROWS, decimSampleRate=[40.0, 20.0] * 6), "Receive.decimSampleRate differs"),
    "no quadratures": (verasonics(ROWS, quadDecim=[2.0] * 12), "are no quadratures of demodFrequency = 5"),
    "one acquisition": (verasonics(ROWS[:64], **{name: column[:1] for name, column in RECEIVE.items()}), "1 pulses"),
    "wavelengths of no frequency": (verasonics(ROWS) | {"Trans": {"name": "L7-4"}}, "Trans.frequency is absent"),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if name == "one acquisition" else []) for name in DAMAGED_BUFFERS],
)
def test_a_damaged_buffer_is_refused_with_what_is_wrong(name: str, tmp_path: Path) -> None:
    variables, said = DAMAGED_BUFFERS[name]
    # Version 7.3 is read in this process. It has no array of one structure.
    (savemat if variables["Receive"].size == 1 else save_v73)(tmp_path / "a.mat", variables)
    with pytest.raises(SettingsError) as refused:
        read(tmp_path / "a.mat")
    assert said in str(refused.value)
