"""Cells, arrays of structures, signals of consecutive records and several files become the pulses that they hold."""

from __future__ import annotations

import sys
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.recordings import Recording, as_source, read_recording, read_settings
from hpe_rig.scene import SettingsError

PULSES, SAMPLES, RATE_HZ, PULSE_RATE_HZ = 11, 32, 40e6, 4e3
RF = np.random.default_rng(8).normal(size=(PULSES, SAMPLES))
RATES = {"carrier_hz": 5e6, "pulse_rate_hz": PULSE_RATE_HZ, "sample_rate_hz": RATE_HZ}


def read(source: Any, options: dict[str, Any] | None = None) -> Recording:
    settings, origins = read_settings(None, None, RATES if options is None else options)
    return read_recording(as_source(source), settings, origins)


def test_fields_of_an_array_of_structures_are_pulses_with_their_times(tmp_path: Path) -> None:
    elements = np.zeros((1, PULSES), dtype=[("rf", object), ("t", object)])
    for pulse in range(PULSES):
        elements[0, pulse] = (RF[pulse], pulse / PULSE_RATE_HZ)
    savemat(tmp_path / "a.mat", {"data": elements, "fs": RATE_HZ, "fc": 5e6})
    recording = read(tmp_path / "a.mat", {})
    np.testing.assert_array_equal(recording.values[0, 0], RF)
    assert recording.pulse_rate_hz == pytest.approx(PULSE_RATE_HZ)
    assert "'data.rf' of (11, 1, 32): axes of length 1 are dropped" in recording.inferred


def test_elements_of_a_cell_are_pulses(tmp_path: Path) -> None:
    cell = np.empty((PULSES, 1), object)
    cell[:, 0] = list(RF)
    savemat(tmp_path / "a.mat", {"rf": cell})
    recording = read(tmp_path / "a.mat", RATES | {"axes": "pulse,sample"})
    np.testing.assert_array_equal(recording.values[0, 0], RF)
    # The same cell in version 7.3: references to matrices, whose axes are in reverse order.
    with h5py.File(tmp_path / "b.mat", "w") as file:
        references = file.create_dataset("rf", (1, PULSES), dtype=h5py.ref_dtype)
        for pulse in range(PULSES):
            references[0, pulse] = file.create_dataset(f"#refs#/{pulse}", data=RF[pulse][:, None]).ref
    recording = read(tmp_path / "b.mat", RATES | {"axes": "pulse,sample"})
    np.testing.assert_array_equal(recording.values[0, 0], RF)


def test_a_signal_of_consecutive_records_is_divided_into_pulses(tmp_path: Path) -> None:
    two = np.stack([RF.reshape(-1), -RF.reshape(-1)], axis=-1)
    with h5py.File(tmp_path / "kwave.h5", "w") as file:
        file["p"], file["dt"], file["Nt"] = two[None], np.full((1, 1, 1), 1 / RATE_HZ), np.array([[RF.size]])
    options = {"carrier_hz": 5e6, "pulse_rate_hz": PULSE_RATE_HZ, "record_samples": SAMPLES, "lines": "2"}
    recording = read(tmp_path / "kwave.h5", options)
    np.testing.assert_array_equal(recording.values[0, 0], -RF)
    assert recording.sample_rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    np.save(tmp_path / "vector.npy", RF.reshape(-1))
    recording = read(tmp_path / "vector.npy", RATES | {"record_samples": SAMPLES})
    np.testing.assert_array_equal(recording.values[0, 0], RF)


def test_a_wav_file_states_its_rate_and_an_option_contradicts_it_in_words(tmp_path: Path) -> None:
    codes = np.rint(RF * 5000).astype("<i2")
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 2, 48000, codes.size, "NONE", ""))
        file.writeframes(codes.tobytes())
    recording = read(tmp_path / "a.wav", RATES | {"record_samples": SAMPLES})
    np.testing.assert_array_equal(recording.values[0, 0], codes)
    assert "sample_rate_hz = 4e+07 from an option, the file states 48000" in recording.inferred


def csv_text(pulse: int, start_s: float = 0.0, rate_hz: float = RATE_HZ) -> str:
    lines = [f"{start_s + sample / rate_hz:.9e},{RF[pulse, sample]:.9f}" for sample in range(SAMPLES)]
    return "time_s,volt\n" + "\n".join(lines)


def csv_files(folder: Path) -> list[Path]:
    paths = [folder / f"shot_{pulse + 1}.csv" for pulse in range(PULSES)]
    for pulse, path in enumerate(paths):
        path.write_text(csv_text(pulse))
    return paths


def test_files_of_one_pulse_each_are_ordered_by_their_numbers(
    scene_of_gate: Callable[[float, float, float], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = csv_files(tmp_path)
    recording = read(paths, {"carrier_hz": 5e6, "pulse_rate_hz": PULSE_RATE_HZ})
    np.testing.assert_allclose(recording.values[0, 0], RF, atol=1e-9)
    assert recording.sample_rate_hz == pytest.approx(RATE_HZ)
    assert recording.inferred[0] == "11 files, one pulse each: shot_1.csv to shot_11.csv"
    # As the shell orders them, and as a pattern that the shell left alone.
    monkeypatch.chdir(tmp_path)
    scene = scene_of_gate(0.3e-3, 0.3e-3, 800.0)
    rates = ["--set", "carrier_hz=5e6", "--set", "pulse_rate_hz=4e3", "--scene", str(scene)]
    for sources in (sorted(path.name for path in paths), ["shot_*.csv"]):
        done = CliRunner().invoke(app, ["import", *sources, *rates, "-o", f"{len(sources)}.h5"])
        assert done.exit_code == 0, done.output
        assert "11 files, one pulse each: shot_1.csv to shot_11.csv" in done.output
    absent = CliRunner().invoke(app, ["import", "none_*.csv", *rates])
    assert (absent.exit_code, "none_*.csv does not exist" in absent.output) == (2, True)


def test_files_of_one_frame_each_get_their_axes_from_the_option(tmp_path: Path) -> None:
    paths = [tmp_path / f"{pulse}.npy" for pulse in range(PULSES)]
    for pulse, path in enumerate(paths):
        np.save(path, np.stack([RF[pulse], 2 * RF[pulse]]))
    recording = read(paths, RATES | {"axes": "pulse,line,sample", "lines": "2"})
    np.testing.assert_array_equal(recording.values[0, 0], 2 * RF)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (csv_text(2).rsplit("\n", 1)[0], "shot_3.csv holds samples of (31,), shot_1.csv of (32,)"),
        (csv_text(2, rate_hz=50e6), "shot_3.csv: its 'column 1 (time_s)' differs from that in shot_1.csv"),
        (csv_text(2)[:-4] + "x", "shot_3.csv: line 33 has values that are not numbers"),
        (csv_text(2, start_s=5e-5), "records begin up to 2000 samples apart"),
        ("", "shot_3.csv is empty"),
        (None, "shot_3.csv does not exist"),
    ],
)
def test_files_that_do_not_belong_together_are_refused_by_name(text: str | None, said: str, tmp_path: Path) -> None:
    paths = csv_files(tmp_path)
    if text is None:
        paths[2].unlink()
    else:
        paths[2].write_text(text)
    with pytest.raises(SettingsError) as refused:
        read(paths, {"carrier_hz": 5e6, "pulse_rate_hz": PULSE_RATE_HZ})
    assert said in str(refused.value)


def test_a_time_column_of_an_array_is_no_pulse() -> None:
    table = np.column_stack([np.arange(SAMPLES) / RATE_HZ, RF.T])
    with pytest.raises(SettingsError, match=r"the first column of 'array' ascends by 2.5e-08: times or an index"):
        read(table, RATES | {"axes": "sample,pulse"})


def test_python_objects_are_refused_with_what_to_do(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array(list(RF), dtype=object), allow_pickle=True)
    np.savez(tmp_path / "b.npz", data=np.array({"rf": RF}))
    for name, function in (("a.npy", "save"), ("b.npz", "savez")):
        with pytest.raises(SettingsError, match=rf"holds Python objects.*Try: .*numpy\.{function}\('.', numpy\.stack"):
            read(tmp_path / name)


def test_a_binary_file_of_an_oscilloscope_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "RigolWFM", None)
    for name, content in (("a.trc", b"WAVEDESC"), ("a.bin", b"AG10\0\0\0\0"), ("a.wfm", b"\x0f\x0f:WFM#003")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SettingsError, match=r"Try: pip install 'hpe-rig\[oscilloscope\]', or save it as CSV"):
            read(tmp_path / name)


def slow_echoes(*shape: int) -> np.ndarray[Any, Any]:
    """Return noise along the last axis that changes little along the one before it."""
    noise = np.random.default_rng(2).normal(size=(*shape[:-2], 1, shape[-1]))
    return noise + 0.1 * np.random.default_rng(3).normal(size=shape)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (slow_echoes(20, 300), 'axes = "pulse,sample"'),
        (slow_echoes(300, 20), 'axes = "pulse,sample"'),
        (slow_echoes(300, 20).T, 'axes = "sample,pulse"'),
        (slow_echoes(12, 20, 300), 'axes = "line,pulse,sample"'),
        (slow_echoes(12, 20, 300).transpose(2, 0, 1), 'axes = "sample,line,pulse"'),
        (np.stack([slow_echoes(20, 300)] * 2, axis=-1), 'axes = "pulse,sample,iq"'),
        (slow_echoes(2, 3000).T, 'axes = "sample,line" and record_samples'),
        (slow_echoes(3, 3000), 'axes = "line,sample" and record_samples'),
    ],
)
def test_suggested_axes_fit_lengths_and_echoes(array: np.ndarray[Any, Any], said: str) -> None:
    with pytest.raises(SettingsError) as refused:
        read(array)
    assert said in str(refused.value)


@pytest.mark.parametrize("shape", [(5, 0), (0, 5), (40, 1), (1, 1)])
def test_an_array_without_records_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(SettingsError, match=r"no array of numbers|carry no motion"):
        read(np.ones(shape), RATES | {"axes": "pulse,sample"})


def test_a_damaged_wav_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(48_000)
        file.writeframes(bytes(1000))
    whole = path.read_bytes()
    # Cut within the samples; zero channels; no chunk of samples.
    for damaged in (whole[:-100], whole[:22] + b"\0" + whole[23:], whole[:36] + b"D" + whole[37:]):
        path.write_bytes(damaged)
        with pytest.raises(SettingsError, match="no whole WAV file"):
            read(path)


def test_the_hint_for_unknown_axes_takes_no_lines_of_an_image_for_pulses() -> None:
    rng = np.random.default_rng(1)
    lines = rng.normal(size=(40, 64))
    pulses = lines[:2, None] + 0.01 * rng.normal(size=(2, 40, 64))
    for array, hint in (
        (np.stack([lines, lines]), "(neighbours are most alike along the axis of 2, too short for pulses)"),
        (pulses, 'such as axes = "line,pulse,sample" (2 along line, 40 along pulse, 64 along sample;'),
    ):
        with pytest.raises(SettingsError) as refused:
            read_recording(array, read_settings(None)[0])
        assert hint in str(refused.value)
